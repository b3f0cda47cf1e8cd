//! Playing bags to ROS 2, and controlling the player.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{Running, WATCHDOG, open_with_stock_readers, output_of, text_of, wait_until};
use downbeat::bags::{TopicDescription, WriterOptions};
use downbeat::bridge::middleware::{DiscoveryRange, ParticipantOptions, Sample};
use downbeat::bridge::ros::{MessageType, Node, NodeName, Participant};
use downbeat::msgs::builtin_interfaces::msg::{Duration, Time};
use downbeat::msgs::qos::QosProfile;
use downbeat::msgs::rosbag2_interfaces::msg::ReadSplitEvent;
use downbeat::msgs::rosbag2_interfaces::srv::{
    Burst, BurstRequest, GetRate, GetRateRequest, IsPaused, IsPausedRequest, Pause, PauseRequest, Play,
    PlayNext, PlayNextRequest, PlayRequest, Resume, ResumeRequest, Seek, SeekRequest, SetRate,
    SetRateRequest, Stop, StopRequest,
};
use downbeat::msgs::{Message, Service, cdr, std_msgs};
use serde_json::json;
use test_machine::free_domain;

const START: i64 = 1_700_000_000;

fn info(name: &str, qos: QosProfile) -> TopicDescription {
    TopicDescription {
        name: name.to_owned(),
        type_name: std_msgs::msg::String::TYPE_NAME.to_owned(),
        definition: std_msgs::msg::String::DEFINITION.to_owned(),
        type_hash: std_msgs::msg::String::TYPE_HASH.to_owned(),
        offered_qos: vec![(&qos).into()],
        format: None,
    }
}

/// `number 0` … one per second on `/chatter`, and a latched `/map` before them.
fn bag(folder: &Path, count: i64) -> PathBuf {
    let bag = folder.join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    let map = writer.add_topic(info("/map", QosProfile::LATCHED)).unwrap();
    let chatter = writer.add_topic(info("/chatter", QosProfile::DEFAULT.keep_last(100))).unwrap();
    let string = |data: String| cdr::to_vec(&std_msgs::msg::String { data });
    writer.write(map, START * 1_000_000_000, 0, &string("the map".into())).unwrap();
    for n in 0..count {
        let time = (START + n) * 1_000_000_000;
        writer.write(chatter, time, time, &string(format!("number {n}"))).unwrap();
    }
    writer.finish().unwrap();
    open_with_stock_readers(&bag);
    bag
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn texts(messages: &[serde_json::Value]) -> Vec<String> {
    messages.iter().map(|message| message["fields"]["data"].as_str().unwrap().to_owned()).collect()
}

fn numbers(range: std::ops::Range<i64>) -> Vec<String> {
    range.map(|number| format!("number {number}")).collect()
}

fn node(domain: u16) -> Node {
    let options =
        ParticipantOptions { discovery_range: DiscoveryRange::Localhost, ..ParticipantOptions::new(domain) };
    let participant = Participant::join(&options).unwrap();
    participant.create_node(NodeName::new("/", "remote_control").unwrap()).unwrap()
}

fn call<S: Service>(node: &Node, name: &str, request: &S::Request) -> S::Response {
    let client = node.client::<S>(&format!("/rosbag2_player/{name}"), QosProfile::SERVICES).unwrap();
    assert!(client.wait_for_service(WATCHDOG), "{name}");
    client.call_and_wait(request, WATCHDOG).unwrap()
}

#[test]
fn services_pause_step_seek_and_stop_a_player() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let bag = bag(folder.path(), 10);
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let qos = json!({"depth": 100});
    peer.ask(json!({"do": "subscribe", "topic": "/renamed", "type": "std_msgs/msg/String", "qos": qos}));
    let clock = json!({"depth": 1, "reliability": "best_effort"});
    peer.ask(json!({"do": "subscribe", "topic": "/clock", "type": "rosgraph_msgs/msg/Clock", "qos": clock}));
    let arguments = [
        "--remap",
        "/chatter:=/renamed",
        "--clock",
        "100",
        "--exclude-topics",
        "/map",
        "--domain",
        &domain.to_string(),
    ];
    let mut player =
        Running::start(&[&["bag", "play", text(&bag), "--start-paused"], &arguments[..]].concat());
    let node = node(domain);
    assert!(call::<IsPaused>(&node, "is_paused", &IsPausedRequest::default()).paused);
    assert!(call::<PlayNext>(&node, "play_next", &PlayNextRequest::default()).success);
    assert_eq!(texts(&peer.take("/renamed", 1)), numbers(0..1));
    let burst = call::<Burst>(&node, "burst", &BurstRequest { num_messages: 2 });
    assert_eq!(burst.actually_burst, 2);
    assert_eq!(texts(&peer.take("/renamed", 2)), numbers(1..3));
    let time = Time::from_nanos((START + 5) * 1_000_000_000 - 1);
    assert!(call::<Seek>(&node, "seek", &SeekRequest { time }).success);
    assert!(call::<PlayNext>(&node, "play_next", &PlayNextRequest::default()).success);
    assert_eq!(texts(&peer.take("/renamed", 1)), numbers(5..6));
    assert_eq!(call::<GetRate>(&node, "get_rate", &GetRateRequest::default()).rate, 1.0);
    assert!(!call::<SetRate>(&node, "set_rate", &SetRateRequest { rate: -1.0 }).success);
    assert!(call::<SetRate>(&node, "set_rate", &SetRateRequest { rate: 20.0 }).success);
    call::<Resume>(&node, "resume", &ResumeRequest::default());
    assert_eq!(texts(&peer.take("/renamed", 4)), numbers(6..10));
    let clock = peer.take("/clock", 1);
    assert!(clock[0]["fields"]["clock"]["sec"].as_i64().unwrap() >= START, "{clock:?}");
    assert!(player.wait().success(), "{}", player.output());
    peer.leave();
}

