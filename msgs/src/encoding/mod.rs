//! The serialisation of messages as a choice: CDR, or others for those who read what ROS 2 does not write.
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
//! assert_eq!(codec.message_encoding(), "protobuf"); // as an MCAP file names it
//! assert_eq!(codec.schema().name, "std_msgs.msg.String");
//!
//! let bytes = codec.encode(&cdr::to_vec(&String { data: "hi".into() }))?;
//! assert_eq!(bytes, b"\x0a\x02hi");
//! assert_eq!(cdr::from_slice::<String>(&codec.decode(&bytes)?)?.data, "hi");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A [`Codec`] goes between CDR and its encoding by the definition of the type, so it serves types that a program was not
//! compiled with as well, and adds no code per type. The structs also have serde's traits, which give the same JSON.
//!
//! | encoding | schema | what comes back |
//! | --- | --- | --- |
//! | `cdr` | `ros2msg` | all, in either byte order |
//! | `json` | `jsonschema` | all but NaN and the infinities, which JSON cannot tell: each is `null`, and read as NaN |
//! | `cbor` | none | all |
//! | `protobuf` | `protobuf` | all |
//! | `foxglove-protobuf` | `protobuf`, Foxglove's own where it has one for the type | what Foxglove's schema has a place for |
//! | `flatbuffers` | `flatbuffer` | all |
//! | `foxglove-flatbuffers` | `flatbuffer`, Foxglove's own likewise | what Foxglove's schema has a place for |
//!
//! Each but `cdr` is a Cargo feature: `json`, `cbor`, `protobuf`, `flatbuffers`.
//!
//! # References
//! - `website/docs/spec/registry.md` of foxglove/mcap: how encodings and their schemas are named in MCAP files.

mod choice;
mod codec;
#[cfg(feature = "json")]
mod json_schema;

pub use crate::interchange::{Direction, Error};
pub use choice::{Encoding, UnknownEncoding};
pub use codec::{Codec, Schema};
