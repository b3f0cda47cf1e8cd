//! Where a football player, the ball and other robots are on the field.
//!
//! - [`Filter`] is the engine, without messages: steps of odometry and [`Landmarks`] in, a [`Believed`] pose
//!   out;
//! - [`Localisation`] is the module for robot files.

mod ball;
mod filter;
mod hypotheses;
mod kinds;
mod messages;
mod module;
mod robots;
mod track;

pub use filter::{Believed, Filter, Landmarks, Pose};
pub use kinds::kinds;
pub use module::Localisation;
