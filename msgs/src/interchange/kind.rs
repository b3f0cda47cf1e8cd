//! The types of fields.

/// The type of a field's elements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Bool,
    Int8,
    UInt8,
    Int16,
    UInt16,
    Int32,
    UInt32,
    /// A `UInt32` that Protobuf writes as four bytes.
    Fixed32,
    Int64,
    UInt64,
    Float32,
    Float64,
    Text {
        bound: Option<usize>,
    },
    /// Text whose bound counts UTF-16 code units.
    WideText {
        bound: Option<usize>,
    },
    /// A point in time: a well-known type of Protobuf, a struct in FlatBuffers.
    Time,
    /// A span of time: a well-known type of Protobuf, a struct in FlatBuffers.
    Duration,
    /// A small number with names for its values.
    Enumeration(usize),
    Record(usize),
}

impl Kind {
    /// The size of a value, if fixed: numbers and booleans.
    pub(crate) const fn width(self) -> Option<usize> {
        Some(match self {
            Self::Bool | Self::Int8 | Self::UInt8 | Self::Enumeration(_) => 1,
            Self::Int16 | Self::UInt16 => 2,
            Self::Int32 | Self::UInt32 | Self::Fixed32 | Self::Float32 => 4,
            Self::Int64 | Self::UInt64 | Self::Float64 => 8,
            Self::Text { .. } | Self::WideText { .. } | Self::Time | Self::Duration | Self::Record(_) => {
                return None;
            }
        })
    }
}
