//! `downbeat bag record --robot` and `downbeat run --record`: what is selected, and when snapshots are taken.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use common::{
    QUIET_ROBOT, Running, WATCHDOG, downbeat, open_with_stock_readers, output_of, robot_file, text_of,
    wait_until,
};
use downbeat::bags::metadata::Metadata;
use downbeat::bags::{Reader, Selection};
use downbeat::bridge::middleware::{DiscoveryRange, ParticipantOptions};
use downbeat::bridge::ros::{Node, NodeName, Participant};
use downbeat::msgs::qos::QosProfile;
use downbeat::msgs::rosbag2_interfaces::srv::{
    IsDiscoveryRunning, Record, RecordRequest, StartDiscovery, Stop, StopDiscovery,
};
use downbeat::msgs::{Service, cdr, std_msgs};
use test_machine::free_domain;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn a_robot_is_recorded_by_module_and_pattern_into_files_of_a_size() {
    let folder = tempfile::tempdir().unwrap();
    let robot = robot_file(folder.path(), |text| text);
    let bag = folder.path().join("bag");
    let mut recording = Running::start(&[
        "bag",
        "record",
        "--robot",
        text(&robot),
        "-o",
        text(&bag),
        "--modules",
        "hardware",
        "--exclude-regex",
        "^/bus/",
        "-b",
        "60000",
        "--max-bag-files",
        "3",
        "--storage-preset-profile",
        "zstd_fast",
        "--custom-data",
        "place=lawn",
        "weather=fine",
    ]);
    wait_until("a fourth file is begun", || bag.join("bag_3.mcap").exists());
    recording.interrupt();
    let output = recording.output();
    let metadata = Metadata::read(&bag.join("metadata.yaml")).unwrap();
    let topics: BTreeSet<&str> = metadata.topics.iter().map(|topic| topic.name.as_str()).collect();
    assert!(topics.contains("/joint_states") && topics.contains("/imu/data_raw"), "{topics:?}");
    assert!(!topics.contains("/bus/exchanges") && !topics.contains("/joint_goals"), "{topics:?}");
    assert_eq!(metadata.files.len(), 3, "the first was removed");
    assert_eq!((&*metadata.custom_data["place"], &*metadata.custom_data["weather"]), ("lawn", "fine"));
    assert!(output.contains("lost 0"), "{output}");
    open_with_stock_readers(&bag);
}

#[test]
fn a_robot_is_recorded_by_expression_with_a_storage_file() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag, storage) =
        (folder.path().join("robot.toml"), folder.path().join("bag"), folder.path().join("storage.yaml"));
    std::fs::write(&robot, QUIET_ROBOT).unwrap();
    std::fs::write(&storage, "compression: Zstd\nchunkSize: 4096\n").unwrap();
    let what = ["bag", "record", "--robot", text(&robot), "-o", text(&bag), "--regex", "^/cycle_"];
    let how = ["--storage", "mcap", "--storage-config-file", text(&storage), "--sync", "files"];
    let trouble = ["--when-slow", "stop", "--when-disk-full", "stop", "--flush-interval", "200ms"];
    text_of(&[&what[..], &how, &trouble, &["--duration", "500ms"]].concat());
    let reader = Reader::open(&bag).unwrap();
    let topics = reader.topics().iter();
    let recorded: BTreeMap<_, _> = topics.map(|topic| (&*topic.info.name, topic.message_count)).collect();
    assert!(recorded["/cycle_times"] > 0, "{recorded:?}");
    assert!(recorded.keys().all(|topic| topic.starts_with("/cycle_")), "{recorded:?}");
    let file = std::fs::read(bag.join("bag_0.mcap")).unwrap();
    assert!(file.windows(4).any(|bytes| bytes == b"zstd"), "the chunks are compressed");
}

