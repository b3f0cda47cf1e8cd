//! What was proven with whom: notes of single tests, of which `cargo xtask test` makes `docs/ros2_matrix.md`.

use serde_json::{Value, json};
use std::fs::OpenOptions;
use std::io::Write;
use std::path::PathBuf;

/// Who was there.
#[derive(Clone, Copy)]
pub enum With {
    /// rclpy of Jazzy, on rmw_fastrtps_cpp.
    Rclpy,
    /// rclpy of Kilted, on its rmw_fastrtps_cpp.
    Kilted,
    /// The Python package `cyclonedds`: the engine of rmw_cyclonedds_cpp.
    Cyclone,
    /// Cyclone DDS of Debian with its security, in C.
    SecuredCyclone,
    /// Fast DDS of Debian with its security, in C++.
    SecuredFast,
    /// The crate `ros2-client`.
    Ros2Client,
    /// The Python package `eclipse-zenoh`, with what `rmw_zenoh_cpp` sends.
    EclipseZenoh,
    /// The recorder of Jazzy, rosbag2: bags that it made.
    Rosbag2,
    /// The Python package `mcap`.
    Mcap,
    /// The Python package `mcap-ros2-support`.
    McapRos2,
    /// The Python package `rosbags`.
    Rosbags,
    /// `@mcap/core` from npm.
    McapCore,
}

/// From downbeat to the peer, the other way, or one thing that takes both. A bag goes from who writes it to
/// who reads it.
#[derive(Clone, Copy)]
pub enum Way {
    Out,
    In,
    Both,
}

/// Notes when it is dropped that the check passed, or failed if that is in a panic.
#[must_use]
pub struct Check(Value);

/// A check of `feature`, under one of the headings of the matrix, that the test goes on to make.
pub fn check(heading: &str, feature: &str, with: With, way: Way) -> Check {
    let with = match with {
        With::Rclpy => "rclpy",
        With::Kilted => "kilted",
        With::Cyclone => "cyclonedds",
        With::SecuredCyclone => "secured_cyclonedds",
        With::SecuredFast => "secured_fastdds",
        With::Ros2Client => "ros2_client",
        With::EclipseZenoh => "eclipse_zenoh",
        With::Rosbag2 => "rosbag2",
        With::Mcap => "mcap",
        With::McapRos2 => "mcap_ros2",
        With::Rosbags => "rosbags",
        With::McapCore => "mcap_core",
    };
    let way = match way {
        Way::Out => "out",
        Way::In => "in",
        Way::Both => "both",
    };
    Check(json!({ "heading": heading, "feature": feature, "with": with, "way": way }))
}

impl Check {
    /// This machine does not allow what the check needs.
    pub fn skipped(mut self) {
        self.0["is_skipped"] = true.into();
    }

    /// The test goes on to show that this cannot be done, and why.
    pub fn limited_by(mut self, reason: &str) -> Self {
        self.0["limit"] = reason.into();
        self
    }
}

impl Drop for Check {
    fn drop(&mut self) {
        let Some(folder) = std::env::var_os("DOWNBEAT_MATRIX").map(PathBuf::from) else { return };
        self.0["passed"] = (!std::thread::panicking()).into();
        // A file for each process, since tests run side by side.
        let file = folder.join(format!("{}.jsonl", std::process::id()));
        let noted = OpenOptions::new()
            .create(true)
            .append(true)
            .open(&file)
            .and_then(|mut notes| notes.write_all(format!("{}\n", self.0).as_bytes()));
        if let Err(error) = noted {
            eprintln!("{}: {error}", file.display());
        }
    }
}
