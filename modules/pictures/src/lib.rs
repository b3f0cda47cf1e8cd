//! Pictures as cameras send them: the pixels of `sensor_msgs/Image` in red, green and blue, and JPEGs.

pub mod jpeg;
pub mod pattern;
mod picture;

pub use picture::{Encoding, Picture, PictureError};
