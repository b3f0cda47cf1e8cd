//! What generated code calls to check bounds before writing.

use super::{Cdr, Count, EncodeError, Text};

type Checked = Result<(), EncodeError>;

/// The fields of a field.
pub fn check_field<T: Cdr>(name: &str, value: &T) -> Checked {
    value.check_bounds().map_err(|error| error.in_field(name))
}

/// How many elements a bounded sequence has.
pub fn check_count<T: Count>(name: &str, value: &T, bound: usize) -> Checked {
    check(name, value.count(), bound)
}

/// How long the bounded strings are.
pub fn check_text<T: Text>(name: &str, value: &T, bound: usize) -> Checked {
    check(name, value.longest(), bound)
}

fn check(path: &str, found: usize, bound: usize) -> Checked {
    if found > bound { Err(EncodeError::Bound { path: path.into(), found, bound }) } else { Ok(()) }
}
