//! Bags recorded from the command line: other readers read them, a killed recording is readable, and they can
//! be played.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use common::rclpy::Peer;
use common::{
    QUIET_ROBOT, Running, open_with_stock_readers, python, record_until, robot_file, text_of, wait_until,
};
use downbeat::bags::metadata::Metadata;
use downbeat::bags::{Reader, Selection};
use serde_json::json;
use test_machine::free_domain;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Runs the demo without ROS 2 until it has recorded the given number of joint states.
fn recorded(folder: &Path, joint_states: u64) -> (PathBuf, String) {
    let (robot, bag) = (robot_file(folder, |text| text), folder.join("bag"));
    let arguments = ["bag", "record", "--robot", text(&robot), "--output", text(&bag)];
    let output = record_until(&arguments, &bag, "/joint_states", joint_states);
    (bag, output)
}

/// Topic, log time and bytes of every message.
fn messages(bag: &Path) -> Vec<(String, i64, Vec<u8>)> {
    let reader = Reader::open(bag).unwrap();
    let messages = reader.messages(Selection::all()).unwrap().map(Result::unwrap);
    let name = |topic: downbeat::bags::TopicId| reader.topics()[topic.index()].info.name.clone();
    messages.map(|message| (name(message.topic), message.log_time, message.data.to_vec())).collect()
}

#[test]
fn a_robot_reports_how_many_messages_it_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let (bag, output) = recorded(folder.path(), 400);
    let metadata = Metadata::read(&bag.join("metadata.yaml")).unwrap();
    let topics = metadata.topics.iter();
    let counts: BTreeMap<_, _> = topics.map(|topic| (&*topic.name, topic.message_count)).collect();
    for topic in ["/joint_states", "/imu/data_raw", "/bus/exchanges", "/diagnostics", "/module_steps"] {
        assert!(counts[topic] > 0, "{topic} in {counts:?}");
    }
    let reported = format!("recorded {} messages, lost 0", counts.values().sum::<u64>());
    assert!(output.contains(&reported), "{reported:?} in {output}");
    assert_eq!(metadata.custom_data["emulated"], "true");
    assert!(text_of(&["bag", "info", text(&bag)]).contains("Storage id:        mcap"));
}

#[test]
fn a_killed_recording_is_readable_up_to_its_last_chunk() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = (robot_file(folder.path(), |text| text), folder.path().join("bag"));
    let file = bag.join("bag_0.mcap");
    let mut running = Running::start(&["bag", "record", "--robot", text(&robot), "--output", text(&bag)]);
    let size = || std::fs::metadata(&file).map_or(0, |metadata| metadata.len());
    wait_until("a few chunks are written", || size() > 600_000);
    running.signal("-KILL");
    assert!(!running.wait().success());
    let ours = messages(&bag);
    assert!(!ours.is_empty());
    assert_eq!(Reader::open(&bag).unwrap().truncation().count(), 1);
    let info = text_of(&["bag", "info", text(&bag)]);
    assert!(info.contains(&format!("Messages:          {}", ours.len())), "{info}");
    let Some(streamed) = python("stream_bag.py", &[&file]) else { return };
    assert_eq!(streamed["messages"], ours.len());
    assert_eq!(streamed["last_log_time"], ours.iter().map(|message| message.1).max().unwrap());
}

#[test]
fn a_bag_played_into_a_robot_gives_the_same_result_each_time() {
    let folder = tempfile::tempdir().unwrap();
    let (bag, _) = recorded(folder.path(), 300);
    let play = |robot: &str, name: &str| {
        let (path, output) = (folder.path().join(format!("{name}.toml")), folder.path().join(name));
        std::fs::write(&path, robot).unwrap();
        text_of(&["bag", "play", text(&bag), "--into", text(&path), "--record", text(&output)]);
        messages(&output)
    };
    let first = play(QUIET_ROBOT, "first");
    assert!(first.iter().filter(|message| message.0 == "/joint_goals").count() > 100);
    assert_eq!(play(QUIET_ROBOT, "second"), first);
    let on_two_threads = QUIET_ROBOT.replace("[robot]", "[robot]\nlauncher = \"pool\"\nthreads = 2");
    assert_eq!(play(&on_two_threads, "pool"), first);
    open_with_stock_readers(&folder.path().join("pool"));
}

