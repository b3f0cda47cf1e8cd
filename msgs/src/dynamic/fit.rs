//! Converts values to the type of a field.

use downbeat_msgs_definitions::{Element, FieldType, Primitive, Shape, Value as DefaultValue};

use super::model::Messages;
use super::{Array, DynamicType, FieldProblem, Value, ValueRef};
use crate::WString;
use crate::cdr::Text;

/// Converts a value to the type of a field. `nested` is the type of the messages in the field, if it holds
/// messages.
pub(super) fn fit(
    field_type: &FieldType,
    nested: Option<&DynamicType>,
    value: Value,
) -> Result<Value, FieldProblem> {
    if field_type.shape == Shape::Single {
        return fit_element(&field_type.element, value);
    }
    let array = match value {
        Value::Array(array) => array,
        other => return Err(kind(field_type.to_string(), ValueRef::from(&other))),
    };
    check_count(field_type.shape, array.len())?;
    let fitted = match (&field_type.element, nested) {
        (Element::Primitive(primitive), _) => each_primitive!(primitive, T => fit_all::<T>(array)?.into()),
        (Element::String { bound }, _) => {
            let texts: Vec<String> = fit_all(array)?;
            texts.iter().try_for_each(|text| check_text(text, *bound))?;
            Array::String(texts)
        }
        (Element::WString { bound }, _) => {
            let texts: Vec<WString> = fit_all(array)?;
            texts.iter().try_for_each(|text| check_text(text, *bound))?;
            Array::WString(texts)
        }
        (Element::Message(_), Some(of)) => match array {
            Array::Message(messages) if messages.of == *of => {
                Array::Message(Messages { of: of.clone(), ..messages })
            }
            other => return Err(kind(field_type.to_string(), ValueRef::Array(&other))),
        },
        (Element::Message(_), None) => {
            return Err(kind(field_type.to_string(), ValueRef::Array(&array)));
        }
    };
    Ok(Value::Array(fitted))
}

/// Converts a value to an element of that type, which is not a message.
pub(super) fn fit_element(element: &Element, value: Value) -> Result<Value, FieldProblem> {
    match element {
        Element::Primitive(primitive) => {
            each_primitive!(primitive, T => T::fit(ValueRef::from(&value)).map(Value::from))
        }
        Element::String { bound } => {
            let text = match value {
                Value::String(text) => text,
                other => String::fit(ValueRef::from(&other))?,
            };
            check_text(&text, *bound).map(|()| Value::String(text))
        }
        Element::WString { bound } => {
            let text = WString::fit(ValueRef::from(&value))?;
            check_text(&text, *bound).map(|()| Value::WString(text))
        }
        Element::Message(name) => Err(kind(format!("a {name}"), ValueRef::from(&value))),
    }
}

/// Converts the default in a definition to the type of the field.
pub(super) fn default_value(field_type: &FieldType, default: &DefaultValue) -> Result<Value, FieldProblem> {
    match default {
        DefaultValue::List(list) => {
            check_count(field_type.shape, list.len())?;
            let values = list.iter().map(one_default);
            let array = match &field_type.element {
                Element::Primitive(primitive) => each_primitive!(primitive, T => {
                    let values: Result<Vec<T>, _> = values.map(|value| T::fit(ValueRef::from(&value?))).collect();
                    Array::from(values?)
                }),
                Element::WString { .. } => {
                    let texts: Result<Vec<_>, _> =
                        values.map(|value| WString::fit(ValueRef::from(&value?))).collect();
                    Array::WString(texts?)
                }
                _ => {
                    let texts: Result<Vec<_>, _> =
                        values.map(|value| String::fit(ValueRef::from(&value?))).collect();
                    Array::String(texts?)
                }
            };
            fit(field_type, None, Value::Array(array))
        }
        one => fit(field_type, None, one_default(one)?),
    }
}

/// Checks the number of elements of an array or sequence of that shape.
pub(super) fn check_count(shape: Shape, found: usize) -> Result<(), FieldProblem> {
    match shape {
        Shape::Array(expected) if found as u64 != expected => Err(FieldProblem::Length { expected, found }),
        Shape::Bounded(bound) if found as u64 > bound => Err(FieldProblem::Bound { bound, found }),
        _ => Ok(()),
    }
}

