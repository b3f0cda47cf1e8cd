//! PX4 autopilots as modules of a robot, and what such modules are made of.
//!
//! - [`v1_14`], [`v1_15`], [`v1_16`], [`v1_17`]: px4_msgs of four releases of PX4; [`Release`] names them,
//!   and their topics;
//! - [`frames`]: NED and FRD to ENU and FLU, and back;
//! - [`clock`]: stamps of PX4 as times of the robot;
//! - [`Px4`], the kind `px4`: standard messages of ROS from those of PX4, and set-points and commands to it;
//! - [`Autopilot`], the kind `px4_emulator`: an emulated autopilot with a vehicle that is a point.
//!
//! docs/px4.md says how to use them. Nothing was ever tried with a PX4 autopilot.

mod autopilot;
pub mod clock;
pub mod frames;
mod module;
mod release;
mod requests;
mod standard;
mod wire;

#[allow(missing_docs, clippy::all)] // generated
mod releases {
    include!(concat!(env!("OUT_DIR"), "/releases.rs"));
}

pub use autopilot::Autopilot;
pub use module::Px4;
pub use release::{AllReleases, RELEASE_VARIABLE, Release, UnknownRelease};
pub use releases::{v1_14, v1_15, v1_16, v1_17};

use downbeat_executor::Synchrony;
use downbeat_kind::Kind;

/// The kinds of modules that this package offers to robot files.
#[must_use]
pub fn kinds() -> Vec<Kind> {
    vec![
        Kind::new("px4", "a PX4 autopilot behind a uXRCE-DDS agent (docs/px4.md)", Px4::default),
        Kind::new("px4_emulator", "an emulated PX4 autopilot, whose vehicle is a point", Autopilot::default)
            .emulated()
            .with_synchrony(Synchrony::WhenDue),
    ]
}
