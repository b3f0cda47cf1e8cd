//! Real peers on another host. Network namespaces stand for the hosts, so this needs root; between them is a
//! switch, or a line that loses 2 % of the frames and takes 20 ms.
#![allow(clippy::unwrap_used)]

mod common;
mod ours;

use common::hosts::{Hosts, Line};
use common::matrix::{Check, Way, With, check};
use common::rclpy::{Peer, python};
use common::texts::{TEXT, Talker, qos_of, taken, text_of};
use common::wait_until;
use downbeat_bridge::middleware::ParticipantOptions;
use downbeat_bridge::ros::{MessageType, NodeName, Participant};
use downbeat_msgs::qos::{Durability, QosProfile};
use downbeat_msgs::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::process::Command;
use std::time::Duration;

/// Runs `test` in a process on host 0 of two hosts; the test function that calls this does nothing else. What
/// it checks is checked with a peer of Python, which has to be installed then.
fn between_hosts<T: FnOnce(&Hosts)>(line: Line, checks: Vec<Check>, test: T) {
    if let Some(hosts) = Hosts::around() {
        // The process that made the hosts notes the checks.
        std::mem::forget(checks);
        return test(&hosts);
    }
    let has_peer = checks.is_empty() || python().is_some();
    let hosts = if has_peer { Hosts::on(line) } else { None };
    let Some(hosts) = hosts else {
        checks.into_iter().for_each(Check::skipped);
        return;
    };
    let path = std::any::type_name::<T>().trim_end_matches("::{{closure}}");
    hosts.run_again(0, path.split_once("::").unwrap().1);
}

fn in_domain(mut command: Command, domain_id: u16) -> Command {
    command.env("ROS_DOMAIN_ID", domain_id.to_string());
    command
}

fn rclpy(hosts: &Hosts, domain_id: u16) -> Peer {
    Peer::start_by(|python| in_domain(hosts.command(1, python), domain_id)).unwrap()
}

fn cyclone(hosts: &Hosts, domain_id: u16) -> Peer {
    let configuration = r#"<CycloneDDS><Domain id="any">
        <General><Interfaces><NetworkInterface name="cable"/></Interfaces></General>
        <Discovery><ParticipantIndex>auto</ParticipantIndex></Discovery>
    </Domain></CycloneDDS>"#;
    Peer::cyclonedds_by(|python| {
        let mut command = in_domain(hosts.command(1, python), domain_id);
        command.env("CYCLONEDDS_URI", configuration);
        command
    })
    .unwrap()
}

fn ourselves(hosts: &Hosts, domain_id: u16) -> Peer {
    ours::start_by(|program| in_domain(hosts.command(1, program), domain_id))
}

/// Any will do: nobody else is on these hosts.
const DOMAIN: u16 = 0;

fn options() -> ParticipantOptions {
    ParticipantOptions::new(DOMAIN)
}

/// Sizes of samples, and how many of each pass both ways.
fn exchange(mut peer: Peer, sizes: &[(usize, usize)]) {
    let talker = Talker::join(&options(), QosProfile::DEFAULT.keep_last(500));
    talker.meet(&mut peer, 500);
    for (size, count) in sizes {
        talker.exchange(&mut peer, *size, *count);
    }
}

const SIZES: &[(usize, usize)] = &[(10, 200), (1_400, 200), (70_000, 20), (1_000_000, 3), (8_000_000, 1)];
/// Fast DDS sends 64 kB at once, 45 frames each of which may be lost: it takes several attempts.
const SMALL_SIZES: &[(usize, usize)] = &[(10, 200), (1_400, 100), (70_000, 5), (200_000, 1)];

const GOOD: &str = "10 B to 8 MB, reliable: all messages";
const BAD: &str = "reliable samples over a line with 2 % loss and 20 ms delay";

fn of_hosts(feature: &str, with: With) -> Vec<Check> {
    vec![check("Several hosts", feature, with, Way::Both)]
}

#[test]
fn samples_of_every_size_pass_between_us_and_rclpy() {
    between_hosts(Line::Good, of_hosts(GOOD, With::Rclpy), |hosts| exchange(rclpy(hosts, DOMAIN), SIZES));
}

#[test]
fn samples_of_every_size_pass_between_us_and_cyclone() {
    between_hosts(Line::Good, of_hosts(GOOD, With::Cyclone), |hosts| exchange(cyclone(hosts, DOMAIN), SIZES));
}

#[test]
fn samples_of_every_size_pass_between_two_of_us() {
    between_hosts(Line::Good, vec![], |hosts| exchange(ourselves(hosts, DOMAIN), SIZES));
}