/// A value that one slot or one array element can hold.
pub(super) trait Scalar: Sized {
    fn fit(value: ValueRef<'_>) -> Result<Self, FieldProblem>;
}

/// The error for a value of another kind.
pub(super) fn kind(expected: String, found: ValueRef<'_>) -> FieldProblem {
    FieldProblem::Kind { expected, found: describe(found) }
}

/// Describes a value, as part of a sentence.
pub(super) fn describe(value: ValueRef<'_>) -> String {
    match value {
        ValueRef::Bool(value) => format!("the bool {value}"),
        ValueRef::Int8(value) => format!("the integer {value}"),
        ValueRef::UInt8(value) => format!("the integer {value}"),
        ValueRef::Int16(value) => format!("the integer {value}"),
        ValueRef::UInt16(value) => format!("the integer {value}"),
        ValueRef::Int32(value) => format!("the integer {value}"),
        ValueRef::UInt32(value) => format!("the integer {value}"),
        ValueRef::Int64(value) => format!("the integer {value}"),
        ValueRef::UInt64(value) => format!("the integer {value}"),
        ValueRef::Float32(value) => format!("the number {value:?}"),
        ValueRef::Float64(value) => format!("the number {value:?}"),
        ValueRef::String(text) | ValueRef::WString(text) => {
            let start: String = text.chars().take(40).collect();
            let more = if start.len() < text.len() { "…" } else { "" };
            format!("the string `{start}{more}`")
        }
        ValueRef::Message(message) => format!("a {}", message.type_name()),
        ValueRef::Array(array) => format!("an array of {} elements", array.len()),
    }
}

fn one_default(default: &DefaultValue) -> Result<Value, FieldProblem> {
    let out_of_range =
        |found: i128| FieldProblem::Range { expected: "an int64 or uint64".into(), found: found.to_string() };
    Ok(match default {
        DefaultValue::Bool(value) => Value::Bool(*value),
        DefaultValue::Integer(value) => match (i64::try_from(*value), u64::try_from(*value)) {
            (Ok(value), _) => Value::Int64(value),
            (_, Ok(value)) => Value::UInt64(value),
            _ => return Err(out_of_range(*value)),
        },
        DefaultValue::Float(value) => Value::Float64(*value),
        DefaultValue::Text(text) => Value::String(text.clone()),
        DefaultValue::List(list) => {
            return Err(FieldProblem::Kind {
                expected: "one value".into(),
                found: format!("a list of {}", list.len()),
            });
        }
    })
}

fn fit_all<T: Scalar + 'static>(array: Array) -> Result<Vec<T>, FieldProblem>
where
    Array: From<Vec<T>>,
    Vec<T>: TryFrom<Array, Error = Array>,
{
    match Vec::<T>::try_from(array) {
        Ok(same) => Ok(same),
        Err(other) => other.iter().map(T::fit).collect(),
    }
}

fn check_text<T: Text>(text: &T, bound: Option<u64>) -> Result<(), FieldProblem> {
    match (bound, text.longest()) {
        (Some(bound), found) if found as u64 > bound => Err(FieldProblem::TextBound { bound, found }),
        _ => Ok(()),
    }
}

fn integer(value: ValueRef<'_>) -> Option<i128> {
    match value {
        ValueRef::Float32(_) | ValueRef::Float64(_) => {
            let float = value.as_f64()?;
            // Whole numbers count as integers, as in JSON.
            (float.fract() == 0.0 && float.abs() < 1e18).then_some(float as i128)
        }
        ValueRef::UInt64(value) => Some(value.into()),
        _ => value.as_i64().map(i128::from),
    }
}

macro_rules! integers {
    ($($of:ident $primitive:ident),*) => {$(
        impl Scalar for $of {
            fn fit(value: ValueRef<'_>) -> Result<Self, FieldProblem> {
                let expected = || format!("a {}", Primitive::$primitive.as_str());
                match integer(value) {
                    Some(number) => number.try_into().map_err(|_| FieldProblem::Range {
                        expected: expected(),
                        found: number.to_string(),
                    }),
                    None => Err(kind(expected(), value)),
                }
            }
        }
    )*};
}

integers!(
    i8 Int8, u8 UInt8, i16 Int16, u16 UInt16, i32 Int32, u32 UInt32, i64 Int64, u64 UInt64
);

macro_rules! from_array {
    ($($of:ty, $variant:ident);*) => {$(
        impl TryFrom<Array> for Vec<$of> {
            type Error = Array;

            /// The values, or the unchanged array if it holds other values.
            fn try_from(array: Array) -> Result<Self, Array> {
                match array {
                    Array::$variant(values) => Ok(values),
                    other => Err(other),
                }
            }
        }
    )*};
}

from_array!(
    bool, Bool; i8, Int8; u8, UInt8; i16, Int16; u16, UInt16; i32, Int32; u32, UInt32; i64, Int64; u64, UInt64;
    f32, Float32; f64, Float64; String, String; WString, WString
);

impl Scalar for bool {
    fn fit(value: ValueRef<'_>) -> Result<Self, FieldProblem> {
        value.as_bool().ok_or_else(|| kind("a bool".into(), value))
    }
}

impl Scalar for f64 {
    fn fit(value: ValueRef<'_>) -> Result<Self, FieldProblem> {
        value.as_f64().ok_or_else(|| kind("a number".into(), value))
    }
}

impl Scalar for f32 {
    fn fit(value: ValueRef<'_>) -> Result<Self, FieldProblem> {
        if let ValueRef::Float32(value) = value {
            return Ok(value); // NaN keeps its bits.
        }
        let wide = f64::fit(value)?;
        let narrow = wide as f32;
        if narrow.is_infinite() && wide.is_finite() {
            return Err(FieldProblem::Range { expected: "a float32".into(), found: format!("{wide:?}") });
        }
        Ok(narrow)
    }
}

impl Scalar for String {
    fn fit(value: ValueRef<'_>) -> Result<Self, FieldProblem> {
        value.as_str().map(Self::from).ok_or_else(|| kind("a string".into(), value))
    }
}

impl Scalar for WString {
    fn fit(value: ValueRef<'_>) -> Result<Self, FieldProblem> {
        value.as_str().map(Self::from).ok_or_else(|| kind("a wstring".into(), value))
    }
}
