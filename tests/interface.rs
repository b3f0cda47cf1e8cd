//! `downbeat interface` as a user sees it.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use common::downbeat;
use downbeat::msgs::cdr;
use downbeat::msgs::sensor_msgs::msg::JointState;
use python_peer::Python;
use serde_json::Value;
use sha2::{Digest, Sha256};

/// The definitions of these tests; see `record.py` there.
const DATA: &str = "tests/data/interface";

/// The program without a sourced ROS 2 environment.
fn interface(arguments: &[&str]) -> Command {
    let mut command = downbeat(&["interface"]);
    command.args(arguments).env_remove("AMENT_PREFIX_PATH").stdin(Stdio::null());
    command
}

fn output_of(command: &mut Command) -> (bool, String, String) {
    let output = command.output().unwrap();
    let [out, error] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    (output.status.success(), out, error)
}

fn shown(arguments: &[&str]) -> String {
    let (is_success, output, error) = output_of(&mut interface(arguments));
    assert!(is_success && error.is_empty(), "{arguments:?}: {error}");
    output
}

fn refused(arguments: &[&str]) -> String {
    let (is_success, output, error) = output_of(&mut interface(arguments));
    assert!(!is_success && output.is_empty(), "{arguments:?}: {output}");
    error
}

/// The ament prefix of the real ROS 2, if it is installed.
fn wheels() -> Option<PathBuf> {
    Python::find().map(|python| python.prefix())
}

#[test]
fn definitions_are_shown_as_the_real_command_shows_them() {
    let recorded = std::fs::read_to_string(Path::new(DATA).join("ros2_interface_show.txt")).unwrap();
    let mut count = 0;
    for transcript in recorded.split("$ ros2 interface show ").skip(1) {
        let (arguments, theirs) = transcript.split_once('\n').unwrap();
        let mut arguments: Vec<&str> = arguments.split(' ').collect();
        let expected = without_leftovers(theirs, arguments.get(1).copied());
        arguments.splice(0..0, ["show", "--from", DATA]);
        assert_eq!(shown(&arguments), expected, "{arguments:?}");
        count += 1;
    }
    assert_eq!(count, 18);
}

#[test]
fn every_definition_of_the_wheels_is_shown_as_the_real_command_shows_it() {
    let Some(prefix) = wheels() else { return };
    let recorded = std::fs::read_to_string(Path::new(DATA).join("ros2_interface_show.tsv")).unwrap();
    let mut hashes: BTreeMap<&str, Vec<(&str, &str)>> = BTreeMap::new();
    for line in recorded.lines() {
        let [name, option, hash] = line.split('\t').collect::<Vec<_>>().try_into().unwrap();
        hashes.entry(option).or_default().push((name, hash));
    }
    assert_eq!(hashes.keys().copied().collect::<Vec<_>>(), ["", "--all-comments", "--no-comments"]);
    for (option, expected) in hashes {
        // All in one call: the text between the headings is the output for each interface.
        let options = ["show", "--all", option];
        let options = if option.is_empty() { &options[..2] } else { &options[..] };
        let (is_success, output, error) = output_of(interface(options).env("AMENT_PREFIX_PATH", &prefix));
        assert!(is_success, "{error}");
        let line = format!("{}\n", "=".repeat(80));
        let ours: BTreeMap<&str, &str> =
            output.split(&line).skip(1).map(|section| section.split_once('\n').unwrap()).collect();
        assert!(expected.len() > 190);
        for (name, hash) in expected {
            let found = Sha256::digest(ours[name])
                .iter()
                .fold(String::new(), |hex, byte| hex + format!("{byte:02x}").as_str());
            assert_eq!(found, hash, "{name} {option}\n{}", ours[name]);
        }
    }
}

/// Removes what the real command leaves of hidden comments: a `#` of each and some whole ones.
fn without_leftovers(text: &str, option: Option<&str>) -> String {
    let lines = text.lines().filter_map(|line| match option {
        None if !line.starts_with('\t') => Some(line),
        Some("--all-comments") => Some(line),
        _ => Some(line.split('#').next().unwrap_or_default().trim_end()).filter(|line| !line.is_empty()),
    });
    lines.fold(String::new(), |text, line| text + line + "\n")
}

