//! An RTPS engine for ROS 2: a sans-IO protocol core and a small driver for UDP.
//!
//! `README.md` contains an overview. [`Participant`] joins a domain over UDP; [`protocol::Participant`] is
//! the protocol without sockets, clock or threads; [`wire`] parses and writes messages.
#![allow(missing_docs, reason = "fields and accessors with a self-explanatory name have no comment")]

mod driver;
pub mod protocol;
pub mod qos;
pub mod wire;

pub use driver::{
    EndpointEvent, EventHandler, JoinError, MatchHandler, Options, Participant, Range, Reader, SOCKET_BUFFER,
    SampleHandler, Security, Writer,
};
