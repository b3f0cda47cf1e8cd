//! What viewers of recorded bags see, and how they play them.

use crate::support::{Frame, Viewer};
use downbeat_bags::{Reader, Selection, SplitLimits, TopicDescription, Truncation, WriterOptions};
use downbeat_edge::Interfaces;
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_view::{Access, BagPlayback, ViewOptions, ViewServer};
use serde_json::{Value, json};
use std::path::Path;
use std::process;
use std::time::Duration;
use tempfile::TempDir;

const MS: u64 = 1_000_000;
/// The time of the first message.
const START: u64 = 1_000_000_000_000;

/// A second of `/pose` every 10 ms with its number, the latched `/map` at the start, and `/rare` at 500 ms;
/// in several files of several chunks.
fn record(folder: &Path) {
    let options = WriterOptions::new()
        .chunk_size(512)
        .split(SplitLimits { max_bytes: Some(4096), ..SplitLimits::default() });
    let mut writer = options.create(folder).unwrap();
    let mut add = |name: &str, qos: QosProfile| {
        let topic = TopicDescription {
            name: name.to_owned(),
            type_name: "std_msgs/msg/String".to_owned(),
            definition: "string data\n".to_owned(),
            offered_qos: vec![(&qos).into()],
            ..TopicDescription::default()
        };
        writer.add_topic(topic).unwrap()
    };
    let (pose, map) = (add("/pose", QosProfile::DEFAULT), add("/map", QosProfile::LATCHED));
    let rare = add("/rare", QosProfile::DEFAULT);
    let mut write = |topic, ms: u64, text: String| {
        let time = i64::try_from(START + ms * MS).unwrap();
        writer.write(topic, time, time, &cdr::to_vec(&Text { data: text })).unwrap();
    };
    write(map, 0, "map".into());
    for n in 0..=100 {
        write(pose, n * 10, n.to_string());
        if n == 50 {
            write(rare, 500, "rare".into());
        }
    }
    writer.finish().unwrap();
}

struct Shown {
    server: ViewServer,
    folder: TempDir,
}

fn show(playback: BagPlayback) -> Shown {
    let folder = tempfile::tempdir().unwrap();
    record(&folder.path().join("bag"));
    let server = serve(&folder.path().join("bag"), playback);
    Shown { server, folder }
}

fn serve(bag: &Path, playback: BagPlayback) -> ViewServer {
    let options =
        ViewOptions { foxglove: Some(0), access: Access::ReadOnly, ..ViewOptions::new("bag").unwrap() };
    let bags = vec![Reader::open(bag).unwrap()];
    ViewServer::show_bags(bags, &Interfaces::carried(), playback, options).unwrap()
}

