//! The features of the crate: one for each package, enabling those of the packages it refers to.

#![allow(clippy::unwrap_used)]

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use downbeat_msgs_definitions::{Catalog, Element};

const ALWAYS: [&str; 4] =
    ["builtin_interfaces", "service_msgs", "type_description_interfaces", "unique_identifier_msgs"];

#[test]
fn every_package_has_a_feature_that_enables_what_it_refers_to() {
    let features = features();
    for (package, needed) in packages() {
        assert!(features.contains_key(&package), "the package {package} has no feature");
        let enabled = closure(&features, &package);
        for other in needed {
            assert!(
                enabled.contains(&other) || ALWAYS.contains(&other.as_str()),
                "the feature {package} must enable {other}"
            );
        }
    }
}

#[test]
fn the_notice_names_every_package_of_others() {
    let notice = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("NOTICE")).unwrap();
    let named: BTreeSet<&str> =
        notice.split(|c: char| !(c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')).collect();
    for package in packages().keys() {
        assert!(named.contains(package.as_str()), "NOTICE lacks {package}");
    }
}

#[test]
fn all_enables_every_package_and_every_feature_is_one() {
    let (features, packages) = (features(), packages());
    let all = closure(&features, "all");
    for package in packages.keys() {
        assert!(all.contains(package) || ALWAYS.contains(&package.as_str()), "`all` lacks {package}");
    }
    for feature in features.keys() {
        let known = ["default", "all", "derive", "cbor", "flatbuffers", "json", "protobuf"];
        let known = known.contains(&feature.as_str()) || packages.contains_key(feature);
        assert!(known, "no package has the feature {feature}");
    }
}

#[test]
fn packages_that_are_always_enabled_need_no_others() {
    let packages = packages();
    for package in ALWAYS {
        assert!(packages[package].iter().all(|other| ALWAYS.contains(&other.as_str())), "{package}");
    }
}

#[test]
fn the_registry_follows_the_features() {
    // The tests have them all enabled.
    let listed: BTreeSet<&str> =
        downbeat_msgs::TYPE_NAMES.iter().map(|name| name.split_once('/').unwrap().0).collect();
    assert_eq!(listed, packages().keys().map(String::as_str).collect());
}

/// Each package in `interfaces/`, and the other packages it refers to.
fn packages() -> BTreeMap<String, BTreeSet<String>> {
    let mut catalog = Catalog::new();
    catalog.add_packages(&Path::new(env!("CARGO_MANIFEST_DIR")).join("interfaces")).unwrap();
    let mut packages: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for message in catalog.messages() {
        let needed = packages.entry(message.name.package.clone()).or_default();
        for field in &message.fields {
            match &field.field_type.element {
                Element::Message(name) if name.package != message.name.package => {
                    needed.insert(name.package.clone());
                }
                _ => {}
            }
        }
    }
    packages
}

fn features() -> BTreeMap<String, Vec<String>> {
    let manifest = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml")).unwrap();
    let manifest: toml::Table = manifest.parse().unwrap();
    manifest["features"].clone().try_into().unwrap()
}

fn closure(features: &BTreeMap<String, Vec<String>>, of: &str) -> BTreeSet<String> {
    let mut enabled = BTreeSet::new();
    let mut next = vec![of.to_owned()];
    while let Some(feature) = next.pop() {
        if enabled.insert(feature.clone()) {
            next.extend(features.get(&feature).into_iter().flatten().cloned());
        }
    }
    enabled
}
