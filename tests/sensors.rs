//! The sensors of `robots/sensors.toml`, emulated: run, recorded and replayed.
#![cfg(feature = "sensors")]
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::Path;

use common::{open_with_stock_readers, output_of, record_until, recorded_messages, text_of};
use serde_json::Value;

const ROBOT: &str = "robots/sensors.toml";
/// Two seconds of the robot.
const BAG: &str = "tests/data/sensors";
const TOPICS: [&str; 7] =
    ["/scan", "/fix", "/vel", "/time_reference", "/imu/data", "/imu/data_raw", "/imu/mag"];

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Replays a bag, and returns the topics that were compared with it.
fn compared(robot: &str, bag: &str) -> Vec<String> {
    let output = output_of(&["bag", "replay", robot, bag, "--json"]);
    let report = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{report} {}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_str(&report).unwrap();
    let topics = report["topics"].as_array().unwrap().iter();
    let compared = topics.filter(|topic| topic.to_string().contains("compared"));
    compared.map(|topic| topic["topic"].as_str().unwrap().to_owned()).collect()
}

#[test]
fn emulated_sensors_in_simulated_time_give_the_same_bag_in_every_run_and_replay() {
    let folder = tempfile::tempdir().unwrap();
    let [one, two] = ["one", "two"].map(|bag| folder.path().join(bag));
    for bag in [&one, &two] {
        text_of(&["run", ROBOT, "--fast", "--duration", "5s", "--record", text(bag)]);
    }
    // `diagnostics` of the process contains times of this machine.
    text_of(&["bag", "diff", text(&one), text(&two), "--ignore", "diagnostics"]);
    assert!(recorded_messages(&one, "/scan") > 40 && recorded_messages(&one, "/imu/data") > 400);
    open_with_stock_readers(&one);
    let compared = compared(ROBOT, text(&one));
    assert!(TOPICS.iter().all(|topic| compared.contains(&(*topic).to_owned())), "{compared:?}");
}

#[test]
fn the_recorded_run_of_the_repository_replays_bit_for_bit() {
    let compared = compared(ROBOT, BAG);
    assert!(TOPICS.iter().all(|topic| compared.contains(&(*topic).to_owned())), "{compared:?}");
}

#[test]
fn sensors_on_pseudo_terminals_are_recorded_in_real_time_and_replay() {
    let folder = tempfile::tempdir().unwrap();
    let port = |name: &str| folder.path().join(name);
    let file = std::fs::read_to_string(ROBOT).unwrap();
    let (lidar, gps) = (port("lidar"), port("gps"));
    let file = file
        .replace(
            "settings = { model = \"ld19\" }",
            &format!("settings = {{ model = \"ld19\", link = {:?} }}", text(&lidar)),
        )
        .replace("memory:lidar", text(&lidar))
        .replace(
            "kind = \"gps_emulator\"",
            &format!("kind = \"gps_emulator\"\nsettings = {{ link = {:?} }}", text(&gps)),
        )
        .replace("memory:gps", text(&gps));
    let robot = port("robot.toml");
    std::fs::write(&robot, file).unwrap();
    let bag = port("bag");
    let arguments = ["bag", "record", "--robot", text(&robot), "--output", text(&bag)];
    record_until(&arguments, &bag, "/scan", 10);
    let compared = compared(text(&robot), text(&bag));
    assert!(
        ["/scan", "/fix", "/imu/data"].iter().all(|topic| compared.contains(&(*topic).to_owned())),
        "{compared:?}"
    );
}

#[test]
fn a_wrong_setting_is_refused_with_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let robot = folder.path().join("robot.toml");
    let file = "[robot]\nname = \"robot\"\n[[module]]\nkind = \"lidar\"\nsettings = { model = \"ld20\" }\n";
    std::fs::write(&robot, file).unwrap();
    let output = output_of(&["check", text(&robot)]);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success());
    assert!(
        error.contains("robot.toml:") && error.contains("\"ld20\" is none of ld06, ld19, rplidar_a1"),
        "{error}"
    );
}