#[test]
fn a_robot_recorded_from_the_network_has_the_bytes_that_it_recorded_itself() {
    let domain = free_domain().to_string();
    let folder = tempfile::tempdir().unwrap();
    let (robot, own) = (robot_file(folder.path(), |text| text), folder.path().join("own"));
    let heard = folder.path().join("heard");
    let mut running = Running::start(&["run", text(&robot), "--domain", &domain, "--record", text(&own)]);
    let record = ["bag", "record", "/joint_states", "--output", text(&heard), "--domain", &domain];
    let mut recorder = Running::start(&record);
    wait_until("joint states are in the file", || {
        heard.join("heard_0.mcap").exists()
            && Reader::open(&heard).is_ok_and(|_| messages(&heard).len() > 300)
    });
    recorder.interrupt();
    running.interrupt();
    let joint_states = |bag: &Path| -> Vec<Vec<u8>> {
        let of_topic = messages(bag).into_iter().filter(|message| message.0 == "/joint_states");
        of_topic.map(|message| message.2).collect()
    };
    // From the first received message on, none is missing, changed or out of order.
    let (own_states, heard_states) = (joint_states(&own), joint_states(&heard));
    let first = own_states.iter().position(|state| *state == heard_states[0]).unwrap();
    let published = &own_states[first..];
    assert!(published.len() >= heard_states.len());
    assert!(published[..heard_states.len()] == heard_states[..], "a joint state was lost or changed");
    for bag in [&own, &heard] {
        open_with_stock_readers(bag);
    }
}

#[test]
fn a_bag_is_not_played_over_what_the_robot_publishes_or_into_a_device() {
    let folder = tempfile::tempdir().unwrap();
    let (bag, _) = recorded(folder.path(), 1);
    let motion_only = folder.path().join("motion_only.toml");
    std::fs::write(&motion_only, QUIET_ROBOT).unwrap();
    let cases = [
        (motion_only, "/joint_goals", "publishes \"/joint_goals\" itself"),
        (folder.path().join("robot.toml"), "/joint_commands", "drives a device"),
    ];
    for (robot, topic, expected) in cases {
        let arguments = ["bag", "play", text(&bag), "--into", text(&robot), "--topics", topic];
        let output = common::output_of(&arguments);
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && message.contains(expected), "{message}");
    }
}

#[test]
fn messages_of_rclpy_are_recorded_and_played_messages_reach_rclpy() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("chatter");
    let qos = json!({"depth": 100, "durability": "transient_local"});
    peer.ask(json!({"do": "advertise", "topic": "/chatter", "type": "std_msgs/msg/String", "qos": qos}));
    let mut recorder = Running::start(&[
        "bag",
        "record",
        "/chatter",
        "/silent",
        "--output",
        text(&bag),
        "--domain",
        &domain.to_string(),
    ]);
    wait_until("the recorder is matched", || peer.ask(json!({"do": "matched", "topic": "/chatter"})) == 1);
    for number in 0..20 {
        peer.ask(
            json!({"do": "publish", "topic": "/chatter", "fields": {"data": format!("number {number}")}}),
        );
    }
    let file = bag.join("chatter_0.mcap");
    wait_until("the messages are in the file", || {
        file.exists() && Reader::open(&bag).is_ok_and(|_| messages(&bag).len() == 20)
    });
    recorder.interrupt();
    assert!(recorder.output().contains("recorded 20 messages, lost 0"), "{}", recorder.output());
    assert!(recorder.output().contains("nothing is recorded on /silent"), "{}", recorder.output());
    peer.leave();
    open_with_stock_readers(&bag);

    let domain = free_domain();
    let Some(mut listener) = Peer::start(domain, "LOCALHOST") else { return };
    listener.ask(json!({"do": "subscribe", "topic": "/chatter", "type": "std_msgs/msg/String", "qos": qos}));
    text_of(&["bag", "play", text(&bag), "--domain", &domain.to_string()]);
    let received = listener.take("/chatter", 20);
    let texts: Vec<_> = received.iter().map(|message| message["fields"]["data"].as_str().unwrap()).collect();
    assert_eq!(texts, (0..20).map(|number| format!("number {number}")).collect::<Vec<_>>());
    let recorded: Vec<String> = messages(&bag).iter().map(|message| python_peer::hex(&message.2)).collect();
    assert!(recorded.iter().zip(&received).all(|(recorded, received)| received["cdr"] == **recorded));
    listener.leave();
}
