//! Protobuf: schemas derived from definitions, and the wire format.
//!
//! ```
//! use downbeat_msgs::definitions::Catalog;
//! use downbeat_msgs::encoding::Encoding;
//! use downbeat_msgs::geometry_msgs::msg::Point;
//!
//! let mut catalog = Catalog::new();
//! let point = "geometry_msgs/msg/Point".parse()?;
//! catalog.add_message("geometry_msgs/msg/Point".parse()?, "float64 x\nfloat64 y\nfloat64 z\n", "Point.msg")?;
//!
//! let codec = Encoding::Protobuf.codec(&catalog, &point)?;
//! let bytes = codec.to_vec(&Point { x: 1.0, y: 0.0, z: 0.0 })?;
//! assert_eq!(bytes, [0x09, 0, 0, 0, 0, 0, 0, 0xf0, 0x3f]); // field 1, a double; zeros are not sent
//! assert_eq!(codec.from_slice::<Point>(&bytes)?.x, 1.0);
//!
//! let files = downbeat_msgs::protobuf::schema_files(&catalog, &point)?;
//! assert_eq!(files[0].path, "geometry_msgs/msg/Point.proto");
//! assert!(files[0].text.contains("message Point {\n  double x = 1;\n"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Schemas
//! | ROS 2 | proto3 |
//! | --- | --- |
//! | package `p`, kind `msg` | package `p.msg`, one file `p/msg/Type.proto` per type |
//! | the n-th field | field number n |
//! | `bool`, `float32`, `float64` | `bool`, `float`, `double` |
//! | `int8` … `int32`, `int64` | `int32`, `int64` |
//! | `uint8` … `uint32`, `uint64`, `byte`, `char` | `uint32`, `uint64` |
//! | `string`, `wstring` | `string` |
//! | arrays and sequences of 8-bit unsigned numbers | `bytes` |
//! | other arrays and sequences | `repeated` |
//! | messages | messages, always sent |
//!
//! Values round-trip exactly. Bounds and lengths are checked when a message is converted back to ROS 2, since
//! proto3 cannot express them. Constants and defaults are not in the schema.
//!
//! # References
//! - <https://protobuf.dev/programming-guides/encoding/> (wire format) and `google/protobuf/descriptor.proto`
//!   of protocolbuffers/protobuf (numbers of the fields of descriptors).

mod decode;
mod descriptor;
mod encode;
mod wire;

use downbeat_msgs_definitions::{Catalog, TypeName};

use crate::interchange::{Error, Schema};
pub(crate) use decode::decode;
pub use descriptor::SchemaFile;
pub(crate) use descriptor::file_descriptor_set;
pub(crate) use descriptor::schema_files as schema_files_of;
pub(crate) use encode::encode;

/// The `.proto` files of a message: its own file first, then its imports.
///
/// # Errors
/// Returns an error if the catalog lacks a type, or the type is too large.
pub fn schema_files(catalog: &Catalog, name: &TypeName) -> Result<Vec<SchemaFile>, Error> {
    Ok(schema_files_of(&Schema::of_definition(catalog, name)?))
}

/// The file of a record: `sensor_msgs/msg/Imu.proto`.
fn path_of(record: &str) -> String {
    format!("{}.proto", record.replace('.', "/"))
}

/// Its package and its name within it.
fn parts(record: &str) -> (&str, &str) {
    record.rsplit_once('.').unwrap_or(("", record))
}

const TIMESTAMP: (&str, &str) = ("google/protobuf/timestamp.proto", "google.protobuf.Timestamp");
const DURATION: (&str, &str) = ("google/protobuf/duration.proto", "google.protobuf.Duration");
