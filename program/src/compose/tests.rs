#![allow(clippy::unwrap_used)]
use super::child::Runner;
use super::composer::*;
use super::document::{Document, Edit};
use super::templates;
use downbeat_robot::{Catalog, PROFILE_SCHEMA};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};

const ROBOT: &str = r#"# A robot.

[robot]
name = "r"   # its node

# Emulated.
[[module]]
name = "emulator"
kind = "darwin_op_emulator"
settings = { link = "memory:r", seed = 3 }

# The hardware.
[[module]]
name = "hardware"
kind = "darwin_op"
settings = { port = "memory:r" } # in memory

[[module]]
name = "mux"
kind = "joint_command_mux"

[expose]
out = [
    "joint_states", # the state
    { topic = "imu/*", qos = "sensor_data" },
    "battery_state", # the battery
    # The last.
    "buttons",
]
parameters = ["mux.*"]

[record]
topics = "all"
"#;

fn composer(folder: &Path, text: Option<&str>) -> Composer {
    let path = folder.join("robot.toml");
    if let Some(text) = text {
        fs::write(&path, text).unwrap();
    }
    let runner = Runner { program: "/nowhere/downbeat".into(), arguments: Vec::new() };
    Composer::open(&path, Catalog::built_in(), runner).unwrap()
}

fn edit(composer: &Composer, edits: Value) -> Answer {
    composer.ask("edit", &json!({ "edits": edits }))
}

fn text(document: &Value) -> &str {
    document["text"].as_str().unwrap()
}

fn problems(document: &Value) -> Vec<Value> {
    document["picture"]["problems"].as_array().unwrap().clone()
}

fn errors(document: &Value) -> Vec<Value> {
    problems(document).into_iter().filter(|problem| problem["severity"] == "error").collect()
}

/// What an edit changes, as lines that are removed and added.
fn changed(edits: Value) -> (Vec<String>, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), Some(ROBOT));
    let after = edit(&composer, edits).unwrap();
    let lines = |text: &str| text.lines().map(str::to_owned).collect::<Vec<_>>();
    let (before, after) = (lines(ROBOT), lines(text(&after)));
    let only = |these: &[String], others: &[String]| {
        let mut rest = others.to_vec();
        let is_new = |line: &&String| match rest.iter().position(|other| other == *line) {
            Some(position) => {
                rest.remove(position);
                false
            }
            None => true,
        };
        these.iter().filter(is_new).cloned().collect::<Vec<_>>()
    };
    (only(&before, &after), only(&after, &before))
}

fn owned(lines: &[&str]) -> Vec<String> {
    lines.iter().map(|&line| line.to_owned()).collect()
}

#[track_caller]
fn assert_changed(edits: Value, removed: &[&str], added: &[&str]) {
    let sorted = |mut lines: Vec<String>| {
        lines.sort();
        lines
    };
    let (before, after) = changed(edits);
    assert_eq!((sorted(before), sorted(after)), (sorted(owned(removed)), sorted(owned(added))));
}

#[test]
fn every_robot_file_of_the_repository_is_kept_as_it_is() {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    let mut files: Vec<PathBuf> = Vec::new();
    for folder in ["robots", "robots/servos", "robots/worlds", "examples"] {
        for entry in fs::read_dir(root.join(folder)).unwrap() {
            let path = entry.unwrap().path();
            let inner = path.join("robot.toml");
            files.extend(inner.exists().then_some(inner));
            files.extend(path.extension().is_some_and(|extension| extension == "toml").then_some(path));
        }
    }
    assert!(files.len() > 10, "{files:?}");
    for path in files {
        let text = fs::read_to_string(&path).unwrap();
        let document = Document::new(text.clone());
        assert_eq!(document.syntax_error(), None, "{}", path.display());
        // An edit and its opposite leave the text as it was.
        let set = |value| Edit::Set { path: vec!["robot".into(), "test".into()], value };
        if document.table("robot").is_object() {
            let there = document.edited(&set(json!(1))).unwrap();
            assert_ne!(there.text(), text);
            let back = there.edited(&set(Value::Null)).unwrap();
            assert_eq!(back.text(), text, "{}", path.display());
        }
        for section in document.sections() {
            let key =
                Edit::SetKey { module: section.name.clone(), key: "deadline".into(), value: json!("1s") };
            let there = document.edited(&key).unwrap();
            let back = Edit::SetKey { module: section.name, key: "deadline".into(), value: Value::Null };
            if section.given.get("deadline").is_none() {
                assert_eq!(there.edited(&back).unwrap().text(), text, "{}", path.display());
            }
        }
    }
}

