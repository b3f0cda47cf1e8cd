//! The Python process with the reference implementations.

pub use python_peer::{hex, unhex};

/// Runs a command of `witness.py` with `input` in a file; returns its output, or `None` without an
/// interpreter.
pub fn ask(command: &str, input: &str) -> Option<String> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/serialisations/witness.py");
    Some(python_peer::Python::find()?.ask(script, command, input))
}
