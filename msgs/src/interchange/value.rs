//! A message between two serialisations.

use std::borrow::Cow;

use super::Kind;

/// The value of a field or a record. Kind and shape of a field determine its variant.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value<'a> {
    Bool(bool),
    /// A value in the range of its signed integer kind.
    Signed(i64),
    /// A value in the range of its unsigned integer kind or enumeration.
    Unsigned(u64),
    Float32(f32),
    Float64(f64),
    Text(Cow<'a, str>),
    /// A time or duration: seconds rounded down, and nanoseconds below 10^9.
    Moment {
        sec: i64,
        nanosec: u32,
    },
    /// A list of a kind with a [width](Kind::width): contiguous little-endian numbers.
    Packed(Cow<'a, [u8]>),
    /// A list of any other kind.
    List(Vec<Value<'a>>),
    /// All fields of a record, in the order of the schema.
    Record(Vec<Value<'a>>),
    /// A missing optional field.
    Absent,
}

impl Value<'_> {
    /// One number of a kind with a width, from its little-endian bytes.
    pub(crate) fn from_packed(kind: Kind, bytes: &[u8]) -> Self {
        let mut all = [0; 8];
        all[..bytes.len()].copy_from_slice(bytes);
        let bits = u64::from_le_bytes(all);
        match kind {
            Kind::Bool => Self::Bool(bits != 0),
            Kind::Int8 => Self::Signed((bits as i8).into()),
            Kind::Int16 => Self::Signed((bits as i16).into()),
            Kind::Int32 => Self::Signed((bits as i32).into()),
            Kind::Int64 => Self::Signed(bits as i64),
            Kind::Float32 => Self::Float32(f32::from_bits(bits as u32)),
            Kind::Float64 => Self::Float64(f64::from_bits(bits)),
            _ => Self::Unsigned(bits),
        }
    }

    /// The bits of a number or boolean, as wide as its kind.
    pub(crate) fn bits(&self) -> Option<u64> {
        Some(match self {
            Self::Bool(value) => u64::from(*value),
            Self::Signed(value) => *value as u64,
            Self::Unsigned(value) => *value,
            Self::Float32(value) => value.to_bits().into(),
            Self::Float64(value) => value.to_bits(),
            _ => return None,
        })
    }

    /// An integer of a kind, if it is in range.
    pub(crate) fn integer(kind: Kind, integer: i128) -> Option<Self> {
        let (least, greatest) = match kind {
            Kind::Int8 => (i8::MIN.into(), i8::MAX.into()),
            Kind::Int16 => (i16::MIN.into(), i16::MAX.into()),
            Kind::Int32 => (i32::MIN.into(), i32::MAX.into()),
            Kind::Int64 => (i64::MIN.into(), i64::MAX.into()),
            Kind::UInt8 | Kind::Enumeration(_) => (0, u8::MAX.into()),
            Kind::UInt16 => (0, u16::MAX.into()),
            Kind::UInt32 | Kind::Fixed32 => (0, u32::MAX.into()),
            Kind::UInt64 => (0, u64::MAX.into()),
            _ => return None,
        };
        if !(least..=greatest).contains(&integer) {
            return None;
        }
        // Both casts are exact within the range just checked.
        Some(if least < 0 { Self::Signed(integer as i64) } else { Self::Unsigned(integer as u64) })
    }
}
