//! What the modules of a football player share.
//!
//! - The messages of [soccer_interfaces](https://github.com/ros-sports/soccer_interfaces), with what they use
//!   of `vision_msgs`: what is seen, in pixels and on the field, and what is believed.
//! - `football_interfaces`: the state of the game and what players tell their team.
//! - [`floor_covariance`]: how certain points on the floor are that a camera sees.
//! - [`Field`]: the measures of a field, its ball and its robots, from a file.
#![allow(rustdoc::broken_intra_doc_links)] // units in brackets, as ROS writes them in comments of messages

downbeat_msgs::include_interfaces!();

mod field;
mod floor;

pub use field::{
    Area, Ball, BallColour, Field, FieldError, Goal, GoalColour, Intersection, IntersectionKind, Line,
    RobotSize,
};
pub use floor::floor_covariance;
