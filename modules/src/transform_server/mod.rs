//! Answers where frames are in each other to who has no transform buffer: the `buffer_server` of tf2_ros.
//!
//! | name | type | |
//! | --- | --- | --- |
//! | `tf2_buffer_server` | action tf2_msgs/LookupTransform | a goal waits until its transform is known, or for its `timeout` |
//! | `tf`, `tf_static` (in) | tf2_msgs/TFMessage | what is known |
//!
//! A goal always succeeds, as with tf2_ros; what went wrong is in the result's `error`. One that is canceled ends at once.
//!
//! # References
//! `tf2_ros/src/buffer_server.cpp` of `ros2/geometry2`, branch jazzy.

mod module;

pub use module::TransformServer;
