//! Services between us and the real rclpy.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{WATCHDOG, on_loopback, wait_until};
use downbeat_bridge::ros::{Client, Node, NodeName, Participant, Reply, Service};
use downbeat_msgs::Message;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::sensor_msgs::msg::Imu;
use downbeat_msgs::sensor_msgs::srv::{SetCameraInfo, SetCameraInfoRequest, SetCameraInfoResponse};
use downbeat_msgs::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};
use serde_json::{Value, json};
use std::sync::mpsc::channel;
use std::time::Duration;
use test_machine::free_domain;

fn downbeat(domain_id: u16) -> (Participant, Node) {
    let participant = Participant::join(&on_loopback(domain_id)).unwrap();
    let node = participant.create_node(NodeName::new("/robot", "downbeat").unwrap()).unwrap();
    (participant, node)
}

fn light(request: SetBoolRequest) -> SetBoolResponse {
    SetBoolResponse { success: request.data, message: format!("data is {}", request.data) }
}

fn answer(data: bool) -> Value {
    json!({"success": data, "message": format!("data is {data}")})
}

#[test]
fn rclpy_calls_us_with_many_requests_in_flight() {
    let domain = free_domain();
    const COUNT: usize = 300;
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Services", "many requests in flight", With::Rclpy, Way::In);
    let (_participant, node) = downbeat(domain);
    let service = node.serve::<SetBool>("light", QosProfile::SERVICES, light).unwrap();
    let name = "/robot/light";
    // With the 10 of the default rclpy drops answers that it has not read yet.
    let client =
        json!({"do": "client", "service": name, "type": "std_srvs/srv/SetBool", "qos": {"depth": COUNT}});
    rclpy.ask(client);
    assert_eq!(rclpy.ask(json!({"do": "wait_for_service", "service": name})), true);

    let requests: Vec<_> = (0..COUNT).map(|number| json!({"data": number % 3 == 0})).collect();
    let answers = rclpy.ask(json!({"do": "call", "service": name, "requests": requests}));
    let expected: Vec<_> = (0..COUNT).map(|number| answer(number % 3 == 0)).collect();
    assert_eq!(answers, json!(expected));
    assert_eq!((service.refused_requests(), service.unreachable_clients()), (0, 0));
    assert_eq!(service.matched_clients(), 1);
}

#[test]
fn we_call_rclpy_with_many_requests_in_flight() {
    let domain = free_domain();
    const COUNT: i32 = 300;
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Services", "many requests in flight", With::Rclpy, Way::Out);
    let (_participant, node) = downbeat(domain);
    // With the 10 of the default rclpy drops requests that it has not read yet.
    let (kind, qos) = ("sensor_msgs/srv/SetCameraInfo", json!({"depth": COUNT}));
    rclpy.ask(json!({"do": "serve", "service": "/camera", "type": kind, "qos": qos}));
    let client: Client<SetCameraInfo> = node.client("/camera", QosProfile::SERVICES).unwrap();
    assert!(client.wait_for_service(WATCHDOG));
    let (sender, answers) = channel();
    for number in 0..COUNT {
        let sender = sender.clone();
        let mut request = SetCameraInfoRequest::default();
        request.camera_info.distortion_model = number.to_string();
        client.call(&request, WATCHDOG, move |result| sender.send((number, result)).unwrap());
    }
    for _ in 0..COUNT {
        let (number, result) = answers.recv_timeout(WATCHDOG).unwrap();
        assert_eq!(result.unwrap().status_message, number.to_string());
    }
}

#[test]
fn no_request_of_a_fresh_client_is_lost_at_a_server_of_rclpy() {
    let domain = free_domain();
    const CLIENTS: usize = 30;
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Services", "first request of a new client", With::Rclpy, Way::Out);
    let (_participant, node) = downbeat(domain);
    rclpy.ask(json!({"do": "serve", "service": "/light", "type": "std_srvs/srv/SetBool"}));
    for number in 0..CLIENTS {
        let client: Client<SetBool> = node.client("/light", QosProfile::SERVICES).unwrap();
        assert!(client.wait_for_service(WATCHDOG), "client {number} finds the service");
        let (sender, answers) = channel();
        client.call(&SetBoolRequest { data: true }, WATCHDOG, move |answer| sender.send(answer).unwrap());
        assert!(answers.recv_timeout(WATCHDOG).unwrap().unwrap().success, "client {number} is answered");
    }
}

