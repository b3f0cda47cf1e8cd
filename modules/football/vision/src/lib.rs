//! What a football player sees in the pictures of its camera: the boundary of the field, lines, their
//! intersections, the centre circle, the ball, goal posts and other robots, in pixels and on the field.
//!
//! - [`Detector`] is the engine, without messages: a [`Picture`], a [`View`] and the classes of [`Colours`]
//!   in, [`Seen`] out;
//! - [`Samples`] learns such classes from marks in pictures;
//! - [`Vision`] is the module for robot files.
//!
//! The order is the classical one of robot football: colour classes by a table, scan lines, field boundary,
//! candidates below it, each verified by its size on the field, and projected with the pose of the camera.
//! Coordinates on the field are in the frame `base_footprint`: on the floor below the base of the robot, x
//! forward, y to the left, in m. Pixels count from the middle of the top left one.
//!
//! # References
//! - T. Laue et al., "Efficient and Reliable Sensor Models for Humanoid Soccer Robot Self-Localization",
//!   2009, for the order.
//! - M. A. Fischler, R. C. Bolles, "Random Sample Consensus", Communications of the ACM 24 (1981), for lines
//!   and the circle.

mod balls;
mod colours;
mod detector;
mod drawing;
mod kinds;
mod labels;
mod learn;
mod markings;
mod module;
mod posts_and_robots;
mod seen;
mod view;

pub use colours::{Class, ClassRange, Colours, ColoursError, Table};
pub use detector::Detector;
pub use downbeat_pictures::{Encoding, Picture, PictureError};
pub use drawing::{annotated, classified};
pub use kinds::kinds;
pub use learn::{LearnError, Samples};
pub use module::Vision;
pub use seen::{
    Exposure, Seen, SeenBall, SeenCircle, SeenIntersection, SeenLine, SeenPost, SeenRobot, TeamColour,
};
pub use view::{Camera, CameraError, View};