#[test]
fn descriptions_equal_the_json_files_of_the_wheels_byte_for_byte() {
    let Some(prefix) = wheels() else { return };
    let all = output_of(interface(&["description", "--all"]).env("AMENT_PREFIX_PATH", &prefix)).1;
    let all: Vec<Value> = serde_json::from_str(&all).unwrap();
    let name_of = |value: &Value| {
        value["type_description_msg"]["type_description"]["type_name"].as_str().unwrap().to_owned()
    };
    let all: BTreeMap<String, &Value> = all.iter().map(|value| (name_of(value), value)).collect();
    let mut count = 0;
    for path in json_files(&prefix.join("share")) {
        let text = std::fs::read_to_string(&path).unwrap();
        let theirs: Value = serde_json::from_str(&text).unwrap();
        let name = name_of(&theirs);
        assert_eq!(all[&name], &theirs, "{name}");
        // The exact spelling is compared for the package with the most variants.
        if name.starts_with("test_msgs/") {
            let ours = output_of(interface(&["description", &name]).env("AMENT_PREFIX_PATH", &prefix)).1;
            assert_eq!(ours.trim_end(), text, "{name}");
        }
        count += 1;
    }
    assert!(count > 190, "{count}");
}

fn json_files(share: &Path) -> Vec<PathBuf> {
    let folder = |path: &Path| {
        std::fs::read_dir(path).map(|entries| entries.map(|entry| entry.unwrap().path()).collect())
    };
    let mut files = Vec::new();
    for package in folder(share).unwrap_or_else(|_| Vec::new()) {
        for kind in ["msg", "srv", "action"] {
            files.extend(folder(&package.join(kind)).unwrap_or_else(|_| Vec::new()));
        }
    }
    files.retain(|path| path.extension().is_some_and(|extension| extension == "json"));
    files
}

#[test]
fn hashes_are_printed_alone_or_with_their_names() {
    let hash = "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01";
    assert_eq!(shown(&["hash", "std_msgs/msg/Header"]), format!("{hash}\n"));
    let all = shown(&["hash", "--all"]);
    assert!(all.contains(&format!("{hash}  std_msgs/msg/Header\n")), "{all}");
    assert!(all.contains("  std_srvs/srv/SetBool_Request\n"), "{all}");
    let json: Value = serde_json::from_str(&shown(&["hash", "std_msgs/msg/Header", "--json"])).unwrap();
    assert_eq!(json, serde_json::json!([{ "type_name": "std_msgs/msg/Header", "hash_string": hash }]));
}

#[test]
fn lists_equal_those_of_the_real_command_and_can_be_filtered() {
    let all = shown(&["list"]);
    assert!(all.starts_with("Messages:\n    "), "{all}");
    assert!(all.contains("\nServices:\n") && all.contains("\nActions:\n"), "{all}");
    assert!(all.contains("\n    sensor_msgs/msg/JointState\n") && !all.contains("SetBool_Request"), "{all}");
    assert_eq!(
        shown(&["list", "shown_msgs", "other_msgs", "--from", DATA]),
        "Messages:\n    other_msgs/msg/Place\n    other_msgs/msg/Stamp\n    shown_msgs/msg/Joint\n    shown_msgs/msg/Leg\n    \
         shown_msgs/msg/Nothing\nServices:\n    shown_msgs/srv/Lift\n    shown_msgs/srv/Rest\nActions:\n    \
         shown_msgs/action/Walk\n"
    );
    assert_eq!(
        shown(&["list", "shown_msgs", "-s", "-a", "--from", DATA]),
        "Services:\n    shown_msgs/srv/Lift\n    shown_msgs/srv/Rest\nActions:\n    shown_msgs/action/Walk\n"
    );
    let parts = shown(&["list", "shown_msgs", "--only-actions", "--all", "--from", DATA]);
    assert!(parts.contains("    shown_msgs/action/Walk_SendGoal_Request\n"), "{parts}");
    let json = shown(&["list", "shown_msgs", "-m", "--json", "--from", DATA]);
    let json: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json[0]["type_name"], "shown_msgs/msg/Joint");
    assert!(json[0]["origin"].as_str().unwrap().ends_with("shown_msgs/msg/Joint.msg"), "{json}");
}

