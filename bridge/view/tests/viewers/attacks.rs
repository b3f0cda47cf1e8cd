//! What viewers cannot do to the robot.

use crate::support::{Frame, Viewer, WATCHDOG, joint_state, open, robot, until};
use downbeat_executor::{Inbox, Received};
use downbeat_msgs::sensor_msgs::msg::Image;
use serde_json::json;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::mpsc::channel;
use std::time::Duration;
use tungstenite::Message;

#[test]
fn connections_beyond_the_limit_are_refused_until_others_leave() {
    let robot = robot(|_| ());
    let mut sockets = Vec::new();
    let mut refused = 0;
    for _ in 0..200 {
        match open(robot.address(), "/", "foxglove.sdk.v1") {
            Ok(socket) => sockets.push(socket),
            Err(_) => refused += 1,
        }
    }
    assert_eq!((sockets.len(), refused), (16, 184));
    let server = robot.server.as_ref().unwrap();
    assert!(server.viewers() <= 16);
    drop(sockets);
    let mut viewer = until(|| Viewer::connect(robot.address(), "/").ok());
    viewer.subscribe(1, "/joint_states");
    robot.move_to(1.0);
    viewer.message();
}

#[test]
fn a_connection_that_says_nothing_is_closed() {
    let robot =
        robot(|options| (options.limits.clients, options.limits.stall) = (1, Duration::from_millis(50)));
    let mut silent = TcpStream::connect(robot.address()).unwrap();
    silent.write_all(b"GET / HTTP/1.1\r\n").unwrap();
    silent.set_read_timeout(Some(WATCHDOG)).unwrap();
    assert!(matches!(silent.read(&mut [0]), Ok(0) | Err(_)));
    until(|| Viewer::connect(robot.address(), "/").ok());
}

#[test]
fn a_peer_that_is_no_viewer_is_disconnected() {
    let robot = robot(|_| ());
    for bytes in
        [&b"GET / HTTP/1.1\r\nHost: a\r\n\r\n"[..], b"\x16\x03\x01\x02\x00", &[b'a'; 100_000], b"\r\n\r\n"]
    {
        let mut peer = TcpStream::connect(robot.address()).unwrap();
        peer.set_read_timeout(Some(WATCHDOG)).unwrap();
        let _ = peer.write_all(bytes);
        let _ = peer.shutdown(std::net::Shutdown::Write);
        let mut answer = Vec::new();
        let _ = peer.read_to_end(&mut answer);
        assert!(!answer.starts_with(b"HTTP/1.1 101"));
    }
    robot.spectator();
}

#[test]
fn a_frame_of_ten_megabytes_ends_the_connection() {
    let robot = robot(|_| ());
    let mut viewer = robot.viewer();
    // The server may end the connection before all is sent.
    let _ = viewer.socket.send(Message::binary(vec![1; 10 << 20]));
    assert!(matches!(viewer.ended(), Some(1009) | None));
    let mut other = robot.spectator();
    other.subscribe(1, "/joint_states");
    robot.move_to(1.0);
    other.message();
}