#[test]
fn settings_change_alone() {
    assert_changed(
        json!([{ "op": "set_setting", "module": "emulator", "setting": "seed", "value": 4 }]),
        &["settings = { link = \"memory:r\", seed = 3 }"],
        &["settings = { link = \"memory:r\", seed = 4 }"],
    );
    assert_changed(
        json!([{ "op": "set_setting", "module": "emulator", "setting": "seed", "value": null }]),
        &["settings = { link = \"memory:r\", seed = 3 }"],
        &["settings = { link = \"memory:r\" }"],
    );
    assert_changed(
        json!([{ "op": "set_setting", "module": "hardware", "setting": "imu_frame", "value": "imu" }]),
        &["settings = { port = \"memory:r\" } # in memory"],
        &["settings = { port = \"memory:r\", imu_frame = \"imu\" } # in memory"],
    );
    assert_changed(
        json!([{ "op": "set_setting", "module": "mux", "setting": "hold_s", "value": 3, "is_double": true }]),
        &[],
        &["settings = { hold_s = 3.0 }"],
    );
    assert_changed(
        json!([{ "op": "set_setting", "module": "mux", "setting": "hold_s", "value": null }]),
        &[],
        &[],
    );
}

#[test]
fn modules_are_added_renamed_and_removed_with_their_comments() {
    assert_changed(
        json!([{ "op": "add_module", "kind": "imu_filter" }]),
        &[],
        &["[[module]]", "name = \"imu_filter\"", "kind = \"imu_filter\"", ""],
    );
    assert_changed(
        json!([{ "op": "add_module", "kind": "library", "name": "led", "keys": { "path": "libled.so" } }]),
        &[],
        &["[[module]]", "name = \"led\"", "kind = \"library\"", "path = \"libled.so\"", ""],
    );
    assert_changed(
        json!([{ "op": "remove_module", "module": "emulator" }]),
        &[
            "# Emulated.",
            "[[module]]",
            "name = \"emulator\"",
            "kind = \"darwin_op_emulator\"",
            "settings = { link = \"memory:r\", seed = 3 }",
            "",
        ],
        &[],
    );
    assert_changed(
        json!([{ "op": "rename_module", "module": "mux", "name": "choice" }]),
        &["name = \"mux\"", "parameters = [\"mux.*\"]"],
        &["name = \"choice\"", "parameters = [\"choice.*\"]"],
    );
}

#[test]
fn a_second_module_of_a_kind_gets_a_number() {
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), None);
    let add = json!({ "op": "add_module", "kind": "imu_filter" });
    let document = edit(&composer, json!([add, add, add])).unwrap();
    let names: Vec<_> = document["picture"]["modules"]
        .as_array()
        .unwrap()
        .iter()
        .map(|module| module["name"].clone())
        .collect();
    assert_eq!(names, ["imu_filter", "imu_filter_2", "imu_filter_3"]);
    assert!(text(&document).starts_with("[robot]\nname = \"robot\"\n\n[[module]]\n"), "{}", text(&document));
    let twice = edit(&composer, json!([{ "op": "add_module", "kind": "gait", "name": "imu_filter" }]));
    assert!(twice.unwrap_err().contains("\"imu_filter\" already"));
}