#[test]
fn a_package_is_read_completely_from_the_first_place_that_has_it() {
    let folder = tempfile::tempdir().unwrap();
    let messages = folder.path().join("prefix/share/std_msgs/msg");
    std::fs::create_dir_all(&messages).unwrap();
    std::fs::write(messages.join("Ours.msg"), "int8 x # ours\n").unwrap();
    let prefix = folder.path().join("prefix");
    for path in [&prefix, &prefix.join("share"), &prefix.join("share/std_msgs")] {
        let from = path.to_str().unwrap();
        assert_eq!(shown(&["list", "std_msgs", "-m", "--from", from]), "Messages:\n    std_msgs/msg/Ours\n");
    }
    let paths = std::env::join_paths([Path::new("/no/such/prefix"), &prefix]).unwrap();
    let (_, output, error) =
        output_of(interface(&["show", "std_msgs/msg/Ours"]).env("AMENT_PREFIX_PATH", &paths));
    assert_eq!((output.as_str(), error.as_str()), ("int8 x # ours\n", ""));
    std::fs::write(messages.join("Wrong.msg"), "int8\n").unwrap();
    let (is_success, output, error) =
        output_of(interface(&["show", "std_msgs/msg/String"]).env("AMENT_PREFIX_PATH", &prefix));
    assert!(
        is_success && error.contains("skipped the package") && error.contains("Wrong.msg:1:5"),
        "{output}{error}"
    );
    assert!(refused(&["list", "--from", prefix.to_str().unwrap()]).contains("Wrong.msg:1:5"));
}

#[test]
fn unknown_names_are_reported_with_the_nearest_name() {
    for (arguments, expected) in [
        (
            ["show", "std_msgs/msg/Strnig"],
            "no interface \"std_msgs/msg/Strnig\" is known, did you mean \"std_msgs/msg/String\"?",
        ),
        (["hash", "JointState"], "did you mean \"sensor_msgs/msg/JointState\"?"),
        (["description", "sensor_msgs/Imu"], "did you mean \"sensor_msgs/msg/Imu\"?"),
        (["show", "my_msgs/msg/Xyzzy"], "set its location with --from"),
        (["list", "std_msg"], "no package \"std_msg\" with interfaces is known, did you mean \"std_msgs\"?"),
        (["list", "--from=no/such/folder"], "cannot read no/such/folder"),
        (["list", "--from=docs"], "docs has no interfaces"),
    ] {
        let message = refused(&arguments);
        assert!(message.contains(expected), "{arguments:?}: {message}");
    }
}

#[test]
fn two_packages_of_one_name_are_reported_with_both_places() {
    let folder = tempfile::tempdir().unwrap();
    let package = |place: &str, text: &str| {
        let messages = folder.path().join(place).join("msg");
        std::fs::create_dir_all(&messages).unwrap();
        std::fs::write(messages.join("Tilt.msg"), text).unwrap();
    };
    package("ours/group/lab_msgs", "float64 angle\n");
    package("theirs/lab_msgs", "float32 angle\n");
    // The output of `generate` is not a package.
    std::fs::create_dir_all(folder.path().join("ours/include/lab_msgs/msg")).unwrap();
    std::fs::write(folder.path().join("ours/include/lab_msgs/msg/tilt.hpp"), "").unwrap();
    package("both/first/lab_msgs", "float64 angle\n");
    package("both/second/lab_msgs", "float64 angle\n");
    package("prefix/share/lab_msgs", "float32 angle\n");
    package("same/share/lab_msgs", "float64 angle\n");
    // A package is named by its package.xml: clones and copies have other folders.
    for clone in ["clone/lab-main", "clones/lab-main", "clones/lab-main-2"] {
        package(clone, "float64 angle\n");
        let manifest = "<?xml version=\"1.0\"?>\n<!-- <name>other</name> -->\n<package format=\"3\">\n  <name> lab_msgs </name>\n";
        std::fs::write(folder.path().join(clone).join("package.xml"), manifest).unwrap();
    }
    let show = |from: &[&str], ament: &str| {
        let mut command = interface(&["show", "lab_msgs/msg/Tilt"]);
        for place in from {
            command.arg("--from").arg(folder.path().join(place));
        }
        let prefixes = std::env::join_paths(ament.split_whitespace().map(|place| folder.path().join(place)));
        output_of(command.env("AMENT_PREFIX_PATH", prefixes.unwrap()))
    };
    let (is_success, shown, said) = show(&["ours", "theirs"], "");
    assert!(is_success && shown.contains("float64"), "{shown}{said}");
    for words in ["two packages named lab_msgs", "ours/group/lab_msgs is used", "theirs/lab_msgs, which"] {
        assert!(said.contains(words), "{said}");
    }
    for place in ["clone", "clone/lab-main"] {
        let (is_success, shown, said) = show(&[place], "");
        assert!(is_success && shown.contains("float64"), "{shown}{said}");
    }
    let (is_success, _, said) = show(&["clones"], "");
    assert!(
        !is_success && said.contains("two packages named lab_msgs") && said.contains("lab-main-2"),
        "{said}"
    );
    let (is_success, _, said) = show(&["both"], "");
    assert!(!is_success, "{said}");
    for words in ["two packages named lab_msgs", "both/first/lab_msgs", "both/second/lab_msgs"] {
        assert!(said.contains(words), "{said}");
    }
    for (from, ament, is_reported) in [
        (&["ours"][..], "prefix", true),
        (&["ours"], "same", false),
        (&[], "same prefix", true),
        (&[], "prefix", false),
    ] {
        let (is_success, _, said) = show(from, ament);
        assert_eq!(
            (is_success, said.contains("two packages")),
            (true, is_reported),
            "{from:?} {ament} {said}"
        );
    }
}

