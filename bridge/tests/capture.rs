//! What we send, as `tshark` decodes it: a recorded conversation of topics, fragments, a service and
//! removals.
#![allow(clippy::unwrap_used)]

mod common;
mod ours;

use common::texts::{Talker, qos_of};
use common::{WATCHDOG, on_loopback, wait_until};
use downbeat_bridge::ros::{NodeName, Participant};
use downbeat_msgs::qos::{Durability, QosProfile};
use downbeat_msgs::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};
use serde_json::json;
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use test_machine::free_domain;

/// The last port of a domain, which no participant has.
fn mark_port(domain: u16) -> u16 {
    7400 + 250 * domain + 249
}

/// Records the domain on the loopback interface, or says why not and returns nothing.
fn record(domain: u16, file: &Path) -> Option<Child> {
    let filter = format!("udp portrange {}-{}", 7400 + 250 * domain, mark_port(domain));
    let mut command = Command::new("dumpcap");
    command.args(["-q", "-i", "lo", "-B", "64", "-f", &filter, "-w"]).arg(file).stderr(Stdio::piped());
    let Ok(mut recording) = command.spawn() else {
        test_machine::missing("dumpcap", "Debian: the package tshark");
        return None;
    };
    let mut line = String::new();
    let mut errors = BufReader::new(recording.stderr.take().unwrap());
    while errors.read_line(&mut line).unwrap() > 0 {
        if line.contains("File:") {
            // It goes on to print how much it has recorded.
            recording.stderr = Some(errors.into_inner());
            return Some(recording);
        }
    }
    recording.wait().unwrap();
    test_machine::skipped(&format!("this user may not record with dumpcap: {line}"));
    None
}

/// Until what was sent so far is in the file.
fn wait_until_recorded(domain: u16, file: &Path) {
    const MARK: &[u8] = b"all that was said before is recorded";
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    wait_until("the recording is written", || {
        // Nobody listens there, so a later send may fail.
        let _ = socket.send_to(MARK, ("127.0.0.1", mark_port(domain)));
        std::fs::read(file).unwrap().windows(MARK.len()).any(|bytes| bytes == MARK)
    });
}

fn tshark(file: &Path, arguments: &[&str]) -> String {
    // By the content first: some domains have ports that other protocols are known for, such as games.
    let by_content = ["-o", "udp.try_heuristic_first:TRUE"];
    let output =
        Command::new("tshark").arg("-r").arg(file).args(by_content).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// All that we say: two of us, with a service, with latched texts, with fragments, with a text that comes too
/// late.
fn converse(domain: u16) {
    let latched = QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT }.keep_last(2);
    let mut peer = ours::start(domain);
    let talker = Talker::join(&on_loopback(domain), latched);
    (0..5).for_each(|number| talker.say(number, 100));
    talker.meet(&mut peer, 100);
    assert_eq!(common::texts::taken(&mut peer, "/ours", 2), [(3, 100), (4, 100)]);
    for size in [10, 1_400, 100_000, 1_000_000] {
        talker.exchange(&mut peer, size, 2);
    }
    let best_effort = QosProfile::SENSOR_DATA;
    let qos = qos_of(best_effort, 5);
    peer.ask(json!({"do": "subscribe_texts", "topic": "/best_effort", "qos": qos}));

    let other = Participant::join(&on_loopback(domain)).unwrap();
    let other = other.create_node(NodeName::new("/", "other").unwrap()).unwrap();
    let service = talker
        .node
        .serve::<SetBool>("/light", QosProfile::SERVICES, |request| SetBoolResponse {
            success: request.data,
            message: String::new(),
        })
        .unwrap();
    let client = other.client::<SetBool>("/light", QosProfile::SERVICES).unwrap();
    assert!(client.wait_for_service(WATCHDOG));
    // What is said to one client is nothing to another.
    let second = other.client::<SetBool>("/light", QosProfile::SERVICES).unwrap();
    assert!(second.wait_for_service(WATCHDOG));
    for client in [&client, &second, &client] {
        assert!(client.call_and_wait(&SetBoolRequest { data: true }, WATCHDOG).unwrap().success);
    }
    drop(service);
    wait_until("the service is gone", || !client.is_available());
    drop((client, second, other, talker));
}

#[test]
fn tshark_decodes_a_conversation_of_ours_without_a_malformed_packet() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("conversation.pcapng");
    let domain = free_domain();
    let Some(mut recording) = record(domain, &file) else { return };
    converse(domain);
    wait_until_recorded(domain, &file);
    let status = Command::new("kill").arg("-INT").arg(recording.id().to_string()).status().unwrap();
    assert!(status.success());
    recording.wait().unwrap();

    let malformed = "_ws.malformed || _ws.expert.severity == \"Error\" || !rtps";
    let malformed = format!("({malformed}) && udp.dstport != {} && !icmp", mark_port(domain));
    assert_eq!(tshark(&file, &["-Y", &malformed]), "");
    let submessages = tshark(&file, &["-T", "fields", "-e", "rtps.sm.id", "-E", "aggregator=,"]);
    let found: BTreeSet<&str> = submessages.split([',', '\n']).collect();
    // INFO_TS, INFO_DST, DATA, DATA_FRAG, HEARTBEAT, ACKNACK, GAP: the names of these numbers stand in RTPS
    // 2.5, 9.4.5.1.
    for id in ["0x09", "0x0e", "0x15", "0x16", "0x07", "0x06", "0x08"] {
        assert!(found.contains(id), "no submessage {id} among {found:?}");
    }
    let topics = tshark(&file, &["-T", "fields", "-e", "rtps.param.topicName"]);
    for topic in ["rt/ours", "rt/theirs", "rq/lightRequest", "rr/lightReply"] {
        assert!(topics.contains(topic), "{topic} among {topics}");
    }
    // The status of a sample that removes what its key names: disposed and unregistered.
    let removals =
        tshark(&file, &["-Y", "rtps.param.status_info == 3", "-T", "fields", "-e", "frame.number"]);
    assert!(removals.lines().count() >= 3, "{removals}");
}
