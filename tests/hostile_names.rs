//! Peers whose names and data hold control characters or invalid text: none of it reaches a terminal.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::fs;
use std::process::Stdio;
use std::sync::LazyLock;

use bytes::Bytes;
use common::{Running, downbeat};
use downbeat::msgs::cdr;
use downbeat::msgs::rmw_dds_common::msg::{Gid, NodeEntitiesInfo, ParticipantEntitiesInfo};
use downbeat_rtps::protocol::{EndpointConfig, WriteOptions};
use downbeat_rtps::qos::{Durability, Qos};
use downbeat_rtps::{Options, Participant, Range};
use test_machine::free_domain;

static DOMAIN: LazyLock<u16> = LazyLock::new(free_domain);
const STRING: &str = "std_msgs::msg::dds_::String_";

/// Clears the screen, sets colours, moves the cursor, rings the bell, reverses text, and imitates another
/// line.
const EVIL: &str = "\x1b[2J\u{9b}31m\u{7}\r\u{202e}\nfake line";

const ROBOT: &str = r#"
[robot]
name = "quiet"
[[module]]
name = "motion"
kind = "stand_nod_wave"
[[module]]
name = "mux"
kind = "joint_command_mux"
[expose]
in = ["joint_commands"]
"#;

/// A participant that announces such names wherever names are possible.
fn hostile() -> (Participant, Vec<downbeat_rtps::Writer>) {
    let mut options = Options::new(*DOMAIN, Range::Localhost);
    options.name = EVIL.to_owned();
    options.user_data = [format!("enclave=/{EVIL};").as_bytes(), b"\xff\xfe"].concat();
    let participant = Participant::join(&options).unwrap();
    let topics = [
        (format!("rt/{EVIL}"), STRING.to_owned()),
        ("rt/type".to_owned(), format!("std_msgs::msg::dds_::{EVIL}_")),
        ("rt/joint_commands".to_owned(), format!("{EVIL}::msg::dds_::JointState_")),
        ("rt/hash".to_owned(), STRING.to_owned()),
        (format!("rq/{EVIL}Request"), "std_srvs::srv::dds_::Trigger_Request_".to_owned()),
    ];
    let mut writers: Vec<_> = topics
        .into_iter()
        .map(|(topic, type_name)| {
            let partition = vec![String::new(), EVIL.to_owned()];
            let mut config =
                EndpointConfig::new(topic, type_name, Qos { partition, ..Qos::writer_default() });
            config.user_data = Bytes::from_static(b"typehash=\xff\x1b[2J;\xfe");
            participant.create_writer(config).unwrap()
        })
        .collect();
    let qos = Qos { durability: Durability::TransientLocal, ..Qos::writer_default() };
    let kind = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";
    let graph = participant.create_writer(EndpointConfig::new("ros_discovery_info", kind, qos)).unwrap();
    let gid = |prefix: [u8; 12], entity: [u8; 4]| {
        let mut data = [0; 16];
        data[..12].copy_from_slice(&prefix);
        data[12..].copy_from_slice(&entity);
        Gid { data }
    };
    let node = |namespace: &str, name: &str| NodeEntitiesInfo {
        node_namespace: namespace.to_owned(),
        node_name: name.to_owned(),
        ..NodeEntitiesInfo::default()
    };
    let info = ParticipantEntitiesInfo {
        gid: gid(participant.prefix().0, [0, 0, 1, 0xc1]),
        node_entities_info_seq: vec![node("/", EVIL), node(&format!("/{EVIL}"), "node"), node("/", "plain")],
    };
    graph.write(cdr::to_vec(&info).into(), WriteOptions::default()).unwrap();
    writers.push(graph);
    (participant, writers)
}

fn assert_is_harmless(text: &str, context: &str) {
    let is_harmful =
        |shown: char| (shown.is_control() && !matches!(shown, '\n' | '\t')) || shown == '\u{202e}';
    assert!(!text.contains(is_harmful), "{context}: {text:?}");
    assert!(!text.lines().any(|line| line.starts_with("fake line")), "{context}: {text}");
}

#[test]
fn nothing_that_peers_announce_controls_a_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("quiet.toml");
    fs::write(&file, ROBOT).unwrap();
    let mut command = downbeat(&["run", file.to_str().unwrap()]);
    command.env("DOWNBEAT_LOG", "trace").env("ROS_DOMAIN_ID", DOMAIN.to_string());
    let mut robot = Running::start_by(&mut command);
    let _hostile = hostile();
    let incompatible = "Incompatible type on topic '/joint_commands'";
    robot.wait_for_output(incompatible);
    let looks: [&[&str]; 8] = [
        &["node", "list", "--all"],
        &["node", "info", "/quiet"],
        &["topic", "list", "-t", "--include-hidden-topics"],
        &["topic", "info", "-v", "/hash"],
        &["topic", "info", "-v", "/joint_commands"],
        &["service", "list", "-t"],
        &["graph"],
        &["graph", "--format", "dot"],
    ];
    for look in looks {
        let look: Vec<&str> =
            if look[0] == "graph" { look.to_vec() } else { [look, &["--spin-time", "5"]].concat() };
        let mut command = downbeat(&look);
        command.env("ROS_DOMAIN_ID", DOMAIN.to_string()).env("DOWNBEAT_LOG", "debug");
        let output = command.stdin(Stdio::null()).output().unwrap();
        let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
        assert!(output.status.success(), "{look:?}: {text}");
        assert_is_harmless(&text, &format!("{look:?}"));
        if look.starts_with(&["node", "list"]) {
            assert!(text.contains("/plain") && text.contains("/quiet"), "{text}");
        }
    }
    robot.interrupt();
    assert_is_harmless(&robot.output(), "the log");
}
