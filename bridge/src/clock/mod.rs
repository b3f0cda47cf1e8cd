//! `/clock`, both ways: the core's time for others, and the time of a simulator or of a bag player for the
//! core (`use_sim_time`).
//!
//! ```
//! use downbeat_bridge::clock::FollowedClock;
//! use downbeat_bridge::middleware::in_process::Hub;
//! use downbeat_bridge::ros::{NodeName, Participant};
//! use downbeat_executor::Core;
//!
//! let participant = Participant::on(std::sync::Arc::new(Hub::new().join()))?;
//! let node = participant.create_node(NodeName::new("/", "downbeat")?)?;
//! let clock = FollowedClock::new();
//! let core = Core::new().with_clock(clock.clone()); // Modules are added after this.
//! let _following = clock.follow(&node, &core.handle())?; // Until it is dropped.
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod follow;
mod publish;
mod sim_time;

pub use follow::{FollowedClock, FollowedTime};
pub use publish::{DEFAULT_RATE_HZ, MODULE_NAME, publish};
pub use sim_time::{NodeClock, SimTime, SimTimeError};

/// Absolute: there is one time, whatever the namespaces.
pub const TOPIC: &str = "/clock";
