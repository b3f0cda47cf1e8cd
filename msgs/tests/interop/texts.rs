//! Definition texts, and messages recorded from real programs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use downbeat_msgs_definitions::{Catalog, TypeName};

use crate::peer::{Peer, hex, unhex};
use crate::values::by_name;

#[test]
fn definition_texts_are_those_of_the_real_recorder() {
    let types = by_name();
    let schemas = recorded_schemas();
    for (name, recorded) in &schemas {
        let ours = types[name.as_str()].definition;
        // The real recorder stores the service for its events.
        if !name.ends_with("_Event") {
            assert_eq!(ours, recorded, "{name}");
        }
    }
    assert_eq!(schemas.len(), 9);
}

#[test]
fn definition_texts_from_the_wheels_files_are_those_of_the_real_recorder_to_the_byte() {
    let Some(peer) = Peer::find() else { return };
    let mut catalog = Catalog::new();
    catalog.add_packages(&peer.share()).unwrap();
    for (name, recorded) in recorded_schemas() {
        let name: TypeName = name.parse().unwrap();
        let ours = match name.name.strip_suffix("_Event") {
            Some(service) => {
                catalog.service_definition_text(&TypeName::new(&name.package, name.kind, service)).unwrap()
            }
            None => catalog.definition_text(&name).unwrap(),
        };
        assert_eq!(ours, recorded, "{name}");
    }
}

#[test]
fn messages_from_the_wire_are_read_and_written_again_to_the_byte() {
    let types = by_name();
    let lines = include_str!("../data/recorded_messages.txt").lines();
    for (name, recorded) in lines.clone().map(|line| line.split_once('\t').unwrap()) {
        let ours = (types[name].read)(&unhex(recorded)).unwrap();
        let rest = recorded.strip_prefix(&hex(&ours)).unwrap_or_else(|| panic!("{name}: {}", hex(&ours)));
        assert!(rest.bytes().all(|digit| digit == b'0'), "{name}: {rest}");
    }
    assert_eq!(lines.count(), 8);
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
