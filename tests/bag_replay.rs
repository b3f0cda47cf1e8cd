//! A bag as a test of a robot: `downbeat bag replay`.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::{Path, PathBuf};
use std::process::Output;

use common::{Running, WATCHDOG, output_of, record_until, recorded_messages, robot_file, wait_until};
use downbeat::bags::{Reader, Selection, WriterOptions};
use downbeat::bridge::expose::parameter_value;
use downbeat::bridge::middleware::{DiscoveryRange, ParticipantOptions};
use downbeat::bridge::ros::{NodeName, Participant};
use downbeat::executor::SettingValue;
use downbeat::msgs::cdr;
use downbeat::msgs::downbeat_interfaces::msg::CycleTimes;
use downbeat::msgs::qos::QosProfile;
use downbeat::msgs::rcl_interfaces::msg::Parameter;
use downbeat::msgs::rcl_interfaces::srv::{SetParameters, SetParametersRequest};
use downbeat::msgs::sensor_msgs::msg::Imu;
use serde_json::{Value, json};
use test_machine::free_domain;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Records the demo from its first to its last cycle, with more than one second of motion.
fn recorded(folder: &Path, edit: impl Fn(String) -> String) -> (PathBuf, PathBuf) {
    recorded_until("/joint_states", 200, folder, edit)
}

fn recorded_until(
    topic: &str,
    count: u64,
    folder: &Path,
    edit: impl Fn(String) -> String,
) -> (PathBuf, PathBuf) {
    let (robot, bag) = (robot_file(folder, edit), folder.join("bag"));
    let arguments = ["bag", "record", "--robot", text(&robot), "--output", text(&bag)];
    record_until(&arguments, &bag, topic, count);
    (robot, bag)
}

fn replayed(robot: &Path, bag: &Path, options: &[&str]) -> Output {
    output_of(&[&["bag", "replay", text(robot), text(bag)], options].concat())
}

fn output_text(output: &Output) -> String {
    [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned()).concat()
}

fn report(robot: &Path, bag: &Path, options: &[&str]) -> Value {
    let output = replayed(robot, bag, &[options, &["--json"]].concat());
    assert!(output.status.success(), "{}", output_text(&output));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn compared(report: &Value, topic: &str) -> u64 {
    let topics = report["topics"].as_array().unwrap();
    let found = topics.iter().find(|known| known["topic"] == topic);
    found.unwrap_or_else(|| panic!("{topic} in {report}"))["compared"].as_u64().unwrap()
}

fn times_of(bag: &Path, topic: &str) -> Vec<i64> {
    let reader = Reader::open(bag).unwrap();
    let selection = Selection::all().topics(reader.topic(topic));
    reader.messages(selection).unwrap().map(|message| message.unwrap().log_time).collect()
}

/// Creates a copy of the bag in which `change` modifies the messages of a topic. It is called with the number
/// of each message.
fn altered(bag: &Path, topic: &str, mut change: impl FnMut(usize, Vec<u8>) -> Option<Vec<u8>>) -> PathBuf {
    let reader = Reader::open(bag).unwrap();
    let target = bag.with_file_name("altered");
    let robot = reader.metadata().unwrap().custom_data["robot"].clone();
    let mut writer = WriterOptions::new().custom_data("robot", robot).create(&target).unwrap();
    let topics = reader.topics().iter().map(|topic| writer.add_topic(topic.info.clone()).unwrap());
    let topics: Vec<_> = topics.collect();
    let mut number = 0;
    for message in reader.messages(Selection::all()).unwrap() {
        let message = message.unwrap();
        let mut data = Some(message.data.to_vec());
        if reader.topics()[message.topic.index()].info.name == topic {
            data = change(number, message.data.to_vec());
            number += 1;
        }
        if let Some(data) = data {
            let id = topics[message.topic.index()];
            writer.write(id, message.log_time, message.publish_time, &data).unwrap();
        }
    }
    writer.finish().unwrap();
    target
}

#[test]
fn a_recorded_robot_repeats_bit_for_bit_under_every_launcher() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = recorded(folder.path(), |text| text);
    for launcher in ["linear", "pool:2", "threads"] {
        let report = report(&robot, &bag, &["--launcher", launcher]);
        assert_eq!(report["different"], 0, "{launcher}: {report}");
        assert_eq!(report["has_recorded_cycles"], true);
        for topic in ["/motion/joint_commands", "/joint_goals", "/joint_states", "/bus/exchanges"] {
            assert!(compared(&report, topic) > 100, "{topic} in {report}");
        }
        assert!(compared(&report, "/diagnostics") > 0, "which the process also publishes: {report}");
        assert_eq!(report["left_out"][0]["module"], "emulator");
    }
    let printed = output_text(&replayed(&robot, &bag, &[]));
    assert!(printed.contains("motion, mux in") && printed.contains("hardware in"), "{printed}");
}

