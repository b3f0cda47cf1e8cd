//! Where a football player is on the field.
//!
//! [`Filter`] is the engine, without messages: steps of odometry and [`Landmarks`] in, a [`Believed`] pose out.

mod filter;

pub use filter::{Believed, Filter, Landmarks, Pose};
