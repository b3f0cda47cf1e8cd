//! ROS 2 interfaces as Rust types.
//!
//! ```
//! use downbeat_msgs::{Message, cdr, sensor_msgs::msg::JointState};
//!
//! let state = JointState { name: vec!["head_pan".into()], position: vec![0.25], ..JointState::default() };
//! let bytes = cdr::to_vec(&state);
//! assert_eq!(cdr::from_slice::<JointState>(&bytes)?, state);
//! assert_eq!(JointState::TYPE_NAME, "sensor_msgs/msg/JointState");
//! assert!(JointState::TYPE_HASH.starts_with("RIHS01_"));
//! # Ok::<(), cdr::Error>(())
//! ```
//!
//! The module of a package has a module `msg` with a struct per message, a module `srv` with a type per service and its
//! messages (`SetBool`, `SetBoolRequest`, `SetBoolResponse`, `SetBoolEvent`), and a module `action` with a type per action,
//! its messages and its services (`Fibonacci`, `FibonacciGoal`, `FibonacciSendGoal`, `FibonacciSendGoalRequest`, …). Fields are named as in ROS 2;
//! a field named as a keyword is written raw (`r#type`). All of it is generated at build time from `interfaces/`.
//!
//! Bounds of sequences and strings are checked when reading, not when writing: see [`cdr`].

// First, so that the macros it defines are known below.
include!(concat!(env!("OUT_DIR"), "/interfaces.rs"));

pub mod byte_list;
pub mod cdr;
pub mod description;
pub mod dynamic;
pub mod encoding;
#[cfg(feature = "flatbuffers")]
pub mod flatbuffers;
#[cfg(any(feature = "protobuf", feature = "flatbuffers"))]
pub mod foxglove;
pub mod large_array;
#[cfg(feature = "protobuf")]
pub mod protobuf;
pub mod qos;

mod interchange;
mod message;
mod time;

/// Stands for the modules of the packages that the crate's `build.rs` generates with `downbeat_msgs_generator`:
///
/// ```ignore
/// downbeat_msgs::include_interfaces!(); // pub mod my_msgs { pub mod msg { pub struct Leg { … } } }
/// ```
#[macro_export]
macro_rules! include_interfaces {
    () => {
        include!(concat!(env!("OUT_DIR"), "/downbeat_msgs.rs"));
    };
}

pub use cdr::WString;
pub use downbeat_msgs_definitions as definitions;
pub use message::{Action, Message, Service};
#[doc(hidden)]
pub use serde; // Generated code in other crates derives its traits by this path.
