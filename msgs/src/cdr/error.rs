//! Errors of reading and writing CDR.

/// A result of reading CDR.
pub type Result<T> = std::result::Result<T, Error>;

/// The bytes are not a value of the expected type.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cannot decode CDR at byte {offset}{}: {problem}", in_field(path))]
pub struct Error {
    /// The problem.
    pub problem: Problem,
    /// The offset in the bytes, including the header.
    pub offset: usize,
    /// The field that was being read, as in `points[3].x`. Empty outside of fields.
    pub path: String,
}

/// The problem with the bytes.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// The input ends too early.
    #[error("needs {needed} more bytes, the input has {left}")]
    TooShort {
        /// Bytes required by the next part.
        needed: usize,
        /// Bytes available.
        left: usize,
    },
    /// A length is greater than the rest of the input can hold.
    #[error(
        "says that {count} elements follow, of at least {least_size} bytes each, but the input has {left} bytes left"
    )]
    Length {
        /// The number of elements declared.
        count: usize,
        /// The minimum size of an element in bytes.
        least_size: usize,
        /// Bytes available.
        left: usize,
    },
    /// A bounded string or sequence exceeds its bound.
    #[error("has the length {found}, the type allows {bound}")]
    Bound {
        /// Its length.
        found: usize,
        /// The maximum length.
        bound: usize,
    },
    /// A boolean is neither 0 nor 1.
    #[error("a bool is 0 or 1, found {0}")]
    Bool(u8),
    /// A string does not end with a zero byte.
    #[error("a string ends with a zero byte, found {0:#04x}")]
    Terminator(u8),
    /// A string is not UTF-8.
    #[error("the string is not UTF-8 after its first {valid} bytes")]
    Utf8 {
        /// The number of valid bytes.
        valid: usize,
    },
    /// A wide string is not UTF-16.
    #[error("the wide string is not UTF-16: {0:#x} is invalid in it")]
    Utf16(u32),
    /// The size of a wide string is odd.
    #[error("the wide string has {0} bytes, but each unit has two")]
    Utf16Size(usize),
    /// The header names a representation that ROS 2 does not use.
    #[error(
        "the header names the representation {0:#06x}{name}, which ROS 2 does not use; \
         CDR (0x0000, 0x0001), CDR2 (0x0006, 0x0007) and D_CDR2 (0x0008, 0x0009) are supported",
        name = super::refused_name(*.0)
    )]
    Representation(u16),
}

impl Error {
    /// Prepends a field to the path.
    #[must_use]
    #[cold]
    pub fn in_field(mut self, name: &str) -> Self {
        put_before(&mut self.path, name);
        self
    }

    /// Prepends an index of an array or sequence to the path.
    #[must_use]
    #[cold]
    pub fn at_index(mut self, index: usize) -> Self {
        put_before(&mut self.path, &format!("[{index}]"));
        self
    }
}

/// Prepends a part to a path.
fn put_before(path: &mut String, part: &str) {
    let separator = if path.is_empty() || path.starts_with('[') { "" } else { "." };
    *path = format!("{part}{separator}{path}");
}

fn in_field(path: &str) -> String {
    if path.is_empty() { String::new() } else { format!(", field `{path}`") }
}

/// A value exceeds a bound of its type, so that receivers would reject it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EncodeError {
    /// A bounded string or sequence exceeds its bound.
    #[error("cannot encode field `{path}`: has the length {found}, the type allows {bound}")]
    Bound {
        /// The field, as in `nodes[3].name`.
        path: String,
        /// Its length.
        found: usize,
        /// The maximum length.
        bound: usize,
    },
    /// The value is too large for CDR, whose lengths have 32 bits.
    #[error("cannot encode a value of {size} bytes: lengths in CDR have 32 bits")]
    TooLarge {
        /// The encoded size in bytes.
        size: usize,
    },
}

impl EncodeError {
    /// Prepends a field to the path.
    #[must_use]
    #[cold]
    pub fn in_field(mut self, name: &str) -> Self {
        if let Self::Bound { path, .. } = &mut self {
            put_before(path, name);
        }
        self
    }

    /// Prepends an index of an array or sequence to the path.
    #[must_use]
    #[cold]
    pub fn at_index(self, index: usize) -> Self {
        self.in_field(&format!("[{index}]"))
    }
}
