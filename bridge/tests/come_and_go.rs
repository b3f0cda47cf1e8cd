//! Endpoints, nodes and processes that come, go, are killed or stopped: what each side knows of the other,
//! and when.
#![allow(clippy::unwrap_used)]

mod common;
mod ours;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::texts::{TEXT, Talker, assert_whole, hear, is_matched, qos_of, taken, text_of};
use common::{WATCHDOG, on_loopback, wait_until};
use downbeat_bridge::middleware::Direction;
use downbeat_bridge::ros::{Introspection, MessageType, Node, NodeName, Participant, Publisher, ServiceType};
use downbeat_executor::{Clock, ManualClock, Time};
use downbeat_msgs::Message;
use downbeat_msgs::qos::{Durability, QosProfile};
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_msgs::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};
use test_machine::free_domain;

/// Longer than a lease of 20 s, after which Fast DDS and we forget who is silent.
const LONGER_THAN_A_LEASE: Duration = Duration::from_secs(25);
/// "At once" on a busy machine, far below every lease and every period of announcements and heartbeats but
/// the shortest.
const AT_ONCE: Duration = Duration::from_secs(2);

fn join(domain_id: u16) -> (Participant, Node) {
    let participant = Participant::join(&on_loopback(domain_id)).unwrap();
    let node = participant.create_node(NodeName::new("/", "downbeat").unwrap()).unwrap();
    (participant, node)
}

fn publish(node: &Node, topic: &str, qos: QosProfile) -> Publisher {
    node.publish(topic, &MessageType::new(TEXT).unwrap(), qos).unwrap()
}

#[track_caller]
fn at_once(what: &str, condition: impl FnMut() -> bool) {
    let start = Instant::now();
    wait_until(what, condition);
    assert!(start.elapsed() < AT_ONCE, "{what}: after {:?}", start.elapsed());
}

/// How many endpoints of a topic `ros2 topic info` counts.
fn count(peer: &mut Peer, direction: &str, topic: &str) -> usize {
    peer.ask(json!({"do": format!("{direction}_of"), "topic": topic})).as_array().unwrap().len()
}

fn lists(peer: &mut Peer, node: &str) -> bool {
    peer.ask(json!({"do": "nodes"})).as_array().unwrap().contains(&Value::from(node))
}

#[test]
fn what_we_remove_is_gone_from_rclpy_at_once() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _endpoint =
        check("Graph", "a removed endpoint disappears from `ros2 topic info`", With::Rclpy, Way::Out);
    let _node = check("Graph", "a removed node of a process that keeps running", With::Rclpy, Way::Out);
    let (participant, node) = join(domain);
    let second = participant.create_node(NodeName::new("/", "second").unwrap()).unwrap();
    let of_second = publish(&second, "/ours", QosProfile::DEFAULT);
    let ours = publish(&node, "/ours", QosProfile::DEFAULT);
    let theirs = hear(&node, "/theirs", QosProfile::DEFAULT);
    peer.ask(json!({"do": "subscribe_texts", "topic": "/ours"}));
    peer.ask(json!({"do": "advertise", "topic": "/theirs", "type": TEXT}));
    wait_until("rclpy knows all", || {
        count(&mut peer, "publishers", "/ours") == 2
            && count(&mut peer, "subscriptions", "/theirs") == 1
            && lists(&mut peer, "/downbeat")
            && lists(&mut peer, "/second")
    });
    drop(ours);
    at_once("the publisher is gone", || count(&mut peer, "publishers", "/ours") == 1);
    at_once("and unmatched", || is_matched(&mut peer, "/ours"));
    drop(theirs);
    at_once("the subscription is gone", || count(&mut peer, "subscriptions", "/theirs") == 0);
    at_once("and unmatched", || peer.ask(json!({"do": "matched", "topic": "/theirs"})) == 0);
    drop((of_second, second));
    at_once("the second node is gone", || !lists(&mut peer, "/second"));
    at_once("with its publisher", || count(&mut peer, "publishers", "/ours") == 0);
    assert!(lists(&mut peer, "/downbeat"));
    drop((node, participant));
    at_once("the process is gone", || !lists(&mut peer, "/downbeat"));
}

