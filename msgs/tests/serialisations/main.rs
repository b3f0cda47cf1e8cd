//! Messages in other serialisations than CDR: through serde, and through `encoding`. Round trips are compared
//! by their CDR, bit for bit. The references are `ciborium`, and for Protobuf, FlatBuffers and JSON Schema
//! the Python libraries of their authors and of Foxglove. These need the interpreter named by
//! `DOWNBEAT_PYTHON`; without it the tests print a note and pass.

#![allow(clippy::unwrap_used)]

mod bad_input;
mod codecs;
mod foxglove;
mod others;
mod python;
#[path = "../dynamic/random.rs"]
mod random;
mod through_serde;
mod types;

#[allow(clippy::all, dead_code, missing_docs)]
mod odd_msgs {
    include!(concat!(env!("OUT_DIR"), "/odd_msgs.rs"));
}