#[test]
fn a_different_message_is_reported_with_time_topic_field_and_both_values() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = recorded(folder.path(), |text| text);
    let (mut before, mut after) = (0.0, 0.0);
    let reader = Reader::open(&bag).unwrap();
    let id = reader.topic("/imu/data_raw").unwrap();
    let of_topic = reader.messages(Selection::all().topics([id])).unwrap();
    let message = of_topic.map(Result::unwrap).nth(40).unwrap();
    for (imu, bits) in [(&mut before, 0), (&mut after, 1)] {
        let decoded: Imu = cdr::from_slice(&message.data).unwrap();
        *imu = f64::from_bits(decoded.linear_acceleration.z.to_bits() ^ bits);
    }
    let bag = altered(&bag, "/imu/data_raw", |number, data| {
        let mut imu: Imu = cdr::from_slice(&data).unwrap();
        if number == 40 {
            imu.linear_acceleration.z = after;
        }
        Some(cdr::to_vec(&imu))
    });
    let output = replayed(&robot, &bag, &[]);
    let printed = output_text(&output);
    assert!(!output.status.success());
    for expected in [
        "/imu/data_raw message 40\n  linear_acceleration.z\n".to_owned(),
        format!("recorded {after:?}"),
        format!("replayed {before:?}"),
        format!("first difference: {}", downbeat::executor::Time::from_nanos(message.log_time)),
        "differs from the bag in 1 messages on 1 topics".to_owned(),
    ] {
        assert!(printed.contains(&expected), "{expected:?} in {printed}");
    }
    for allowed in [
        ["--tolerance", "imu/data_raw:linear_acceleration=1e-9"],
        ["--tolerance", "=0.001%"],
        ["--ignore", "imu/*:linear_acceleration.z"],
        ["--ignore", "imu/data_raw"],
    ] {
        let output = replayed(&robot, &bag, &allowed);
        assert!(output.status.success(), "{allowed:?}: {}", output_text(&output));
    }
    let section = "\n[replay]\ntolerance = [\"imu/data_raw:linear_acceleration=1e-9\"]\n";
    let robot_text = std::fs::read_to_string(&robot).unwrap() + section;
    std::fs::write(&robot, robot_text).unwrap();
    let output = replayed(&robot, &bag, &[]);
    assert!(output.status.success(), "as [replay] says: {}", output_text(&output));
}

#[test]
fn extra_and_missing_messages_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = recorded_until("/battery_state", 2, folder.path(), |text| text);
    let shorter = altered(&bag, "/battery_state", |number, data| (number == 0).then_some(data));
    let printed = output_text(&replayed(&robot, &shorter, &["--modules", "hardware"]));
    assert!(printed.contains("/battery_state message 1\n    recorded not at all\n"), "{printed}");
    std::fs::remove_dir_all(&shorter).unwrap();
    let last = Reader::open(&bag).unwrap();
    let count = last.topics()[last.topic("/bus/exchanges").unwrap().index()].message_count as usize;
    let without_answer = altered(&bag, "/bus/exchanges", |number, data| (number + 1 < count).then_some(data));
    let output = replayed(&robot, &without_answer, &["--modules", "hardware"]);
    assert!(!output.status.success(), "{}", output_text(&output));
}

#[test]
fn another_setting_leads_to_another_run() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = recorded(folder.path(), |text| text);
    let output = replayed(&robot, &bag, &["-p", "motion.stand_s:=1.0"]);
    let printed = output_text(&output);
    assert!(!output.status.success() && printed.contains("/motion/joint_commands message "), "{printed}");
    assert!(printed.contains("position["), "{printed}");
    let only = report(&robot, &bag, &["-p", "motion.stand_s:=1.0", "--modules", "mux", "hardware"]);
    assert_eq!(only["modules"], json!(["mux"]), "the messages of the others were input: {only}");
}

