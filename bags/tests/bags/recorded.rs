//! The recorded bags of the repository, and a bag of actions and services, opened by other software.

use std::fs;
use std::path::{Path, PathBuf};

use downbeat_bags::{Reader, TopicDescription, WriterOptions};
use downbeat_msgs::carried;
use downbeat_msgs::dynamic::{Definitions, DynamicMessage};
use serde_json::Value;

use crate::matrix::{Check, Way, With};
use crate::node::read_with_node;
use crate::stock_readers;
use crate::support::noted;

/// The bags below the folders of this repository, except those of other recorders.
fn recorded_bags() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut bags = Vec::new();
    let mut folders =
        ["bags/recordings", "examples", "program/src/new/templates"].map(|of| root.join(of)).to_vec();
    while let Some(folder) = folders.pop() {
        if folder.join("metadata.yaml").exists() {
            bags.push(folder);
            continue;
        }
        let entries = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap());
        folders.extend(entries.filter(|entry| entry.file_type().unwrap().is_dir()).map(|entry| entry.path()));
    }
    bags.sort();
    bags
}

/// A bag with a message of each part of an action and of each part of a service.
fn write_parts(bag: &Path) {
    let mut writer = WriterOptions::new().create(bag).unwrap();
    let definitions = Definitions::new().with_carried();
    let names: Vec<_> = carried().messages().map(|message| message.name.clone()).collect();
    let parts = names.iter().filter(|name| {
        ["PlayMotion_", "FollowJointTrajectory_", "SetBool_", "GetPlan_"]
            .iter()
            .any(|of| name.name.starts_with(of))
    });
    for (time, name) in (1_i64..).zip(parts) {
        let of = definitions.describe(&name.to_string()).unwrap();
        let topic = TopicDescription {
            name: format!("/{}/{}", name.package, name.name),
            type_name: name.to_string(),
            definition: of.text,
            type_hash: of.hash,
            ..TopicDescription::default()
        };
        let topic = writer.add_topic(topic).unwrap();
        writer.write(topic, time, time, &DynamicMessage::new(&of.message_type).to_cdr()).unwrap();
    }
    assert!(writer.finish().unwrap().message_count() > 25);
}

#[test]
fn every_recorded_bag_is_opened_by_other_readers() {
    let bags = recorded_bags();
    assert!(bags.len() >= 4, "{bags:?}");
    let folder = tempfile::tempdir().unwrap();
    for (number, bag) in bags.iter().enumerate() {
        // Several have the same name.
        let copy = folder.path().join(format!("{number}_{}", bag.file_name().unwrap().display()));
        fs::create_dir(&copy).unwrap();
        for entry in fs::read_dir(bag).unwrap() {
            let entry = entry.unwrap();
            fs::copy(entry.path(), copy.join(entry.file_name())).unwrap();
        }
    }
    write_parts(&folder.path().join("parts"));
    let checks = [With::Rosbags, With::McapRos2]
        .map(|with| noted("the recorded bags of the repository", with, Way::Out));
    if stock_readers::open_bags(folder.path()).len() < 3 {
        checks.into_iter().for_each(Check::skipped);
    }
}

#[test]
fn every_recorded_bag_is_opened_by_mcap_core() {
    let check = noted("the recorded bags of the repository", With::McapCore, Way::Out);
    for bag in recorded_bags() {
        let reader = Reader::open(&bag).unwrap();
        let mut read = 0;
        for entry in fs::read_dir(&bag).unwrap() {
            let file = entry.unwrap().path();
            if file.extension().is_some_and(|of| of == "mcap") {
                let Some(found) = read_with_node(&file) else { return check.skipped() };
                for by in ["indexed", "streamed"] {
                    assert_eq!(found[by]["error"], Value::Null, "{}, {by}", file.display());
                }
                read += found["indexed"]["messages"].as_array().unwrap().len();
            }
        }
        assert_eq!(read as u64, reader.message_count(), "{}", bag.display());
    }
}