#[test]
fn a_module_moves_with_its_comment() {
    let document = Document::new(ROBOT.to_owned());
    let first = document.edited(&Edit::MoveModule { module: "mux".into(), to: 0 }).unwrap();
    let names = |document: &Document| -> Vec<_> {
        document.sections().into_iter().map(|section| section.name).collect()
    };
    assert_eq!(names(&first), ["mux", "emulator", "hardware"]);
    let back = first.edited(&Edit::MoveModule { module: "mux".into(), to: 2 }).unwrap();
    assert_eq!(back.text(), ROBOT);
    let last = document.edited(&Edit::MoveModule { module: "emulator".into(), to: 9 }).unwrap();
    assert_eq!(names(&last), ["hardware", "mux", "emulator"]);
    assert!(last.text().contains("\n# Emulated.\n[[module]]\nname = \"emulator\""), "{}", last.text());
    // A file that ends with its modules, and begins with one.
    let short = Document::new("[[module]]\nkind = \"gait\"\n[[module]]\nkind = \"falls\"".to_owned());
    let moved = short.edited(&Edit::MoveModule { module: "falls".into(), to: 0 }).unwrap();
    assert_eq!(names(&moved), ["falls", "gait"]);
}

#[test]
fn exposure_is_a_tick_that_keeps_the_comments_of_a_list() {
    let expose =
        |list: &str, name: &str, on| json!([{ "op": "expose", "list": list, "name": name, "on": on }]);
    assert_changed(expose("out", "diagnostics", true), &[], &["    \"diagnostics\","]);
    assert_changed(expose("out", "battery_state", false), &["    \"battery_state\", # the battery"], &[]);
    assert_changed(expose("out", "joint_states", false), &["    \"joint_states\", # the state"], &[]);
    assert_changed(expose("out", "buttons", false), &["    # The last.", "    \"buttons\","], &[]);
    assert_changed(expose("out", "/joint_states", true), &[], &[]);
    assert_changed(
        expose("out", "imu/data_raw", false),
        &["    { topic = \"imu/*\", qos = \"sensor_data\" },"],
        &["    { topic = \"imu/*\", qos = \"sensor_data\", except = [\"imu/data_raw\"] },"],
    );
    assert_changed(expose("services", "reset", true), &[], &["services = [\"reset\"]"]);
    assert_changed(
        json!([{ "op": "expose", "list": "calls", "name": "plan", "on": true, "type": "std_srvs/srv/Trigger" }]),
        &[],
        &["calls = [{ service = \"plan\", type = \"std_srvs/srv/Trigger\" }]"],
    );
    assert_changed(expose("in", "nothing", false), &[], &[]);
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), Some(ROBOT));
    edit(&composer, expose("out", "imu/data_raw", false)).unwrap();
    assert_eq!(text(&edit(&composer, expose("out", "imu/data_raw", true)).unwrap()), ROBOT);
}

#[test]
fn recording_is_a_tick() {
    let record = |topic: &str, on| json!([{ "op": "record", "topic": topic, "on": on }]);
    assert_changed(record("buttons", false), &[], &["except = [\"buttons\"]"]);
    assert_changed(record("buttons", true), &[], &[]);
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), Some(ROBOT));
    let is_recorded = |document: &Value| {
        let topics = document["picture"]["topics"].as_array().unwrap();
        topics.iter().find(|topic| topic["name"] == "buttons").unwrap()["is_recorded"].clone()
    };
    assert_eq!(is_recorded(&edit(&composer, record("buttons", false)).unwrap()), false);
    let document = edit(&composer, record("buttons", true)).unwrap();
    assert_eq!((is_recorded(&document), text(&document)), (json!(true), ROBOT));
    edit(&composer, json!([{ "op": "set", "path": ["record", "topics"], "value": ["joint_states"] }]))
        .unwrap();
    let document = edit(&composer, record("buttons", true)).unwrap();
    assert!(text(&document).contains("topics = [\"joint_states\", \"buttons\"]"), "{}", text(&document));
    let document = edit(&composer, record("buttons", false)).unwrap();
    assert!(text(&document).contains("topics = [\"joint_states\"]\n"), "{}", text(&document));
}

