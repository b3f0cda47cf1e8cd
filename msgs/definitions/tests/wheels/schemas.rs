//! The schemas of bags: `rosbags` computes of each the hash that stands beside it.

use std::path::Path;

use downbeat_msgs_definitions::{Catalog, Kind, TypeName};
use python_peer::Python;
use serde_json::json;

use crate::carried;
use crate::peer::ask;

/// What users write, and `rosbags` reads differently: types called `Header`, `char`, line ends of Windows,
/// types of the own package in services and actions.
fn users(catalog: &mut Catalog) {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    for folder in ["tests/user_msgs", "tests/data/interface", "msgs/tests/data"] {
        let folder = root.join(folder);
        let packages = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        for package in packages.filter(|path| path.to_string_lossy().ends_with("_msgs")) {
            assert!(catalog.add_package(&package).unwrap() > 0, "{}", package.display());
        }
    }
    for (name, text) in [
        ("walker_msgs/msg/Header", "# Their own.\r\nchar\tkind\r\nuint8 KIND=1\r\n"),
        (
            "walker_msgs/msg/Leg",
            "Header header\nHeader[2] before\nstd_msgs/Header sent\nchar[<=4] name \"ab\" # char\n",
        ),
        (
            "walker_msgs/msg/Legs",
            "# Of a walker.\nLeg[] legs\nstring<=10[<=5] names\nfloat32 X=1.5e3\nbool B=True\nbyte[4] b\n",
        ),
        ("walker_msgs/msg/Nothing", ""),
    ] {
        let text = if name.ends_with("Leg") { text.replace(" \"ab\"", "") } else { text.to_owned() };
        catalog.add_message(name.parse().unwrap(), &text, name).unwrap();
    }
    let service = "Header header\nLeg[3] legs\nchar c\nstring<=3[2] s\n---\n# Empty.\n";
    catalog.add_service("walker_msgs/srv/Place".parse().unwrap(), service, "Place.srv").unwrap();
    let action = "Legs legs\nHeader[] h\n---\nNothing nothing\n---\nwalker_msgs/Leg leg\nchar[2] c\n";
    catalog.add_action("walker_msgs/action/Walk".parse().unwrap(), action, "Walk.action").unwrap();
    catalog.check().unwrap();
}

#[test]
fn rosbags_computes_the_hash_of_every_type_from_its_schema() {
    let Some(python) = Python::find() else { return };
    let mut catalog = carried();
    users(&mut catalog);
    let names: Vec<TypeName> = catalog.messages().map(|message| message.name.clone()).collect();
    let texts: Vec<_> = names.iter().map(|name| catalog.schema_text(name).unwrap()).collect();
    let input: String = names
        .iter()
        .zip(&texts)
        .map(|(name, (encoding, text))| format!("{}\n", json!([name.to_string(), encoding.as_str(), text])))
        .collect();
    let computed = ask(&python, "hash", &input);
    let (mut equal, mut different, mut wide) = (0, Vec::new(), 0);
    for ((name, (_, text)), computed) in names.iter().zip(&texts).zip(computed.lines()) {
        let hash = catalog.type_hash(name).unwrap();
        if computed == hash {
            equal += 1;
        } else if text.contains("wstring") && !computed.starts_with("RIHS01_") {
            // It knows no wide strings, so that it computes no hash.
            wide += 1;
        } else {
            different.push(format!("{name}: {computed}\n{text}"));
        }
    }
    assert_eq!(equal + different.len() + wide, names.len());
    assert!(different.is_empty(), "{} different:\n{}", different.len(), different.join("\n"));
    let parts = names.iter().filter(|name| name.kind != Kind::Message).count();
    assert!(
        equal > 400 && parts > 200 && wide < 20,
        "{equal} equal, {parts} parts, {wide} with wide strings"
    );
}

#[test]
fn a_schema_reads_back_as_the_same_type() {
    let mut catalog = carried();
    users(&mut catalog);
    for message in catalog.messages() {
        let name = &message.name;
        let (encoding, text) = catalog.schema_text(name).unwrap();
        let mut again = Catalog::new();
        again.add_definition_text(name, encoding, &text, "bag").unwrap();
        assert_eq!(again.type_hash(name).unwrap(), catalog.type_hash(name).unwrap(), "{name}");
        assert_eq!(again.schema_text(name).unwrap().0, encoding);
    }
}