#[test]
fn what_rclpy_removes_is_gone_from_us_at_once() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _endpoint =
        check("Graph", "a removed endpoint disappears from `ros2 topic info`", With::Rclpy, Way::In);
    let _node = check("Graph", "a removed node of a process that keeps running", With::Rclpy, Way::In);
    let (participant, node) = join(domain);
    let ours = publish(&node, "/ours", QosProfile::DEFAULT);
    let (theirs, _heard) = hear(&node, "/theirs", QosProfile::DEFAULT);
    peer.ask(json!({"do": "subscribe_texts", "topic": "/ours"}));
    peer.ask(json!({"do": "advertise", "topic": "/theirs", "type": TEXT}));
    peer.ask(json!({"do": "second_node", "name": "second", "topic": "/theirs"}));
    let lists = |name: &str| participant.remote_nodes().iter().any(|node| node.name == name);
    wait_until("we know all", || {
        ours.matched_subscriptions() == 1 && theirs.matched_publishers() == 2 && lists("/second")
    });
    peer.ask(json!({"do": "stop", "topic": "/ours"}));
    at_once("the subscription is gone", || ours.matched_subscriptions() == 0);
    peer.ask(json!({"do": "second_node", "name": "second", "topic": null}));
    at_once("the second node is gone", || !lists("/second") && theirs.matched_publishers() == 1);
    peer.ask(json!({"do": "stop", "topic": "/theirs"}));
    at_once("the publisher is gone", || theirs.matched_publishers() == 0);
    assert!(lists("/peer"));
    peer.leave();
    at_once("the process is gone", || participant.remote_endpoints().is_empty() && !lists("/peer"));
}

/// The publishers and subscriptions of a topic that Cyclone DDS knows, each by its user data.
fn user_data(peer: &mut Peer, topic: &str) -> Vec<Value> {
    peer.ask(json!({"do": "endpoints", "topic": topic})).as_array().unwrap().clone()
}

#[test]
fn cyclone_knows_our_type_hashes_and_what_we_remove_is_gone_at_once() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _hash = check("Graph", "type hashes of downbeat's endpoints", With::Cyclone, Way::Out);
    let _gone = check("Graph", "a removed endpoint disappears from discovery", With::Cyclone, Way::Out);
    let (participant, node) = join(domain);
    let ours = publish(&node, "/ours", QosProfile::DEFAULT);
    let theirs = hear(&node, "/theirs", QosProfile::DEFAULT);
    let expected = [Value::from(format!("typehash={};", Text::TYPE_HASH))];
    wait_until("Cyclone knows our endpoints by their type hash", || {
        user_data(&mut peer, "/ours") == expected && user_data(&mut peer, "/theirs") == expected
    });
    drop(ours);
    at_once("the publisher is gone", || user_data(&mut peer, "/ours").is_empty());
    drop(theirs);
    at_once("the subscription is gone", || user_data(&mut peer, "/theirs").is_empty());
    let again = publish(&node, "/ours", QosProfile::DEFAULT);
    at_once("another publisher is known", || user_data(&mut peer, "/ours") == expected);
    drop((again, node, participant));
    at_once("the process is gone", || user_data(&mut peer, "/ours").is_empty());
}

