//! `downbeat bag record` of topics in the ROS network: selection, control by services, snapshots.
#![allow(clippy::unwrap_used, missing_docs)]

#[path = "../common/mod.rs"]
mod common;
mod options;

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};

use common::matrix::{Way, With, check};
use common::rclpy::{Peer, python as rclpy_python};
use common::{
    Running, WATCHDOG, downbeat, open_with_stock_readers, python, recorded_messages, text_of, wait_until,
};
use downbeat::bags::metadata::{Metadata, RecordedDurability, RecordedHistory, RecordedReliability};
use downbeat::bags::{Reader, Selection};
use downbeat::bridge::middleware::{DiscoveryRange, ParticipantOptions, Sample};
use downbeat::bridge::ros::{MessageType, Node, NodeName, Participant};
use downbeat::msgs::qos::QosProfile;
use downbeat::msgs::rosbag2_interfaces::msg::WriteSplitEvent;
use downbeat::msgs::rosbag2_interfaces::srv::{
    IsDiscoveryRunning, IsPaused, Pause, Record, RecordRequest, Resume, Snapshot, SplitBagfile,
    StartDiscovery, Stop, StopDiscovery, TogglePaused,
};
use downbeat::msgs::{Message, Service, cdr, std_msgs};
use serde_json::json;
use test_machine::{SmallDisk, free_domain};

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Returns the number of messages on each topic of a bag.
fn counts(bag: &Path) -> BTreeMap<String, u64> {
    let reader = Reader::open(bag).unwrap();
    let topics = reader.topics().iter();
    topics.map(|topic| (topic.info.name.clone(), topic.message_count)).collect()
}

/// A node of this process, limited to loopback.
fn node(name: &str, domain_id: u16) -> Node {
    let options = ParticipantOptions {
        domain_id,
        discovery_range: DiscoveryRange::Localhost,
        ..ParticipantOptions::from_env().unwrap()
    };
    let participant = Participant::join(&options).unwrap();
    participant.create_node(NodeName::new("/", name).unwrap()).unwrap()
}

fn call<S: Service>(node: &Node, service: &str, request: &S::Request) -> S::Response {
    let client = node.client::<S>(service, QosProfile::SERVICES).unwrap();
    assert!(client.wait_for_service(WATCHDOG), "{service}");
    client.call_and_wait(request, WATCHDOG).unwrap()
}

/// A publisher of numbered texts that is matched with the recorder.
struct Talker {
    publisher: downbeat::bridge::ros::Publisher,
    next: u32,
}

impl Talker {
    fn new(node: &Node) -> Self {
        let message_type = MessageType::new(std_msgs::msg::String::TYPE_NAME).unwrap();
        let publisher = node.publish("/chatter", &message_type, QosProfile::DEFAULT).unwrap();
        Self { publisher, next: 0 }
    }

    fn say(&mut self, count: u32) {
        wait_until("the recorder is matched", || self.publisher.matched_subscriptions() > 0);
        for number in self.next..self.next + count {
            let message = std_msgs::msg::String { data: number.to_string() };
            self.publisher.publish(cdr::to_vec(&message).into()).unwrap();
        }
        self.next += count;
    }
}

fn said(bag: &Path) -> Vec<u32> {
    let reader = Reader::open(bag).unwrap();
    texts(&reader, Selection::all())
}

/// Nothing if there is no such bag or topic yet.
fn said_on(bag: &Path, topic: &str) -> Vec<u32> {
    let reader = Reader::open(bag).ok();
    let found =
        reader.and_then(|reader| Some(texts(&reader, Selection::all().topics([reader.topic(topic)?]))));
    found.unwrap_or_default()
}

fn texts(reader: &Reader, selection: Selection) -> Vec<u32> {
    let messages = reader.messages(selection).unwrap().map(Result::unwrap);
    let text = |data: &[u8]| cdr::from_slice::<std_msgs::msg::String>(data).unwrap().data;
    messages.map(|message| text(&message.data).parse().unwrap()).collect()
}

/// The error of sqlite3 if this build supports it, otherwise that of the build.
const NO_ZSTD: &str = if cfg!(feature = "sqlite") {
    "sqlite3 does not support compression"
} else {
    "build with --features sqlite"
};

