//! The hashes in the generated types.

use std::collections::{BTreeMap, BTreeSet};

use crate::every_type::{every_type, services_and_actions};
use crate::peer::Peer;

fn hashes() -> Vec<(&'static str, &'static str)> {
    let mut hashes: Vec<_> = every_type().iter().map(|of| (of.name, of.hash)).collect();
    hashes.extend(services_and_actions());
    hashes
}

#[test]
fn every_hash_is_that_of_the_wheels() {
    let Some(peer) = Peer::find() else { return };
    let published = peer.published_hashes();
    let mut compared = BTreeMap::new();
    for (name, hash) in hashes().into_iter().filter(|(name, _)| peer.has_package_of(name)) {
        let theirs = published.get(name).unwrap_or_else(|| panic!("the wheels have no {name}"));
        assert_eq!(hash, theirs, "{name}");
        compared.insert(name, hash);
    }
    // Every interface of a built-in package must be in the registry.
    let places: BTreeSet<&str> = compared.keys().map(|name| place_of(name)).collect();
    for name in published.keys().filter(|name| places.contains(place_of(name))) {
        assert!(compared.contains_key(name.as_str()), "{name} is not built in");
    }
    assert!(compared.len() > 300, "only {} types were compared", compared.len());
}

/// `test_msgs/srv`.
fn place_of(name: &str) -> &str {
    name.rsplit_once('/').unwrap().0
}

/// The wheels lack some packages, whose messages rosbags defines independently.
#[test]
fn hashes_of_messages_are_those_that_rosbags_computes_from_its_own_definitions() {
    let Some(peer) = Peer::find() else { return };
    let ours: BTreeMap<&str, &str> = hashes().into_iter().collect();
    let names = ours.keys().fold(String::new(), |names, name| names + name + "\n");
    let answer = peer.ask("bags_hashes", &[], &names);
    let compared = answer.lines::<2>();
    for [name, hash] in &compared {
        assert_eq!(ours[name], *hash, "{name}");
    }
    let is_compared = |name: &str| compared.iter().any(|[compared, _]| *compared == name);
    assert!(
        compared.len() > 140 && is_compared("sensor_msgs/msg/Imu"),
        "only {} were compared",
        compared.len()
    );
    for name in [
        "tf2_msgs/msg/TFMessage",
        "rosbag2_interfaces/msg/WriteSplitEvent",
        "statistics_msgs/msg/MetricsMessage",
    ] {
        assert!(!ours.contains_key(name) || is_compared(name), "{name}");
    }
}
