#![allow(clippy::unwrap_used)]
use std::path::Path;

use downbeat_executor::Core;

use super::*;
use crate::Robot;

const ROBOT: &str = "[robot]\nname = \"r\"\nnamespace = \"/ns\"\n[[module]]\nkind = \"joint_command_mux\"\nname = \"mux\"\n\
                     settings = { hold_s = 2.0 }\n[[module]]\nkind = \"darwin_op_emulator\"\nname = \"emulator\"";

fn robot() -> RobotFile {
    RobotFile::parse(Source::new(Path::new("robot.toml"), ROBOT.into()), &crate::Catalog::built_in())
        .unwrap()
        .0
}

fn set(file: &mut RobotFile, text: &str) -> Result<()> {
    file.set_from_parameters(&Arc::new(Source::new(Path::new("params.yaml"), text.into())))
}

fn hold_s(file: &RobotFile) -> SettingValue {
    file.modules[0].settings["hold_s"].value.clone()
}

fn problem(text: &str) -> String {
    let mut file = robot();
    let problem = set(&mut file, text).and_then(|()| file.build(Core::new()).map(drop));
    problem.err().unwrap().to_string()
}

#[test]
fn a_node_can_be_named_in_every_form_of_ros() {
    for text in [
        "/ns/r:\n  ros__parameters:\n    mux.hold_s: 5.0",
        "ns/r:\n  ros__parameters:\n    mux: {hold_s: 5.0}",
        "ns:\n  r:\n    ros__parameters:\n      mux:\n        hold_s: 5.0",
        "/ns:\n  \"*\":\n    ros__parameters: {mux.hold_s: 5.0}",
        "/*/r: {ros__parameters: {mux.hold_s: 5.0}}",
        "/**:\n  ros__parameters:\n    mux.hold_s: 5.0",
        "/other: {ros__parameters: {what.ever: 1}}\n/**: {ros__parameters: {mux.hold_s: 5.0}}",
    ] {
        let mut file = robot();
        set(&mut file, text).unwrap();
        assert_eq!(hold_s(&file), 5.0.into(), "{text}");
    }
}

#[test]
fn values_for_another_node_change_nothing() {
    for text in ["", "/r: {ros__parameters: {mux.hold_s: 5.0}}", "/ns/r: {ros__parameters: }"] {
        let mut file = robot();
        set(&mut file, text).unwrap();
        assert_eq!(hold_s(&file), 2.0.into(), "{text}");
    }
}

#[test]
fn later_values_take_precedence_and_the_command_line_over_all() {
    let mut file = robot();
    set(&mut file, "/**: {ros__parameters: {mux.hold_s: 3.0}}\n/ns/r: {ros__parameters: {mux.hold_s: 4}}")
        .unwrap();
    assert_eq!(hold_s(&file), SettingValue::Integer(4));
    set(&mut file, "/**: {ros__parameters: {mux.hold_s: 5.0}}").unwrap();
    assert_eq!(hold_s(&file), 5.0.into());
    file.set_from_argument("mux.hold_s:=6.5").unwrap();
    file.set_from_argument("emulator.faults:=[\"drop:0.01\"]").unwrap();
    let core = file.build(Core::new()).unwrap().core;
    assert_eq!(core.settings("mux").unwrap()[0].value, 6.5.into());
    let emulator = core.settings("emulator").unwrap();
    let faults = emulator.iter().find(|setting| setting.name == "faults").unwrap();
    assert_eq!(faults.value, vec!["drop:0.01".to_owned()].into());
}