#[test]
fn without_a_selection_it_prints_what_ros2_bag_record_prints() {
    let domain = free_domain().to_string();
    for (arguments, words) in [
        (&["bag", "record"][..], "Need to specify at least one option out of --all"),
        (&["bag", "record", "/a", "--exclude-regex", "b"], "--exclude-regex argument requires either --all"),
        (&["bag", "record", "/a", "--exclude-topics", "/b"], "--exclude-topics argument requires either"),
        (&["bag", "record", "-a", "-b", "1000"], "the minimum is 1024"),
        (&["bag", "record", "-a", "-e", "("], "regex parse error"),
        (
            &["bag", "record", "-a", "--storage-preset-profile", "small"],
            "none, fastwrite, zstd_fast, zstd_small",
        ),
        (&["bag", "record", "-a", "-s", "rocks"], "mcap, sqlite3"),
        (&["bag", "record", "-a", "-s", "sqlite3", "--zstd"], NO_ZSTD),
        (&["bag", "record", "-a", "-s", "mcap", "--storage-preset-profile", "resilient"], "zstd_small"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let output = downbeat(arguments).args(["--domain", &domain]).current_dir(&folder).output().unwrap();
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && error.contains(words), "{arguments:?}: {error}");
    }
}

#[test]
fn all_topics_of_real_nodes_are_recorded_as_the_real_recorder_notes_them() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let note = check("Bags", "`bag record --all --exclude-regex`, any type", With::Rclpy, Way::In);
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let latched = json!({"durability": "transient_local", "depth": 1});
    let best_effort = json!({"reliability": "best_effort"});
    for (topic, kind, qos) in [
        ("/chatter", "std_msgs/msg/String", json!({})),
        ("/imu", "sensor_msgs/msg/Imu", best_effort),
        ("/map_name", "std_msgs/msg/String", latched),
        ("/noise", "std_msgs/msg/String", json!({})),
        ("/_hidden", "std_msgs/msg/String", json!({})),
        ("/joy", "sensor_msgs/msg/Joy", json!({})),
    ] {
        peer.ask(json!({"do": "advertise", "topic": topic, "type": kind, "qos": qos}));
    }
    peer.ask(json!({"do": "publish", "topic": "/map_name", "fields": {"data": "lawn"}}));
    let arguments = [
        "bag",
        "record",
        "-a",
        "--exclude-regex",
        "noi.e",
        "-o",
        text(&bag),
        "--domain",
        &domain.to_string(),
    ];
    let mut recorder = Running::start(&arguments);
    for topic in ["/chatter", "/imu", "/map_name", "/joy"] {
        wait_until("the recorder is matched", || peer.ask(json!({"do": "matched", "topic": topic})) == 1);
    }
    for number in 0..20 {
        let data = format!("number {number}");
        peer.ask(json!({"do": "publish", "topic": "/chatter", "fields": {"data": data}}));
        peer.ask(json!({"do": "publish", "topic": "/noise", "fields": {"data": data}}));
        peer.ask(json!({"do": "publish", "topic": "/_hidden", "fields": {"data": data}}));
        peer.ask(json!({"do": "publish", "topic": "/imu", "fields": {"orientation": {"w": 1.0}}}));
        peer.ask(json!({"do": "publish", "topic": "/joy", "fields": {"axes": [0.5]}}));
    }
    wait_until("the messages are in the file", || {
        bag.join("metadata.yaml").exists()
            && ["/chatter", "/joy"].iter().all(|topic| counts(&bag).get(*topic) == Some(&20))
            && counts(&bag).get("/map_name") == Some(&1)
    });
    recorder.interrupt();
    peer.leave();

    let counts = counts(&bag);
    assert!(!counts.contains_key("/noise") && !counts.contains_key("/_hidden"), "{counts:?}");
    let metadata = Metadata::read(&bag.join("metadata.yaml")).unwrap();
    let qos = |name: &str| {
        let topic = metadata.topics.iter().find(|topic| topic.name == name).unwrap();
        assert_eq!(topic.offered_qos.len(), 1, "{name}");
        let qos = topic.offered_qos[0];
        assert_eq!((qos.history, qos.depth), (RecordedHistory::Unknown, 0), "{name}: not part of discovery");
        assert!(topic.type_hash.starts_with("RIHS01_"), "{name}");
        (qos.reliability, qos.durability)
    };
    assert_eq!(qos("/chatter"), (RecordedReliability::Reliable, RecordedDurability::Volatile));
    assert_eq!(qos("/imu"), (RecordedReliability::BestEffort, RecordedDurability::Volatile));
    assert_eq!(qos("/map_name"), (RecordedReliability::Reliable, RecordedDurability::TransientLocal));
    open_with_stock_readers(&bag);
    drop(note);
}