#[test]
fn a_type_that_contains_itself_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let messages = folder.path().join("knot_msgs/msg");
    std::fs::create_dir_all(&messages).unwrap();
    std::fs::write(messages.join("A.msg"), "B b\n").unwrap();
    std::fs::write(messages.join("B.msg"), "A[] a\nUnknown u\n").unwrap();
    let from = folder.path().to_str().unwrap();
    let (is_success, _, error) = output_of(&mut interface(&["show", "knot_msgs/msg/A", "--from", from]));
    assert!(
        !is_success
            && error.contains("knot_msgs/msg/A contains itself: knot_msgs/msg/A -> knot_msgs/msg/B ->"),
        "{error}"
    );
    let message = refused(&["hash", "knot_msgs/msg/B", "--from", from]);
    assert!(message.contains("knot_msgs/msg/Unknown"), "{message}");
}

#[test]
fn types_that_grow_exponentially_or_are_too_deep_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    let messages = folder.path().join("bomb_msgs/msg");
    std::fs::create_dir_all(&messages).unwrap();
    for n in 0..40 {
        std::fs::write(messages.join(format!("D{n}.msg")), format!("D{m} one\nD{m} other\n", m = n + 1))
            .unwrap();
    }
    std::fs::write(messages.join("D40.msg"), "int32 x\n").unwrap();
    for n in 0..500 {
        std::fs::write(messages.join(format!("L{n}.msg")), format!("L{} next\n", n + 1)).unwrap();
    }
    std::fs::write(messages.join("L500.msg"), "int32 x\n").unwrap();
    let from = folder.path().to_str().unwrap();
    for (name, expected) in [
        ("bomb_msgs/msg/D0", "bomb_msgs/msg/D0 has more than 100000 lines; --json shows each type once"),
        ("bomb_msgs/msg/L0", "bomb_msgs/msg/L0 is nested deeper than 100 types"),
    ] {
        let (is_success, _, error) = output_of(&mut interface(&["show", name, "--from", from]));
        assert!(!is_success && error.contains(expected), "{error}");
    }
    let all: Value =
        serde_json::from_str(&shown(&["show", "bomb_msgs/msg/D0", "--json", "--from", from])).unwrap();
    assert_eq!(all.as_array().unwrap().len(), 41);
}

#[test]
fn parts_of_services_and_actions_have_definitions_hashes_and_descriptions() {
    let event = shown(&["show", "shown_msgs/srv/Lift_Event", "--from", DATA]);
    assert!(event.starts_with("service_msgs/ServiceEventInfo info\n\tuint8 REQUEST_SENT"), "{event}");
    let goal = shown(&["show", "shown_msgs/action/Walk_SendGoal", "--from", DATA, "--no-comments"]);
    assert!(goal.starts_with("unique_identifier_msgs/UUID goal_id\n\tuint8[16] uuid\n"), "{goal}");
    assert!(goal.contains("\n---\nbool accepted\n"), "{goal}");
    assert!(
        shown(&["hash", "shown_msgs/action/Walk_FeedbackMessage", "--from", DATA]).starts_with("RIHS01_")
    );
}

#[test]
fn fields_and_constants_are_available_as_json() {
    let json = shown(&["show", "shown_msgs/msg/Leg", "--json", "--from", DATA]);
    let json: Value = serde_json::from_str(&json).unwrap();
    let names: Vec<&str> =
        json.as_array().unwrap().iter().map(|of| of["type_name"].as_str().unwrap()).collect();
    assert_eq!(
        names,
        ["shown_msgs/msg/Leg", "shown_msgs/msg/Joint", "other_msgs/msg/Stamp", "other_msgs/msg/Place"]
    );
    assert_eq!(json[0]["constants"][0]["name"], "LEFT");
    assert_eq!(json[0]["constants"][0]["value"], 0);
    assert_eq!(json[0]["fields"][2]["type"], "shown_msgs/msg/Joint[<=2]");
    assert_eq!(
        (&json[0]["fields"][3]["type"], &json[0]["fields"][3]["default"]),
        (&"string<=8".into(), &"left".into())
    );
}

