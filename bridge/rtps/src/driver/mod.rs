//! The protocol on UDP: sockets, a thread, and handles for writers and readers.

mod interfaces;
mod log_limit;
mod options;
mod sockets;

pub use options::{JoinError, Options, Range};