#[test]
fn rclpy_lists_our_services_and_clients_under_our_node() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Graph", "services and clients of a node", With::Rclpy, Way::Out);
    let (_participant, node) = downbeat(domain);
    let _service: Service = node.serve::<SetBool>("~/light", QosProfile::SERVICES, light).unwrap();
    let _client: Client<SetCameraInfo> = node.client("/camera", QosProfile::SERVICES).unwrap();
    let mut ask = |what: &str| rclpy.ask(json!({"do": what, "node": "downbeat", "namespace": "/robot"}));
    wait_until("rclpy lists the service", || {
        ask("services_of").get("/robot/downbeat/light") == Some(&json!(["std_srvs/srv/SetBool"]))
    });
    wait_until("rclpy lists the client", || {
        ask("clients_of").get("/camera") == Some(&json!(["sensor_msgs/srv/SetCameraInfo"]))
    });
    assert_eq!(
        rclpy.ask(json!({"do": "services_and_types"}))["/robot/downbeat/light"],
        json!(["std_srvs/srv/SetBool"])
    );
}

#[test]
fn a_client_that_was_killed_leaves_the_others_their_answers() {
    let domain = free_domain();
    let Some(mut killed) = Peer::start(domain, "LOCALHOST") else { return };
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check(
        "Faults",
        "other clients receive their answers after a client was killed",
        With::Rclpy,
        Way::In,
    );
    let (_participant, node) = downbeat(domain);
    let (sender, requests) = channel();
    let later = move |request, reply: Reply<SetBool>| sender.send((request, reply)).unwrap();
    let service = node.serve_later::<SetBool>("light", QosProfile::SERVICES, later).unwrap();
    let name = "/robot/light";
    for peer in [&mut killed, &mut rclpy] {
        peer.ask(json!({"do": "client", "service": name, "type": "std_srvs/srv/SetBool"}));
        assert_eq!(peer.ask(json!({"do": "wait_for_service", "service": name})), true);
    }
    wait_until("both are matched", || service.matched_clients() == 2);
    killed.send(json!({"do": "call", "service": name, "requests": [{"data": true}]}));
    let (request, unanswerable) = requests.recv_timeout(WATCHDOG).unwrap();
    assert!(request.data);
    drop(killed);
    unanswerable.send(&SetBoolResponse::default()).unwrap();
    for _ in 0..20 {
        rclpy.send(json!({"do": "call", "service": name, "requests": [{"data": false}]}));
        let (request, reply) = requests.recv_timeout(WATCHDOG).unwrap();
        reply.send(&light(request)).unwrap();
        assert_eq!(rclpy.answer(), json!([answer(false)]));
    }
}

#[test]
fn the_first_reply_of_a_fresh_server_reaches_a_waiting_client() {
    let domain = free_domain();
    let starts = std::env::var("DOWNBEAT_FRESH_STARTS").map_or(10, |count| count.parse().unwrap());
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Services", "first response of a new server", With::Rclpy, Way::In);
    for start in 0..starts {
        // Fast DDS believes in a server that left for as long as its lease runs, so each has a name of its
        // own.
        let name = format!("/light_{start}");
        rclpy.ask(json!({"do": "client", "service": name, "type": "std_srvs/srv/SetBool"}));
        let (_participant, node) = downbeat(domain);
        let _service = node.serve::<SetBool>(&name, QosProfile::SERVICES, light).unwrap();
        assert_eq!(rclpy.ask(json!({"do": "wait_for_service", "service": name})), true);
        let answers = rclpy.ask(json!({"do": "call", "service": name, "requests": [{"data": true}]}));
        assert_eq!(answers, json!([answer(true)]), "start {start}");
    }
}

