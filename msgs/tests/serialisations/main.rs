//! Messages in other serialisations than CDR: through serde, and through `encoding`. What comes back is compared by its CDR,
//! bit for bit. The witnesses are `ciborium`, and for Protobuf, FlatBuffers and JSON Schema the Python libraries of their
//! makers and of Foxglove; those need the interpreter that `DOWNBEAT_PYTHON` names, without it the tests say so and pass.

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