#[test]
fn a_robot_file_selects_what_is_recorded_and_check_prints_it() {
    let folder = tempfile::tempdir().unwrap();
    let record = |keys: &str| {
        let robot = robot_file(folder.path(), |text| {
            let before = text.split("[record]").next().unwrap().to_owned();
            format!("{before}\n[record]\n{keys}\n")
        });
        let output = output_of(&["check", text(&robot)]);
        let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
        text.lines()
            .rfind(|line| line.contains("recorded with") || line.contains(".toml:"))
            .unwrap()
            .to_owned()
    };
    assert!(
        record("topics = [\"imu/*\", \"joint_states\"]")
            .ends_with("recorded with --record: imu/data_raw, joint_states")
    );
    let by_type = record(
        "types = [\"sensor_msgs/msg/JointState\"]\nexcept = [\"joint_goals\"]\nmodules = [\"hardware\"]",
    );
    assert!(by_type.ends_with("recorded with --record: joint_states"), "{by_type}");
    let hidden = record("exposed = false");
    assert!(hidden.contains("bus/exchanges") && !hidden.contains("joint_states"), "{hidden}");
    for (keys, problem) in [
        ("modules = [\"hardwear\"]", "there is no module \"hardwear\" to record, did you mean \"hardware\"?"),
        ("preset = \"zstd_tiny\"", "unknown choice \"zstd_tiny\""),
        ("max_bag_size = 10", "1024 or more"),
        ("disk_full = \"explode\"", "unknown choice"),
    ] {
        let error = record(keys);
        assert!(error.contains(problem), "{error}");
    }
}

/// A robot that is recorded in simulated time only around the third second.
#[cfg(feature = "state_machine")]
#[test]
fn a_condition_on_topics_takes_a_snapshot_of_what_was_before_and_after() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let run = |condition: &str| {
        let record = format!(
            "[record]\ntopics = [\"joint_states\"]\nsnapshot = \"500ms\"\nsnapshot_after = \"300ms\"\n\
             snapshot_when = \"{condition}\"\n"
        );
        let robot =
            robot_file(folder.path(), |text: String| text.replace("[record]\ntopics = \"all\"\n", &record));
        let domain = free_domain().to_string();
        let arguments = ["run", text(&robot), "--fast", "--duration", "4s", "--domain", &domain, "--record"];
        output_of(&[&arguments[..], &[text(&bag)]].concat())
    };
    let refused = run("joint_state.position[0] > 1");
    let error = String::from_utf8(refused.stderr).unwrap();
    assert!(error.contains("no topic \"joint_state\", did you mean \"joint_states\"?"), "{error}");
    std::fs::remove_dir_all(&bag).unwrap_or_default();
    let output = run("joint_states.header.stamp.sec >= 3");
    assert!(output.status.success(), "{output:?}");
    let reader = Reader::open(&bag).unwrap();
    let times: Vec<_> =
        reader.messages(Selection::all()).unwrap().map(|m| m.unwrap().log_time as f64 / 1e9).collect();
    let (first, last) = (times[0], times[times.len() - 1]);
    assert!((2.45..2.55).contains(&first) && (3.25..3.35).contains(&last), "{first} {last}");
    open_with_stock_readers(&bag);
}

#[test]
fn a_bag_names_the_distribution_in_whose_environment_it_was_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let robot = robot_file(folder.path(), |text| text);
    for (variable, named) in [("kilted", "kilted"), ("", "jazzy")] {
        let bag = folder.path().join(named);
        let domain = free_domain().to_string();
        let run = [
            "run",
            text(&robot),
            "--fast",
            "--duration",
            "200ms",
            "--domain",
            &domain,
            "--record",
            text(&bag),
        ];
        let output = downbeat(&run).env("ROS_DISTRO", variable).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        assert_eq!(Reader::open(&bag).unwrap().metadata().unwrap().ros_distro, named);
        open_with_stock_readers(&bag);
    }
}

/// Counts down from 3 to below 0 in half seconds, on `in`.
#[cfg(feature = "state_machine")]
const COUNTDOWN: &str = r#"<scxml xmlns="http://www.w3.org/2005/07/scxml" xmlns:downbeat="urn:downbeat:state_machine" version="1.0">
    <downbeat:publish topic="in" type="std_msgs/msg/Float64"/>
    <downbeat:every period="500ms" event="tick"/>
    <datamodel><data id="left" expr="3"/></datamodel>
    <state id="counts">
        <transition event="tick">
            <assign location="left" expr="left - 1"/>
            <send target="in"><param name="data" expr="left"/></send>
        </transition>
    </state>
