//! Modules that talk to others over the network.
//!
//! - [`packets`]: what the referee's program (GameController) of the football leagues sends, and what players answer. It parses and
//!   builds both, so that a referee can use it too.
//! - [`game_controller`]: the module that listens to the referee.
//! - [`game_controller_sender`]: the module that sends the packets of a referee and collects the answers.
//! - [`team`]: team messages of the humanoid league, and the module that exchanges them.
//! - [`udp`]: the device behind the modules: a socket whose datagrams are recorded, so that a replay repeats them.
//! - [`udp_lines`]: lines of text on UDP, as topics.
//! - [`tcp`] and [`tcp_lines`]: the same on TCP, as a server or a client.
//! - `mqtt` (feature of that name): topics of the robot on an MQTT broker.
//!
//! The modules run detached. They never wait for the network: sockets are polled.

pub mod game_controller;
pub mod game_controller_sender;
mod mailbox;
#[cfg(feature = "mqtt")]
pub mod mqtt;
pub mod packets;
pub mod tcp;
pub mod tcp_lines;
pub mod team;
pub mod udp;
pub mod udp_lines;
