//! Bounds of sequences and strings, and their check before encoding.

use super::{Cdr, EncodeError};

/// A sequence, to which a bound applies.
pub trait Count {
    /// The number of elements.
    fn count(&self) -> usize;
}

impl<T> Count for Vec<T> {
    fn count(&self) -> usize {
        self.len()
    }
}

impl Count for &[u8] {
    fn count(&self) -> usize {
        self.len()
    }
}

/// A string or a collection of strings, to which a string bound applies.
pub trait Text {
    /// The length of the longest string, in the unit of its bound: bytes, or UTF-16 code units of a
    /// [`WString`](super::WString).
    fn longest(&self) -> usize;
}

impl Text for &str {
    fn longest(&self) -> usize {
        self.len()
    }
}

impl Text for String {
    fn longest(&self) -> usize {
        self.len()
    }
}

impl<T: Text> Text for Vec<T> {
    fn longest(&self) -> usize {
        self.iter().map(T::longest).max().unwrap_or(0)
    }
}

impl<T: Text, const N: usize> Text for [T; N] {
    fn longest(&self) -> usize {
        self.iter().map(T::longest).max().unwrap_or(0)
    }
}

type Checked = std::result::Result<(), EncodeError>;

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
