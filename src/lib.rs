//! Robot software as small modules in one process: the crates of downbeat, and robots from robot files.
//!
//! A user's program is an [`App`]: kinds of modules registered by name, with all commands of the program
//! `downbeat`. [`App::start`] runs a robot inside another program; [`executor`] runs modules without robot
//! files.

mod app;
pub mod modules;

/// Sines and the like that give the same bits on every machine, for modules whose recorded runs replay on
/// another one; those of `std` are the C library's.
pub use libm;

pub use app::{App, AppError};
pub use downbeat_bags as bags;
pub use downbeat_bridge as bridge;
pub use downbeat_device as device;
pub use downbeat_edge as edge;
pub use downbeat_executor as executor;
pub use downbeat_library_host as library_host;
pub use downbeat_msgs as msgs;
pub use downbeat_robot::{
    self as robot, Failure, TestResult, duration, encoding, inspect, journal, playback, recorder, replay,
    ros_recorder, running, table,
};
#[cfg(feature = "view")]
pub use downbeat_view as view;

/// The README of the repository, whose examples are compiled with the documentation tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;

#[cfg(doctest)]
#[doc = include_str!("../docs/log.md")]
struct LogPage;

#[cfg(doctest)]
#[doc = include_str!("../docs/messages.md")]
struct MessagesPage;

#[cfg(doctest)]
#[doc = include_str!("../docs/your_robot.md")]
struct YourRobotPage;