#[test]
fn samples_pass_between_us_and_rclpy_over_a_bad_line() {
    between_hosts(Line::Bad, of_hosts(BAD, With::Rclpy), |hosts| exchange(rclpy(hosts, DOMAIN), SMALL_SIZES));
}

#[test]
fn samples_pass_between_us_and_cyclone_over_a_bad_line() {
    let sizes = &[(10, 200), (1_400, 100), (70_000, 20), (1_000_000, 2)];
    between_hosts(Line::Bad, of_hosts(BAD, With::Cyclone), |hosts| exchange(cyclone(hosts, DOMAIN), sizes));
}

#[test]
fn samples_pass_between_two_of_us_over_a_bad_line() {
    let sizes = &[(10, 200), (1_400, 100), (70_000, 20), (1_000_000, 3), (8_000_000, 1)];
    between_hosts(Line::Bad, vec![], |hosts| exchange(ourselves(hosts, DOMAIN), sizes));
}

#[test]
fn services_and_latched_texts_pass_between_us_and_rclpy_over_a_bad_line() {
    let check =
        of_hosts("services and latched messages over a line with 2 % loss and 20 ms delay", With::Rclpy);
    between_hosts(Line::Bad, check, |hosts| {
        const TYPE: &str = "std_srvs/srv/SetBool";
        let mut peer = rclpy(hosts, DOMAIN);
        let latched =
            QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT }.keep_last(5);
        let talker = Talker::join(&options(), latched);
        (0..20).for_each(|number| talker.say(number, 10_000));
        talker.meet(&mut peer, 20);
        let last: Vec<_> = (15..20).map(|number| (number, 10_000)).collect();
        assert_eq!(taken(&mut peer, "/ours", 5), last);

        let answer = |request: SetBoolRequest| SetBoolResponse {
            success: request.data,
            message: format!("data is {}", request.data),
        };
        // As many as are under way at once.
        let qos = QosProfile::SERVICES.keep_last(100);
        let _service = talker.node.serve::<SetBool>("/light", qos, answer).unwrap();
        peer.ask(json!({"do": "client", "service": "/light", "type": TYPE, "qos": {"depth": 100}}));
        assert_eq!(peer.ask(json!({"do": "wait_for_service", "service": "/light"})), true);
        let requests = vec![json!({"data": true}); 50];
        let answers: Value = vec![json!({"success": true, "message": "data is true"}); 50].into();
        assert_eq!(peer.ask(json!({"do": "call", "service": "/light", "requests": requests})), answers);

        peer.ask(json!({"do": "serve", "service": "/theirs", "type": TYPE, "qos": {"depth": 100}}));
        let client = talker.node.client::<SetBool>("/theirs", QosProfile::SERVICES).unwrap();
        assert!(client.wait_for_service(common::WATCHDOG));
        for number in 0..20 {
            let data = number % 2 == 0;
            let answer = client.call_and_wait(&SetBoolRequest { data }, common::WATCHDOG).unwrap();
            assert_eq!(answer.success, data);
        }
    });
}

#[test]
fn who_is_behind_a_cable_that_was_out_for_30_seconds_is_found_again() {
    between_hosts(Line::Good, of_cable(30), |hosts| find_each_other_after(hosts, 30));
}

#[test]
fn who_is_behind_a_cable_that_was_out_for_5_seconds_is_not_lost() {
    between_hosts(Line::Good, of_cable(5), |hosts| find_each_other_after(hosts, 5));
}

#[test]
#[ignore = "takes long; cargo xtask wire runs it"]
fn who_is_behind_a_cable_that_was_out_for_26_seconds_is_found_again() {
    between_hosts(Line::Good, of_cable(26), |hosts| find_each_other_after(hosts, 26));
}

#[test]
#[ignore = "takes long; cargo xtask wire runs it"]
fn who_is_behind_a_cable_that_was_out_for_a_minute_is_found_again() {
    between_hosts(Line::Good, of_cable(60), |hosts| find_each_other_after(hosts, 60));
}

/// Our leases and those of Fast DDS end after 20 s, those of Cyclone after 10 s.
const ALL_LEASES: u64 = 25;
const ANY_LEASE: u64 = 10;

fn of_cable(seconds: u64) -> Vec<Check> {
    let feature = format!("a cable unplugged for {seconds} s: both sides list and hear each other again");
    [With::Rclpy, With::Cyclone].map(|peer| check("Discovery", &feature, peer, Way::Both)).into()
}

