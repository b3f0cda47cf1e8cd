//! Robot software as small modules in one process: the crates of downbeat, and robots from robot files.
//!
//! ```no_run
//! use downbeat::executor::Core;
//! use downbeat::robot::RobotFile;
//!
//! let mut robot = RobotFile::read("robots/darwin_op.toml".as_ref())?.build(Core::new())?;
//! robot.core.run()?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod cycle_journal;
pub mod duration;
pub mod encoding;
pub mod inspect;
pub mod playback;
pub mod program;
mod raw_recorder;
pub mod recorder;
pub mod replay;
pub mod robot;
pub mod ros_recorder;
pub mod settings_journal;
pub mod step_journal;
pub mod table;

pub use downbeat_bags as bags;
pub use downbeat_bridge as bridge;
pub use downbeat_executor as executor;
pub use downbeat_modules as modules;
pub use downbeat_msgs as msgs;

/// The page of the repository, whose examples are compiled with the documentation tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
pub struct Readme;
