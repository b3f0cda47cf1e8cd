//! Emulated sensors on Linux device interfaces: recorded, and replayed without the devices.
#![cfg(feature = "sensors")]
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::fs;
use std::path::{Path, PathBuf};

use common::{output_of, record_until};
use serde_json::Value;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn fixture() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/kernel_sensors")
}

fn replayed(robot: &Path, bag: &Path) -> Value {
    let output = output_of(&["bag", "replay", text(robot), text(bag), "--json"]);
    let report = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{report} {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_str(&report).unwrap()
}

/// Asserts that all topics were compared and are equal.
fn assert_compared(report: &Value) {
    let topics = report["topics"].as_array().unwrap();
    for name in [
        "/image_raw/compressed",
        "/image_raw",
        "/camera_info",
        "/joy",
        "/cmd_vel",
        "/from_can_bus",
        "/gpio/edges",
    ] {
        let topic = topics.iter().find(|topic| topic["topic"] == name);
        let topic = topic.unwrap_or_else(|| panic!("{name} in {report}"));
        assert!(topic["compared"].as_u64().unwrap_or_default() > 0, "{topic}");
    }
}

#[test]
fn a_robot_with_emulated_devices_is_recorded_and_replayed_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    for file in ["robot.toml", "drive.events", "drive.log"] {
        fs::copy(fixture().join(file), folder.path().join(file)).unwrap();
    }
    let (robot, bag) = (folder.path().join("robot.toml"), folder.path().join("bag"));
    record_until(&["bag", "record", "--robot", text(&robot), "--output", text(&bag)], &bag, "/image_raw", 10);
    // The devices are removed; the recording supplies their data.
    fs::write(folder.path().join("drive.events"), "").unwrap();
    fs::write(folder.path().join("drive.log"), "").unwrap();
    assert_compared(&replayed(&robot, &bag));
}

/// `recorded_run` is two seconds of `robot.toml`.
#[test]
fn the_recorded_run_repeats_bit_for_bit() {
    let robot = fixture().join("robot.toml");
    assert_compared(&replayed(&robot, &fixture().join("recorded_run")));
}

#[test]
fn a_wrong_calibration_is_refused_with_its_file_and_line() {
    let folder = tempfile::tempdir().unwrap();
    let robot = folder.path().join("robot.toml");
    fs::write(
        &robot,
        "[robot]\nname = \"eye\"\n\n[[module]]\nname = \"camera\"\nkind = \"camera\"\nsettings = { calibration = \"front.yaml\" }\n",
    )
    .unwrap();
    let matrix = "{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}";
    let calibration = format!(
        "image_width: 640\nimage_height: 480\ncamera_matrix: {matrix}\ndistortion_coefficients: {{rows: 1, cols: 4, data: [0, 0, 0, 0]}}\n\
         rectification_matrix: {matrix}\nprojection_matrix: {matrix}\n"
    );
    fs::write(folder.path().join("front.yaml"), calibration).unwrap();
    let output = output_of(&["check", text(&robot)]);
    let told = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success());
    assert!(told.contains("front.yaml: line 4, distortion_coefficients: it is 1x4, expected 1x5"), "{told}");
}