#[test]
fn services_pause_resume_split_and_stop_a_recorder() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let node = node("steering", domain);
    let events: Arc<Mutex<Vec<WriteSplitEvent>>> = Arc::default();
    let heard = Arc::clone(&events);
    let on_event =
        Box::new(move |sample: Sample| heard.lock().unwrap().push(cdr::from_slice(&sample.cdr).unwrap()));
    let message_type = MessageType::new(WriteSplitEvent::TYPE_NAME).unwrap();
    let listening =
        node.subscribe("/events/write_split", &message_type, QosProfile::DEFAULT, on_event).unwrap();
    let mut talker = Talker::new(&node);
    let mut recorder = Running::start(&[
        "bag",
        "record",
        "--topics",
        "/chatter",
        "-o",
        text(&bag),
        "--domain",
        &domain.to_string(),
    ]);
    talker.say(10);
    let is_paused = || call::<IsPaused>(&node, "/rosbag2_recorder/is_paused", &Default::default()).paused;
    assert!(!is_paused());
    let flushed = |count: usize| {
        wait_until("the messages are in the file", || {
            bag.join("bag_0.mcap").exists() && said(&bag).len() == count
        });
    };
    flushed(10);
    call::<Pause>(&node, "/rosbag2_recorder/pause", &Default::default());
    assert!(is_paused());
    talker.say(5);
    // Messages and answers take different paths: another call is answered after all of them.
    call::<SplitBagfile>(&node, "/rosbag2_recorder/split_bagfile", &Default::default());
    wait_until("the split is reported", || events.lock().unwrap().len() == 1);
    let event = events.lock().unwrap()[0].clone();
    assert_eq!(
        (event.closed_file.as_str(), event.opened_file.as_str()),
        (text(&bag.join("bag_0.mcap")), text(&bag.join("bag_1.mcap")))
    );
    assert_eq!(event.node_name, "/rosbag2_recorder");
    call::<Resume>(&node, "/rosbag2_recorder/resume", &Default::default());
    assert!(!is_paused());
    talker.say(3);
    flushed(13);
    call::<Stop>(&node, "/rosbag2_recorder/stop", &Default::default());
    // The bag is finished when the request is answered; the recorder may be asked to record again.
    assert!(Reader::open(&bag).unwrap().truncation().next().is_none());
    recorder.interrupt();
    let numbers: BTreeSet<u32> = said(&bag).into_iter().collect();
    assert_eq!(numbers, (0..10).chain(15..18).collect());
    assert_eq!(Metadata::read(&bag.join("metadata.yaml")).unwrap().files.len(), 2);
    open_with_stock_readers(&bag);
    drop(listening);
}

