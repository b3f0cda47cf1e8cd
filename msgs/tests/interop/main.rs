//! Our messages against those of others: hashes, definition texts and bytes. Witnesses are the ROS 2 Jazzy wheels (rclpy over
//! rmw_fastrtps_cpp), and for what these do not have or do, `rosbags` and `cyclonedds`.
//!
//! Needs the Python interpreter that `DOWNBEAT_PYTHON` names; without it the tests say so and pass.
//!
//! Every type of the registry is compared; none is listed here. Random values come from [`SEED`], the type's name and a
//! number, all three told where a comparison fails.

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

/// What all random values come from.
const SEED: u64 = 0x5eed;