#[test]
fn a_killed_recording_replays_up_to_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = (robot_file(folder.path(), |text| text), folder.path().join("bag"));
    let mut running = Running::start(&["bag", "record", "--robot", text(&robot), "--output", text(&bag)]);
    wait_until("goals and joint states are written", || {
        ["/joint_goals", "/joint_states"].iter().all(|topic| recorded_messages(&bag, topic) > 50)
    });
    running.signal("-KILL");
    running.wait();
    let report = report(&robot, &bag, &[]);
    assert!(compared(&report, "/joint_goals") > 10 && compared(&report, "/joint_states") > 10, "{report}");
}

#[test]
fn settings_changed_while_the_robot_ran_change_again() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = (robot_file(folder.path(), |text| text), folder.path().join("bag"));
    let mut running =
        Running::start(&["run", text(&robot), "--domain", &domain.to_string(), "--record", text(&bag)]);
    let options =
        ParticipantOptions { discovery_range: DiscoveryRange::Localhost, ..ParticipantOptions::new(domain) };
    let node =
        Participant::join(&options).unwrap().create_node(NodeName::new("/", "tuner").unwrap()).unwrap();
    let set = node.client::<SetParameters>("/darwin_op/set_parameters", QosProfile::SERVICES).unwrap();
    assert!(set.wait_for_service(WATCHDOG));
    wait_until("it moves", || recorded_messages(&bag, "/joint_goals") > 20);
    // Settings of a module inside the cycle and of a detached module.
    let values =
        [("motion.stand_s", SettingValue::Double(1.5)), ("hardware.p_gain", SettingValue::Integer(16))];
    for (name, value) in values {
        let parameter = Parameter { name: name.to_owned(), value: parameter_value(&value) };
        let request = SetParametersRequest { parameters: vec![parameter] };
        let answer = set.call_and_wait(&request, WATCHDOG).unwrap();
        assert!(answer.results[0].successful, "{name}: {answer:?}");
    }
    let before = recorded_messages(&bag, "/joint_goals");
    wait_until("it has moved on", || recorded_messages(&bag, "/joint_goals") > before + 150);
    running.interrupt();
    for launcher in ["linear", "threads"] {
        let report = report(&robot, &bag, &["--launcher", launcher]);
        assert_eq!(report["different"], 0, "{launcher}: {report}");
    }
    let without = altered(&bag, "/module_settings", |_, _| None);
    let printed = output_text(&replayed(&robot, &without, &[]));
    for topic in ["/motion/joint_commands", "/bus/exchanges"] {
        let line = printed.lines().find(|line| line.contains(topic)).unwrap();
        assert!(!line.trim_end().ends_with(" 0"), "{printed}");
    }
}

#[test]
fn messages_published_while_the_robot_stopped_are_not_compared() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = recorded_until("/joint_goals", 150, folder.path(), |text| text);
    let goals = times_of(&bag, "/joint_goals");
    // As if the robot had begun to stop while a command was in transit from the motion to the multiplexer.
    let begin_of_stop = goals[100] - 1;
    let mut has_ended = false;
    let bag = altered(&bag, "/cycle_times", |_, data| {
        let mut cycles: CycleTimes = cdr::from_slice(&data).unwrap();
        let count = cycles.times.partition_point(|&time| time <= begin_of_stop);
        cycles.is_end = count < cycles.times.len();
        cycles.times.truncate(count);
        let is_before = !has_ended;
        has_ended |= cycles.is_end;
        is_before.then(|| cdr::to_vec(&cycles))
    });
    for modules in [&["motion", "mux"][..], &["mux"]] {
        let report = report(&robot, &bag, &[&["--modules"], modules].concat());
        assert_eq!((&report["different"], compared(&report, "/joint_goals")), (&json!(0), 100), "{report}");
    }
}

#[test]
fn a_detached_module_replays_from_a_bag_without_the_times_of_cycles() {
    let recordings = Path::new(env!("CARGO_MANIFEST_DIR")).join("bags/recordings");
    let (robot, bag) = (recordings.join("darwin_op_emulated.toml"), recordings.join("darwin_op_emulated"));
    let report = report(&robot, &bag, &["--modules", "hardware"]);
    assert!(compared(&report, "/diagnostics") > 10 && compared(&report, "/imu/data_raw") > 1000, "{report}");
}

fn reason_of(report: &Value, topic: &str) -> String {
    let topics = report["not_compared"].as_array().unwrap();
    let found = topics.iter().find(|known| known["topic"] == topic);
    found.unwrap_or_else(|| panic!("{topic} in {report}"))["reason"].as_str().unwrap().to_owned()
}

