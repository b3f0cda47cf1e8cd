//! Services with the second vendor of DDS, in the words of rmw_cyclonedds_cpp: requests and responses carry a
//! header.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{WATCHDOG, on_loopback, wait_until};
use downbeat_bridge::ros::{Client, Node, NodeName, Participant, Service};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};
use serde_json::{Value, json};
use std::sync::mpsc::channel;
use test_machine::free_domain;

const TYPE: &str = "std_srvs/srv/SetBool";

fn downbeat(domain_id: u16) -> Node {
    let participant = Participant::join(&on_loopback(domain_id)).unwrap();
    participant.create_node(NodeName::new("/", "downbeat").unwrap()).unwrap()
}

fn serve(node: &Node) -> Service {
    node.serve::<SetBool>("/light", QosProfile::SERVICES, |request| SetBoolResponse {
        success: request.data,
        message: format!("data is {}", request.data),
    })
    .unwrap()
}

fn connect(cyclone: &mut Peer, name: &str) {
    cyclone.ask(json!({"do": "client", "service": "/light", "name": name}));
    wait_until("Cyclone finds the service", || {
        cyclone.ask(json!({"do": "is_available", "name": name})) == true
    });
}

/// The answers that `count` requests, true and false in turn, are to have: one each.
fn answers(count: usize) -> Value {
    (0..count).map(|number| answer(number % 2 == 0)).map(|answer| json!([answer])).collect()
}

fn answer(data: bool) -> Value {
    json!([data, format!("data is {data}")])
}

fn in_turn(count: usize) -> Value {
    (0..count).map(|number| number % 2 == 0).collect()
}

#[test]
fn cyclone_calls_our_service_and_each_client_has_its_own_answers() {
    let domain = free_domain();
    let Some(mut cyclone) = Peer::cyclonedds(domain) else { return };
    let _one = check("Services", "service of a module", With::Cyclone, Way::In);
    let _many = check("Services", "many requests in flight", With::Cyclone, Way::In);
    let node = downbeat(domain);
    let service = serve(&node);
    let first = check("Services", "first response to a new client", With::Cyclone, Way::Out);
    for number in 0..8 {
        let name = format!("client {number}");
        connect(&mut cyclone, &name);
        assert_eq!(
            cyclone.ask(json!({"do": "call", "name": name, "requests": [true]})),
            answers(1),
            "{name}"
        );
    }
    drop(first);
    for name in ["one", "two"] {
        connect(&mut cyclone, name);
    }
    wait_until("we have found all", || service.matched_clients() == 10);
    for name in ["one", "two", "one"] {
        let answered = cyclone.ask(json!({"do": "call", "name": name, "requests": in_turn(100)}));
        assert_eq!(answered, answers(100));
    }
}

#[test]
fn one_service_answers_clients_of_both_vendors_each_in_its_way() {
    let domain = free_domain();
    let Some(mut cyclone) = Peer::cyclonedds(domain) else { return };
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Services", "clients of Fast DDS and Cyclone DDS at once", With::Cyclone, Way::In);
    let _check = check("Services", "clients of Fast DDS and Cyclone DDS at once", With::Rclpy, Way::In);
    let node = downbeat(domain);
    let _service = serve(&node);
    connect(&mut cyclone, "client");
    let qos = json!({"depth": 100});
    rclpy.ask(json!({"do": "client", "service": "/light", "type": TYPE, "qos": qos}));
    assert_eq!(rclpy.ask(json!({"do": "wait_for_service", "service": "/light"})), true);
    for _ in 0..3 {
        let requests: Vec<_> = (0..20).map(|number| json!({"data": number % 2 == 0})).collect();
        rclpy.send(json!({"do": "call", "service": "/light", "requests": requests}));
        cyclone.send(json!({"do": "call", "requests": in_turn(20)}));
        let of_rclpy: Value = (0..20)
            .map(|number| json!({"success": number % 2 == 0, "message": format!("data is {}", number % 2 == 0)}))
            .collect();
        assert_eq!(rclpy.answer(), of_rclpy);
        assert_eq!(cyclone.answer(), answers(20));
    }
}

#[test]
fn we_call_a_service_of_cyclone() {
    let domain = free_domain();
    let Some(mut cyclone) = Peer::cyclonedds(domain) else { return };
    let _one = check("Services", "service called by a module", With::Cyclone, Way::Out);
    let _many = check("Services", "many requests in flight", With::Cyclone, Way::Out);
    let node = downbeat(domain);
    cyclone.ask(json!({"do": "serve", "service": "/light"}));
    let client: Client<SetBool> = node.client("/light", QosProfile::SERVICES).unwrap();
    assert!(client.wait_for_service(WATCHDOG), "the service of Cyclone is found");
    // Another client of ours hears the same answers and must not take them for its own.
    let other: Client<SetBool> = node.client("/light", QosProfile::SERVICES).unwrap();
    assert!(other.wait_for_service(WATCHDOG), "and by the other client");
    let (sender, answered) = channel();
    for number in 0..50 {
        let sender = sender.clone();
        let data = number % 2 == 0;
        let client = if number % 5 == 0 { &other } else { &client };
        client.call(&SetBoolRequest { data }, WATCHDOG, move |answer| sender.send((number, answer)).unwrap());
    }
    let mut asked = Vec::new();
    wait_until("Cyclone has answered all", || {
        let more = cyclone.ask(json!({"do": "answer", "service": "/light", "suffix": ", says cyclone"}));
        asked.extend(more.as_array().unwrap().iter().cloned());
        asked.len() == 50
    });
    assert_eq!(asked.iter().filter(|data| **data == true).count(), 25);
    for _ in 0..50 {
        let (number, answer) = answered.recv_timeout(WATCHDOG).unwrap();
        let answer = answer.unwrap();
        let data = number % 2 == 0;
        assert_eq!(
            answer,
            SetBoolResponse {
                success: data,
                message: format!("data is {}, says cyclone", if data { "True" } else { "False" })
            }
        );
    }
}

#[test]
fn no_request_of_a_fresh_client_is_lost_at_a_server_of_cyclone() {
    let domain = free_domain();
    const CLIENTS: usize = 30;
    let Some(mut cyclone) = Peer::cyclonedds(domain) else { return };
    let _check = check("Services", "first request of a new client", With::Cyclone, Way::Out);
    let node = downbeat(domain);
    cyclone.ask(json!({"do": "serve", "service": "/light"}));
    for number in 0..CLIENTS {
        let client: Client<SetBool> = node.client("/light", QosProfile::SERVICES).unwrap();
        assert!(client.wait_for_service(WATCHDOG), "client {number} finds the service");
        let (sender, answered) = channel();
        client.call(&SetBoolRequest { data: true }, WATCHDOG, move |answer| sender.send(answer).unwrap());
        wait_until("the request arrives", || {
            cyclone.ask(json!({"do": "answer", "service": "/light"})) == json!([true])
        });
        answered.recv_timeout(WATCHDOG).unwrap().unwrap();
    }
}
