//! Looking up definitions by name: the order of sources, and errors that list what was found where.

use std::fs;
use std::path::Path;

use downbeat_msgs::definitions::TypeName;
use downbeat_msgs::dynamic::{
    AmentPrefixPath, Definitions, DescribedTypes, DynamicMessage, DynamicType, Schemas, TypeLookupError,
};
use downbeat_msgs::type_description_interfaces::msg::TypeDescription;
use downbeat_msgs::{TYPE_NAMES, carried};

/// An ament prefix with these files below `share`.
fn prefix(folder: &Path, files: &[(&str, &str)]) -> AmentPrefixPath {
    for (path, text) in files {
        let path = folder.join("share").join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    AmentPrefixPath::new([folder.to_owned()])
}

fn field_names(of: &DynamicType) -> Vec<String> {
    of.fields().map(|field| field.name.to_owned()).collect()
}

#[test]
fn all_built_in_types_are_found() {
    let definitions = Definitions::new().with_carried();
    for name in TYPE_NAMES {
        assert_eq!(definitions.find(name).unwrap().name().to_string(), *name);
    }
    assert!(definitions.find("test_msgs/action/Fibonacci_FeedbackMessage").is_ok());
    assert!(carried().service(&"std_srvs/srv/SetBool".parse().unwrap()).is_ok());
    assert!(carried().check().is_ok());
}

#[test]
fn files_of_an_ament_prefix_are_found_with_what_they_refer_to() {
    let folder = tempfile::tempdir().unwrap();
    let idl = "module legs { module msg { struct Foot { double force; }; }; };\n";
    let installed = prefix(
        folder.path(),
        &[
            ("legs/msg/Leg.msg", "std_msgs/Header header\nKnee[2] knees\nFoot foot\n"),
            ("legs/msg/Knee.msg", "float64 angle 0.5\n"),
            ("legs/msg/Foot.idl", idl),
            ("legs/srv/Kick.srv", "Leg leg\n---\nbool hit\n"),
            ("legs/action/Walk.action", "Leg[] legs\n---\n---\nfloat64 way\n"),
        ],
    );
    let definitions = Definitions::new().with(installed).with_carried();
    let leg = definitions.find("legs/msg/Leg").unwrap();
    let message = DynamicMessage::new(&leg);
    assert_eq!(message.get("knees[1].angle").unwrap().as_f64(), Some(0.5));
    assert_eq!(message.get("foot.force").unwrap().as_f64(), Some(0.0));
    assert_eq!(field_names(&definitions.find("legs/srv/Kick_Request").unwrap()), ["leg"]);
    assert_eq!(
        field_names(&definitions.find("legs/srv/Kick_Event").unwrap()),
        ["info", "request", "response"]
    );
    let feedback = definitions.find("legs/action/Walk_FeedbackMessage").unwrap();
    assert_eq!(field_names(&feedback), ["goal_id", "feedback"]);
    assert!(definitions.find("legs/action/Walk_SendGoal_Request").is_ok());
}

#[test]
fn the_first_source_that_has_a_type_is_used_and_schemas_are_independent() {
    let folder = tempfile::tempdir().unwrap();
    let installed = prefix(folder.path(), &[("std_msgs/msg/Header.msg", "int8 other\n")]);
    let mut schemas = Schemas::new("walk.mcap");
    let line = "=".repeat(80);
    let text = format!("std_msgs/Header header\n\n{line}\nMSG: std_msgs/Header\nint8 old\n");
    schemas.add("legs/msg/Leg", "ros2msg", &text).unwrap();
    let idl = format!(
        "{line}\nIDL: legs/msg/Toe\nmodule legs {{ module msg {{ struct Toe {{ legs::msg::Nail nail; }}; }}; }};\n\
         {line}\nIDL: legs/msg/Nail\nmodule legs {{ module msg {{ struct Nail {{ uint8 colour; }}; }}; }};\n"
    );
    schemas.add("legs/msg/Toe", "ros2idl", &idl).unwrap();

    let carried_first = Definitions::new().with_carried().with(installed.clone()).with(schemas.clone());
    assert_eq!(field_names(&carried_first.find("std_msgs/msg/Header").unwrap()), ["stamp", "frame_id"]);
    let installed_first = Definitions::new().with(installed).with_carried().with(schemas);
    assert_eq!(field_names(&installed_first.find("std_msgs/msg/Header").unwrap()), ["other"]);
    for definitions in [carried_first, installed_first] {
        let leg = DynamicMessage::new(&definitions.find("legs/msg/Leg").unwrap());
        assert_eq!(leg.get("header.old").unwrap().as_i64(), Some(0));
        let toe = DynamicMessage::new(&definitions.find("legs/msg/Toe").unwrap());
        assert_eq!(toe.get("nail.colour").unwrap().as_i64(), Some(0));
    }
}

/// Schemas and messages of the real recorder, see `tests/data/README.md`.
#[test]
fn recorded_messages_are_read_by_recorded_schemas() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let mut schemas = Schemas::new("a recording");
    for entry in fs::read_dir(data.join("recorded_schemas")).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_string_lossy().replace('.', "/");
        let encoding = if name.ends_with("_Event") { "unknown" } else { "ros2msg" };
        schemas.add(&name, encoding, &fs::read_to_string(path).unwrap()).unwrap();
    }
    let definitions = Definitions::new().with(schemas);
    let lines = fs::read_to_string(data.join("recorded_messages.txt")).unwrap();
    for (name, bytes) in lines.lines().map(|line| line.split_once('\t').unwrap()) {
        let bytes = python_peer::unhex(bytes);
        let message = DynamicMessage::from_cdr(&definitions.find(name).unwrap(), &bytes).unwrap();
        let again = message.to_cdr();
        assert_eq!(again, bytes[..again.len()], "{name}");
        // Bytes after the value are padding.
        assert!(bytes[again.len()..].iter().all(|byte| *byte == 0), "{name}");
    }
}

