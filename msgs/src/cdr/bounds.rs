//! Functions with which generated code checks bounds before writing.

use super::{Cdr, Count, EncodeError, Text};

type Checked = Result<(), EncodeError>;

/// Checks the fields of a message in a field.
pub fn check_field<T: Cdr>(name: &str, value: &T) -> Checked {
    value.check_bounds().map_err(|error| error.in_field(name))
}

/// Checks the number of elements of a bounded sequence.
pub fn check_count<T: Count>(name: &str, value: &T, bound: usize) -> Checked {
    check(name, value.count(), bound)
}

/// Checks the length of bounded strings.
pub fn check_text<T: Text>(name: &str, value: &T, bound: usize) -> Checked {
    check(name, value.longest(), bound)
}

fn check(path: &str, found: usize, bound: usize) -> Checked {
    if found > bound { Err(EncodeError::Bound { path: path.into(), found, bound }) } else { Ok(()) }
}
