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

mod codec;
#[cfg(feature = "json")]
mod json_schema;

use std::fmt;
use std::str::FromStr;

pub use crate::interchange::{CodecDirection, Error};
pub use codec::{Codec, Schema};

/// A serialisation of messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// CDR, which ROS 2 sends and records.
    #[default]
    Cdr,
    /// Objects with the names of the fields.
    Json,
    /// Like JSON, but binary (RFC 8949); bytes are byte strings.
    Cbor,
    /// With a schema derived from the definition.
    Protobuf,
    /// With Foxglove's schema for the type; other types as [`Encoding::Protobuf`].
    FoxgloveProtobuf,
    /// With a schema derived from the definition.
    FlatBuffers,
    /// With Foxglove's schema for the type; other types as [`Encoding::FlatBuffers`].
    FoxgloveFlatBuffers,
}

/// The name of an encoding is unknown.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown encoding \"{name}\"; there are {}", Encoding::ALL.map(Encoding::as_str).join(", "))]
pub struct UnknownEncoding {
    /// The name.
    pub name: String,
}

impl Encoding {
    /// All encodings.
    pub const ALL: [Self; 7] = [
        Self::Cdr,
        Self::Json,
        Self::Cbor,
        Self::Protobuf,
        Self::FoxgloveProtobuf,
        Self::FlatBuffers,
        Self::FoxgloveFlatBuffers,
    ];

    /// Its name in robot files and on the command line.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Cdr => "cdr",
            Self::Json => "json",
            Self::Cbor => "cbor",
            Self::Protobuf => "protobuf",
            Self::FoxgloveProtobuf => "foxglove-protobuf",
            Self::FlatBuffers => "flatbuffers",
            Self::FoxgloveFlatBuffers => "foxglove-flatbuffers",
        }
    }

    /// Its name in MCAP files and in the metadata of a bag.
    #[must_use]
    pub const fn message_encoding(self) -> &'static str {
        match self {
            Self::Cdr => "cdr",
            Self::Json => "json",
            Self::Cbor => "cbor",
            Self::Protobuf | Self::FoxgloveProtobuf => "protobuf",
            Self::FlatBuffers | Self::FoxgloveFlatBuffers => "flatbuffer",
        }
    }

    /// The encoding of a channel in an MCAP file, from its message encoding and the name of its schema.
    #[must_use]
    pub fn of_channel(message_encoding: &str, schema_name: &str) -> Option<Self> {
        let is_foxglove = schema_name.starts_with("foxglove.");
        Some(match message_encoding {
            "cdr" => Self::Cdr,
            "json" => Self::Json,
            "cbor" => Self::Cbor,
            "protobuf" if is_foxglove => Self::FoxgloveProtobuf,
            "protobuf" => Self::Protobuf,
            "flatbuffer" if is_foxglove => Self::FoxgloveFlatBuffers,
            "flatbuffer" => Self::FlatBuffers,
            _ => return None,
        })
    }
}

impl fmt::Display for Encoding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for Encoding {
    type Err = UnknownEncoding;

    fn from_str(name: &str) -> Result<Self, UnknownEncoding> {
        Self::ALL
            .into_iter()
            .find(|encoding| encoding.as_str() == name)
            .ok_or_else(|| UnknownEncoding { name: name.into() })
    }
}