#[test]
fn wires_are_remaps_of_equal_types() {
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), Some(ROBOT));
    let port = |module: &str, port: &str| json!({ "module": module, "port": port });
    let goals = port("mux", "joint_goals");
    let commands = port("hardware", "joint_commands");
    let document = edit(&composer, json!([{ "op": "connect", "from": goals, "to": commands }])).unwrap();
    assert!(text(&document).contains("remap = { joint_commands = \"joint_goals\" }"), "{}", text(&document));
    let is_wired = |document: &Value| {
        document["picture"]["wires"]
            .as_array()
            .unwrap()
            .iter()
            .any(|wire| wire["from"] == goals && wire["to"] == commands)
    };
    assert!(is_wired(&document));
    assert_eq!(errors(&document), [] as [Value; 0]);

    let document = edit(&composer, json!([{ "op": "disconnect", "to": commands }])).unwrap();
    assert!(!is_wired(&document) && !text(&document).contains("remap"), "{}", text(&document));

    let renamed =
        edit(&composer, json!([{ "op": "connect", "from": goals, "to": commands, "rename": "from" }]))
            .unwrap();
    assert!(text(&renamed).contains("remap = { joint_goals = \"joint_commands\" }"), "{}", text(&renamed));

    for (from, to, words) in [
        (port("hardware", "imu/data_raw"), commands.clone(), "sensor_msgs/msg/Imu"),
        (commands.clone(), goals.clone(), "a wire leads from"),
        (port("hardware", "imu"), commands.clone(), "no port \"imu\""),
        (port("nobody", "imu"), commands.clone(), "no module \"nobody\""),
    ] {
        let refused = edit(&composer, json!([{ "op": "connect", "from": from, "to": to }])).unwrap_err();
        assert!(refused.contains(words), "{refused}");
    }
}

#[test]
fn ports_have_the_name_of_their_module() {
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), None);
    let document = edit(
        &composer,
        json!([
            { "op": "add_module", "kind": "forward_command", "name": "wheels" },
            { "op": "set_setting", "module": "wheels", "setting": "joints", "value": ["left", "right"] },
        ]),
    )
    .unwrap();
    let ports = document["picture"]["modules"][0]["ports"].as_array().unwrap();
    assert!(ports.iter().any(|port| port["name"] == "wheels/commands"), "{ports:?}");
    assert_eq!(errors(&document), [] as [Value; 0]);
}

#[test]
fn a_wire_that_is_a_name_of_both_is_cut_by_another_name() {
    let folder = tempfile::tempdir().unwrap();
    let text_of = "[robot]\nname = \"r\"\n[[module]]\nkind = \"imu_filter\"\n[[module]]\nkind = \"gait\"\n";
    let composer = composer(folder.path(), Some(text_of));
    let to = json!({ "module": "gait", "port": "imu/data" });
    let document = edit(&composer, json!([{ "op": "disconnect", "to": to }])).unwrap();
    assert!(text(&document).contains("remap = { \"imu/data\" = \"gait/imu/data\" }"), "{}", text(&document));
    let from = json!({ "module": "imu_filter", "port": "imu/data" });
    let document = edit(&composer, json!([{ "op": "connect", "from": from, "to": to }])).unwrap();
    assert_eq!(text(&document), text_of);
}

#[test]
fn problems_have_their_places() {
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), Some(ROBOT));
    assert_eq!(errors(&composer.ask("document", &json!({})).unwrap()), [] as [Value; 0]);
    let set = |module: &str, setting: &str, value: Value| json!({ "op": "set_setting", "module": module, "setting": setting, "value": value });
    let document =
        edit(&composer, json!([set("mux", "hold_s", json!(-1)), set("hardware", "board", json!("cm750"))]))
            .unwrap();
    let found = errors(&document);
    let place =
        |problem: &Value| (problem["line"].clone(), problem["module"].clone(), problem["key"].clone());
    assert_eq!(
        found.iter().map(place).collect::<Vec<_>>(),
        [
            (json!(16), json!("hardware"), json!("settings.board")),
            (json!(21), json!("mux"), json!("settings.hold_s"))
        ]
    );
    assert!(found[1]["problem"].as_str().unwrap().contains("out of range"), "{found:?}");
    // Its ports are shown all the same.
    let mux = &document["picture"]["modules"][2];
    assert!(mux["ports"].as_array().unwrap().iter().any(|port| port["name"] == "joint_goals"), "{mux}");

    for (wrong, line, module, key) in [
        (
            json!({ "op": "set_topic", "module": "hardware", "port": "joint_command", "topic": "x" }),
            17,
            "hardware",
            json!("remap.joint_command"),
        ),
        (
            json!({ "op": "set_key", "module": "mux", "key": "synchrony", "value": "never" }),
            21,
            "mux",
            json!("synchrony"),
        ),
        (json!({ "op": "add_module", "kind": "gaits" }), 24, "gaits", Value::Null),
    ] {
        composer.ask("reload", &json!({})).unwrap();
        let document = edit(&composer, json!([wrong])).unwrap();
        let found = errors(&document);
        assert_eq!(found.len(), 1, "{wrong}: {found:?}");
        assert_eq!(found[0]["module"], module, "{found:?}");
        assert_eq!(found[0]["line"], line, "{wrong}: {found:?}");
        if !key.is_null() {
            assert_eq!(found[0]["key"], key, "{found:?}");
        }
    }

    composer.ask("reload", &json!({})).unwrap();
    let document =
        edit(&composer, json!([{ "op": "expose", "list": "out", "name": "nothing", "on": true }])).unwrap();
    let found = errors(&document);
    assert!(
        found[0]["module"].is_null()
            && found[0]["problem"].as_str().unwrap().contains("no module has a topic"),
        "{found:?}"
    );
    assert_eq!(
        text(&document).lines().nth(found[0]["line"].as_u64().unwrap() as usize - 1),
        Some("    \"nothing\",")
    );
}