#[test]
fn errors_in_a_parameter_file_contain_the_line_and_the_nearest_name() {
    let cases = [
        (
            "/ns/r:\n  ros__parameters:\n    mix.hold_s: 1.0",
            ":3: the robot has no module \"mix\", did you mean \"mux\"?",
        ),
        (
            "/ns/r:\n  ros__parameters:\n    mux:\n      hold: 1.0",
            ":4: module \"mux\" has no setting \"hold\"",
        ),
        ("/ns/r:\n  ros__parameters:\n    mux:\n      hold: 1.0", "did you mean \"hold_s\"?"),
        (
            "/ns/r:\n  ros__parameters:\n\n    mux.hold_s: long",
            ":4: module \"mux\", setting \"hold_s\": expected double, found text \"long\"",
        ),
        (
            "/ns/r:\n  ros__parameters:\n    mux.hold_s: -1.0",
            ":3: module \"mux\", setting \"hold_s\": -1 is out of range",
        ),
        (
            "/ns/r:\n  ros__parameters:\n    mux.hold_s: [true, 1]",
            ":3: expected a list of numbers only, of texts only, or of booleans only",
        ),
        (
            "/ns/r:\n  ros__parameters:\n    mux: 1",
            ":3: \"mux\" is a module; a parameter is named mux.setting",
        ),
        ("/ns/r:\n  ros__parameters:\n    mux.hold_s:", ":3: expected true, false, a number"),
        ("/ns/r:\n  ros__parameters: 3", ":2: expected parameters with their values"),
        ("/ns/r:\n  parameters:\n    mux.hold_s: 1", ":3: expected the name of a node"),
        (
            "/ns/r:\n  ros_parameters:\n    mux.hold_s: 1",
            ":2: \"ros_parameters\" is not ros__parameters, with two underscores; did you mean that?",
        ),
        ("/ns/r:\n  ros__paramters:\n    mux.hold_s: 1", ":2: \"ros__paramters\" is not ros__parameters"),
        ("/ns/r:\n  ros__params: {mux.hold_s: 1}", ":2: \"ros__params\" is not ros__parameters"),
        ("ros__parameters:\n  mux.hold_s: 1", ":1: ros__parameters must be under the name of a node"),
        ("/ns/r:\n  ros__parameters:\n    mux.hold_s: [1,", ":"),
        ("/ns/r:\n  ros__parameters:\n    mux.hold_s: 1\n    mux.hold_s: 2", "duplicate"),
        ("just text", ":1: expected the name of a node"),
    ];
    for (text, expected) in cases {
        let problem = problem(text);
        assert!(problem.starts_with("params.yaml:"), "{problem}");
        assert!(problem.contains(expected), "{problem}\n  should contain\n{expected}");
    }
}

#[test]
fn errors_on_the_command_line_contain_the_argument() {
    let cases = [
        ("mux.hold_s=3", "-p mux.hold_s=3: expected module.setting:=value"),
        ("mix.hold_s:=3", "-p mix.hold_s:=3: the robot has no module \"mix\", did you mean \"mux\"?"),
        ("mux.hold:=3", "-p mux.hold:=3: module \"mux\" has no setting \"hold\""),
        (
            "mux.hold_s:=yes",
            "-p mux.hold_s:=yes: module \"mux\", setting \"hold_s\": expected double, found bool true",
        ),
        ("mux.hold_s:=", "found nothing"),
        ("mux.hold_s:=[1", "-p mux.hold_s:=[1: "),
    ];
    for (argument, expected) in cases {
        let mut file = robot();
        let problem = file.set_from_argument(argument).and_then(|()| file.build(Core::new()).map(drop));
        let problem = problem.err().unwrap().to_string();
        assert!(problem.contains(expected), "{problem}\n  should contain\n{expected}");
    }
}

#[test]
fn parameters_under_wildcards_that_no_module_declares_are_ignored() {
    let mut file = robot();
    let text = "/**:\n  ros__parameters:\n    carrier_id: carrier\n    mux: 3\n    mux.gain: 1.0\n    mux.hold_s: 0.5\n    \
                gripper: {force: 2.0}\n/ns/*:\n  ros__parameters: {other.a: 1}\n";
    set(&mut file, text).unwrap();
    let core = file.build(Core::new()).unwrap().core;
    assert_eq!(core.settings("mux").unwrap()[0].value, 0.5.into());
    // Values of settings that are declared are checked.
    let problem = problem("/**:\n  ros__parameters:\n    mux.hold_s: long");
    assert!(problem.contains(":3: module \"mux\", setting \"hold_s\""), "{problem}");
}

