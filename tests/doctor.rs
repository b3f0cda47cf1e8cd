//! `downbeat doctor` on the machine of the test.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{downbeat, robot_file};
use serde_json::Value;

/// The exit code, the findings and what is printed on standard error.
fn doctor(arguments: &[&str], variables: &[(&str, &str)]) -> (Option<i32>, Vec<Value>, String) {
    let mut command = downbeat(&["doctor", "--json"]);
    let output = command.args(arguments).envs(variables.iter().copied()).output().unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{error}"));
    let findings = report["findings"].as_array().unwrap().clone();
    let problems = findings.iter().filter(|finding| finding["verdict"] == "problem").count();
    assert_eq!(report["problems"], problems);
    assert_eq!(output.status.code(), Some(i32::from(problems > 0)), "{error}");
    (output.status.code(), findings, error)
}

fn has(findings: &[Value], verdict: &str, found: &str) -> bool {
    let is_it =
        |finding: &Value| finding["verdict"] == verdict && finding["found"].as_str().unwrap().contains(found);
    findings.iter().any(is_it)
}

#[test]
fn a_port_of_the_robot_file_that_is_missing_is_a_problem() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string("robots/darwin_op_serial.toml").unwrap();
    let robot = folder.path().join("robot.toml");
    std::fs::write(&robot, text.replace("/dev/ttyUSB0", "/dev/ttyNone")).unwrap();
    let (code, findings, error) = doctor(&[robot.to_str().unwrap()], &[]);
    assert!(has(&findings, "problem", "/dev/ttyNone of hardware does not exist"), "{findings:#?}");
    assert_eq!(code, Some(1));
    assert!(error.contains("findings are problems"), "{error}");
}

#[test]
fn the_port_of_servos_is_that_of_their_description() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string("robots/servos/so101.toml").unwrap();
    std::fs::write(folder.path().join("arm.toml"), text.replace("/dev/ttyACM0", "/dev/ttyNone")).unwrap();
    let robot = folder.path().join("robot.toml");
    let text = "[robot]\nname = \"arm\"\n\n[[module]]\nname = \"hardware\"\nkind = \"servo_bus\"\n\
                settings = { description = \"arm.toml\" }\n";
    std::fs::write(&robot, text).unwrap();
    let (_, findings, _) = doctor(&[robot.to_str().unwrap()], &[]);
    assert!(has(&findings, "problem", "/dev/ttyNone of hardware does not exist"), "{findings:#?}");
}

#[test]
fn an_emulated_robot_asks_for_no_device_and_what_the_environment_leads_to_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let robot = robot_file(folder.path(), |text| text);
    let (_, findings, _) = doctor(&[robot.to_str().unwrap()], &[("ROS_DOMAIN_ID", "77")]);
    assert!(has(&findings, "ok", "no serial port and no camera"), "{findings:#?}");
    assert!(has(&findings, "ok", "DDS domain 77, with nodes of this machine only"), "{findings:#?}");
    let (code, findings, _) = doctor(&[], &[("ROS_DOMAIN_ID", "robot")]);
    assert!(has(&findings, "problem", "ROS_DOMAIN_ID=\"robot\" is not a domain"), "{findings:#?}");
    assert_eq!(code, Some(1));
}

#[test]
fn a_robot_file_that_cannot_be_read_does_not_hide_the_machine() {
    let (_, findings, _) = doctor(&["robots/none.toml"], &[]);
    assert!(has(&findings, "problem", "robots/none.toml"), "{findings:#?}");
    assert!(findings.iter().any(|finding| finding["area"] == "clock"), "{findings:#?}");
}
