//! An RTPS engine for ROS 2: a sans-IO protocol core and a small driver for UDP.
//!
//! `README.md` has the picture. [`Participant`] joins a domain over UDP; [`protocol::Participant`] is the same without
//! sockets, clock and threads; [`wire`] reads and writes the bytes.
#![allow(missing_docs, reason = "a field or accessor whose name says all has no comment")]

mod driver;
pub mod protocol;
pub mod qos;
pub mod wire;

pub use driver::{
    EndpointEvent, EventHandler, JoinError, MatchHandler, Options, Participant, Range, Reader, SampleHandler,
    Writer,
};