fn paused() -> BagPlayback {
    BagPlayback { starts_paused: true, ..BagPlayback::default() }
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Command {
    Play,
    Pause,
}

/// A state of playback: status, time in ms after the start, whether the time jumped, and the request that it
/// answers.
#[derive(Debug, PartialEq)]
struct State(u8, u64, bool, String);

impl Shown {
    fn viewer(&self) -> Viewer {
        Viewer::connect_as(self.server.foxglove_address().unwrap(), "/", "foxglove.sdk.v1").unwrap()
    }
}

/// A request as Foxglove's SDK writes it.
fn request(command: Command, rate: f32, seek_ms: Option<u64>, id: &str) -> Vec<u8> {
    let mut frame = vec![3, u8::from(command == Command::Pause)];
    frame.extend(rate.to_le_bytes());
    frame.push(u8::from(seek_ms.is_some()));
    frame.extend(seek_ms.map_or(0, |ms| START + ms * MS).to_le_bytes());
    frame.extend(u32::try_from(id.len()).unwrap().to_le_bytes());
    frame.extend(id.as_bytes());
    frame
}

fn state(body: &[u8]) -> State {
    let time = u64::from_le_bytes(body[1..9].try_into().unwrap());
    assert_eq!(body.len(), 18 + u32::from_le_bytes(body[14..18].try_into().unwrap()) as usize);
    State(body[0], (time - START) / MS, body[13] == 1, String::from_utf8(body[18..].to_vec()).unwrap())
}

/// Sends a request, and returns the state that answers it. What came before is dropped.
fn control(viewer: &mut Viewer, command: Command, rate: f32, seek_ms: Option<u64>) -> State {
    viewer.send_binary(request(command, rate, seek_ms, "mine"));
    loop {
        let state = state(&viewer.binary(5));
        if state.3 == "mine" {
            return state;
        }
    }
}

/// The next message: its subscription, its time in ms, and its text.
fn message(viewer: &mut Viewer) -> (u32, u64, String) {
    let (subscription, time, bytes) = viewer.message();
    (subscription, (time - START) / MS, cdr::from_slice::<Text>(&bytes).unwrap().data)
}

#[test]
fn a_bag_is_announced_with_its_topics_and_times() {
    let shown = show(paused());
    let viewer = shown.viewer();
    let capabilities = viewer.info["capabilities"].as_array().unwrap();
    assert!(capabilities.contains(&json!("playbackControl")) && capabilities.contains(&json!("time")));
    assert!(!capabilities.contains(&json!("services")) && !capabilities.contains(&json!("clientPublish")));
    assert_eq!(viewer.info["dataStartTime"], json!({ "sec": 1000, "nsec": 0 }));
    assert_eq!(viewer.info["dataEndTime"], json!({ "sec": 1001, "nsec": 0 }));
    let channel = viewer.channel("/pose");
    assert_eq!((&channel["encoding"], &channel["schemaEncoding"]), (&json!("cdr"), &json!("ros2msg")));
    assert_eq!(
        (&channel["schemaName"], &channel["schema"]),
        (&json!("std_msgs/msg/String"), &json!("string data\n"))
    );
}

/// Viewers read the language of `.msg` files, but not IDL as `rosidl` writes it.
#[test]
fn types_that_are_defined_in_idl_are_announced_as_messages() {
    let bags = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/bags");
    for (file, topic, type_name, lines) in [
        ("idl_simple.mcap", "/simple", "my_msgs/msg/Simple", &["int32 a", "float64 b"][..]),
        (
            "idl_composite.mcap",
            "/bed",
            "garden_msgs/msg/Bed",
            &[
                "uint8 WET=1",
                "garden_msgs/Plant[2] corners",
                "MSG: garden_msgs/Plant",
                "MSG: std_msgs/Header",
            ],
        ),
    ] {
        let server = serve(&bags.join(file), paused());
        let mut viewer =
            Viewer::connect_as(server.foxglove_address().unwrap(), "/", "foxglove.sdk.v1").unwrap();
        let channel = viewer.channel(topic);
        assert_eq!(
            (&channel["schemaName"], &channel["schemaEncoding"], &channel["encoding"]),
            (&json!(type_name), &json!("ros2msg"), &json!("cdr"))
        );
        let schema = channel["schema"].as_str().unwrap();
        assert!(lines.iter().all(|line| schema.lines().any(|found| found == *line)), "{schema}");
        viewer.subscribe(1, topic);
        let (_, time, bytes) = viewer.message();
        let first = Reader::open(bags.join(file)).unwrap();
        let first = first.messages(Selection::all()).unwrap().next().unwrap().unwrap();
        assert_eq!((i64::try_from(time).unwrap(), &bytes[..]), (first.log_time, &first.data[..]));
    }
}

#[test]
fn a_subscription_receives_the_last_message_while_the_bag_is_paused() {
    let shown = show(BagPlayback { start_offset: Duration::from_millis(505), ..paused() });
    let mut viewer = shown.viewer();
    assert_eq!(
        state(&viewer.binary(5)),
        State(1, 505, false, String::new()),
        "a new viewer learns the state"
    );
    for (id, topic, time, text) in [(1, "/map", 0, "map"), (2, "/rare", 500, "rare"), (3, "/pose", 500, "50")]
    {
        viewer.subscribe(id, topic);
        assert_eq!(message(&mut viewer), (id, time, text.into()));
    }
}

#[test]
fn after_a_seek_every_topic_has_its_last_message_and_play_goes_on() {
    let shown = show(paused());
    let mut viewer = shown.viewer();
    for (id, topic) in [(1, "/map"), (2, "/rare"), (3, "/pose")] {
        viewer.subscribe(id, topic);
    }
    assert_eq!(control(&mut viewer, Command::Pause, 1.0, Some(734)), State(1, 734, true, "mine".into()));
    assert_eq!(message(&mut viewer), (1, 0, "map".into()));
    assert_eq!(message(&mut viewer), (2, 500, "rare".into()));
    assert_eq!(message(&mut viewer), (3, 730, "73".into()));
    assert_eq!(control(&mut viewer, Command::Play, 2.0, None), State(0, 734, false, "mine".into()));
    // States overtake messages.
    let (mut poses, mut has_ended) = (Vec::new(), false);
    while poses.len() < 27 || !has_ended {
        match viewer.wait_for(|_| true) {
            Frame::Binary(frame) if frame[0] == 1 => {
                assert_eq!(frame[1..5], [3, 0, 0, 0]);
                poses.push(cdr::from_slice::<Text>(&frame[13..]).unwrap().data);
            }
            Frame::Binary(frame) if frame[0] == 5 => {
                assert_eq!(state(&frame[1..]), State(3, 1000, false, String::new()), "it ends by itself");
                has_ended = true;
            }
            _ => {}
        }
    }
    assert_eq!(poses, (74..=100).map(|n: u32| n.to_string()).collect::<Vec<_>>());
    // Before the first message of a topic there is none.
    assert_eq!(control(&mut viewer, Command::Pause, 2.0, Some(100)), State(1, 100, true, "mine".into()));
    assert_eq!(message(&mut viewer), (1, 0, "map".into()));
    assert_eq!(message(&mut viewer), (3, 100, "10".into()));
    assert_eq!(control(&mut viewer, Command::Pause, 2.0, Some(5000)).1, 1000, "the end is the last time");
}

#[test]
fn every_message_arrives_once_although_subscriptions_change() {
    let shown = show(paused());
    let mut viewer = shown.viewer();
    viewer.subscribe(1, "/pose");
    assert_eq!(message(&mut viewer), (1, 0, "0".into()));
    control(&mut viewer, Command::Play, 1.0, None);
    let mut poses = Vec::new();
    while poses.last() != Some(&"100".to_owned()) {
        let (subscription, _, text) = message(&mut viewer);
        if subscription != 1 {
            continue;
        }
        poses.push(text);
        // The messages are read again from here, with another selection.
        let others = poses.len() as u32;
        if others.is_multiple_of(20) {
            let channel = viewer.channel("/rare")["id"].clone();
            viewer.send(
                json!({ "op": "subscribe", "subscriptions": [{ "id": 1 + others, "channelId": channel }] }),
            );
        } else if others % 20 == 10 && others > 20 {
            viewer.send(json!({ "op": "unsubscribe", "subscriptionIds": [others - 9] }));
        }
    }
    let expected: Vec<_> = (1..=100).map(|n: u32| n.to_string()).collect();
    assert_eq!(poses, expected);
}

#[test]
fn all_viewers_see_the_same_time() {
    let shown = show(paused());
    let (mut one, mut other) = (shown.viewer(), shown.viewer());
    other.subscribe(7, "/pose");
    assert_eq!(message(&mut other).1, 0);
    control(&mut one, Command::Pause, 1.0, Some(300));
    let is_jump = |frame: &Frame| matches!(frame, Frame::Binary(bytes) if bytes[0] == 5 && bytes[14] == 1);
    assert!(matches!(other.wait_for(is_jump), Frame::Binary(bytes) if state(&bytes[1..]).1 == 300));
    assert_eq!(message(&mut other), (7, 300, "30".into()));
}

#[test]
fn playback_starts_with_the_first_viewer_and_repeats() {
    let shown = show(BagPlayback {
        repeats: true,
        start_offset: Duration::from_millis(900),
        ..BagPlayback::default()
    });
    let mut viewer = shown.viewer();
    viewer.subscribe(1, "/pose");
    for _ in 0..2 {
        while message(&mut viewer).2 != "100" {}
        assert!(message(&mut viewer).1 <= 900, "from the start again");
    }
}

#[test]
fn the_client_class_gets_times_and_no_frame_that_it_does_not_know() {
    let shown = show(paused());
    let mut old = Viewer::connect(shown.server.foxglove_address().unwrap(), "/").unwrap();
    let mut new = shown.viewer();
    control(&mut new, Command::Pause, 1.0, Some(250));
    loop {
        match old.wait_for(|_| true) {
            Frame::Binary(frame) if frame[0] == 2 => {
                if u64::from_le_bytes(frame[1..].try_into().unwrap()) == START + 250 * MS {
                    break;
                }
            }
            frame => assert!(!matches!(&frame, Frame::Binary(bytes) if bytes[0] == 5), "a state of playback"),
        }
    }
}

#[test]
fn the_client_class_reads_a_bag_that_is_played() {
    let Some(modules) = test_machine::node_modules() else { return };
    let shown = show(BagPlayback { start_offset: Duration::from_millis(700), ..BagPlayback::default() });
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/node/bag.mjs");
    let mut node = process::Command::new("node");
    node.arg(script).arg(shown.server.foxglove_url().unwrap()).env("DOWNBEAT_NODE_MODULES", modules);
    let output = node.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(found["errors"], json!([]));
    assert_eq!(found["info"]["dataEndTime"], json!({ "sec": 1001, "nsec": 0 }));
    let numbers =
        found["texts"].as_array().unwrap().iter().map(|text| text.as_str().unwrap().parse::<u64>().unwrap());
    let numbers: Vec<_> = numbers.collect();
    assert!(numbers[0] >= 70 && numbers.windows(2).all(|pair| pair[1] == pair[0] + 1), "{numbers:?}");
    let times: Vec<u64> = found["times"]
        .as_array()
        .unwrap()
        .iter()
        .map(|time| time.as_str().unwrap().parse().unwrap())
        .collect();
    assert!(times[0] >= START + 700 * MS && times.is_sorted(), "{times:?}");
}

#[test]
fn a_damaged_bag_is_shown_up_to_the_damage_with_a_message() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    record(&bag);
    // The last file lacks its end, as after a crash.
    let last = Reader::open(&bag).unwrap().files().last().unwrap().to_owned();
    let bytes = std::fs::read(&last).unwrap();
    std::fs::write(&last, &bytes[..bytes.len() / 2]).unwrap();
    let reader = Reader::open(&bag).unwrap();
    let loss = reader.truncation().next().map(Truncation::to_string).unwrap();
    let end = reader.end_time().unwrap();
    let server = serve(&bag, paused());
    let mut viewer = Viewer::connect_as(server.foxglove_address().unwrap(), "/", "foxglove.sdk.v1").unwrap();
    let told = viewer.json("status");
    assert_eq!((&told["level"], &told["message"]), (&json!(1), &json!(loss)));
    viewer.subscribe(1, "/pose");
    control(&mut viewer, Command::Pause, 1.0, Some(1000));
    let time = loop {
        let (_, time, _) = viewer.message();
        if time > START {
            break time;
        }
    };
    assert!(time <= u64::try_from(end).unwrap() && time > START + 500 * MS, "{time}");
}

