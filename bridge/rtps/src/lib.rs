//! An RTPS engine for ROS 2: a sans-IO protocol core and a small driver for UDP.

mod driver;
pub mod protocol;
pub mod qos;
pub mod wire;

pub use driver::{
    EndpointEvent, EventHandler, JoinError, MatchHandler, Options, Participant, Range, Reader, SampleHandler,
    Writer,
};
