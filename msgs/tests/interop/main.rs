//! Our messages against the real ones: hashes, definition texts and bytes, with the ROS 2 Jazzy wheels as the witness, and
//! `rosbags` as a second, independent one for what rclpy does not do (big-endian, types of our own).
//!
//! Needs the Python interpreter that `DOWNBEAT_PYTHON` names; without it the tests say so and pass.

#![allow(clippy::unwrap_used)]

mod descriptions;
mod every_type;
mod peer;
mod random;
mod users_packages;

#[allow(clippy::all, dead_code, missing_docs)]
mod odd_msgs {
    include!(concat!(env!("OUT_DIR"), "/odd_msgs.rs"));
}

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use downbeat_msgs_generator::Catalog;
use serde_json::Value;

use every_type::{Type, carried_services, every_type, has_no_wheel};
use peer::{Peer, hex, unhex};
use random::Random;

/// Random values of each type, in each direction.
const VALUES_PER_TYPE: usize = 40;

#[test]
fn every_hash_is_that_of_the_wheels() {
    let Some(peer) = Peer::find() else { return };
    let mut hashes: Vec<(&str, &str)> =
        every_type().iter().filter(|of| !has_no_wheel(of.name)).map(|of| (of.name, of.hash)).collect();
    hashes.extend(carried_services().into_iter().filter(|(name, _)| !has_no_wheel(name)));
    for (name, hash) in &hashes {
        assert_eq!(*hash, peer.published_hashes(name)[*name], "{name}");
    }
    assert!(hashes.len() > 260, "only {} types were compared", hashes.len());
}

#[test]
fn the_generator_understands_every_interface_of_the_wheels() {
    let Some(peer) = Peer::find() else { return };
    let mut catalog = Catalog::new();
    let files = catalog.add_packages(&peer.share()).unwrap();
    assert!(files > 190, "only {files} files were found");
    catalog.check().unwrap();
    let messages = catalog.messages().map(|of| &of.name);
    for name in
        messages.chain(catalog.services().map(|of| &of.name)).chain(catalog.actions().map(|of| &of.name))
    {
        let published = &peer.published_hashes(&name.to_string())[&name.to_string()];
        assert_eq!(catalog.type_hash(name).unwrap(), *published, "{name}");
    }
}

#[test]
fn definition_texts_are_those_of_the_real_recorder() {
    let schemas = recorded_schemas();
    for (name, recorded) in &schemas {
        let types = every_type();
        let ours = types.iter().find(|of| of.name == name).unwrap().definition;
        assert_eq!(without_comments(ours), without_comments(recorded), "{name}");
    }
    assert_eq!(schemas.len(), 9);
}

#[test]
fn messages_from_the_wire_are_read_and_written_again_to_the_byte() {
    let types: BTreeMap<&str, Type> = every_type().into_iter().map(|of| (of.name, of)).collect();
    let lines = include_str!("../data/recorded_messages.txt").lines();
    for (name, recorded) in lines.clone().map(|line| line.split_once('\t').unwrap()) {
        let (ours, value) = (types[name].read)(&unhex(recorded)).unwrap();
        if name == "std_srvs/srv/SetBool_Event" {
            assert_eq!(value["response"][0]["message"], "ok", "{value}");
        }
        assert_same(&hex(&ours), recorded, name);
    }
    assert_eq!(lines.count(), 8);
}

#[test]
fn definition_texts_from_the_wheels_files_are_those_of_the_real_recorder_to_the_byte() {
    let Some(peer) = Peer::find() else { return };
    let mut catalog = Catalog::new();
    catalog.add_packages(&peer.share()).unwrap();
    for (name, recorded) in recorded_schemas() {
        assert_eq!(catalog.definition_text(&name.parse().unwrap()).unwrap(), recorded, "{name}");
    }
}

#[test]
fn what_rclpy_writes_is_read_and_written_again_to_the_byte() {
    let Some(peer) = Peer::find() else { return };
    let types: Vec<Type> = every_type().into_iter().filter(|of| !has_no_wheel(of.name)).collect();
    let names: String = types.iter().fold(String::new(), |all, of| all + of.name + "\n");
    let answer = peer.ask("write", &[&VALUES_PER_TYPE.to_string()], &names);
    let mut lines = answer.lines();
    for of in &types {
        for number in 0..=VALUES_PER_TYPE {
            let mut parts = lines.next().unwrap().split('\t');
            let (name, bytes, value) =
                (parts.next().unwrap(), unhex(parts.next().unwrap()), parts.next().unwrap());
            assert_eq!(name, of.name);
            if number == 0 {
                assert_same(&hex(&(of.default)()), &hex(&bytes), name);
            }
            let (again, json) = (of.read)(&bytes).unwrap_or_else(|error| panic!("{name} {value}: {error}"));
            assert_same(&hex(&again), &hex(&bytes), name);
            assert_eq!(json, serde_json::from_str::<Value>(value).unwrap(), "{name}");
        }
    }
    assert_eq!(lines.next(), None);
}

