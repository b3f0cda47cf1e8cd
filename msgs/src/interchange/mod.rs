//! The common part of all serialisations except CDR: a message is a [`Value`] of named and numbered fields,
//! described by a [`Schema`]. Each format reads and writes values by their schema and does not depend on ROS
//! 2; [`cdr`] converts between values and messages.
//!
//! ```text
//!  message ◄── cdr ──► Value + Schema of its definition ◄──► JSON, CBOR, Protobuf, FlatBuffers
//!     ▲                                                            ▲
//!     └─── foxglove ─► Value + Foxglove's schema ◄─────────────────┘
//! ```

// Each format uses a part of it.
#![cfg_attr(
    not(all(feature = "json", feature = "cbor", feature = "protobuf", feature = "flatbuffers")),
    allow(dead_code, unused_imports)
)]

mod budget;
pub(crate) mod cdr;
mod error;
mod schema;
#[cfg(any(feature = "json", feature = "cbor"))]
pub(crate) mod tree;
mod value;

pub(crate) use budget::Budget;
pub(crate) use error::Problem;
pub use error::{Direction, Error};
pub(crate) use schema::{Count, Enumeration, Field, Kind, Record, Schema};
pub(crate) use value::Value;
