//! A message between two serialisations.

use std::borrow::Cow;

use super::{Field, Kind, Problem, Schema, Shape};

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

impl<'a> Value<'a> {
    /// The value of a field that is missing in the input: zero, empty or absent.
    pub(crate) fn absent(schema: &Schema, field: &Field, budget: &mut Budget) -> Result<Self, Problem> {
        budget.spend(size_of::<Self>())?;
        match (field.shape, field.kind.width()) {
            (Shape::Single, _) if field.is_optional => Ok(Self::Absent),
            (Shape::Single, _) => Self::zero(schema, field.kind, budget),
            (Shape::Array(count), Some(width)) => {
                let size = usize::try_from(count).unwrap_or(usize::MAX).saturating_mul(width);
                budget.spend(size)?;
                Ok(Self::Packed(vec![0; size].into()))
            }
            (Shape::Array(count), None) => {
                let mut list = Vec::new();
                for _ in 0..count {
                    budget.spend(size_of::<Self>())?;
                    list.push(Self::zero(schema, field.kind, budget)?);
                }
                Ok(Self::List(list))
            }
            (Shape::Bounded(_) | Shape::Sequence, Some(_)) => Ok(Self::Packed(Cow::Borrowed(&[]))),
            (Shape::Bounded(_) | Shape::Sequence, None) => Ok(Self::List(Vec::new())),
        }
    }

    /// The zero of a kind.
    pub(crate) fn zero(schema: &Schema, kind: Kind, budget: &mut Budget) -> Result<Self, Problem> {
        Ok(match kind {
            Kind::Bool => Self::Bool(false),
            Kind::Int8 | Kind::Int16 | Kind::Int32 | Kind::Int64 => Self::Signed(0),
            Kind::UInt8
            | Kind::UInt16
            | Kind::UInt32
            | Kind::Fixed32
            | Kind::UInt64
            | Kind::Enumeration(_) => Self::Unsigned(0),
            Kind::Float32 => Self::Float32(0.0),
            Kind::Float64 => Self::Float64(0.0),
            Kind::Text { .. } | Kind::WideText { .. } => Self::Text(Cow::Borrowed("")),
            Kind::Time | Kind::Duration => Self::Moment { sec: 0, nanosec: 0 },
            Kind::Record(index) => {
                let fields = schema.records[index].fields.iter();
                Self::Record(
                    fields.map(|field| Self::absent(schema, field, budget)).collect::<Result<_, _>>()?,
                )
            }
        })
    }

    /// Sets the fields of a zeroed record to the defaults of the definition.
    pub(crate) fn initialize(&mut self, schema: &Schema, record: usize) {
        let Self::Record(values) = self else { return };
        for (field, value) in schema.records[record].fields.iter().zip(values) {
            match (&field.initial, field.kind, &mut *value) {
                (Some(initial), ..) => *value = initial.clone(),
                (None, Kind::Record(inner), Self::List(values)) => {
                    values.iter_mut().for_each(|value| value.initialize(schema, inner));
                }
                (None, Kind::Record(inner), value) => value.initialize(schema, inner),
                _ => {}
            }
        }
    }

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

/// Formats that omit defaults, or that share tables, can represent large values with few bytes. The memory of
/// a value is therefore counted while it is read.
#[derive(Debug)]
pub(crate) struct Budget {
    left: usize,
    all: usize,
}

/// The limit for any input: more than any message of defaults.
const FLOOR: usize = 16 << 20;
/// Bytes of memory per byte of input, above the floor: a list of numbers in text or varints takes 8, of small
/// messages 100.
const FACTOR: usize = 128;

impl Budget {
    pub(crate) fn for_input(length: usize) -> Self {
        let all = length.saturating_mul(FACTOR).saturating_add(FLOOR);
        Self { left: all, all }
    }

    /// Counts bytes that are about to be allocated.
    pub(crate) fn spend(&mut self, bytes: usize) -> Result<(), Problem> {
        match self.left.checked_sub(bytes) {
            Some(left) => {
                self.left = left;
                Ok(())
            }
            None => Err(Problem::new(format!(
                "the value would take more than {} bytes of memory, too many for an input of this size",
                self.all
            ))),
        }
    }
}
