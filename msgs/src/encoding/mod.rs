//! Selectable serialisations of messages: CDR, or other formats for readers other than ROS 2.
//!
//! ```
//! use downbeat_msgs::definitions::Catalog;
//! use downbeat_msgs::encoding::Encoding;
//! use downbeat_msgs::{Message, cdr, std_msgs::msg::String};
//!
//! let mut catalog = Catalog::new();
//! catalog.add_message(String::TYPE_NAME.parse()?, "string data\n", "String.msg")?;
//!
//! let encoding: Encoding = "protobuf".parse()?;
//! let codec = encoding.codec(&catalog, &String::TYPE_NAME.parse()?)?;
//! assert_eq!(codec.message_encoding(), "protobuf"); // as in MCAP files
//! assert_eq!(codec.schema().name, "std_msgs.msg.String");
//!
//! let bytes = codec.encode(&cdr::to_vec(&String { data: "hi".into() }))?;
//! assert_eq!(bytes, b"\x0a\x02hi");
//! assert_eq!(cdr::from_slice::<String>(&codec.decode(&bytes)?)?.data, "hi");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A [`Codec`] converts between CDR and its encoding using the definition of the type, so it also supports
//! types that are not compiled in, and adds no code per type. The structs also implement serde's traits,
//! which produce the same JSON.
//!
//! | encoding | schema | preserved |
//! | --- | --- | --- |
//! | `cdr` | `ros2msg` | all, in either byte order |
//! | `json` | `jsonschema` | all but NaN and infinities, which JSON cannot represent: each is `null`, and read as NaN |
//! | `cbor` | none | all |
//! | `protobuf` | `protobuf` | all |
//! | `foxglove-protobuf` | `protobuf`, Foxglove's own if it has one for the type | the fields of Foxglove's schema |
//! | `flatbuffers` | `flatbuffer` | all |
//! | `foxglove-flatbuffers` | `flatbuffer`, Foxglove's own likewise | the fields of Foxglove's schema |
//!
//! Each except `cdr` is a Cargo feature: `json`, `cbor`, `protobuf`, `flatbuffers`.
//!
//! # References
//! - `website/docs/spec/registry.md` of foxglove/mcap: names of encodings and their schemas in MCAP files.

mod choice;
mod codec;
#[cfg(feature = "json")]
mod json_schema;

pub use crate::interchange::{Direction, Error};
pub use choice::{Encoding, UnknownEncoding};
pub use codec::{Codec, Schema};
