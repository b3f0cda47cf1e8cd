//! What football leagues send over the network.
//!
//! - [`packets`]: what the referee's program (GameController) sends, and what players answer. It parses and
//!   builds both, so that a referee can use it too.
//! - [`game_controller`]: the module that listens to the referee.
//! - [`game_controller_sender`]: the module that sends the packets of a referee and collects the answers.
//! - [`team`]: team messages of the humanoid league, and the module that exchanges them.
//!
//! The modules run detached, on the sockets of [`downbeat_network`].

pub mod game_controller;
pub mod game_controller_sender;
mod kinds;
pub mod packets;
pub mod team;

pub use kinds::kinds;
