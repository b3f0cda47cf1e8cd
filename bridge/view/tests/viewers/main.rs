//! Viewers of a running core, over loopback: what they see, what they may do, and what they cannot do to the robot.
#![allow(clippy::unwrap_used)]

mod attacks;
mod client_class;
mod look;
mod steer;
mod support;
