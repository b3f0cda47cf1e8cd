//! Compares definitions, descriptions and hashes with those that ROS 2 Jazzy ships and those that its tools
//! generate.
//!
//! Needs the Python interpreter named by `DOWNBEAT_PYTHON`; without it the tests print a note and pass.

#![allow(clippy::unwrap_used)]

mod grammar;
mod peer;
mod schemas;

use std::collections::BTreeSet;
use std::path::Path;

use downbeat_msgs_definitions::{Catalog, DefinitionEncoding, Kind, MessageDefinition, TypeName};
use python_peer::Python;
use serde_json::Value;

use peer::{ask, files_of};

pub(crate) fn carried() -> Catalog {
    let mut catalog = Catalog::new();
    catalog.add_packages(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../interfaces")).unwrap();
    catalog.check().unwrap();
    catalog
}

/// Compares every type of a published description, including the parts and dependencies of the root, and
/// returns their names.
fn compare(catalog: &Catalog, published: &Value) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for entry in published["type_hashes"].as_array().unwrap() {
        let text = entry["type_name"].as_str().unwrap();
        let name: TypeName = text.parse().unwrap();
        assert_eq!(catalog.type_hash(&name).unwrap(), entry["hash_string"].as_str().unwrap(), "{name}");
        names.insert(text.to_owned());
    }
    let mut published = published["type_description_msg"].clone();
    without_defaults(&mut published);
    let name: TypeName = published["type_description"]["type_name"].as_str().unwrap().parse().unwrap();
    let ours: Value = serde_json::from_str(&catalog.type_description(&name).unwrap().to_json()).unwrap();
    assert_eq!(ours, published, "{name}");
    names
}

/// Removes defaults: the hash does not depend on them, and our descriptions lack them.
fn without_defaults(description: &mut Value) {
    match description {
        Value::Object(members) => {
            members.remove("default_value");
            members.values_mut().for_each(without_defaults);
        }
        Value::Array(items) => items.iter_mut().for_each(without_defaults),
        _ => {}
    }
}

fn names_of(catalog: &Catalog) -> BTreeSet<String> {
    let messages = catalog.messages().map(|of| &of.name);
    let services = catalog.services().map(|of| &of.name);
    let actions = catalog.actions().map(|of| &of.name);
    messages.chain(services).chain(actions).map(TypeName::to_string).collect()
}

#[test]
fn built_in_packages_have_the_descriptions_and_hashes_of_every_json_file_of_the_wheels() {
    let Some(peer) = Python::find() else { return };
    let catalog = carried();
    let mut compared = BTreeSet::new();
    let files = files_of(&peer, "json");
    for file in &files {
        compared.extend(compare(&catalog, &serde_json::from_str(&file.text).unwrap()));
    }
    assert!(files.len() > 190, "only {} files were found", files.len());
    // Our packages contain nothing that the wheels lack, including parts of services and actions.
    let packages: BTreeSet<&str> = files.iter().map(|file| file.package.as_str()).collect();
    let mut ours = names_of(&catalog);
    ours.retain(|name| packages.contains(name.split('/').next().unwrap()));
    assert_eq!(compared, ours);
}

#[test]
fn the_built_in_files_are_those_of_the_wheels_to_the_byte() {
    let Some(peer) = Python::find() else { return };
    let interfaces = Path::new(env!("CARGO_MANIFEST_DIR")).join("../interfaces");
    let mut compared = 0;
    for extension in ["msg", "srv", "action"] {
        for file in files_of(&peer, extension) {
            let kind = file.path.parent().unwrap().file_name().unwrap();
            let ours = interfaces.join(&file.package).join(kind).join(file.path.file_name().unwrap());
            if let Ok(ours) = std::fs::read_to_string(ours) {
                assert_eq!(ours, file.text, "{}", file.path.display());
                compared += 1;
            }
        }
    }
    assert!(compared > 150, "{compared}");
}

#[test]
fn an_ament_prefix_is_read_completely_together_with_the_built_in_packages() {
    let Some(peer) = Python::find() else { return };
    let mut catalog = carried();
    let before = names_of(&catalog);
    let found = catalog.add_ament_prefix(&peer.prefix()).unwrap();
    assert!(found.faults.is_empty(), "{:?}", found.faults);
    assert!(found.files > 190, "only {} files were found", found.files);
    catalog.check().unwrap();
    assert_eq!(names_of(&catalog), before);
}

#[test]
fn an_ament_prefix_with_idl_files_alone_means_the_same() {
    let Some(peer) = Python::find() else { return };
    let prefix = Path::new(env!("CARGO_TARGET_TMPDIR")).join("idl_prefix");
    let files = files_of(&peer, "idl");
    for file in &files {
        let copy = prefix.join(file.path.strip_prefix(peer.prefix()).unwrap());
        std::fs::create_dir_all(copy.parent().unwrap()).unwrap();
        std::fs::write(copy, &file.text).unwrap();
    }
    let mut catalog = Catalog::new();
    let found = catalog.add_ament_prefix(&prefix).unwrap();
    assert_eq!((found.files, found.faults.len()), (files.len(), 0), "{:?}", found.faults);
    catalog.check().unwrap();

    // Every hash and description.
    for file in files_of(&peer, "json") {
        compare(&catalog, &serde_json::from_str(&file.text).unwrap());
    }
    // Defaults and constants, on which the hash does not depend.
    let mut written = Catalog::new();
    written.add_packages(&peer.prefix().join("share")).unwrap();
    assert_eq!(names_of(&catalog), names_of(&written));
    for message in written.messages() {
        let generated = catalog.message(&message.name).unwrap();
        assert!(generated.means_the_same_as(message), "{}", difference(message, generated));
    }
}