#[test]
fn a_player_prints_what_it_waits_for() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let bag = bag(folder.path(), 1);
    let printed = text_of(&["bag", "play", text(&bag), "--domain", &domain.to_string()]);
    assert!(printed.contains("waiting up to 3 s for subscribers of /map, /chatter"), "{printed}");
}

#[test]
fn topics_are_played_by_type_and_expression_with_other_qos_and_a_clock() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let bag = bag(folder.path(), 3);
    let overrides = folder.path().join("qos.yaml");
    std::fs::write(&overrides, "/chatter: {reliability: best_effort, depth: 10}\n").unwrap();
    let play = [
        "bag",
        "play",
        text(&bag),
        "-r",
        "100",
        "--domain",
        &domain.to_string(),
        "--disable-keyboard-controls",
    ];
    let by_type = [
        "--topic-types",
        "std_msgs/msg/String",
        "--qos-profile-overrides-path",
        text(&overrides),
        "--clock-topics-all",
    ];
    let played = text_of(&[&play[..], &by_type].concat());
    assert!(played.contains("played 4 messages"), "{played}");
    let by_name = ["--regex", "/chat.*", "--exclude-services", "/switch", "--clock-topics", "/chatter"];
    let reading = ["--read-ahead-queue-size", "1", "--wait-for-all-acked", "1000"];
    let played = text_of(&[&play[..], &by_name, &reading].concat());
    assert!(played.contains("played 3 messages"), "{played}");
    let other_type = text_of(&[&play[..], &["--topic-types", "std_msgs/msg/Bool"]].concat());
    assert!(other_type.contains("played 0 messages"), "{other_type}");
}

#[test]
fn a_bag_with_too_many_topics_for_a_process_is_refused_immediately() {
    let domain = free_domain().to_string();
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("wide");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    for number in 0..5000 {
        writer.add_topic(info(&format!("/topic_{number}"), QosProfile::DEFAULT)).unwrap();
    }
    writer.finish().unwrap();
    let output = output_of(&["bag", "play", text(&bag), "--domain", &domain]);
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && error.contains("the bag has 5000 topics"), "{error}");
    let some = text_of(&["bag", "play", text(&bag), "--domain", &domain, "--topics", "/topic_1"]);
    assert!(some.contains("played 0 messages"), "{some}");
}

#[test]
fn a_service_plays_a_part_of_a_bag() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let bag = bag(folder.path(), 10);
    let options = ["--start-paused", "-r", "100", "--no-latched", "--domain", &domain.to_string()];
    let mut player = Running::start(&[&["bag", "play", text(&bag)], &options[..]].concat());
    let node = node(domain);
    let seconds = |seconds: i64| Time::from_nanos(seconds * 1_000_000_000);
    let part = PlayRequest {
        start_offset: seconds(2),
        playback_duration: Duration::from_nanos(1_500_000_000),
        playback_until_timestamp: seconds(START + 6),
    };
    assert!(call::<Play>(&node, "play", &part).success);
    assert!(player.wait().success(), "{}", player.output());
    assert!(player.output().contains("played 5 messages"), "2 to 6: {}", player.output());
}

#[test]
fn a_player_says_when_it_goes_on_to_the_next_file() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    let chatter = writer.add_topic(info("/chatter", QosProfile::DEFAULT)).unwrap();
    let string = cdr::to_vec(&std_msgs::msg::String::default());
    for n in 0..3 {
        writer.write(chatter, n * 1_000_000_000, 0, &string).unwrap();
        if n < 2 {
            writer.split().unwrap();
        }
    }
    writer.finish().unwrap();
    let node = node(domain);
    let events: Arc<Mutex<Vec<ReadSplitEvent>>> = Arc::default();
    let heard = Arc::clone(&events);
    let on_event =
        Box::new(move |sample: Sample| heard.lock().unwrap().push(cdr::from_slice(&sample.cdr).unwrap()));
    let message_type = MessageType::new(ReadSplitEvent::TYPE_NAME).unwrap();
    let topic = "/events/read_split";
    let listening = node.subscribe(topic, &message_type, QosProfile::DEFAULT, on_event).unwrap();
    let mut player =
        Running::start(&["bag", "play", text(&bag), "--start-paused", "--domain", &domain.to_string()]);
    wait_until("the player is matched", || listening.matched_publishers() > 0);
    let next = |splits: usize| {
        assert!(call::<PlayNext>(&node, "play_next", &PlayNextRequest::default()).success);
        wait_until("the split is reported", || events.lock().unwrap().len() >= splits);
        assert_eq!(events.lock().unwrap().len(), splits);
    };
    next(0);
    next(1);
    next(2);
    assert!(!call::<PlayNext>(&node, "play_next", &PlayNextRequest::default()).success);
    call::<Stop>(&node, "stop", &StopRequest::default());
    assert!(player.wait().success(), "{}", player.output());
    let events = events.lock().unwrap();
    for (number, event) in events.iter().enumerate() {
        let file = |number: usize| text(&bag.join(format!("bag_{number}.mcap"))).to_owned();
        assert_eq!((&event.closed_file, &event.opened_file), (&file(number), &file(number + 1)));
        assert_eq!(event.node_name, "/rosbag2_player");
    }
    assert_eq!(events.len(), 2, "there is no file after the last one");
}