#[test]
fn cyclone_finds_a_type_hash_at_every_endpoint_of_a_node() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _check =
        check("Graph", "type hashes of services, actions and the node graph", With::Cyclone, Way::Out);
    let (_participant, node) = join(domain);
    let services = QosProfile::SERVICES;
    let kind = |name: &str| ServiceType::new(name).unwrap();
    let action = [
        ("/count/_action/send_goal", "test_msgs/action/Fibonacci_SendGoal"),
        ("/count/_action/get_result", "test_msgs/action/Fibonacci_GetResult"),
        ("/count/_action/cancel_goal", "action_msgs/srv/CancelGoal"),
        ("/light", "std_srvs/srv/SetBool"),
        ("~/get_parameters", "rcl_interfaces/srv/GetParameters"),
        ("~/list_parameters", "rcl_interfaces/srv/ListParameters"),
        ("~/set_parameters", "rcl_interfaces/srv/SetParameters"),
    ];
    let served: Vec<_> = action
        .iter()
        .map(|(name, of)| node.serve_raw(name, &kind(of), services, Box::new(drop)).unwrap())
        .collect();
    let clients: Vec<_> =
        action.iter().map(|(name, of)| node.client_raw(name, &kind(of), services).unwrap()).collect();
    let clock: Arc<dyn Clock> = Arc::new(ManualClock::new(Time::ZERO));
    for service in &served {
        service
            .configure_introspection(&node, Introspection::Metadata, services, Arc::clone(&clock))
            .unwrap();
    }
    let topics = [
        ("/count/_action/feedback", "test_msgs/action/Fibonacci_FeedbackMessage"),
        ("/count/_action/status", "action_msgs/msg/GoalStatusArray"),
        ("/rosout", "rcl_interfaces/msg/Log"),
        ("/parameter_events", "rcl_interfaces/msg/ParameterEvent"),
    ];
    let published: Vec<_> = topics
        .iter()
        .map(|(name, of)| node.publish(name, &MessageType::new(of).unwrap(), QosProfile::DEFAULT).unwrap())
        .collect();
    // Servers and clients have two endpoints each; services have events; the graph has two, and the node its
    // description.
    let count = 2 * (served.len() + clients.len()) + served.len() + published.len() + 2 + 2;
    let mut found = Vec::new();
    wait_until("Cyclone knows all endpoints", || {
        found.clone_from(peer.ask(json!({"do": "all_endpoints"})).as_array().unwrap());
        found.len() == count
    });
    for endpoint in &found {
        let hash = endpoint[3].as_str().unwrap().strip_prefix("typehash=RIHS01_");
        let digits = hash.and_then(|hash| hash.strip_suffix(';')).unwrap_or_default();
        let is_hash = digits.len() == 64 && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
        assert!(is_hash, "{endpoint}");
    }
    let data_of = |topic: &str| -> BTreeSet<&str> {
        let of_topic = found.iter().filter(|endpoint| endpoint[1] == topic);
        of_topic.map(|endpoint| endpoint[3].as_str().unwrap()).collect()
    };
    let expected = |hash: &str| format!("typehash={hash};");
    assert_eq!(data_of("rq/lightRequest"), BTreeSet::from([&*expected(SetBoolRequest::TYPE_HASH)]));
    assert_eq!(data_of("rr/lightReply"), BTreeSet::from([&*expected(SetBoolResponse::TYPE_HASH)]));
}

#[test]
fn our_node_comes_back_to_rclpy_after_our_lease_was_over() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let feature = "the name of a node comes back after its lease was over";
    let _check = check("Faults", feature, With::Rclpy, Way::Out);
    let mut ours = ours::start_by(|program| {
        let mut command = ours::on_loopback(program, domain);
        command.env(ours::LEASE_MS, "2000").env(ours::NODE, "stopped");
        command
    });
    ours.ask(json!({"do": "advertise", "topic": "/theirs", "type": TEXT}));
    let knows = |rclpy: &mut Peer| count(rclpy, "publishers", "/theirs") == 1 && lists(rclpy, "/stopped");
    wait_until("rclpy knows it", || knows(&mut rclpy));
    for _ in 0..2 {
        ours.signal("-STOP");
        wait_until("rclpy has forgotten it", || {
            count(&mut rclpy, "publishers", "/theirs") == 0 && !lists(&mut rclpy, "/stopped")
        });
        ours.signal("-CONT");
        wait_until("rclpy knows it again", || knows(&mut rclpy));
    }
}