#[test]
fn a_seek_reads_only_what_it_needs() {
    let shown = show(paused());
    // Chunks between the map and the end are damaged: nobody needs them.
    let bag = shown.folder.path().join("bag");
    let middle = Reader::open(&bag).unwrap().files().nth(1).unwrap().to_owned();
    drop(shown.server);
    let mut bytes = std::fs::read(&middle).unwrap();
    let length = bytes.len();
    bytes[100..length / 3].fill(0xA5);
    std::fs::write(&middle, bytes).unwrap();
    let server = serve(&bag, paused());
    let mut viewer = Viewer::connect_as(server.foxglove_address().unwrap(), "/", "foxglove.sdk.v1").unwrap();
    viewer.subscribe(1, "/map");
    viewer.subscribe(2, "/pose");
    viewer.send_binary(request(Command::Pause, 1.0, Some(990), "end"));
    let is_status = |frame: &Frame| matches!(frame, Frame::Json(value) if value["op"] == "status");
    let last = cdr::to_vec(&Text { data: "99".into() });
    viewer.wait_for(|frame| {
        assert!(!is_status(frame), "{frame:?}");
        matches!(frame, Frame::Binary(bytes) if bytes[0] == 1 && bytes[13..] == last)
    });
    // Who plays it is told.
    viewer.send_binary(request(Command::Play, 20.0, Some(0), "start"));
    viewer.wait_for(is_status);
    while message(&mut viewer).2 != "100" {}
}