#[test]
fn a_module_without_any_input_is_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), None);
    let document = edit(&composer, json!([{ "op": "add_module", "kind": "imu_filter" }])).unwrap();
    let warning = &problems(&document)[0];
    assert_eq!((&warning["severity"], &warning["module"]), (&json!("warning"), &json!("imu_filter")));
    let fed = edit(&composer, json!([{ "op": "expose", "list": "in", "name": "imu/data_raw", "on": true, "type": "sensor_msgs/msg/Imu" }])).unwrap();
    assert_eq!(problems(&fed), [] as [Value; 0]);
}

#[test]
fn changes_can_be_undone_and_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), Some(ROBOT));
    assert!(composer.ask("undo", &json!({})).unwrap_err().contains("nothing to undo"));
    let first = edit(&composer, json!([{ "op": "add_module", "kind": "gait" }])).unwrap();
    let second = edit(&composer, json!([{ "op": "remove_module", "module": "mux" }])).unwrap();
    assert_eq!(composer.ask("undo", &json!({})).unwrap()["text"], first["text"]);
    let start = composer.ask("undo", &json!({})).unwrap();
    assert_eq!((text(&start), &start["is_dirty"], &start["can_undo"]), (ROBOT, &json!(false), &json!(false)));
    composer.ask("redo", &json!({})).unwrap();
    let last = composer.ask("redo", &json!({})).unwrap();
    assert_eq!((&last["text"], &last["can_redo"]), (&second["text"], &json!(false)));
    composer.ask("undo", &json!({})).unwrap();
    let branch = edit(&composer, json!([{ "op": "add_module", "kind": "falls" }])).unwrap();
    assert_eq!(branch["can_redo"], false);
}

#[test]
fn several_edits_are_all_made_or_none() {
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), Some(ROBOT));
    let edits =
        json!([{ "op": "add_module", "kind": "gait" }, { "op": "remove_module", "module": "nobody" }]);
    assert!(edit(&composer, edits).unwrap_err().contains("no module \"nobody\""));
    assert_eq!(text(&composer.ask("document", &json!({})).unwrap()), ROBOT);
}

#[test]
fn edits_that_make_no_sense_are_refused_in_words() {
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), Some(ROBOT));
    for (wrong, words) in [
        (json!([{ "op": "explode" }]), "unknown variant `explode`"),
        (json!([{ "op": "add_module" }]), "missing field `kind`"),
        (json!([{ "op": "add_module", "kind": "gait", "extra": 1 }]), "unknown field `extra`"),
        (json!(["add_module"]), "an edit is not understood"),
        (json!({}), "`edits` is a list"),
        (json!([{ "op": "set", "path": ["module", "name"], "value": 1 }]), "\"module\" is none of robot"),
        (json!([{ "op": "set", "path": ["robot"], "value": 1 }]), "no key of a table"),
        (json!([{ "op": "set", "path": [], "value": 1 }]), "empty"),
        (json!([{ "op": "set_key", "module": "mux", "key": "settings", "value": {} }]), "an edit of its own"),
        (
            json!([{ "op": "set_setting", "module": "mux", "setting": "sources", "value": [null] }]),
            "no empty values",
        ),
        (json!([{ "op": "expose", "list": "parameters", "name": "a", "on": true }]), "no list of [expose]"),
        (json!([{ "op": "text", "text": "[robot\nname = 1" }]), "line 1"),
        (json!([{ "op": "template", "name": "hexapod" }]), "no template"),
        (json!([{ "op": "text", "text": "#".repeat(LONGEST_TEXT + 1) }]), "at most"),
    ] {
        let refused = composer.ask("edit", &json!({ "edits": wrong })).unwrap_err();
        assert!(refused.contains(words), "{refused}");
    }
    assert!(composer.ask("dance", &json!({})).unwrap_err().contains("\"dance\""));
    assert_eq!(text(&composer.ask("document", &json!({})).unwrap()), ROBOT);
}