#[test]
fn rclpy_knows_the_type_hashes_of_our_endpoints_and_we_know_theirs() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _out = check("Graph", "type hashes of downbeat's endpoints", With::Rclpy, Way::Out);
    let (participant, node) = join(domain);
    let _ours = publish(&node, "/ours", QosProfile::DEFAULT);
    let _theirs = hear(&node, "/theirs", QosProfile::DEFAULT);
    for topic in ["/ours", "/theirs"] {
        wait_until("rclpy knows the type hash", || {
            peer.ask(json!({"do": "type_hashes", "topic": topic})) == json!([Text::TYPE_HASH])
        });
    }
    peer.ask(json!({"do": "advertise", "topic": "/theirs", "type": TEXT}));
    wait_until("we know theirs", || {
        participant.remote_endpoints().iter().any(|endpoint| {
            endpoint.topic_name == "rt/theirs"
                && endpoint.direction == Direction::Out
                && endpoint.type_hash.as_deref() == Some(Text::TYPE_HASH)
        })
    });
}

#[test]
fn rclpy_forgets_us_when_our_lease_is_over_after_we_were_killed() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Faults", "a killed process disappears after its lease", With::Rclpy, Way::Out);
    let mut killed = ours::start_by(|program| {
        let mut command = ours::on_loopback(program, domain);
        command.env(ours::LEASE_MS, "3000");
        command
    });
    killed.ask(json!({"do": "advertise", "topic": "/theirs", "type": TEXT}));
    wait_until("rclpy knows it", || count(&mut rclpy, "publishers", "/theirs") == 1);
    // Killed by the drop: it takes no leave.
    drop(killed);
    let start = Instant::now();
    wait_until("rclpy has forgotten it", || count(&mut rclpy, "publishers", "/theirs") == 0);
    assert!(start.elapsed() < Duration::from_secs(8), "after {:?}", start.elapsed());
}

#[test]
fn we_forget_rclpy_when_its_lease_is_over_after_it_was_killed() {
    let domain = free_domain();
    let Some(mut killed) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Faults", "a killed process disappears after its lease", With::Rclpy, Way::In);
    let talker = Talker::join(&on_loopback(domain), QosProfile::DEFAULT);
    talker.meet(&mut killed, 10);
    drop(killed);
    // More than any window: a reader that is dead delays nobody. On a busy machine a sample waits until those
    // before are sent.
    for number in 0..10_000 {
        wait_until("the window is open", || talker.ours.publish(text_of(number, 100)).is_ok());
    }
    wait_until("it is forgotten", || {
        talker.ours.matched_subscriptions() == 0 && talker.theirs.matched_publishers() == 0
    });
    assert_eq!(talker.participant.remote_endpoints(), []);
}

#[test]
fn what_rclpy_missed_while_it_was_stopped_it_gets_when_it_goes_on() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Faults", "a peer that is suspended for 3 s misses nothing", With::Rclpy, Way::Both);
    let qos = QosProfile::DEFAULT.keep_last(300);
    let talker = Talker::join(&on_loopback(domain), qos);
    talker.meet(&mut peer, 300);
    let mut other = ours::start(domain);
    other.ask(json!({"do": "subscribe_texts", "topic": "/ours", "qos": qos_of(qos, 300)}));
    wait_until("the other is matched", || {
        talker.ours.matched_subscriptions() == 2 && is_matched(&mut other, "/ours")
    });
    peer.signal("-STOP");
    // More than its socket holds.
    for number in 0..300 {
        talker.say(number, 5_000);
    }
    assert_whole(&taken(&mut other, "/ours", 300), 5_000, 300);
    std::thread::sleep(Duration::from_secs(3));
    peer.signal("-CONT");
    assert_whole(&taken(&mut peer, "/ours", 300), 5_000, 300);
    peer.ask(json!({"do": "publish_texts", "topic": "/theirs", "size": 5_000, "count": 300}));
    let heard: Vec<_> = (0..300).map(|_| talker.heard()).collect();
    assert_whole(&heard, 5_000, 300);
}

/// Until a text goes each way.
fn hear_each_other(talker: &Talker, peer: &mut Peer) {
    let mut number = 1000;
    wait_until("the peer hears us", || {
        number += 1;
        talker.say(number, 50);
        std::thread::sleep(Duration::from_millis(20));
        let heard = peer.ask(json!({"do": "take", "topic": "/ours"}));
        heard.as_array().unwrap().contains(&json!([number, 50]))
    });
    wait_until("we hear the peer", || {
        number += 1;
        let publish =
            json!({"do": "publish_texts", "topic": "/theirs", "size": 50, "count": 1, "first": number});
        peer.ask(publish);
        talker.heard_within(Duration::from_millis(200)).is_some_and(|(heard, _)| heard == number)
    });
}