#[test]
fn a_stopped_recorder_records_again_and_looks_for_topics_as_it_is_asked() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let bag = |name: &str| folder.path().join(name);
    let node = node("operator", domain);
    let mut talker = Talker::new(&node);
    let (first, domain) = (bag("bag"), domain.to_string());
    let mut recorder = Running::start(&["bag", "record", "--all", "-o", text(&first), "--domain", &domain]);
    let record = |uri: &str| {
        let request = RecordRequest { uri: uri.to_owned() };
        let response = call::<Record>(&node, "/rosbag2_recorder/record", &request);
        (response.return_code, response.error_string)
    };
    let stop = || call::<Stop>(&node, "/rosbag2_recorder/stop", &Default::default());
    let start_discovery = || {
        let response =
            call::<StartDiscovery>(&node, "/rosbag2_recorder/start_discovery", &Default::default());
        (response.return_code, response.error_string)
    };
    let stop_discovery = || {
        let response = call::<StopDiscovery>(&node, "/rosbag2_recorder/stop_discovery", &Default::default());
        (response.return_code, response.error_string)
    };
    let is_discovering =
        || call::<IsDiscoveryRunning>(&node, "/rosbag2_recorder/is_discovery_running", &Default::default());
    let done = (0, String::new());
    let refused = |reason: &str| (1, reason.to_owned());

    talker.say(2);
    assert_eq!(record(""), refused("a recording is running already: stop it first"));
    wait_until("the messages are in the file", || said_on(&first, "/chatter") == [0, 1]);
    stop();
    assert!(!is_discovering().running);
    assert_eq!(start_discovery(), refused("nothing is being recorded"));
    assert_eq!(stop_discovery(), refused("discovery is not running"));
    stop();

    // Into a directory of its own, of the name that the recorder was started with.
    assert_eq!(record(""), done);
    talker.say(3);
    let second = bag("bag_2");
    wait_until("the messages are in the file", || said_on(&second, "/chatter") == [2, 3, 4]);
    assert_eq!(start_discovery(), refused("discovery is running already"));
    assert!(is_discovering().running);
    assert_eq!(stop_discovery(), done);
    assert!(!is_discovering().running);
    let message_type = MessageType::new(std_msgs::msg::String::TYPE_NAME).unwrap();
    let late = node.publish("/late", &message_type, QosProfile::DEFAULT).unwrap();
    stop();
    assert!(!counts(&second).contains_key("/late"), "nothing looked for it");

    let third = bag("third");
    let (exists, problem) = record(&format!("file://{}", text(&second)));
    assert!(exists == 1 && problem.contains("exists already"), "{problem}");
    call::<TogglePaused>(&node, "/rosbag2_recorder/toggle_paused", &Default::default());
    assert_eq!(record(&format!("file://{}", text(&third))), done);
    wait_until("the recorder is matched", || late.matched_subscriptions() > 0);
    talker.say(2);
    call::<SplitBagfile>(&node, "/rosbag2_recorder/split_bagfile", &Default::default());
    assert!(call::<IsPaused>(&node, "/rosbag2_recorder/is_paused", &Default::default()).paused);
    call::<TogglePaused>(&node, "/rosbag2_recorder/toggle_paused", &Default::default());
    talker.say(1);
    wait_until("the message is in the file", || said_on(&third, "/chatter") == [7]);
    recorder.interrupt();
    assert!(recorder.wait().success(), "{}", recorder.output());
    assert!(counts(&third).contains_key("/late"));
    [first, second, third].iter().for_each(|bag| open_with_stock_readers(bag));
}

#[test]
fn rclpy_sees_the_services_of_the_recorder() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut recorder = Running::start(&[
        "bag",
        "record",
        "--all",
        "--snapshot-mode",
        "-o",
        text(&bag),
        "--domain",
        &domain.to_string(),
    ]);
    let expected = [
        ("is_discovery_running", "IsDiscoveryRunning"),
        ("is_paused", "IsPaused"),
        ("pause", "Pause"),
        ("record", "Record"),
        ("resume", "Resume"),
        ("snapshot", "Snapshot"),
        ("split_bagfile", "SplitBagfile"),
        ("start_discovery", "StartDiscovery"),
        ("stop", "Stop"),
        ("stop_discovery", "StopDiscovery"),
        ("toggle_paused", "TogglePaused"),
    ]
    .map(|(name, of)| (format!("/rosbag2_recorder/{name}"), json!([format!("rosbag2_interfaces/srv/{of}")])));
    let mut seen = json!(null);
    wait_until("rclpy sees the services", || {
        seen = peer.ask(json!({"do": "services_of", "node": "rosbag2_recorder", "namespace": "/"}));
        expected.iter().all(|(name, of)| seen.get(name) == Some(of))
    });
    recorder.interrupt();
}

#[test]
fn a_snapshot_is_written_when_the_service_requests_it() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let domain = free_domain();
    let node = node("snapshots", domain);
    let mut talker = Talker::new(&node);
    let mut recorder = Running::start(&[
        "bag",
        "record",
        "/chatter",
        "--snapshot-mode",
        "--max-cache-size",
        "4000",
        "--snapshot-duration",
        "1h",
        "-o",
        text(&bag),
        "--domain",
        &domain.to_string(),
    ]);
    talker.say(500);
    let mut found = Vec::new();
    // Messages may still be in transit: the last snapshot contains the last messages.
    wait_until("a snapshot has the last message", || {
        assert!(call::<Snapshot>(&node, "/rosbag2_recorder/snapshot", &Default::default()).success);
        found = said(&bag);
        found.last() == Some(&499)
    });
    recorder.interrupt();
    assert!(found.len() < 500, "only the latest: {}", found.len());
    assert!(found.is_sorted());
    assert_eq!(said(&bag), found, "nothing is written without a request");
    open_with_stock_readers(&bag);
}

