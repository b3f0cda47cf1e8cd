//! ROS 2 interfaces as Rust types.
//!
//! ```
//! use downbeat_msgs::{Message, cdr, sensor_msgs::msg::JointState};
//!
//! let state = JointState { name: vec!["head_pan".into()], position: vec![0.25], ..JointState::default() };
//! let bytes = cdr::to_vec(&state);
//! assert_eq!(cdr::from_slice::<JointState>(&bytes)?, state);
//! assert_eq!(JointState::TYPE_NAME, "sensor_msgs/msg/JointState");
//! assert!(JointState::TYPE_HASH.starts_with("RIHS01_"));
//! # Ok::<(), cdr::Error>(())
//! ```
//!
//! The module of a package has a module `msg` with a struct per message, a module `srv` with a type per
//! service and its messages (`SetBool`, `SetBoolRequest`, `SetBoolResponse`, `SetBoolEvent`), and a module
//! `action` with a type per action, its messages and its services (`Fibonacci`, `FibonacciGoal`,
//! `FibonacciSendGoal`, `FibonacciSendGoalRequest`, …). Fields are named as in ROS 2; a field whose name is a
//! keyword is a raw identifier (`r#type`). All of it is generated at build time from `interfaces/`.
//!
//! Each struct with strings or sequences has a view in `msg::view`, which borrows them from the input: see
//! [`cdr::FromReader`].
//!
//! Bounds of sequences and strings are checked when reading, and on request when writing: see [`cdr`].

// First, so that its macros are defined below.
include!(concat!(env!("OUT_DIR"), "/interfaces.rs"));

pub mod byte_list;
pub mod cdr;
pub mod description;
pub mod dynamic;
pub mod encoding;
#[cfg(feature = "flatbuffers")]
pub mod flatbuffers;
#[cfg(any(feature = "protobuf", feature = "flatbuffers"))]
pub mod foxglove;
pub mod large_array;
mod printable;
#[cfg(feature = "protobuf")]
pub mod protobuf;
pub mod qos;
pub mod yaml;

mod carried;
mod interchange;
mod interface_set;
mod message;
mod time;

/// Includes the modules of the packages that the crate's `build.rs` generates with `downbeat_msgs_generator`,
/// and `INTERFACES`, the [set](InterfaceSet) of everything in them:
///
/// ```ignore
/// downbeat_msgs::include_interfaces!(); // pub mod my_msgs { pub mod msg { pub struct Leg { … } } }
/// ```
#[macro_export]
macro_rules! include_interfaces {
    () => {
        include!(concat!(env!("OUT_DIR"), "/downbeat_msgs.rs"));
    };
}

pub use carried::carried;
pub use cdr::WString;
pub use downbeat_files::user_file;
pub use downbeat_msgs_definitions as definitions;
pub use interface_set::{InterfaceSet, InterfaceVisitor};
pub use message::{Action, Message, OneAction, OneMessage, OneService, Service};
pub use printable::{printable, write_printable_lines};
#[doc(hidden)]
pub use serde; // Generated code in other crates derives its traits through this path.

/// Makes a hand-written struct a ROS 2 message, with the same bytes, definition text, type description and
/// hash as a generated message with that definition.
///
/// ```
/// use downbeat_msgs::std_msgs::msg::Header;
/// use downbeat_msgs::{Message, cdr};
///
/// /// One leg of a robot.
/// #[derive(Clone, Debug, Default, PartialEq, Message)]
/// #[message(name = "my_msgs/msg/Leg")]
/// struct Leg {
///     header: Header,
///     /// From the hip down [rad].
///     angles: [f64; 6],
///     #[message(type = "string<=16[<=4]")]
///     contacts: Vec<String>,
/// }
///
/// assert_eq!(cdr::from_slice::<Leg>(&cdr::to_vec(&Leg::default()))?, Leg::default());
/// assert!(Leg::TYPE_HASH.starts_with("RIHS01_"));
/// assert!(Leg::DEFINITION.starts_with(
///     "# One leg of a robot.\n\nstd_msgs/Header header\n# From the hip down [rad].\nfloat64[6] angles\n"
/// ));
/// # Ok::<(), cdr::Error>(())
/// ```
///
/// Everything but the name is computed from the fields at compile time. The type of a field is the Rust type
/// in the struct, generated or derived, so the hash always matches it.
///
/// # Attributes
/// - `name = "my_msgs/msg/Leg"`: the full name. Without it, the name consists of the crate's name, or the
///   package in the path of the file, and the struct's name.
/// - `file = "msg/Leg.msg"`: the definition, relative to the folder of `Cargo.toml`. The struct must have the
///   same fields in the same order with the same types; a field that differs is an error at that field.
///   `DEFINITION` is the file's text, including its comments and defaults. Constants, and defaults in the
///   implementation of `Default`, are up to the struct.
/// - `crate = "some::path"`: the path of this crate, if not `::downbeat_msgs`.
/// - on a field, without a file: `type = "byte"` or `type = "string<=16[<=4]"`, the type as in a definition,
///   for what Rust types cannot express: `byte`, and bounds.
///
/// # Types
/// `bool`, the integers of 8 to 64 bits, `f32`, `f64`, `String` (`string`), `WString` (`wstring`), structs
/// that are messages, and `[T; N]` and `Vec<T>` of these. `u8` is `uint8`; in a file also `byte` or `char`.
///
/// A field of another type, or one that does not match the file, does not compile:
///
/// ```compile_fail,E0277
/// # use downbeat_msgs::Message;
/// #[derive(Clone, Debug, Default, PartialEq, Message)]
/// #[message(name = "my_msgs/msg/Leg")]
/// struct Leg {
///     side: Option<u8>, // `Option<u8>` cannot be the type of a field of a ROS 2 message
/// }
/// ```
///
/// ```compile_fail,E0080
/// # use downbeat_msgs::Message;
/// #[derive(Clone, Debug, Default, PartialEq, Message)]
/// #[message(file = "interfaces/geometry_msgs/msg/Point32.msg")]
/// struct Point32 {
///     x: f32,
///     y: f32,
///     z: f64, // interfaces/geometry_msgs/msg/Point32.msg:3:1: `z` is `float32`, in Rust `f32`
/// }
/// ```
///
/// ```compile_fail,E0080
/// # use downbeat_msgs::{Message, builtin_interfaces::msg::Duration};
/// #[derive(Clone, Debug, Default, PartialEq, Message)]
/// #[message(file = "interfaces/std_msgs/msg/Header.msg")]
/// struct Header {
///     stamp: Duration, // `stamp` is `builtin_interfaces/Time`, in Rust the struct of builtin_interfaces/msg/Time
///     frame_id: String,
/// }
/// ```
///
/// ```compile_fail,E0080
/// # use downbeat_msgs::Message;
/// #[derive(Clone, Debug, Default, PartialEq, Message)]
/// struct Matrix {
///     rows: Vec<Vec<f64>>, // ROS 2 has no arrays of arrays: put the inner one into a message
/// }
/// ```
#[cfg(feature = "derive")]
pub use downbeat_msgs_derive::Message;
