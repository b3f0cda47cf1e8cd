//! Viewers of a running core and of bags, over loopback: what they see, what they may do, and what they
//! cannot do to the robot.
#![allow(clippy::unwrap_used)]

mod attacks;
mod bag;
mod client_class;
mod look;
mod page;
mod steer;
mod support;
