//! Compares our messages with other implementations: hashes, definition texts and bytes. The references are
//! the ROS 2 Jazzy wheels (rclpy over rmw_fastrtps_cpp) and, for what these lack, `rosbags` and `cyclonedds`.
//!
//! Needs the Python interpreter named by `DOWNBEAT_PYTHON`; without it the tests print a note and pass.
//!
//! Every type of the registry is compared. Random values depend on [`SEED`], the type's name and a number,
//! which a failed comparison prints.

#![allow(clippy::unwrap_used)]

mod bags;
mod cyclone;
mod descriptions;
mod every_type;
mod exact;
mod hashes;
mod peer;
mod random;
mod reading;
mod ros;
mod texts;
mod users_packages;
mod values;

#[allow(clippy::all, dead_code, missing_docs)]
mod odd_msgs {
    include!(concat!(env!("OUT_DIR"), "/odd_msgs.rs"));
}

/// The seed of all random values.
const SEED: u64 = 0x5eed;