</scxml>
"#;

/// A library in Rust panics at the first negative number.
#[cfg(feature = "state_machine")]
#[test]
fn a_panic_takes_a_snapshot_of_what_was_before_and_after() {
    let folder = tempfile::tempdir().unwrap();
    let library = std::env::current_exe().unwrap().with_file_name("libdownbeat_library_example.so");
    let bag = folder.path().join("bag");
    let robot = format!(
        "[robot]\nname = \"counter\"\n[[module]]\nname = \"counter\"\nkind = \"state_machine\"\nfile = \"countdown.scxml\"\n\
         [[module]]\nname = \"amplifier\"\nkind = \"library\"\npath = \"{}\"\n\
         [record]\ntopics = \"all\"\nsnapshot = \"700ms\"\nsnapshot_after = \"600ms\"\nsnapshot_on_panic = true\n",
        library.display()
    );
    let file = folder.path().join("robot.toml");
    std::fs::write(&file, robot).unwrap();
    std::fs::write(folder.path().join("countdown.scxml"), COUNTDOWN).unwrap();
    let arguments = ["run", text(&file), "--fast", "--duration", "5s", "--record", text(&bag)];
    let output = output_of(&arguments);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("taking a snapshot: amplifier panicked"), "{said}");
    let reader = Reader::open(&bag).unwrap();
    let numbers = reader.messages(Selection::all().topics([reader.topic("/in").unwrap()])).unwrap();
    let numbers = numbers
        .map(|message| cdr::from_slice::<std_msgs::msg::Float64>(&message.unwrap().data).unwrap().data);
    assert_eq!(numbers.collect::<Vec<_>>(), [0.0, -1.0, -2.0]);
    assert!(text_of(&["bag", "check", text(&bag)]).contains("0 problems"));
    open_with_stock_readers(&bag);
}

/// The recorder of a robot's own has all services of rosbag2's, of which some can do nothing for it.
#[test]
fn the_recorder_of_a_robot_refuses_what_it_cannot_do_with_a_reason() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = (folder.path().join("robot.toml"), folder.path().join("bag"));
    std::fs::write(&robot, QUIET_ROBOT).unwrap();
    let mut running =
        Running::start(&["run", text(&robot), "--record", text(&bag), "--domain", &domain.to_string()]);
    let options =
        ParticipantOptions { discovery_range: DiscoveryRange::Localhost, ..ParticipantOptions::new(domain) };
    let participant = Participant::join(&options).unwrap();
    let node = participant.create_node(NodeName::new("/", "operator").unwrap()).unwrap();
    let record = || {
        let response = call::<Record>(&node, "record", &RecordRequest::default());
        (response.return_code, response.error_string)
    };
    assert_eq!(record(), (1, "a recording is running already".to_owned()));
    let started = call::<StartDiscovery>(&node, "start_discovery", &Default::default());
    assert_eq!(started.return_code, 1);
    assert!(started.error_string.contains("[record] of its file selects"), "{}", started.error_string);
    let stopped = call::<StopDiscovery>(&node, "stop_discovery", &Default::default());
    assert_eq!((stopped.return_code, &*stopped.error_string), (1, "discovery is not running"));
    assert!(!call::<IsDiscoveryRunning>(&node, "is_discovery_running", &Default::default()).running);
    call::<Stop>(&node, "stop", &Default::default());
    let (code, reason) = record();
    assert!(code == 1 && reason.contains("start it again with --record"), "{reason}");
    assert!(running.is_running(), "the robot goes on");
    running.interrupt();
    open_with_stock_readers(&bag);
}

fn call<S: Service>(node: &Node, service: &str, request: &S::Request) -> S::Response {
    let client = node.client::<S>(&format!("/rosbag2_recorder/{service}"), QosProfile::SERVICES).unwrap();
    assert!(client.wait_for_service(WATCHDOG), "{service}");
    client.call_and_wait(request, WATCHDOG).unwrap()
}
