//! Type descriptions, known at compile time.
//!
//! Every message, service and action has a description, in the form that ROS 2 nodes request from each other
//! (`~/get_type_description`):
//!
//! ```
//! use downbeat_msgs::{Message, std_msgs::msg::Header};
//!
//! let description = Header::type_description();
//! assert_eq!(description.type_description.type_name, "std_msgs/msg/Header");
//! assert_eq!(description.referenced_type_descriptions[0].type_name, "builtin_interfaces/msg/Time");
//! ```
//!
//! It is derived from a constant, [`Message::FIELDS`](crate::Message::FIELDS), from which the derive macro
//! also computes, at compile time, the hash and the definition text of a message that has no definition file.
//!
//! # References
//! `type_description_interfaces` of `ros2/rcl_interfaces` and `rosidl_generator_type_description` of `ros2/rosidl`, branch
//! jazzy.

mod expand;
mod field;
mod hash;
mod sha256;
mod text;

#[doc(hidden)]
pub use field::check;
pub use field::{Description, Field, FieldType, FieldValue, Shape};
pub use hash::{Hash, hash};
pub use text::{OwnText, Text, definition};