#[test]
fn who_was_stopped_for_longer_than_the_lease_is_found_again() {
    let domains @ [of_rclpy, of_cyclone, of_ours] = [free_domain(), free_domain(), free_domain()];
    let Some(rclpy) = Peer::start(of_rclpy, "LOCALHOST") else { return };
    let Some(cyclone) = Peer::cyclonedds(of_cyclone) else { return };
    let Some(mut watching) = Peer::start(of_ours, "LOCALHOST") else { return };
    let feature = "a peer that is suspended for longer than its lease";
    let _rclpy = check("Faults", feature, With::Rclpy, Way::Both);
    let _cyclone = check("Faults", feature, With::Cyclone, Way::Both);
    let _ours = check("Faults", "downbeat is suspended for longer than its lease", With::Rclpy, Way::Both);
    let of_us = ours::start_by(|program| {
        let mut command = ours::on_loopback(program, of_ours);
        command.env(ours::NODE, "stopped");
        command
    });
    let mut stopped = [rclpy, cyclone, of_us];
    let talkers = domains.map(|domain_id| Talker::join(&on_loopback(domain_id), QosProfile::DEFAULT));
    for (talker, peer) in talkers.iter().zip(&mut stopped) {
        talker.meet(peer, 10);
    }
    let [.., ours] = &mut stopped;
    ours.ask(json!({"do": "advertise", "topic": "/to_rclpy", "type": TEXT}));
    watching.ask(json!({"do": "subscribe_texts", "topic": "/to_rclpy"}));
    wait_until("rclpy knows the one of us", || is_matched(&mut watching, "/to_rclpy"));

    stopped.iter().for_each(|peer| peer.signal("-STOP"));
    std::thread::sleep(LONGER_THAN_A_LEASE);
    for (talker, domain_id) in talkers.iter().zip(domains) {
        assert_eq!(talker.ours.matched_subscriptions(), 0, "the peer in domain {domain_id} is forgotten");
    }
    assert!(!is_matched(&mut watching, "/to_rclpy"), "the one of us is forgotten");
    stopped.iter().for_each(|peer| peer.signal("-CONT"));
    for (talker, peer) in talkers.iter().zip(&mut stopped) {
        talker.wait_until_matched(peer);
        hear_each_other(talker, peer);
    }
    let [.., ours] = &mut stopped;
    wait_until("rclpy hears the one of us again", || {
        ours.ask(json!({"do": "publish_texts", "topic": "/to_rclpy", "size": 60, "count": 1}));
        std::thread::sleep(Duration::from_millis(20));
        watching
            .ask(json!({"do": "take", "topic": "/to_rclpy"}))
            .as_array()
            .is_some_and(|heard| !heard.is_empty())
    });
    let [rclpy, ..] = &mut stopped;
    wait_until("each lists the nodes of the other", || {
        lists(rclpy, "/downbeat")
            && lists(&mut watching, "/stopped")
            && names(&talkers[0].participant).contains("/peer")
            && names(&talkers[2].participant).contains("/stopped")
    });
}

/// The nodes of others that we list.
fn names(participant: &Participant) -> BTreeSet<String> {
    participant.remote_nodes().into_iter().map(|node| node.name).collect()
}