#[test]
fn parameters_of_every_node_are_ignored() {
    let mut file = robot();
    set(&mut file, "/**: {ros__parameters: {use_sim_time: true, qos_overrides: {/parameter_events: {publisher: {depth: 1}}}}}")
        .unwrap();
    assert_eq!(hold_s(&file), 2.0.into());
}

#[test]
fn dumped_parameters_are_loaded_unchanged() {
    let settings = |robot: &Robot| ["mux", "emulator"].map(|module| robot.core.settings(module).unwrap());
    let mut file = robot();
    file.set_from_argument("mux.hold_s:=0.125").unwrap();
    file.set_from_argument("emulator.link:='/tmp/a \"b\": # c'").unwrap();
    file.set_from_argument("emulator.faults:=[\"drop:0.01\", \"dead-servo:5@3s..6s\"]").unwrap();
    let original = file.build(Core::new()).unwrap();
    let dumped = original.parameters();
    assert!(dumped.starts_with("/ns/r:\n  ros__parameters:\n    mux:\n      # s; how long"), "{dumped}");
    let mut file = robot();
    set(&mut file, &dumped).unwrap();
    let loaded = file.build(Core::new()).unwrap();
    assert_eq!(settings(&loaded), settings(&original));
    assert_eq!(loaded.parameters(), dumped);
}

fn value_of(text: &str) -> Result<SettingValue, String> {
    setting_value(&serde_norway::from_str(text).unwrap())
}

#[test]
fn values_have_the_type_that_yaml_gives_them() {
    assert_eq!(value_of("true"), Ok(true.into()));
    assert_eq!(value_of("True"), Ok(true.into()));
    assert_eq!(value_of("-3"), Ok(SettingValue::Integer(-3)));
    assert_eq!(value_of("3.0"), Ok(3.0.into()));
    assert_eq!(value_of("\"3\""), Ok("3".to_owned().into()));
    assert_eq!(value_of("/dev/ttyUSB0"), Ok("/dev/ttyUSB0".to_owned().into()));
    assert_eq!(value_of("[1, 2]"), Ok(vec![1_i64, 2].into()));
    assert_eq!(value_of("[1, 2.5]"), Ok(vec![1.0, 2.5].into()));
    assert_eq!(value_of("[true, false]"), Ok(vec![true, false].into()));
    assert_eq!(value_of("[a, b]"), Ok(vec!["a".to_owned(), "b".to_owned()].into()));
}

#[test]
fn values_that_no_setting_can_have_are_refused() {
    for (text, problem) in [
        ("~", "found nothing"),
        ("[1, a]", "of numbers only, of texts only"),
        ("[true, 1]", "or of booleans only"),
        ("18446744073709551615", "64 bits"),
        ("!x 3", "with a tag"),
    ] {
        let refusal = value_of(text).unwrap_err();
        assert!(refusal.contains(problem), "{text}: {refusal}");
    }
}

#[test]
fn dots_in_place_of_the_slashes_of_a_module_in_a_namespace_are_reported_with_the_right_spelling() {
    let mut file = robot();
    // As an `[[include]]` in an `[[include]]` names it.
    file.modules[0].name = "blue_2/arm/mux".to_owned();
    for (argument, expected) in [
        ("blue_2.arm.mux.hold_s:=1.0", "no module \"blue_2\", did you mean \"blue_2/arm/mux.hold_s\"?"),
        ("blue_2.arm.mux:=1.0", "did you mean \"blue_2/arm/mux.setting\"?"),
        (
            "blue_2.hold_s:=1.0",
            "no module \"blue_2\": it is a namespace, so write blue_2/module.hold_s with one of its modules: blue_2/arm/mux",
        ),
        ("blue_2:=1.0", "so write blue_2/module.setting with one of its modules"),
        ("blue_2.arm.max.hold_s:=1.0", "no module \"blue_2\"; there is"),
    ] {
        let error = file.set_from_argument(argument).unwrap_err().to_string();
        assert!(error.contains(expected), "{argument}: {error}");
    }
    file.set_from_argument("blue_2/arm/mux.hold_s:=1.0").unwrap();
    assert_eq!(hold_s(&file), 1.0.into());
}