#[test]
fn the_first_answer_to_a_fresh_client_arrives() {
    let domain = free_domain();
    let starts = std::env::var("DOWNBEAT_FRESH_STARTS").map_or(10, |count| count.parse().unwrap());
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Services", "first response to a new client", With::Rclpy, Way::Out);
    rclpy.ask(json!({"do": "serve", "service": "/light", "type": "std_srvs/srv/SetBool"}));
    for start in 0..starts {
        let (_participant, node) = downbeat(domain);
        let client: Client<SetBool> = node.client("/light", QosProfile::SERVICES).unwrap();
        assert!(client.wait_for_service(WATCHDOG));
        let answer = client.call_and_wait(&SetBoolRequest { data: true }, Duration::from_secs(20));
        assert_eq!(answer.unwrap_or_else(|error| panic!("start {start}: {error}")).message, "data is True");
    }
}

#[test]
fn large_requests_and_replies_pass_between_us_and_rclpy() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Services", "requests and replies of up to 100 kB", With::Rclpy, Way::In);
    let _check2 = check("Services", "requests and replies of up to 100 kB", With::Rclpy, Way::Out);
    let (_participant, node) = downbeat(domain);
    let echo = |request: SetCameraInfoRequest| SetCameraInfoResponse {
        success: true,
        status_message: request.camera_info.distortion_model,
    };
    let _service = node.serve::<SetCameraInfo>("/ours", QosProfile::SERVICES, echo).unwrap();
    let client: Client<SetCameraInfo> = node.client("/theirs", QosProfile::SERVICES).unwrap();
    let kind = "sensor_msgs/srv/SetCameraInfo";
    rclpy.ask(json!({"do": "client", "service": "/ours", "type": kind}));
    rclpy.ask(json!({"do": "serve", "service": "/theirs", "type": kind}));
    assert_eq!(rclpy.ask(json!({"do": "wait_for_service", "service": "/ours"})), true);
    assert!(client.wait_for_service(WATCHDOG));
    // Around these lies what fits into one packet of an Ethernet.
    for length in (850..1060).step_by(10).chain((1200..1400).step_by(7)).chain([2000, 20_000, 100_000]) {
        let text: String = "0123456789".chars().cycle().take(length).collect();
        let request = json!({"camera_info": {"distortion_model": text}});
        let answers = rclpy.ask(json!({"do": "call", "service": "/ours", "requests": [request]}));
        assert_eq!(answers, json!([{"success": true, "status_message": text}]), "{length} to rclpy");

        let mut request = SetCameraInfoRequest::default();
        request.camera_info.distortion_model = text.clone();
        let answer = client.call_and_wait(&request, WATCHDOG).unwrap();
        assert_eq!(answer.status_message, text, "{length} from rclpy");
    }
}

#[test]
fn rclpy_learns_from_us_what_a_type_looks_like() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Node services", "get_type_description, with sources", With::Rclpy, Way::In);
    let (_participant, _node) = downbeat(domain);
    let name = "/robot/downbeat/get_type_description";
    let kind = "type_description_interfaces/srv/GetTypeDescription";
    rclpy.ask(json!({"do": "client", "service": name, "type": kind}));
    assert_eq!(rclpy.ask(json!({"do": "wait_for_service", "service": name})), true);
    // Its own answer to the same question, for a type it has in use.
    rclpy.ask(json!({"do": "subscribe", "topic": "/imu", "type": Imu::TYPE_NAME}));
    let own = "/peer/get_type_description";
    rclpy.ask(json!({"do": "client", "service": own, "type": kind}));
    let request = json!({"type_name": Imu::TYPE_NAME, "type_hash": Imu::TYPE_HASH});
    let mut ask = |service: &str, requests: Value| {
        rclpy.ask(json!({"do": "call", "service": service, "requests": requests}))
    };
    let (ours, theirs) = (ask(name, json!([request])), ask(own, json!([request])));
    assert_eq!(ours[0]["successful"], true);
    assert_eq!(ours[0]["type_description"], theirs[0]["type_description"]);
    let names = |answer: &Value| {
        let sources = answer[0]["type_sources"].as_array().unwrap().clone();
        sources
            .into_iter()
            .map(|source| (source["type_name"].clone(), source["encoding"].clone()))
            .collect::<Vec<_>>()
    };
    assert_eq!(names(&ours), names(&theirs));

    let unknown = json!([{"type_name": "a/msg/B", "type_hash": format!("RIHS01_{}", "0".repeat(64))}]);
    assert_eq!(ask(name, unknown.clone()), ask(own, unknown));
}