#[test]
fn a_text_that_is_no_toml_is_shown_with_its_line_and_can_be_corrected() {
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), Some("[robot]\nname = \n"));
    let document = composer.ask("document", &json!({})).unwrap();
    assert_eq!(problems(&document)[0]["line"], 2, "{document}");
    let refused = edit(&composer, json!([{ "op": "add_module", "kind": "gait" }])).unwrap_err();
    assert!(refused.contains("line 2") && refused.contains("correct the text"), "{refused}");
    let document = edit(&composer, json!([{ "op": "text", "text": ROBOT }])).unwrap();
    assert_eq!(document["picture"]["modules"].as_array().unwrap().len(), 3);
}

#[test]
fn saving_writes_the_file_and_the_places_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), None);
    let document = edit(&composer, json!([{ "op": "template", "name": "darwin_op" }])).unwrap();
    assert_eq!((&document["is_new"], &document["is_dirty"]), (&json!(true), &json!(true)));
    assert_eq!(errors(&document), [] as [Value; 0]);
    composer
        .ask("layout", &json!({ "modules": { "mux": { "x": 10.4, "y": -3 }, "nobody": { "x": 1, "y": 1 } } }))
        .unwrap();
    let saved = composer.ask("save", &json!({})).unwrap();
    assert_eq!((&saved["is_new"], &saved["is_dirty"]), (&json!(false), &json!(false)));
    assert_eq!(fs::read_to_string(folder.path().join("robot.toml")).unwrap(), text(&document));
    let layout: Value =
        serde_json::from_str(&fs::read_to_string(folder.path().join("robot.toml.layout.json")).unwrap())
            .unwrap();
    assert_eq!(layout, json!({ "version": 1, "modules": { "mux": { "x": 10.0, "y": -3.0 } } }));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "nothing else is left");
    // The names of modules are keys of the places.
    edit(&composer, json!([{ "op": "rename_module", "module": "mux", "name": "choice" }])).unwrap();
    let again = composer.ask("save", &json!({})).unwrap();
    assert_eq!(again["layout"], json!({ "choice": { "x": 10.0, "y": -3.0 } }));
    let wrong = composer.ask("layout", &json!({ "modules": { "choice": { "x": "left" } } })).unwrap_err();
    assert!(wrong.contains("not x and y"), "{wrong}");
}

#[test]
fn a_file_that_somebody_else_changed_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), Some(ROBOT));
    let path = folder.path().join("robot.toml");
    let mine = edit(&composer, json!([{ "op": "add_module", "kind": "gait" }])).unwrap();
    let theirs = ROBOT.replace("seed = 3", "seed = 5");
    fs::write(&path, &theirs).unwrap();
    assert_eq!(composer.ask("document", &json!({})).unwrap()["is_changed_on_disk"], true);
    let answer = composer.ask("save", &json!({})).unwrap();
    assert_eq!(answer["conflict"]["text"], theirs);
    assert_eq!(fs::read_to_string(&path).unwrap(), theirs);

    let reloaded = composer.ask("reload", &json!({})).unwrap();
    assert_eq!((text(&reloaded), &reloaded["is_dirty"]), (theirs.as_str(), &json!(false)));
    assert_eq!(composer.ask("undo", &json!({})).unwrap()["text"], mine["text"]);
    composer.ask("save", &json!({})).unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), text(&mine));

    fs::remove_file(&path).unwrap();
    assert!(composer.ask("save", &json!({})).unwrap()["conflict"]["text"].is_null());
    composer.ask("save", &json!({ "overwrite": true })).unwrap();
    assert_eq!(fs::read_to_string(&path).unwrap(), text(&mine));
}