fn find_each_other_after(hosts: &Hosts, seconds: u64) {
    const DOMAINS: [u16; 3] = [0, 1, 2];
    let [one, two, three] = DOMAINS;
    let mut peers = [rclpy(hosts, one), cyclone(hosts, two), ourselves(hosts, three)];
    let talkers =
        DOMAINS.map(|domain_id| Talker::join(&ParticipantOptions::new(domain_id), QosProfile::DEFAULT));
    for (talker, peer) in talkers.iter().zip(&mut peers) {
        talker.meet(peer, 10);
        talker.exchange(peer, 100, 5);
    }
    hosts.pull_the_cable();
    std::thread::sleep(Duration::from_secs(seconds));
    for (talker, peer) in talkers.iter().zip(&mut peers) {
        let ours = talker.ours.matched_subscriptions();
        let theirs = peer.ask(json!({"do": "matched", "topic": "/ours"}));
        if seconds > ALL_LEASES {
            assert_eq!((ours, theirs), (0, json!(0)), "both are forgotten");
        } else if seconds < ANY_LEASE {
            assert_eq!((ours, theirs), (1, json!(1)), "none is forgotten");
        }
    }
    hosts.put_the_cable_back();
    for (talker, peer) in talkers.iter().zip(&mut peers) {
        talker.wait_until_matched(peer);
        talker.exchange(peer, 100, 5);
        talker.exchange(peer, 70_000, 5);
    }
    let [rclpy, ..] = &mut peers;
    wait_until("both list the node of the other", || {
        let nodes = rclpy.ask(json!({"do": "nodes"}));
        nodes.as_array().unwrap().contains(&json!("/downbeat"))
            && talkers[0].participant.remote_nodes().iter().any(|node| node.name == "/peer")
            && talkers[2].participant.remote_nodes().iter().any(|node| node.name == "/peer")
    });
}

#[test]
fn a_cable_that_was_out_for_3_seconds_loses_nothing_of_what_is_kept() {
    let check = of_hosts("a cable unplugged for 3 s: nothing is lost", With::Rclpy);
    between_hosts(Line::Good, check, |hosts| {
        let mut peer = rclpy(hosts, DOMAIN);
        let talker = Talker::join(&options(), QosProfile::DEFAULT.keep_last(500));
        talker.meet(&mut peer, 500);
        hosts.pull_the_cable();
        (0..200).for_each(|number| talker.say(number, 3_000));
        let publish = json!({"do": "publish_texts", "topic": "/theirs", "size": 3_000, "count": 200});
        peer.ask(publish);
        std::thread::sleep(Duration::from_secs(3));
        hosts.put_the_cable_back();
        common::texts::assert_whole(&taken(&mut peer, "/ours", 200), 3_000, 200);
        let heard: Vec<_> = (0..200).map(|_| talker.heard()).collect();
        common::texts::assert_whole(&heard, 3_000, 200);
    });
}

#[test]
fn fifty_of_us_and_rclpy_find_each_other_by_multicast() {
    let check = of_hosts("50 participants of one host, by multicast", With::Rclpy);
    between_hosts(Line::Good, check, |hosts| {
        const COUNT: usize = 50;
        let mut peer = rclpy(hosts, DOMAIN);
        let qos = qos_of(QosProfile::DEFAULT, 200);
        peer.ask(json!({"do": "subscribe_texts", "topic": "/ours", "qos": qos}));
        let kind = MessageType::new(TEXT).unwrap();
        let all: Vec<_> = (0..COUNT)
            .map(|number| {
                let participant = Participant::join(&options()).unwrap();
                let name = NodeName::new("/", &format!("node_{number}")).unwrap();
                let node = participant.create_node(name).unwrap();
                let publisher = node.publish("/ours", &kind, QosProfile::DEFAULT).unwrap();
                (participant, node, publisher)
            })
            .collect();
        wait_until("all are matched", || {
            all.iter().all(|(.., publisher)| publisher.matched_subscriptions() == 1)
                && peer.ask(json!({"do": "matched", "topic": "/ours"})) == COUNT
        });
        for (number, (.., publisher)) in all.iter().enumerate() {
            publisher.publish(text_of(number, 100)).unwrap();
        }
        let numbers: BTreeSet<_> =
            taken(&mut peer, "/ours", COUNT).iter().map(|(number, _)| *number).collect();
        assert_eq!(numbers, (0..COUNT).collect());
        wait_until("each of us knows all others and rclpy", || {
            all.iter().all(|(participant, ..)| participant.remote_nodes().len() == COUNT)
        });
    });
}
