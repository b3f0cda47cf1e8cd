//! Zenoh as the nodes of `rmw_zenoh_cpp` (Jazzy) use it.
//!
//! - [`wire`] writes and reads their keys, tokens, quality of service and attachments, without a session.
//! - [`Settings`] are the variables of the environment that `rmw_zenoh_cpp` honours, and its defaults.
//! - [`open`] makes the session of a participant; [`Router`] is what `rmw_zenohd` is.
//!
//! The engine behind the trait of the bridge stands on it, in `bridge/src/middleware/zenoh`.
//!
//! ```
//! use downbeat_zenoh::wire::{Announced, Token};
//!
//! let token: Token = "@ros2_lv/0/89358d841018189f4be60385f2d48452/0/0/NN/%/%robot/talker".parse()?;
//! assert_eq!(token.node.to_string(), "/robot/talker");
//! assert_eq!(token.announced, Announced::Node);
//! # Ok::<(), downbeat_zenoh::wire::TokenError>(())
//! ```

mod router;
mod session;
mod settings;
pub mod wire;

pub use router::Router;
pub use session::{OpenError, Reach, RouterCheck, open, open_onlooker};
pub use settings::{MOST_MESSAGE_BYTES, Settings, SettingsError};
/// The crates of the pinned version, for the engine.
pub use {zenoh, zenoh_ext};