#[test]
fn a_player_that_repeats_is_stopped_by_a_service() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let bag = bag(folder.path(), 3);
    let mut player =
        Running::start(&["bag", "play", text(&bag), "--loop", "-r", "100", "--domain", &domain.to_string()]);
    let node = node(domain);
    call::<Pause>(&node, "pause", &PauseRequest::default());
    assert!(call::<IsPaused>(&node, "is_paused", &IsPausedRequest::default()).paused);
    let playing = |part: PlayRequest| call::<Play>(&node, "play", &part).success;
    assert!(playing(PlayRequest::default()));
    assert!(!playing(PlayRequest::default()), "it is already playing");
    call::<Stop>(&node, "stop", &StopRequest::default());
    assert!(player.wait().success(), "{}", player.output());
    assert!(player.output().contains("played "), "{}", player.output());
}

#[test]
fn recorded_requests_are_sent_to_a_server_again() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Bags", "`bag play --publish-service-requests`", With::Rclpy, Way::Out);
    let service = "/reference/set_torque";
    peer.ask(json!({"do": "serve", "service": service, "type": "std_srvs/srv/SetBool"}));
    // A bag of the real recorder, which did not store the definition of the type.
    let bag = concat!(env!("CARGO_MANIFEST_DIR"), "/bags/tests/data/jazzy_mcap");
    let play = ["bag", "play", bag, "--publish-service-requests", "--services", service, "-r", "10"];
    let played = text_of(&[&play[..], &["--domain", &domain.to_string()]].concat());
    assert!(played.contains("played 17 messages; 0 were refused"), "{played}");
    let sent: Vec<_> = (0..17).map(|n| json!({"data": n % 2 == 0})).collect();
    assert_eq!(peer.ask(json!({"do": "requests_to", "service": service})), json!(sent));
    // No client published events of its requests.
    let played = text_of(
        &[&play[..], &["--service-requests-source", "client_introspection", "--domain", &domain.to_string()]]
            .concat(),
    );
    assert!(played.contains("played 0 messages; 0 were refused"), "{played}");
    peer.leave();
}

#[test]
fn messages_latched_before_the_start_are_played_and_the_end_is_respected() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let bag = bag(folder.path(), 10);
    let options =
        ["-r", "100", "--start-offset", "4", "--playback-duration", "2.5", "--domain", &domain.to_string()];
    let played = text_of(&[&["bag", "play", text(&bag)], &options[..]].concat());
    assert!(played.contains("played 4 messages"), "the map, and 4 to 6: {played}");
    let played = text_of(&[&["bag", "play", text(&bag), "--no-latched"], &options[..]].concat());
    assert!(played.contains("played 3 messages"), "{played}");
    let until =
        ["-r", "100", "--playback-until-sec", "1700000001", "-e", "/chat.*", "--domain", &domain.to_string()];
    let played = text_of(&[&["bag", "play", text(&bag)], &until[..]].concat());
    assert!(played.contains("played 2 messages"), "{played}");
}

#[test]
fn messages_of_types_in_idl_are_played_and_topics_that_cannot_be_are_an_error() {
    let domain = free_domain().to_string();
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/bags");
    let played = |bag: &str, arguments: &[&str]| {
        let bag = folder.join(bag);
        let always = ["bag", "play", text(&bag), "--domain", &domain, "--disable-keyboard-controls"];
        let output = output_of(&[&always, arguments].concat());
        let said = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
        (output.status.success(), said)
    };
    let (is_success, said) = played("idl_simple.mcap", &[]);
    assert!(is_success && said.contains("played 3 messages; 0 were refused"), "{said}");
    let (is_success, said) = played("idl_composite.mcap", &[]);
    assert!(is_success && said.contains("played 4 messages; 0 were refused"), "{said}");
    let (is_success, said) = played("foxlog.mcap", &["--topics", "/log"]);
    assert!(!is_success && said.contains("nothing of /log can be played"), "{said}");
    let reason = "messages in \"json\" of the schema \"foxglove.Log\", which is no ROS 2 type, so they cannot be published; `downbeat bag \
                  export` writes them";
    assert!(said.contains("topic \"/log\" holds") && said.contains(reason), "{said}");
}