#[test]
fn thirty_nodes_come_and_go_and_all_list_those_that_are_left() {
    const PROCESSES: usize = 15;
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let Some(mut cyclone) = Peer::cyclonedds(domain) else { return };
    let feature = "30 nodes that come and go: the others list those that are left";
    let _rclpy = check("Discovery", feature, With::Rclpy, Way::Out);
    let _cyclone = check("Discovery", feature, With::Cyclone, Way::Out);
    let (observer, _node) = join(domain);
    let come = |number: usize| {
        let participant = Participant::join(&on_loopback(domain)).unwrap();
        let nodes = ["first", "second"].map(|which| {
            participant.create_node(NodeName::new(&format!("/guest_{number}"), which).unwrap()).unwrap()
        });
        let publisher = publish(&nodes[0], &format!("/guest_{number}/text"), QosProfile::DEFAULT);
        (number, participant, nodes, publisher)
    };
    let mut guests: Vec<_> = (0..PROCESSES).map(come).collect();
    for round in 0..3 {
        let present: BTreeSet<usize> = guests.iter().map(|(number, ..)| *number).collect();
        let is_guest = |name: &&str| name.starts_with("/guest_");
        let nodes: BTreeSet<String> = present
            .iter()
            .flat_map(|number| ["first", "second"].map(|which| format!("/guest_{number}/{which}")))
            .collect();
        let topics: BTreeSet<String> =
            present.iter().map(|number| format!("rt/guest_{number}/text")).collect();
        wait_until(&format!("rclpy lists those that are there in round {round}"), || {
            let listed = rclpy.ask(json!({"do": "nodes"}));
            let listed = listed.as_array().unwrap().iter().filter_map(Value::as_str).filter(is_guest);
            listed.map(str::to_owned).collect::<BTreeSet<_>>() == nodes
        });
        wait_until(&format!("Cyclone does in round {round}"), || {
            let found = cyclone.ask(json!({"do": "all_endpoints"}));
            let found = found.as_array().unwrap().iter().filter_map(|endpoint| endpoint[1].as_str());
            found.filter(|topic| topic.starts_with("rt/guest_")).map(str::to_owned).collect::<BTreeSet<_>>()
                == topics
        });
        wait_until(&format!("we do in round {round}"), || {
            names(&observer).into_iter().filter(|name| is_guest(&name.as_str())).collect::<BTreeSet<_>>()
                == nodes
        });
        // Some leave, and as many come, all at once.
        guests.retain(|(number, ..)| number % 3 != round);
        guests.extend((0..PROCESSES - guests.len()).map(|index| come(100 * (round + 1) + index)));
    }
}

#[test]
fn two_hundred_endpoints_of_ours_and_of_rclpy_are_matched() {
    let domain = free_domain();
    const COUNT: usize = 100;
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Graph", "200 endpoints", With::Rclpy, Way::Both);
    let (_participant, node) = join(domain);
    let name = |whose: &str, number: usize| format!("/{whose}_{number}");
    let ours: Vec<_> =
        (0..COUNT).map(|number| publish(&node, &name("ours", number), QosProfile::DEFAULT)).collect();
    let theirs: Vec<_> =
        (0..COUNT).map(|number| hear(&node, &name("theirs", number), QosProfile::DEFAULT)).collect();
    peer.ask(json!({"do": "many", "count": COUNT, "type": TEXT}));
    wait_until("all are matched", || {
        ours.iter().all(|publisher| publisher.matched_subscriptions() == 1)
            && theirs.iter().all(|(subscription, _)| subscription.matched_publishers() == 1)
    });
    wait_until("at rclpy too", || {
        (0..COUNT).all(|number| {
            is_matched(&mut peer, &name("ours", number)) && is_matched(&mut peer, &name("theirs", number))
        })
    });
    ours.iter().for_each(|publisher| publisher.publish(text_of(7, 100)).unwrap());
    let mut missing = COUNT as u64;
    wait_until("rclpy hears all", || {
        let taken = peer.ask(json!({"do": "take_from_all"}));
        missing -= taken.as_object().unwrap().values().filter_map(Value::as_u64).sum::<u64>();
        missing == 0
    });
    peer.ask(json!({"do": "publish_on_all", "size": 100}));
    for (_, heard) in &theirs {
        assert_eq!(heard.recv_timeout(WATCHDOG).unwrap(), Some((0, 100)));
    }
}