#[test]
fn what_we_write_is_read_and_written_again_by_rclpy_to_the_byte() {
    let Some(peer) = Peer::find() else { return };
    let ours = random_values(|of| !has_no_wheel(of.name));
    let answer = peer.ask("read", &[], &ours);
    let mut count = 0;
    for (line, theirs) in ours.lines().zip(answer.lines()) {
        let (name, bytes) = line.split_once('\t').unwrap();
        assert_same(bytes, theirs, name);
        count += 1;
    }
    assert_eq!((count, answer.lines().count()), (ours.lines().count(), count));
}

#[test]
fn rosbags_reads_what_we_write_by_our_definition_text_and_we_read_its_big_endian() {
    let Some(peer) = Peer::find() else { return };
    // Texts of events begin with `SRV:`, which rosbags does not read; nor has it wide strings, nor all that is odd. The messages
    // that an action refers to it looks for among actions.
    let is_known = |of: &Type| {
        !of.name.ends_with("_Event")
            && !of.name.contains("/action/")
            && !of.name.ends_with("/WStrings")
            && !of.name.starts_with("odd_msgs/")
    };
    let ours = random_values(is_known);
    let mut request = String::new();
    for of in every_type().iter().filter(|of| is_known(of)) {
        writeln!(request, "define\t{}\t{}", of.name, hex(of.definition.as_bytes())).unwrap();
    }
    let answer = peer.ask("big_endian", &[], &(request + &ours));
    let types: BTreeMap<&str, Type> = every_type().into_iter().map(|of| (of.name, of)).collect();
    let mut count = 0;
    for (line, theirs) in ours.lines().zip(answer.lines()) {
        let (name, bytes) = line.split_once('\t').unwrap();
        let (little, big) = theirs.split_once('\t').unwrap();
        assert_eq!(little, bytes, "{name}");
        assert!(big.starts_with("00000000"), "{name} {big}");
        let (again, _) =
            (types[name].read)(&unhex(big)).unwrap_or_else(|error| panic!("{name} {big}: {error}"));
        assert_eq!(hex(&again), bytes, "{name} {big}");
        count += 1;
    }
    assert_eq!((count, answer.lines().count()), (ours.lines().count(), count));
}

#[test]
fn random_values_of_every_type_come_back_the_same() {
    let types: BTreeMap<&str, Type> = every_type().into_iter().map(|of| (of.name, of)).collect();
    for (name, bytes) in random_values(|_| true).lines().map(|line| line.split_once('\t').unwrap()) {
        let (again, _) =
            (types[name].read)(&unhex(bytes)).unwrap_or_else(|error| panic!("{name} {bytes}: {error}"));
        assert_eq!(hex(&again), bytes, "{name}");
    }
}

/// `serialize_message` gives a buffer as long as the size it estimated beforehand (`rmw_serialize` in
/// rmw_fastrtps_shared_cpp takes the length from `getEstimatedSerializedSize`), which is the greatest size for types that have
/// one, and counts padding before empty sequences for others. What stands behind the value is no part of it.
fn assert_same(ours: &str, theirs: &str, what: &str) {
    let rest = theirs.strip_prefix(ours).unwrap_or_else(|| panic!("{what}: we write {ours}, rclpy {theirs}"));
    assert!(rest.bytes().all(|digit| digit == b'0'), "{what}: behind {ours} rclpy has {rest}");
}

/// Lines of name and bytes.
fn random_values(choose: impl Fn(&Type) -> bool) -> String {
    let mut random = Random::new(0x5eed);
    let mut lines = String::new();
    for of in every_type().iter().filter(|of| choose(of)) {
        for _ in 0..VALUES_PER_TYPE {
            writeln!(lines, "{}\t{}", of.name, hex(&(of.random)(&mut random))).unwrap();
        }
    }
    lines
}

fn recorded_schemas() -> BTreeMap<String, String> {
    let folder: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/recorded_schemas");
    let mut schemas = BTreeMap::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_string_lossy().replace('.', "/");
        schemas.insert(name, std::fs::read_to_string(path).unwrap());
    }
    schemas
}

/// The words of each line that has any, comments left out.
fn without_comments(text: &str) -> Vec<Vec<&str>> {
    text.lines()
        .map(|line| {
            line.split('#')
                .next()
                .unwrap_or("")
                .split(['=', ' ', '\t'])
                .filter(|word| !word.is_empty())
                .collect()
        })
        .filter(|words: &Vec<&str>| !words.is_empty())
        .collect()
}
