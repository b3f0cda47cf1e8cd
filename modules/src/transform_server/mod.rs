//! Answers transform lookups of nodes without a transform buffer, like the `buffer_server` of tf2_ros.
//!
//! | name | type | |
//! | --- | --- | --- |
//! | `tf2_buffer_server` | action tf2_msgs/LookupTransform | a goal waits until its transform is known, or for its `timeout` |
//! | `tf`, `tf_static` (in) | tf2_msgs/TFMessage | the known transforms |
//!
//! A goal always succeeds, as in tf2_ros; failures are reported in the result's `error`. A canceled goal ends
//! at once.
//!
//! # References
//! `tf2_ros/src/buffer_server.cpp` of `ros2/geometry2`, branch jazzy.

mod module;

pub use module::TransformServer;