#[test]
fn the_description_of_a_node_is_checked_against_the_hash_and_found() {
    let mut described = DescribedTypes::new("/legs");
    for name in ["sensor_msgs/msg/JointState", "std_srvs/srv/SetBool", "test_msgs/action/Fibonacci"] {
        let ours = carried().type_description(&name.parse::<TypeName>().unwrap()).unwrap();
        let (answer, hash) = (TypeDescription::from(&ours), ours.hash());
        described.add(&answer, &hash).unwrap();
        let error = described.add(&answer, &hash.replace("RIHS01_", "RIHS01_0")).unwrap_err().to_string();
        assert!(error.starts_with(&format!("the type description of {name} has the hash {hash}")), "{error}");
        let mut forged = answer.clone();
        forged.type_description.fields[0].name = "forged".into();
        assert!(described.add(&forged, &hash).is_err());
    }
    let definitions = Definitions::new().with(described);
    assert!(definitions.find("std_srvs/srv/SetBool_Event").is_ok()); // Has a `char`, described as `uint8`.
    for name in ["sensor_msgs/msg/JointState", "std_msgs/msg/Header", "std_srvs/srv/SetBool_Request"] {
        let of = definitions.find(name).unwrap();
        assert_eq!(of, Definitions::new().with_carried().find(name).unwrap());
    }
    let error = definitions.find("std_srvs/srv/Trigger_Request").unwrap_err().to_string();
    assert!(error.contains("it has described std_srvs/srv/SetBool_"), "{error}");
}

#[test]
fn an_error_lists_the_searched_sources_and_their_problems() {
    let folder = tempfile::tempdir().unwrap();
    let installed = prefix(
        folder.path(),
        &[("legs/msg/Leg.msg", "Knee knee\n"), ("legs/msg/Bad.msg", "int8 a\nint9 b\n")],
    );
    let definitions = Definitions::new().with_carried().with(installed);
    let error = definitions.find("legs/msg/Leg").unwrap_err();
    assert_eq!(
        error.to_string(),
        format!(
            "found no definition of legs/msg/Knee, the type of a field of legs/msg/Leg. Looked in the built-in interfaces: \
             they have nothing of that package; in the ament prefixes: no share/legs/msg/Knee.msg or .idl in {}",
            folder.path().display()
        )
    );
    let error = definitions.find("legs/msg/Bad").unwrap_err();
    assert!(matches!(error, TypeLookupError::Unusable { .. }));
    assert!(error.to_string().contains("Bad.msg:2:1: "), "{error}");
    let error = definitions.find("std_msgs/msg/Heder").unwrap_err().to_string();
    assert!(error.contains("they have std_msgs/msg/Header of that package"), "{error}");
    for name in ["", "Leg", "../msg/Leg", "legs/msg/../Leg", "legs/msg/Leg/"] {
        assert!(matches!(definitions.find(name), Err(TypeLookupError::Name(_))), "{name}");
    }
    let error = Definitions::new().find("a/msg/A").unwrap_err().to_string();
    assert!(error.ends_with("Looked nowhere: there are no sources"), "{error}");
}
