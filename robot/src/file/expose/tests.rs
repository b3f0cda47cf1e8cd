#![allow(clippy::unwrap_used)]
use std::time::Duration;

use downbeat_bridge::expose::{Limits, OfACycle};
#[cfg(feature = "zenoh")]
use downbeat_bridge::middleware::{Priority, SendOptions};
use downbeat_bridge::ros::{Policy, QosRequest};
use downbeat_msgs::qos::{Durability, History, Liveliness, QosProfile, Reliability};

use super::*;
use crate::RobotFile;

fn entries(text: &str) -> Vec<ExposeEntry> {
    RobotFile::parse_entries(text, &Interfaces::carried(), None).unwrap_or_else(|error| panic!("{error}"))
}

fn problem(text: &str, engine: Option<Engine>) -> String {
    RobotFile::parse_entries(text, &Interfaces::carried(), engine).err().unwrap().to_string()
}

fn qos(direction: &str, qos: &str) -> QosRequest {
    entries(&format!("{direction} = [{{ topic = \"a\", qos = {qos} }}]"))[0].qos
}

#[test]
fn presets_equal_those_of_rmw() {
    for (name, profile) in [
        ("default", QosProfile::DEFAULT),
        ("sensor_data", QosProfile::SENSOR_DATA),
        ("services", QosProfile::SERVICES),
        ("services_default", QosProfile::SERVICES),
        ("parameters", QosProfile::PARAMETERS),
        ("parameter_events", QosProfile::PARAMETER_EVENTS),
        ("clock", QosProfile::CLOCK),
        ("rosout", QosProfile::ROSOUT),
        ("latched", QosProfile::LATCHED),
    ] {
        assert_eq!(qos("out", &format!("\"{name}\"")), profile.into(), "{name}");
    }
    assert_eq!(qos("in", "\"best_available\""), QosRequest::BEST_AVAILABLE);
    let system = |direction: &str| qos(direction, "\"system_default\"").profile().unwrap();
    assert_eq!(system("out"), QosProfile::DEFAULT.keep_last(1));
    assert_eq!(system("in"), QosProfile::CLOCK);
}

#[test]
fn each_policy_can_be_given_beside_a_preset() {
    let given = qos(
        "out",
        "{ preset = \"sensor_data\", reliability = \"reliable\", durability = \"best_available\", \
         history = \"keep_all\", deadline = \"100ms\", lifespan = \"2s\", liveliness = \"manual_by_topic\", \
         liveliness_lease_duration = \"1s\" }",
    );
    let expected = QosRequest {
        history: History::KeepAll,
        reliability: Policy::Given(Reliability::Reliable),
        durability: Policy::BestAvailable,
        deadline: Policy::Given(Some(Duration::from_millis(100))),
        lifespan: Some(Duration::from_secs(2)),
        liveliness: Policy::Given(Liveliness::ManualByTopic),
        liveliness_lease_duration: Policy::Given(Some(Duration::from_secs(1))),
    };
    assert_eq!(given, expected);
    let rosout =
        qos("out", "{ preset = \"rosout\", lifespan = \"infinite\", depth = 3, durability = \"volatile\" }");
    assert_eq!(rosout.profile().unwrap(), QosProfile::DEFAULT.keep_last(3));
    assert_eq!(rosout.durability, Policy::Given(Durability::Volatile));
    assert_eq!(qos("in", "{ deadline = \"best_available\" }").deadline, Policy::BestAvailable);
}

#[test]
fn a_topic_can_have_limits_and_another_node() {
    let text =
        "out = [{ topic = \"a\", rate_hz = 12.5, every = 3, latest_only = true, node = \"camera\" }, \"b\"]";
    let [a, b] = <[ExposeEntry; 2]>::try_from(entries(text)).ok().unwrap();
    let period = Some(Duration::from_millis(80));
    assert_eq!(a.limits, Limits { period, every: 3, of_a_cycle: OfACycle::Latest });
    assert_eq!((a.node.as_deref(), b.node.as_deref()), (Some("camera"), None));
    assert_eq!(b.limits, Limits::default());
    assert_eq!(
        entries("in = [{ topic = \"a\", rate_hz = 5 }]")[0].limits.period,
        Some(Duration::from_millis(200))
    );
}

#[test]
fn errors_contain_the_line() {
    for (entry, expected) in [
        (
            "{ topic = \"a\", qos = \"sensor\" }",
            "unknown QoS preset \"sensor\", did you mean \"sensor_data\"?",
        ),
        ("{ topic = \"a\", qos = { reliability = \"best\" } }", "unknown choice \"best\""),
        ("{ topic = \"a\", qos = { deadline = 100 } }", "expected a time with its unit"),
        ("{ topic = \"a\", qos = { lease = \"1s\" } }", "qos has no \"lease\""),
        ("{ topic = \"a\", qos = { history = \"keep_all\", depth = 2 } }", "\"depth\" needs"),
        ("{ topic = \"a\", rate_hz = 0 }", "0 is not a rate"),
        ("{ topic = \"a\", rate_hz = -1.0 }", "-1 is not a rate"),
        ("{ topic = \"a\", rate_hz = nan }", "NaN is not a rate"),
        ("{ topic = \"a\", every = 0 }", "greater than 0"),
        ("{ topic = \"a\", latest_only = 1 }", "expected true or false, found 1"),
        ("{ topic = \"a\", latest = true }", "did you mean \"latest_only\"?"),
        ("{ topic = \"a\", priority = \"data\" }", "\"priority\" needs a network with engine = \"zenoh\""),
        ("{ topic = \"a\", express = true }", "\"express\" needs a network with engine = \"zenoh\""),
        ("{ topic = \"a/*\", as = \"/b\" }", "a new name has the wildcards"),
        ("{ topic = \"a\", as = \"/b/*\" }", "\"a\" has none for it"),
        ("{ topic = \"a\", except = [\"b\"] }", "\"except\" needs a pattern"),
        ("{ topic = \"a/*\", except = [\"b**\"] }", "pattern \"b**\""),
        ("\"a/b**\"", "pattern \"a/b**\""),
    ] {
        let problem = problem(&format!("in = []\nout = [{entry}]"), None);
        assert!(problem.starts_with("expose:2: ") && problem.contains(expected), "{problem}");
    }
}

#[cfg(feature = "zenoh")]
#[test]
fn topics_on_zenoh_have_a_priority_and_may_be_express() {
    let zenoh = Some(Engine::Zenoh);
    for (name, priority) in Priority::ALL {
        let text = format!("out = [{{ topic = \"a\", priority = \"{name}\", express = true }}, \"b\"]");
        let entries = RobotFile::parse_entries(&text, &Interfaces::carried(), zenoh).unwrap();
        assert_eq!(entries[0].send, SendOptions { priority, is_express: true });
        assert_eq!((entries[1].send, priority.name()), (SendOptions::default(), name));
    }
    let unknown = problem("out = [\n{ topic = \"a\", priority = \"real_tim\" }]", zenoh);
    assert_eq!(unknown, "expose:2: unknown choice \"real_tim\", did you mean \"real_time\"?");
    let incoming = problem("in = [{ topic = \"a\", priority = \"data\" }]", zenoh);
    assert!(incoming.contains("has no \"priority\""), "{incoming}");
}