#[test]
fn requests_that_make_no_sense_are_answered_and_change_nothing() {
    let shown = show(paused());
    let mut viewer = shown.viewer();
    viewer.send_binary(vec![3, 9, 0, 0]);
    assert!(viewer.json("status")["message"].as_str().unwrap().contains("damaged"));
    viewer.send(json!({ "op": "advertise", "channels": [{ "id": 1, "topic": "/pose", "encoding": "cdr", "schemaName": "std_msgs/msg/String" }] }));
    assert!(viewer.json("status")["message"].as_str().unwrap().contains("read-only"));
    viewer.send(json!({ "op": "getParameters", "parameterNames": [] }));
    assert!(viewer.json("status")["message"].as_str().unwrap().contains("recorded bag"));
    // Rates that are no rates.
    for rate in [f32::NAN, -1.0, 0.0, f32::INFINITY] {
        assert_eq!(control(&mut viewer, Command::Pause, rate, None).1, 0);
    }
}

#[test]
fn bags_of_the_real_recorder_are_shown_in_full() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../bags/tests/data");
    for bag in ["jazzy_mcap", "jazzy_mcap_zstd"] {
        let bag = data.join(bag);
        let reader = Reader::open(&bag).unwrap();
        let mut expected = std::collections::BTreeMap::new();
        for message in reader.messages(downbeat_bags::Selection::all()).unwrap().flatten() {
            let name = &reader.topics()[message.topic.index()].info.name;
            expected.entry(name.clone()).or_insert_with(Vec::new).push(message.data.to_vec());
        }
        let server = serve(&bag, paused());
        let mut viewer =
            Viewer::connect_as(server.foxglove_address().unwrap(), "/", "foxglove.sdk.v1").unwrap();
        let is_event = |topic: &str| topic.ends_with("_service_event");
        let shown = viewer.channels.iter().any(|channel| is_event(channel["topic"].as_str().unwrap()));
        assert_eq!(shown, expected.keys().any(|topic| is_event(topic)));
        expected.retain(|name, _| viewer.channels.iter().any(|channel| channel["topic"] == name.as_str()));
        assert!(expected.len() > 5, "{:?}", expected.keys());
        let names: Vec<_> = expected.keys().cloned().collect();
        for (id, name) in names.iter().enumerate() {
            viewer.subscribe(u32::try_from(id).unwrap(), name);
        }
        viewer.send_binary(request(Command::Play, 20.0, None, "go"));
        let mut received = std::collections::BTreeMap::new();
        while received.values().map(Vec::len).sum::<usize>() < expected.values().map(Vec::len).sum::<usize>()
        {
            let (id, _, bytes) = viewer.message();
            received.entry(names[id as usize].clone()).or_insert_with(Vec::new).push(bytes);
        }
        assert_eq!(received, expected);
    }
}
