//! Why bytes are not a value.

/// A result of reading CDR.
pub type Result<T> = std::result::Result<T, Error>;

/// Bytes are not the value they were read as.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cannot decode CDR at byte {offset}{}: {problem}", in_field(path))]
pub struct Error {
    /// What is wrong.
    pub problem: Problem,
    /// Where in the bytes, the header counted.
    pub offset: usize,
    /// The field that was being read, as in `points[3].x`. Empty outside of any.
    pub path: String,
}

/// What is wrong with the bytes.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// They end too early.
    #[error("needs {needed} more bytes, the input has {left}")]
    TooShort {
        /// Bytes the next part takes.
        needed: usize,
        /// Bytes there are.
        left: usize,
    },
    /// A length is greater than what is left can hold.
    #[error(
        "says that {count} elements follow, of at least {least_size} bytes each, but the input has {left} bytes left"
    )]
    Length {
        /// Elements the length promises.
        count: usize,
        /// The fewest bytes of one.
        least_size: usize,
        /// Bytes there are.
        left: usize,
    },
    /// A bounded string or sequence exceeds its bound.
    #[error("has the length {found}, the type allows {bound}")]
    Bound {
        /// Its length.
        found: usize,
        /// The greatest allowed.
        bound: usize,
    },
    /// A truth value is neither 0 nor 1.
    #[error("a bool is 0 or 1, found {0}")]
    Bool(u8),
    /// A string does not end with a zero byte.
    #[error("a string ends with a zero byte, found {0:#04x}")]
    Terminator(u8),
    /// A string is not UTF-8.
    #[error("the string is not UTF-8 after its first {valid} bytes")]
    Utf8 {
        /// Bytes that are.
        valid: usize,
    },
    /// A wide string is not UTF-16.
    #[error("the wide string is not UTF-16: {0:#x} has no place in it")]
    Utf16(u32),
    /// The header names a representation that is not read here.
    #[error("the header names the representation {0:#06x}{name}, only CDR_BE (0x0000) and CDR_LE (0x0001) are read", name = representation_name(*.0))]
    Representation(u16),
}

impl Error {
    /// The same error, one field further out.
    #[must_use]
    #[cold]
    pub fn in_field(mut self, name: &str) -> Self {
        let separator = if self.path.is_empty() || self.path.starts_with('[') { "" } else { "." };
        self.path = format!("{name}{separator}{}", self.path);
        self
    }

    /// The same error, one element of an array or sequence further out.
    #[must_use]
    #[cold]
    pub fn at_index(mut self, index: usize) -> Self {
        let separator = if self.path.is_empty() || self.path.starts_with('[') { "" } else { "." };
        self.path = format!("[{index}]{separator}{}", self.path);
        self
    }
}

fn in_field(path: &str) -> String {
    if path.is_empty() { String::new() } else { format!(", field `{path}`") }
}

fn representation_name(identifier: u16) -> &'static str {
    match identifier {
        0x0002 | 0x0003 => " (parameter list)",
        0x0006 | 0x0007 => " (XCDR version 2, plain)",
        0x0008 | 0x0009 => " (XCDR version 2, delimited)",
        0x000a | 0x000b => " (XCDR version 2, parameter list)",
        _ => "",
    }
}
