//! A server that shows a core, or recorded bags ([`ViewServer::show_bags`]), to Foxglove, Lichtblick and
//! PlotJuggler: topics, services, settings, files and the graph of modules over Foxglove's WebSocket
//! protocol.
//!
//! ```
//! use downbeat_edge::Interfaces;
//! use downbeat_executor::Core;
//! use downbeat_view::{ViewOptions, ViewServer};
//!
//! let mut core = Core::new();
//! let options = ViewOptions { foxglove: Some(0), ..ViewOptions::new("robot")? };
//! let server = ViewServer::start(&mut core, &Interfaces::carried(), options)?;
//! println!("open {} in a viewer", server.foxglove_url().unwrap_or_default());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! - A topic leaves the core only while somebody subscribes to it: without viewers nothing is serialized.
//!   (Latched topics are the exception, since a late viewer receives their last messages.)
//! - The robot never waits for a viewer. Messages wait in a bounded queue per viewer; what does not fit is
//!   dropped, counted and reported to that viewer. A viewer that does not read at all, or sends too much, is
//!   disconnected.
//! - Every viewer may read. What changes the robot (publishing, calling, setting) needs a token, see
//!   [`Access`]. The server listens only on this machine unless [`ViewOptions::address`] says otherwise.
//!
//! Bags are played to all viewers at once; each of them may play, pause, seek and change the rate, without a
//! token.
//!
//! Topics appear under their names in the core with a leading slash, and settings of modules as
//! `<module>.<setting>`.
//!
//! # References
//! The protocol as in the repositories `foxglove/ws-protocol` (client class and types, 0.8.0) and
//! `foxglove/foxglove-sdk` (`rust/foxglove/src/protocol`, version 1): subprotocols `foxglove.websocket.v1`
//! and `foxglove.sdk.v1`.

mod announcing;
mod assets;
mod bag;
mod channels;
mod client;
mod connection;
mod feed;
mod graph;
mod options;
mod outbox;
mod page;
mod parameters;
mod protocol;
mod server;
mod services;
mod session;
mod shared;
mod source;
mod subscribed;

pub use bag::BagPlayback;
pub use options::{Access, Limits, Token, TokenError, ViewOptions, ViewTime};
pub use page::{Ask, Host, ModuleProfile, PAGE_PORT, PageOptions, Panel, PanelScript};
pub use server::{ViewError, ViewServer};
pub use source::CoreLink;