#[test]
fn topics_that_were_not_compared_are_listed_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = recorded_until("/joint_goals", 20, folder.path(), |text| text);
    let report = report(&robot, &bag, &["--modules", "mux", "--except", "joint_states", "--strict"]);
    assert!(compared(&report, "/joint_goals") > 0, "{report}");
    assert_eq!(reason_of(&report, "/motion/joint_commands"), "published by motion, which was not chosen");
    assert_eq!(reason_of(&report, "/joint_states"), "excluded");
    assert_eq!(reason_of(&report, "/cycle_times"), "the recording's own account of the run");
    let printed = output_text(&replayed(&robot, &bag, &["--modules", "mux"]));
    assert!(
        printed.contains("not compared:") && printed.contains("motion, which was not chosen"),
        "{printed}"
    );
}

#[test]
fn a_replay_that_compared_nothing_fails() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = recorded_until("/joint_goals", 20, folder.path(), |text| text);
    for nothing in [["--except", "joint_goals"], ["--ignore", "joint_goals"]] {
        let output = replayed(&robot, &bag, &[&["--modules", "mux"], &nothing[..]].concat());
        assert_eq!(output.status.code(), Some(1), "{}", output_text(&output));
        assert!(output_text(&output).contains("the replay compared nothing"), "{}", output_text(&output));
    }
}

#[test]
fn topics_of_a_module_that_is_left_out_fail_a_strict_replay() {
    let folder = tempfile::tempdir().unwrap();
    let without = "[record]\nexcept = [\"bus/exchanges\", \"module_events\"]";
    let (robot, bag) = recorded(folder.path(), |text| text.replace("[record]", without));
    let lax = replayed(&robot, &bag, &[]);
    assert!(lax.status.success(), "{}", output_text(&lax));
    let strict = replayed(&robot, &bag, &["--strict"]);
    let printed = output_text(&strict);
    assert_eq!(strict.status.code(), Some(1), "{printed}");
    for expected in [
        "not hardware: it drives a device, and the bag has no /bus/exchanges with the device's answers",
        "without /module_events, which is not in the bag: requests from outside, transitions",
        "not all topics of the replayed modules were compared",
        "/joint_states: published by hardware, which was not replayed",
    ] {
        assert!(printed.contains(expected), "{expected:?} in {printed}");
    }
}

#[test]
fn a_topic_that_the_bag_lacks_is_listed_and_fails_a_strict_replay() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = recorded_until("/joint_goals", 20, folder.path(), |text| {
        text.replace("topics = \"all\"", "topics = [\"joint_goals\", \"joint_states\", \"cycle_times\"]")
    });
    let motion =
        |options: &[&str]| replayed(&robot, &bag, &[&["--modules", "motion", "mux"], options].concat());
    let lenient = output_text(&motion(&[]));
    assert!(lenient.contains("published by motion, but the bag lacks the topic"), "{lenient}");
    let strict = motion(&["--strict"]);
    let printed = output_text(&strict);
    assert_eq!(strict.status.code(), Some(1), "{printed}");
    assert!(printed.contains("not all topics of the replayed modules were compared: /motion/"), "{printed}");
    let excepted = motion(&["--strict", "--except", "motion/joint_commands"]);
    assert!(excepted.status.success(), "{}", output_text(&excepted));
    let section = "\n[replay]\nexcept = [\"motion/*\"]\n";
    std::fs::write(&robot, std::fs::read_to_string(&robot).unwrap() + section).unwrap();
    assert!(motion(&["--strict"]).status.success(), "as [replay] says");
}

#[test]
fn modules_that_cannot_be_replayed_are_reported_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = recorded_until("/joint_goals", 1, folder.path(), |text| {
        text.replace("topics = \"all\"", "topics = [\"joint_goals\", \"cycle_times\"]")
    });
    let printed = output_text(&replayed(&robot, &bag, &["--modules", "hardware"]));
    assert!(
        printed.contains("\"hardware\" cannot be replayed") && printed.contains("/bus/exchanges"),
        "{printed}"
    );
    let printed = output_text(&replayed(&robot, &bag, &["--modules", "legs"]));
    assert!(printed.contains("no module \"legs\"; it has emulator, hardware, motion, mux"), "{printed}");
    let printed = output_text(&replayed(&robot, &bag, &["--modules", "motion"]));
    assert!(printed.contains("no topic that motion publish"), "{printed}");
}