#[test]
fn a_type_name_can_be_piped_in_and_a_closed_pipe_is_not_an_error() {
    let mut child = interface(&["hash", "-"]).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(b"std_msgs/msg/Header\n").unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(output.stdout.starts_with(b"RIHS01_f49fb3ae"));

    let mut command = interface(&["description", "--all"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    child.stdout.take().unwrap().read_exact(&mut [0; 10]).unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(
        output.status.success() && output.stderr.is_empty(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

/// Runs `decode` on bytes. Returns whether they are a message, and the output.
fn decoded(arguments: &[&str], bytes: &[u8]) -> (bool, String) {
    let mut command = interface(&["decode"]);
    command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    child.stdin.take().unwrap().write_all(bytes).unwrap();
    let output = child.wait_with_output().unwrap();
    let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
    (output.status.success(), text)
}

#[test]
fn messages_are_decoded_in_both_byte_orders_and_by_definitions_from_elsewhere() {
    let little = [0, 1, 0, 0, 7, 0, 0, 0, 0, 0, 0, 128];
    let big = [0, 0, 0, 0, 0, 0, 0, 7, 128, 0, 0, 0];
    for bytes in [little, big] {
        let yaml = decoded(&["builtin_interfaces/msg/Time"], &bytes);
        assert_eq!(yaml, (true, "sec: 7\nnanosec: 2147483648\n".to_owned()));
    }
    let json = decoded(&["other_msgs/msg/Stamp", "--json", "--from", DATA], &little);
    assert_eq!(json, (true, "{\"sec\":7,\"nanosec\":2147483648}\n".to_owned()));
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), little).unwrap();
    let path = file.path().to_str().unwrap();
    assert_eq!(
        shown(&["decode", "builtin_interfaces/msg/Time", "--file", path]),
        "sec: 7\nnanosec: 2147483648\n"
    );
}

#[test]
fn a_message_of_the_real_recorder_is_decoded_as_it_was_published() {
    let recorded = include_str!("../msgs/tests/data/recorded_messages.txt");
    let digits = recorded.lines().find_map(|line| line.strip_prefix("sensor_msgs/msg/JointState\t")).unwrap();
    let bytes: Vec<u8> =
        (0..digits.len()).step_by(2).map(|at| u8::from_str_radix(&digits[at..at + 2], 16).unwrap()).collect();
    let (is_success, json) = decoded(&["sensor_msgs/msg/JointState", "--json"], &bytes);
    assert!(is_success, "{json}");
    let json: Value = serde_json::from_str(&json).unwrap();
    let typed: JointState = cdr::from_slice(&bytes).unwrap();
    assert!(!typed.name.is_empty());
    assert_eq!(json, serde_json::to_value(&typed).unwrap());
}

#[test]
fn errors_of_decoding_contain_byte_and_field() {
    let strings = [0, 1, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 6, 0, 0, 0, b'h', b'e'];
    let cases: [(&str, &[u8], &[&str]); 5] = [
        (
            "std_msgs/msg/Header",
            &strings,
            &["standard input is not a std_msgs/msg/Header in CDR", "byte 16", "`frame_id`"],
        ),
        ("sensor_msgs/msg/Imu", &[0, 1, 0, 0, 1], &["byte 4", "`header.stamp.sec`", "needs 4 more bytes"]),
        ("std_msgs/msg/String", &[0, 42, 0, 0], &["byte 0", "0x002a"]),
        ("std_msgs/msg/String", &[], &["byte 0"]),
        ("std_srvs/srv/SetBool", &[0, 1, 0, 0], &["is a service", "std_srvs/srv/SetBool_Request"]),
    ];
    for (name, bytes, expected) in cases {
        let (is_success, message) = decoded(&[name], bytes);
        assert!(!is_success, "{message}");
        for part in expected {
            assert!(message.contains(part), "{part:?} in {message}");
        }
    }
    let message = refused(&["decode", "std_msgs/msg/String", "--file", "no/such/file"]);
    assert!(message.contains("cannot read no/such/file"), "{message}");
}