#[test]
fn a_flood_of_requests_ends_the_connection() {
    let robot = robot(|options| options.limits.incoming_per_second = 50);
    let mut viewer = robot.viewer();
    for _ in 0..200 {
        if viewer.socket.send(Message::text(r#"{"op":"unsubscribe","subscriptionIds":[1]}"#)).is_err() {
            break;
        }
    }
    assert!(matches!(viewer.ended(), Some(1008) | None));
}

#[test]
fn damaged_requests_are_answered_and_change_nothing() {
    let robot = robot(|_| ());
    let mut viewer = robot.viewer();
    for text in [
        "",
        "{",
        "[]",
        "{}",
        r#"{"op":"fly"}"#,
        r#"{"op":"subscribe"}"#,
        r#"{"op":"subscribe","subscriptions":[{"id":-1,"channelId":"a"}]}"#,
    ] {
        viewer.socket.send(Message::text(text)).unwrap();
        assert!(viewer.json("status")["message"].as_str().unwrap().contains("cannot be read"), "{text}");
    }
    for bytes in [vec![], vec![0], vec![1, 0], vec![2; 12], vec![255; 40]] {
        viewer.send_binary(bytes);
        viewer.json("status");
    }
    viewer.send(json!({ "op": "subscribe", "subscriptions": [{ "id": 1, "channelId": 999_999 }] }));
    assert!(viewer.json("status")["message"].as_str().unwrap().contains("no channel 999999"));
    viewer.subscribe(1, "/joint_states");
    let channel = viewer.channel("/joint_states")["id"].clone();
    viewer.send(json!({ "op": "subscribe", "subscriptions": [{ "id": 1, "channelId": channel }] }));
    assert!(viewer.json("status")["message"].as_str().unwrap().contains("exists already"));
    robot.move_to(0.5);
    viewer.message();
}

#[test]
fn subscriptions_and_publications_are_bounded() {
    let robot = robot(|options| (options.limits.subscriptions, options.limits.publications) = (3, 2));
    let mut viewer = robot.viewer();
    let channel = viewer.channel("/joint_states")["id"].clone();
    let subscriptions: Vec<_> = (0..4).map(|id| json!({ "id": id, "channelId": channel })).collect();
    viewer.send(json!({ "op": "subscribe", "subscriptions": subscriptions }));
    assert!(viewer.json("status")["message"].as_str().unwrap().contains("3 subscriptions"));
    let topic = |id| json!({ "id": id, "topic": format!("/new{id}"), "encoding": "cdr", "schemaName": "std_msgs/msg/Bool" });
    viewer.send(json!({ "op": "advertise", "channels": [topic(1), topic(2), topic(3)] }));
    assert!(viewer.json("status")["message"].as_str().unwrap().contains("2 topics"));
}

/// A viewer reads nothing while 100 MB of images are published.
#[test]
fn a_slow_viewer_loses_messages_and_the_robot_loses_none() {
    let robot = robot(|options| options.limits.stall = Duration::from_secs(10));
    let images = robot.core.inlet::<Image>("image").wait(WATCHDOG).unwrap().unwrap();
    let (sender, arrived) = channel();
    let inside = robot.core.outlet("image", Inbox::KeepAll, move |image: Received<'_, Image>| {
        let _ = sender.send(image.width);
    });
    let _inside = inside.wait(WATCHDOG).unwrap().unwrap();
    let mut slow = robot.spectator();
    slow.wait_for_topic("/image");
    slow.subscribe(1, "/image");
    slow.subscribe(2, "/joint_states");
    for width in 0..400 {
        let image = Image { width, data: vec![7; 250_000], ..Image::default() };
        images.publish(image).unwrap();
        // One at a time: the inlet is bounded too.
        assert_eq!(arrived.recv_timeout(WATCHDOG), Ok(width), "the robot loses nothing");
    }
    robot.move_to(0.5);
    // Another viewer is not affected.
    let mut other = robot.spectator();
    other.subscribe(1, "/joint_states");
    robot.move_to(0.75);
    other.message();
    // The slow viewer receives a report, and its small topic was not displaced.
    let (mut received, mut is_told, mut position) = (0, false, None);
    while !is_told || position.is_none() {
        match slow.wait_for(|_| true) {
            Frame::Binary(bytes) if bytes[0] == 1 && bytes[1] == 1 => received += 1,
            Frame::Binary(bytes) if bytes[0] == 1 => {
                position.get_or_insert(bytes);
            }
            Frame::Json(status) if status["op"] == "status" => {
                assert_eq!(status["level"], 1);
                is_told |= status["message"].as_str().unwrap().contains("/image are dropped");
            }
            _ => {}
        }
    }
    assert!(received < 400, "images were dropped");
    let expected = downbeat_msgs::cdr::to_vec(&joint_state(0.5));
    assert_eq!(position.unwrap()[13..], expected);
}

#[test]
fn a_viewer_that_never_reads_is_disconnected() {
    let robot = robot(|options| options.limits.stall = Duration::from_millis(500));
    std::fs::write(robot.folder.path().join("large.stl"), vec![7; 4 << 20]).unwrap();
    let mut viewer = robot.viewer();
    for id in 0..20 {
        let fetch = json!({ "op": "fetchAsset", "uri": "package://robot/large.stl", "requestId": id });
        // It may have been disconnected by now.
        let _ = viewer.socket.send(Message::text(fetch.to_string()));
    }
    let server = robot.server.as_ref().unwrap();
    until(|| (server.viewers() == 0).then_some(()));
}

#[test]
fn a_server_stops_while_a_viewer_reads_nothing() {
    let mut robot = robot(|_| ());
    std::fs::write(robot.folder.path().join("large.stl"), vec![7; 30 << 20]).unwrap();
    let mut viewer = robot.viewer();
    viewer.send(json!({ "op": "fetchAsset", "uri": "package://robot/large.stl", "requestId": 1 }));
    robot.server = None;
}