/// Late joiners get the depth of the publisher, no more and no less; 20 texts were published before.
fn latched(domain_id: u16, peer: &mut Peer) {
    const DEPTH: u32 = 5;
    const SIZE: usize = 100_000;
    let latched = QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT };
    let (_participant, node) = join(domain_id);
    let ours = publish(&node, "/ours", latched.keep_last(DEPTH));
    (0..20).for_each(|number| ours.publish(text_of(number, SIZE)).unwrap());
    let qos = |depth| qos_of(latched, depth);
    peer.ask(json!({"do": "advertise", "topic": "/theirs", "type": TEXT, "qos": qos(DEPTH)}));
    peer.ask(json!({"do": "publish_texts", "topic": "/theirs", "size": SIZE, "count": 20}));

    let last: Vec<_> = (15..=20).map(|number| (number, SIZE)).collect();
    peer.ask(json!({"do": "subscribe_texts", "topic": "/ours", "qos": qos(100)}));
    let (_theirs, heard) = hear(&node, "/theirs", latched.keep_last(100));
    assert_eq!(taken(peer, "/ours", 5), last[..5]);
    let first: Vec<_> = (0..5).map(|_| heard.recv_timeout(WATCHDOG).unwrap().unwrap()).collect();
    assert_eq!(first, last[..5]);
    // Nothing older came between: the next is the one that is published now.
    ours.publish(text_of(20, SIZE)).unwrap();
    assert_eq!(taken(peer, "/ours", 1), last[5..]);
    let publish = json!({"do": "publish_texts", "topic": "/theirs", "size": SIZE, "count": 1, "first": 20});
    peer.ask(publish);
    assert_eq!(heard.recv_timeout(WATCHDOG).unwrap(), Some(last[5]));
}

const EXACT: &str = "latched messages: exactly as many as the depth of the publisher";

#[test]
fn late_joiners_of_rclpy_and_ours_get_exactly_the_depth() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Topics", EXACT, With::Rclpy, Way::Both);
    latched(domain, &mut peer);
}

#[test]
fn late_joiners_of_cyclone_and_ours_get_exactly_the_depth() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _check = check("Topics", EXACT, With::Cyclone, Way::Both);
    latched(domain, &mut peer);
}

#[test]
fn replies_of_100_kb_pass_in_the_words_of_cyclone() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _check = check("Services", "requests and replies of up to 100 kB", With::Cyclone, Way::Both);
    let (_participant, node) = join(domain);
    let long = "x".repeat(100_000);
    let message = long.clone();
    let _service = node
        .serve::<SetBool>("/ours", QosProfile::SERVICES, move |request| SetBoolResponse {
            success: request.data,
            message: message.clone(),
        })
        .unwrap();
    peer.ask(json!({"do": "client", "service": "/ours"}));
    wait_until("Cyclone finds our service", || peer.ask(json!({"do": "is_available"})) == true);
    let answered = peer.ask(json!({"do": "call", "requests": [true, false, true]}));
    assert!(answered == json!([[[true, long]], [[false, long]], [[true, long]]]));

    peer.ask(json!({"do": "serve", "service": "/theirs"}));
    let client = node.client::<SetBool>("/theirs", QosProfile::SERVICES).unwrap();
    assert!(client.wait_for_service(WATCHDOG));
    let (sender, answers) = channel();
    client.call(&SetBoolRequest { data: true }, WATCHDOG, move |answer| sender.send(answer).unwrap());
    wait_until("Cyclone was asked", || {
        peer.ask(json!({"do": "answer", "service": "/theirs", "suffix": long})) == json!([true])
    });
    let answer = answers.recv_timeout(WATCHDOG).unwrap().unwrap();
    assert!(answer == SetBoolResponse { success: true, message: format!("data is True{long}") });
}

#[test]
fn a_participant_that_joins_late_has_the_latched_text_of_rclpy_at_once() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _check =
        check("Topics", "latched messages to a process that joins late, immediately", With::Rclpy, Way::In);
    let latched = QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT };
    let qos = qos_of(latched, 1);
    peer.ask(json!({"do": "advertise", "topic": "/theirs", "type": TEXT, "qos": qos}));
    peer.ask(json!({"do": "publish_texts", "topic": "/theirs", "size": 100, "count": 1}));
    // Fast DDS repeats its heartbeat after 3 s, later than this accepts.
    for _ in 0..3 {
        let (_participant, node) = join(domain);
        let (_theirs, heard) = hear(&node, "/theirs", latched);
        at_once("the text has arrived", || heard.try_recv() == Ok(Some((0, 100))));
    }
}
