//! `downbeat graph` of a network with real rclpy.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::text_of;
use downbeat::msgs::Message;
use downbeat::msgs::rcl_interfaces::srv::GetParametersRequest;
use serde_json::{Value, json};
use test_machine::free_domain;

#[test]
fn the_network_is_shown_as_text_as_json_and_drawn() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Graph", "`downbeat graph` of the network", With::Rclpy, Way::In);
    let latched = json!({"depth": 1, "durability": "transient_local"});
    let text = "std_msgs/msg/String";
    peer.ask(json!({"do": "advertise", "topic": "/chatter", "type": text, "qos": latched}));
    let graph = |more: &[&str]| {
        text_of(&[&["graph", "--domain", &domain.to_string(), "--wait", "30s"], more].concat())
    };
    let shown = graph(&["--json"]);
    let shown: Value = serde_json::from_str(&shown).unwrap();
    assert_eq!(shown["nodes"].as_array().unwrap().len(), 1, "{shown}");
    assert_eq!(
        (&shown["nodes"][0]["name"], &shown["nodes"][0]["vendor"]),
        (&json!("/peer"), &json!("eProsima Fast DDS"))
    );
    let endpoints = shown["endpoints"].as_array().unwrap();
    let chatter = endpoints.iter().find(|endpoint| endpoint["name"] == "/chatter").unwrap();
    let expected = json!({
        "kind": "publisher", "name": "/chatter", "type": text, "node": "/peer",
        "type_hash": "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
        "reliability": "reliable", "durability": "transient_local", "deadline_ns": null,
        "liveliness": "automatic", "liveliness_lease_ns": null,
    });
    assert_eq!(chatter, &expected);

    let lines = graph(&[]);
    let lines: Vec<_> =
        lines.lines().map(|line| line.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
    for expected in [
        "/peer eProsima Fast DDS".to_owned(),
        format!("/chatter {text}"),
        format!("publisher /peer reliable transient_local {}", chatter["type_hash"].as_str().unwrap()),
        "/peer/get_parameters rcl_interfaces/srv/GetParameters".to_owned(),
        format!("server /peer reliable volatile {}", GetParametersRequest::TYPE_HASH),
    ] {
        assert!(lines.contains(&expected), "{expected} is in {lines:#?}");
    }
    let dot = graph(&["--format", "dot"]);
    assert!(dot.starts_with("digraph") && dot.contains("/chatter") && dot.contains(" -> t"), "{dot}");
    peer.leave();
}