fn difference(one: &MessageDefinition, two: &MessageDefinition) -> String {
    format!("{}:\n{:#?}\n{:#?}\n{:#?}\n{:#?}", one.name, one.fields, two.fields, one.constants, two.constants)
}

#[test]
fn a_schema_of_idl_blocks_as_rosbag2_writes_it_means_the_same() {
    let Some(peer) = Python::find() else { return };
    let files = files_of(&peer, "idl");
    let text_of = |name: &TypeName| {
        let path = peer.prefix().join("share").join(name.to_string()).with_extension("idl");
        files.iter().find(|file| file.path == path).unwrap().text.as_str()
    };
    let carried = carried();
    let name: TypeName = "sensor_msgs/msg/CameraInfo".parse().unwrap();
    let mut schema = String::new();
    let mut waiting = vec![name.clone()];
    let mut seen = BTreeSet::new();
    while let Some(name) = waiting.pop() {
        if seen.insert(name.clone()) {
            let text = text_of(&name);
            schema += &format!("{}\nIDL: {name}\n{text}\n", "=".repeat(80));
            let includes =
                text.lines().filter_map(|line| line.strip_prefix("#include \"")?.strip_suffix(".idl\""));
            waiting.extend(includes.map(|include| include.parse::<TypeName>().unwrap()));
        }
    }
    assert!(seen.len() > 3, "{seen:?}");
    let mut catalog = Catalog::new();
    catalog.add_definition_text(&name, DefinitionEncoding::Ros2Idl, &schema, "bag").unwrap();
    catalog.check().unwrap();
    assert_eq!(catalog.type_hash(&name).unwrap(), carried.type_hash(&name).unwrap());
}

#[test]
fn rosidl_generates_our_descriptions_of_types_that_no_wheel_has() {
    let Some(peer) = Python::find() else { return };
    let mut catalog = carried();
    // What `downbeat new --template messages` makes for `colcon build`.
    let template =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../src/program/new/templates/messages/my_robot");
    catalog.add_package(&template).unwrap();
    let published: BTreeSet<String> = files_of(&peer, "json").into_iter().map(|file| file.package).collect();
    let mut ours = names_of(&catalog);
    ours.retain(|name| !published.contains(name.split('/').next().unwrap()));
    let packages: BTreeSet<&str> = ours.iter().map(|name| name.split('/').next().unwrap()).collect();
    assert!(packages.contains("tf2_msgs"), "{packages:?}");

    let interfaces = Path::new(env!("CARGO_MANIFEST_DIR")).join("../interfaces");
    let folder_of =
        |package: &&str| if *package == "my_robot" { template.clone() } else { interfaces.join(package) };
    let folders =
        packages.iter().map(|package| format!("{}\n", folder_of(package).display())).collect::<String>();
    let mut described = BTreeSet::new();
    for line in ask(&peer, "describe", &folders).lines() {
        let (name, theirs) = line.split_once('\t').unwrap();
        let mut theirs: Value = serde_json::from_str(theirs).unwrap();
        without_defaults(&mut theirs);
        let ours = catalog.type_description(&name.parse().unwrap()).unwrap().to_json();
        let ours: Value = serde_json::from_str(&ours).unwrap();
        assert_eq!(ours["type_description"], theirs, "{name}");
        described.insert(name.to_owned());
    }
    assert_eq!(described, ours);
}

#[test]
fn rosbags_knows_the_same_messages_and_constants() {
    let Some(peer) = Python::find() else { return };
    let catalog = carried();
    let mut compared = BTreeSet::new();
    for line in ask(&peer, "store", "").lines() {
        let [name, hash, constants] = line.split('\t').collect::<Vec<_>>()[..] else { panic!("{line}") };
        let name: TypeName = name.parse().unwrap();
        // For types with a `char`, rosbags computes a different hash than ROS 2.
        if !["Char", "Gid", "NodeEntitiesInfo", "ParticipantEntitiesInfo", "ServiceEventInfo"]
            .contains(&&*name.name)
        {
            assert_eq!(catalog.type_hash(&name).unwrap(), hash, "{name}");
        }
        let ours: Value = catalog.message(&name).unwrap().constants.iter().map(grammar::constant).collect();
        assert_eq!(ours, serde_json::from_str::<Value>(constants).unwrap(), "{name}");
        compared.insert(name);
    }
    // All messages except those that rosbags lacks, and one that was added to Jazzy late.
    for message in catalog.messages().filter(|message| message.name.kind == Kind::Message) {
        let name = &message.name;
        let is_left_out = [
            "bond",
            "control_msgs",
            "controller_manager_msgs",
            "downbeat_interfaces",
            "example_interfaces",
            "simulation_interfaces",
            "test_msgs",
        ]
        .contains(&name.package.as_str())
            || name.to_string() == "nav_msgs/msg/Goals";
        assert!(is_left_out || compared.contains(name), "{name}");
    }
}
