//! Definitions, descriptions and hashes against those that ROS 2 Jazzy ships and those that its own tools make.
//!
//! Needs the Python interpreter that `DOWNBEAT_PYTHON` names; without it the tests say so and pass.

#![allow(clippy::unwrap_used)]

mod peer;

use std::collections::BTreeSet;
use std::path::Path;

use downbeat_msgs_definitions::{Catalog, TypeName};
use serde_json::Value;

use peer::Peer;

fn carried() -> Catalog {
    let mut catalog = Catalog::new();
    catalog.add_packages(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../interfaces")).unwrap();
    catalog.check().unwrap();
    catalog
}

/// Compares every type of a published description, the parts and dependencies of the root among them; returns their names.
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

/// The hash does not depend on them, nor are they in what is compared.
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
fn what_we_carry_has_the_descriptions_and_hashes_of_every_json_file_of_the_wheels() {
    let Some(peer) = Peer::find() else { return };
    let catalog = carried();
    let mut compared = BTreeSet::new();
    let files = peer.files("json");
    for file in &files {
        compared.extend(compare(&catalog, &serde_json::from_str(&file.text).unwrap()));
    }
    assert!(files.len() > 190, "only {} files were found", files.len());
    // Nothing of these packages is carried that the wheels do not have, parts of services and actions included.
    let packages: BTreeSet<&str> = files.iter().map(|file| file.package.as_str()).collect();
    let mut ours = names_of(&catalog);
    ours.retain(|name| packages.contains(name.split('/').next().unwrap()));
    assert_eq!(compared, ours);
}
