//! Transforms between coordinate frames over time, with the rules of tf2.
//!
//! [`TransformBuffer`] stores the transforms from `/tf` and `/tf_static` and looks up the transform between
//! two frames at a time. It is plain data: no thread, no lock, no clock. [`listen`] fills the buffer of a
//! module, [`TransformBroadcaster`] publishes. [`transform_server`] answers lookups of other nodes.
//!
//! ```
//! use downbeat_executor::Time;
//! use downbeat_transforms::{At, TransformBuffer};
//! use downbeat_msgs::geometry_msgs::msg::{Point, PointStamped, TransformStamped};
//!
//! let transform = |parent: &str, child: &str, x: f64, seconds: i64| {
//!     let mut transform = TransformStamped { child_frame_id: child.into(), ..TransformStamped::default() };
//!     transform.header.frame_id = parent.into();
//!     transform.header.stamp.sec = seconds as i32;
//!     transform.transform.translation.x = x;
//!     transform
//! };
//! let mut buffer = TransformBuffer::new();
//! buffer.insert(&transform("odom", "base_link", 1.0, 10))?;
//! buffer.insert(&transform("odom", "base_link", 2.0, 12))?;
//! buffer.insert_static(&transform("base_link", "camera", 0.1, 0))?;
//!
//! let eleven_seconds = Time::from_nanos(11_000_000_000);
//! let found = buffer.lookup("odom", "camera", eleven_seconds)?;
//! assert!((found.target_from_source.translation.x - 1.6).abs() < 1e-12);
//!
//! let mut seen = PointStamped { point: Point { x: 3.0, ..Point::default() }, ..PointStamped::default() };
//! (seen.header.frame_id, seen.header.stamp.sec) = ("camera".into(), 11);
//! assert!((buffer.transform(&seen, "odom")?.point.x - 4.6).abs() < 1e-12);
//!
//! let too_late = buffer.lookup("odom", "camera", Time::from_nanos(12_123_000_000)).unwrap_err();
//! assert!(too_late.to_string().contains("extrapolation 0.123000000 s into the future"));
//! assert_eq!(buffer.lookup("odom", "camera", At::Latest)?.time, Time::from_nanos(12_000_000_000));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Frames and units
//! A transform message with `header.frame_id` *p* and `child_frame_id` *c* is `p_from_c`: it maps coordinates
//! in *c* to coordinates in *p* (metres, unit quaternions). Frames form a tree; the parent of a frame may
//! change over time.
//!
//! # References
//! - `tf2/src/buffer_core.cpp`, `tf2/src/cache.cpp` and `tf2_geometry_msgs` of `ros2/geometry2`, for the
//!   rules of lookups.
//! - REP-105 for names of frames.

mod buffer;
mod error;
mod geometry;
mod kinds;
mod lookup;
mod modules;
pub mod transform_server;

pub use buffer::{FrameInfo, Taken, TransformBuffer};
pub use error::{LookupError, TimeDirection, TransformRefused};
pub use geometry::{Isometry, Stamped, Transformable, isometry, transform_message, wrapped};
pub use kinds::kinds;
pub use lookup::{At, FoundTransform};
pub use modules::{TF, TF_STATIC, TransformBroadcaster, listen};

#[cfg(test)]
mod tests;
