//! FlatBuffers: schemas derived from definitions, and the format.
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
//! let codec = Encoding::FlatBuffers.codec(&catalog, &point)?;
//! let bytes = codec.to_vec(&Point { x: 1.0, y: 0.0, z: 2.0 })?;
//! assert_eq!(codec.from_slice::<Point>(&bytes)?.z, 2.0);
//!
//! let text = downbeat_msgs::flatbuffers::schema_text(&catalog, &point)?;
//! assert!(text.contains("namespace geometry_msgs.msg;\n\ntable Point {\n  x:double (id: 0);\n"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Package `p` and kind `msg` are the namespace `p.msg`, messages are tables, the n-th field has the id n-1,
//! arrays and sequences are vectors, numbers keep their size, and `wstring` is `string`. Values round-trip
//! without loss. Bounds and lengths are checked when a message is converted back to ROS 2, since FlatBuffers
//! cannot express them.
//!
//! The schema for MCAP files is the binary one (`.bfbs`), which is itself a FlatBuffer and is written here
//! without `flatc`.
//!
//! # References
//! - `docs/source/internals.md` (the format) and `reflection/reflection.fbs` (the binary schema) of
//!   google/flatbuffers.

mod decode;
mod encode;
mod schema;

use downbeat_msgs_definitions::{Catalog, TypeName};

use crate::interchange::{Error, Kind, Schema};
pub(crate) use decode::decode;
pub(crate) use encode::encode;
pub(crate) use schema::binary_schema;

/// The `.fbs` text of a message and its nested messages.
///
/// # Errors
/// Returns an error if the catalog lacks a type, or the type is too large.
pub fn schema_text(catalog: &Catalog, name: &TypeName) -> Result<String, Error> {
    Ok(schema::schema_text(&Schema::of_definition(catalog, name)?))
}

/// Size and alignment of a field's value within its table.
fn inline_size(kind: Kind) -> (usize, usize) {
    match kind {
        // A struct of two 32-bit numbers.
        Kind::Time | Kind::Duration => (8, 4),
        // An offset, if it has no width.
        kind => kind.width().map_or((4, 4), |width| (width, width)),
    }
}
