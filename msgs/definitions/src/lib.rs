//! Reads ROS 2 interface definitions (`.msg`, `.srv`, `.action`, `.idl`) and derives what both ends of a
//! connection must agree on: the `ros2msg` definition text, type descriptions and RIHS01 hashes.
//!
//! ```
//! use downbeat_msgs_definitions::{Catalog, TypeName};
//!
//! let mut catalog = Catalog::new();
//! catalog.add_message("std_msgs/msg/String".parse()?, "string data\n", "std_msgs/msg/String.msg")?;
//! catalog.check()?;
//! let name: TypeName = "std_msgs/msg/String".parse()?;
//! assert!(catalog.type_hash(&name)?.starts_with("RIHS01_df668c74"));
//! # Ok::<(), downbeat_msgs_definitions::Error>(())
//! ```
//!
//! Text is [parsed](parse_message) into [definitions](MessageDefinition), a [`Catalog`] holds them and
//! resolves their references, and everything else ([`TypeDescription`], [definition
//! text](Catalog::definition_text)) is derived from a checked catalog.
//!
//! # References
//! - `ros2/rosidl` branch jazzy: `rosidl_adapter/rosidl_adapter/parser.py` (the grammar),
//!   `rosidl_generator_type_description` (descriptions and hashes).
//! - `ros2/rosbag2` branch jazzy: `docs/message_definition_encoding.md` (definition text).

mod catalog;
mod definition;
mod definition_text;
mod derived;
mod description;
mod error;
mod idl;
mod name;
mod parse;
pub mod python;

pub use catalog::{AmentPrefix, Catalog};
pub use definition::{
    ActionDefinition, Constant, Element, Field, FieldType, MessageDefinition, Primitive, ServiceDefinition,
    Shape, Value,
};
pub use definition_text::{DefinitionEncoding, portable_definition_text};
pub use description::{FieldTypeDescription, IndividualTypeDescription, TypeDescription};
pub use downbeat_files::{nearest, suggestion};
pub use error::{Error, Place};
pub use idl::{Definition, parse_idl};
pub use name::{Kind, TypeName};
pub use parse::{parse_action, parse_message, parse_service};