/// A topic that is not recorded, and comes after the recording has begun.
#[cfg(feature = "state_machine")]
#[test]
fn a_condition_on_topics_of_the_network_takes_a_snapshot() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let domain = free_domain();
    let record = |condition: &str| {
        let arguments =
            ["bag", "record", "/chatter", "--snapshot-when", condition, "--snapshot-duration", "1h"];
        let domain = domain.to_string();
        Running::start(&[&arguments[..], &["-o", text(&bag), "--domain", &domain]].concat())
    };
    let mut refused = record("tank_level.data >");
    assert!(!refused.wait().success());
    assert!(refused.output().contains("--snapshot-when: "), "{}", refused.output());
    std::fs::remove_dir_all(&bag).unwrap_or_default();
    let node = node("tank", domain);
    let mut talker = Talker::new(&node);
    let mut recorder = record("tank_level.data > 2 && age('tank_level') < 10");
    talker.say(100);
    let message_type = MessageType::new(std_msgs::msg::Float64::TYPE_NAME).unwrap();
    let tank = node.publish("/tank/level", &message_type, QosProfile::DEFAULT).unwrap();
    let fill = |data: f64| tank.publish(cdr::to_vec(&std_msgs::msg::Float64 { data }).into()).unwrap();
    wait_until("the condition is watched", || tank.matched_subscriptions() > 0);
    (0..10).for_each(|_| fill(1.9));
    talker.say(100);
    assert_eq!(said_on(&bag, "/chatter"), Vec::<u32>::new());
    fill(2.1);
    fill(2.2);
    wait_until("the snapshot is in the file", || {
        talker.say(1);
        said_on(&bag, "/chatter").len() >= 200
    });
    recorder.interrupt();
    let lines = recorder.output();
    assert_eq!(lines.matches("taking a snapshot: its condition became true").count(), 1, "{lines}");
    let reader = Reader::open(&bag).unwrap();
    assert_eq!(reader.topics().len(), 1, "the topic of the condition was not asked for");
    open_with_stock_readers(&bag);

    std::fs::remove_dir_all(&bag).unwrap();
    let mut recorder = record("tank_lvl.data > 2");
    recorder.wait_for_output("Listening for topics");
    recorder.interrupt();
    let lines = recorder.output();
    assert!(lines.contains("no topic that is published is \"tank_lvl\""), "{lines}");
}

#[test]
fn a_type_that_only_the_ament_path_knows_is_recorded_with_its_definition() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let package = folder.path().join("prefix/share/lawn_msgs/msg");
    std::fs::create_dir_all(&package).unwrap();
    let blade = "# Of grass.\nfloat32 height # m\nstd_msgs/Header header\n";
    std::fs::write(package.join("Blade.msg"), blade).unwrap();
    let bag = folder.path().join("bag");
    let node = node("gardener", domain);
    let message_type = MessageType::new("lawn_msgs/msg/Blade").unwrap();
    let publisher = node.publish("/blades", &message_type, QosProfile::DEFAULT).unwrap();
    let mut command = downbeat(&[
        "bag",
        "record",
        "-e",
        "bla",
        "-o",
        text(&bag),
        "--domain",
        &domain.to_string(),
        "-f",
        "cdr",
    ]);
    let mut recorder = Running::start_by(command.env("AMENT_PREFIX_PATH", folder.path().join("prefix")));
    wait_until("the recorder is matched", || publisher.matched_subscriptions() > 0);
    // Little-endian CDR: height, stamp, frame_id.
    let message = [0, 1, 0, 0, 0, 0, 128, 63, 1, 0, 0, 0, 2, 0, 0, 0, 2, 0, 0, 0, b'a', 0];
    for _ in 0..7 {
        publisher.publish(message.to_vec().into()).unwrap();
    }
    wait_until("the messages are in the file", || {
        bag.join("metadata.yaml").exists() && counts(&bag).get("/blades") == Some(&7)
    });
    recorder.interrupt();
    let reader = Reader::open(&bag).unwrap();
    assert_eq!(counts(&bag), BTreeMap::from([("/blades".to_owned(), 7)]));
    let info = &reader.topics()[reader.topic("/blades").unwrap().index()].info;
    assert!(info.definition.starts_with(blade) && info.definition.contains("MSG: std_msgs/Header"));
    assert!(info.type_hash.starts_with("RIHS01_"));
    open_with_stock_readers(&bag);
}

