//! Modules that talk to other programs over the network.
//!
//! - [`udp`]: the device behind the modules: a socket whose datagrams are recorded, so that a replay repeats
//!   them.
//! - [`udp_lines`]: lines of text on UDP, as topics.
//! - [`tcp`] and [`tcp_lines`]: the same on TCP, as a server or a client.
//! - [`mailbox`]: for modules with sockets: what all of them share.
//! - `mqtt` (feature of that name): topics of the robot on an MQTT broker.
//!
//! The modules run detached. They never wait for the network: sockets are polled.

mod kinds;
pub mod mailbox;
#[cfg(feature = "mqtt")]
pub mod mqtt;
pub mod tcp;
pub mod tcp_lines;
pub mod udp;
pub mod udp_lines;

pub use kinds::kinds;