#[cfg(unix)]
#[test]
fn saving_keeps_permissions_and_follows_links() {
    use std::os::unix::fs::{PermissionsExt, symlink};
    let folder = tempfile::tempdir().unwrap();
    let real = folder.path().join("real.toml");
    fs::write(&real, ROBOT).unwrap();
    fs::set_permissions(&real, fs::Permissions::from_mode(0o640)).unwrap();
    symlink(&real, folder.path().join("robot.toml")).unwrap();
    let composer = composer(folder.path(), None);
    edit(&composer, json!([{ "op": "add_module", "kind": "gait" }])).unwrap();
    composer.ask("save", &json!({})).unwrap();
    assert!(fs::symlink_metadata(folder.path().join("robot.toml")).unwrap().is_symlink());
    assert!(fs::read_to_string(&real).unwrap().contains("kind = \"gait\""));
    assert_eq!(fs::metadata(&real).unwrap().permissions().mode() & 0o777, 0o640);
}

#[test]
fn a_robot_runs_only_what_is_saved_and_has_no_problems() {
    let folder = tempfile::tempdir().unwrap();
    let composer = composer(folder.path(), Some(ROBOT));
    edit(&composer, json!([{ "op": "set_setting", "module": "mux", "setting": "hold_s", "value": -1 }]))
        .unwrap();
    assert!(composer.ask("run", &json!({})).unwrap_err().contains("save the robot file first"));
    composer.ask("save", &json!({})).unwrap();
    let refused = composer.ask("run", &json!({})).unwrap_err();
    assert!(refused.contains("line 21") && refused.contains("out of range"), "{refused}");
    composer.ask("undo", &json!({})).unwrap();
    composer.ask("save", &json!({})).unwrap();
    assert!(composer.ask("run", &json!({})).unwrap_err().contains("/nowhere/downbeat"));
    assert!(composer.ask("stop", &json!({})).unwrap_err().contains("no robot was started"));
    assert_eq!(composer.ask("output", &json!({})).unwrap()["is_running"], false);
}

#[test]
fn templates_have_no_problems() {
    for template in templates::usable(&Catalog::built_in()) {
        let folder = tempfile::tempdir().unwrap();
        let composer = composer(folder.path(), None);
        let document = edit(&composer, json!([{ "op": "template", "name": template.name }])).unwrap();
        let found: Vec<_> = errors(&document);
        // A robot without modules does not start, which the page says by its list of templates; C++ is built
        // first.
        let is_ready = !matches!(template.name, "empty" | "cpp");
        assert_eq!(found.is_empty(), is_ready, "{}: {found:?}", template.name);
    }
}

#[test]
fn a_template_writes_the_files_it_needs_but_none_that_exists() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("rover.urdf"), "<robot name=\"mine\"><link name=\"base_link\"/></robot>")
        .unwrap();
    let composer = composer(folder.path(), None);
    edit(&composer, json!([{ "op": "template", "name": "rover" }])).unwrap();
    let read = |name: &str| fs::read_to_string(folder.path().join(name)).unwrap();
    assert!(read("rover_servos.toml").contains("left_wheel") && read("rover.urdf").contains("mine"));
    let text = edit(&composer, json!([])).unwrap()["text"].as_str().unwrap().to_owned();
    assert!(
        text.contains("diff_drive") && !text.contains("patrol"),
        "of kinds that this program has: {text}"
    );
}

#[test]
fn the_profile_has_kinds_templates_and_launchers() {
    let folder = tempfile::tempdir().unwrap();
    let profile = composer(folder.path(), None).ask("profile", &json!({})).unwrap();
    assert_eq!(profile["schema"], PROFILE_SCHEMA);
    assert!(profile["kinds"].as_array().unwrap().iter().any(|kind| kind["kind"] == "gait"));
    assert!(profile["launchers"].as_array().unwrap().contains(&json!("pool")));
    assert!(profile["templates"].as_array().unwrap().iter().any(|template| template["name"] == "darwin_op"));
}
