//! Values of fields that are missing in the input: zeros, or the defaults of the definition.

use std::borrow::Cow;

use super::{Budget, Field, Kind, Problem, Schema, Shape, Value};

impl Value<'_> {
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
}
