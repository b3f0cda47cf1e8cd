//! The release after Jazzy: its rclpy, on its Fast DDS, in one domain with us.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Check, Way, With, check};
use common::rclpy::Peer;
use common::texts::Talker;
use common::{WATCHDOG, on_loopback, wait_until};
use downbeat_msgs::Message;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_msgs::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};
use serde_json::json;
use test_machine::free_domain;

const TYPE: &str = "std_srvs/srv/SetBool";

#[test]
fn rclpy_of_kilted_and_we_know_hear_and_call_each_other() {
    let both = |heading, feature| check(heading, feature, With::Kilted, Way::Both);
    let checks = [
        both("Topics", "texts of 50 bytes to 1 MB"),
        both("Services", "a request and its response"),
        both("Graph", "node names and type hashes"),
        both("Faults", "a node that leaves is gone at once"),
    ];
    let domain = free_domain();
    let Some(mut peer) = Peer::kilted(domain) else {
        return checks.into_iter().for_each(Check::skipped);
    };
    let talker = Talker::join(&on_loopback(domain), QosProfile::DEFAULT);
    talker.meet(&mut peer, 10);
    for (size, count) in [(50, 5), (70_000, 5), (1_000_000, 2)] {
        talker.exchange(&mut peer, size, count);
    }

    wait_until("Kilted knows our node and its types", || {
        // Of our publisher and of its own subscription.
        peer.ask(json!({"do": "nodes"})).as_array().unwrap().contains(&json!("/downbeat"))
            && peer.ask(json!({"do": "type_hashes", "topic": "/ours"}))
                == json!([Text::TYPE_HASH, Text::TYPE_HASH])
    });
    let theirs = || talker.participant.remote_nodes().into_iter().find(|node| node.name == "/peer");
    wait_until("we know its node", || {
        theirs().is_some_and(|node| node.endpoints.iter().any(|known| known.topic.as_str() == "/theirs"))
    });
    let hashes =
        talker.participant.remote_endpoints().into_iter().filter(|known| known.topic_name == "rt/theirs");
    assert!(hashes.map(|known| known.type_hash).all(|hash| hash.as_deref() == Some(Text::TYPE_HASH)));

    let _light = talker
        .node
        .serve::<SetBool>("/light", QosProfile::SERVICES, |request| SetBoolResponse {
            success: request.data,
            message: "ours".to_owned(),
        })
        .unwrap();
    peer.ask(json!({"do": "client", "service": "/light", "type": TYPE}));
    assert_eq!(peer.ask(json!({"do": "wait_for_service", "service": "/light"})), true);
    let answers = peer.ask(json!({"do": "call", "service": "/light", "requests": [{"data": true}]}));
    assert_eq!(answers, json!([{"success": true, "message": "ours"}]));
    peer.ask(json!({"do": "serve", "service": "/theirs", "type": TYPE}));
    let client = talker.node.client::<SetBool>("/theirs", QosProfile::SERVICES).unwrap();
    assert!(client.wait_for_service(WATCHDOG));
    assert!(client.call_and_wait(&SetBoolRequest { data: true }, WATCHDOG).unwrap().success);

    peer.leave();
    wait_until("the peer is gone", || {
        talker.participant.remote_endpoints().is_empty() && talker.participant.remote_nodes().is_empty()
    });
}