/// Packages that are generated from IDL install no `.msg` file.
#[test]
fn a_type_that_only_an_idl_file_of_the_ament_path_defines_is_recorded_with_its_definition() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let package = folder.path().join("prefix/share/my_idl/msg");
    std::fs::create_dir_all(&package).unwrap();
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/my_idl/msg/Simple.idl");
    std::fs::copy(source, package.join("Simple.idl")).unwrap();
    let bag = folder.path().join("bag");
    let node = node("gardener", domain);
    let message_type = MessageType::new("my_idl/msg/Simple").unwrap();
    let publisher = node.publish("/simple", &message_type, QosProfile::DEFAULT).unwrap();
    let arguments = ["bag", "record", "/simple", "-o", text(&bag), "--domain", &domain.to_string()];
    let mut recorder =
        Running::start_by(downbeat(&arguments).env("AMENT_PREFIX_PATH", folder.path().join("prefix")));
    wait_until("the recorder is matched", || publisher.matched_subscriptions() > 0);
    // Little-endian CDR: an integer, padding, and 0.5.
    let message = [0, 1, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xe0, 0x3f];
    publisher.publish(message.to_vec().into()).unwrap();
    wait_until("the message is in the file", || recorded_messages(&bag, "/simple") == 1);
    recorder.interrupt();
    let reader = Reader::open(&bag).unwrap();
    let info = &reader.topics()[0].info;
    assert_eq!(info.definition.trim(), "int32 a\nfloat64 b");
    assert!(info.type_hash.starts_with("RIHS01_"));
    let exported = folder.path().join("exported");
    text_of(&["bag", "export", text(&bag), "-f", "jsonl", "-o", text(&exported)]);
    let rows = std::fs::read_to_string(exported.join("simple.jsonl")).unwrap();
    let row: serde_json::Value = serde_json::from_str(rows.trim()).unwrap();
    assert_eq!(row["message"], json!({"a": 7, "b": 0.5}));
    open_with_stock_readers(&bag);
}

#[test]
fn events_of_a_service_of_a_real_node_are_recorded() {
    let domain = free_domain().to_string();
    let Some(interpreter) = rclpy_python() else { return };
    let note =
        check("Bags", "`bag record --services`: events of service introspection", With::Rclpy, Way::In);
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/introspected_service.py");
    let mut node = Command::new(interpreter)
        .arg(script)
        .env("ROS_DOMAIN_ID", &domain)
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(node.stdout.take().unwrap()).lines();
    assert_eq!(lines.next().unwrap().unwrap(), "ready");
    let mut recorder = Running::start(&[
        "bag",
        "record",
        "--services",
        "/set_torque",
        "-o",
        text(&bag),
        "--domain",
        &domain,
    ]);
    recorder.wait_for_output("Subscribed to topic '/set_torque/_service_event'");
    let events = |bag: &Path| counts(bag).get("/set_torque/_service_event").copied().unwrap_or(0);
    let mut input = node.stdin.take().unwrap();
    // A request and an answer, each sent and received: the events are latched, so none is missed.
    writeln!(input, "go").unwrap();
    assert_eq!(lines.next().unwrap().unwrap(), "called");
    wait_until("the events are in the file", || bag.join("metadata.yaml").exists() && events(&bag) >= 8);
    recorder.interrupt();
    drop(input);
    node.wait().unwrap();
    let info = text_of(&["bag", "info", text(&bag)]);
    assert!(info.contains("Service: /set_torque | Type: std_srvs/srv/SetBool | Event Count: 8"), "{info}");
    let metadata = Metadata::read(&bag.join("metadata.yaml")).unwrap();
    assert_eq!(metadata.topics.len(), 1, "no other topic");
    assert_eq!(metadata.topics[0].type_name, "std_srvs/srv/SetBool_Event");
    open_with_stock_readers(&bag);
    drop(note);
}
