//! Reading and converting the values of fields.

use super::{Array, DynamicMessage, DynamicType, MessageRef, Messages, Value, ValueRef};
use crate::WString;

impl<'a> ValueRef<'a> {
    /// A floating-point number or an integer, as the nearest `f64`.
    #[must_use]
    pub fn as_f64(self) -> Option<f64> {
        match self {
            Self::Float32(value) => Some(value.into()),
            Self::Float64(value) => Some(value),
            _ => self.as_integer().map(|value| value as f64),
        }
    }

    /// An integer that an `i64` can hold.
    #[must_use]
    pub fn as_i64(self) -> Option<i64> {
        self.as_integer().and_then(|value| value.try_into().ok())
    }

    /// An integer that is not negative.
    #[must_use]
    pub fn as_u64(self) -> Option<u64> {
        self.as_integer().and_then(|value| value.try_into().ok())
    }

    /// A boolean.
    #[must_use]
    pub fn as_bool(self) -> Option<bool> {
        match self {
            Self::Bool(value) => Some(value),
            _ => None,
        }
    }

    /// The text of a string or wide string.
    #[must_use]
    pub fn as_str(self) -> Option<&'a str> {
        match self {
            Self::String(text) | Self::WString(text) => Some(text),
            _ => None,
        }
    }

    /// A message.
    #[must_use]
    pub fn as_message(self) -> Option<MessageRef<'a>> {
        match self {
            Self::Message(message) => Some(message),
            _ => None,
        }
    }

    /// An array or sequence.
    #[must_use]
    pub fn as_array(self) -> Option<&'a Array> {
        match self {
            Self::Array(array) => Some(array),
            _ => None,
        }
    }

    /// The values of an array or sequence, if it is one of `T`.
    ///
    /// ```
    /// # use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
    /// # let of = DynamicType::from_definition_text("my_msgs/msg/Scan", "ros2msg", "float64[] range\n")?;
    /// let mut scan = DynamicMessage::new(&of);
    /// scan.set("range", vec![1.5, 2.5])?;
    /// assert_eq!(scan.get("range")?.as_slice::<f64>(), Some([1.5, 2.5].as_slice()));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn as_slice<T: ArrayElement>(self) -> Option<&'a [T]> {
        self.as_array().and_then(T::slice)
    }

    /// Returns an owned copy.
    #[must_use]
    pub fn to_value(self) -> Value {
        match self {
            Self::Bool(value) => Value::Bool(value),
            Self::Int8(value) => Value::Int8(value),
            Self::UInt8(value) => Value::UInt8(value),
            Self::Int16(value) => Value::Int16(value),
            Self::UInt16(value) => Value::UInt16(value),
            Self::Int32(value) => Value::Int32(value),
            Self::UInt32(value) => Value::UInt32(value),
            Self::Int64(value) => Value::Int64(value),
            Self::UInt64(value) => Value::UInt64(value),
            Self::Float32(value) => Value::Float32(value),
            Self::Float64(value) => Value::Float64(value),
            Self::String(text) => Value::String(text.into()),
            Self::WString(text) => Value::WString(text.into()),
            Self::Message(message) => Value::from(message.to_message()),
            Self::Array(array) => Value::Array(array.clone()),
        }
    }

    fn as_integer(self) -> Option<i128> {
        Some(match self {
            Self::Int8(value) => value.into(),
            Self::UInt8(value) => value.into(),
            Self::Int16(value) => value.into(),
            Self::UInt16(value) => value.into(),
            Self::Int32(value) => value.into(),
            Self::UInt32(value) => value.into(),
            Self::Int64(value) => value.into(),
            Self::UInt64(value) => value.into(),
            _ => return None,
        })
    }
}

impl<'a> From<&'a Value> for ValueRef<'a> {
    fn from(value: &'a Value) -> Self {
        match value {
            Value::Bool(value) => Self::Bool(*value),
            Value::Int8(value) => Self::Int8(*value),
            Value::UInt8(value) => Self::UInt8(*value),
            Value::Int16(value) => Self::Int16(*value),
            Value::UInt16(value) => Self::UInt16(*value),
            Value::Int32(value) => Self::Int32(*value),
            Value::UInt32(value) => Self::UInt32(*value),
            Value::Int64(value) => Self::Int64(*value),
            Value::UInt64(value) => Self::UInt64(*value),
            Value::Float32(value) => Self::Float32(*value),
            Value::Float64(value) => Self::Float64(*value),
            Value::String(text) => Self::String(text),
            Value::WString(text) => Self::WString(text),
            Value::Message(message) => Self::Message(message.as_message()),
            Value::Array(array) => Self::Array(array),
        }
    }
}

impl Array {
    /// The number of values.
    #[must_use]
    pub fn len(&self) -> usize {
        each_array!(self, values => values.len())
    }

    /// Returns whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The element at an index.
    #[must_use]
    pub fn get(&self, index: usize) -> Option<ValueRef<'_>> {
        Some(match self {
            Self::Bool(values) => ValueRef::Bool(*values.get(index)?),
            Self::Int8(values) => ValueRef::Int8(*values.get(index)?),
            Self::UInt8(values) => ValueRef::UInt8(*values.get(index)?),
            Self::Int16(values) => ValueRef::Int16(*values.get(index)?),
            Self::UInt16(values) => ValueRef::UInt16(*values.get(index)?),
            Self::Int32(values) => ValueRef::Int32(*values.get(index)?),
            Self::UInt32(values) => ValueRef::UInt32(*values.get(index)?),
            Self::Int64(values) => ValueRef::Int64(*values.get(index)?),
            Self::UInt64(values) => ValueRef::UInt64(*values.get(index)?),
            Self::Float32(values) => ValueRef::Float32(*values.get(index)?),
            Self::Float64(values) => ValueRef::Float64(*values.get(index)?),
            Self::String(values) => ValueRef::String(values.get(index)?),
            Self::WString(values) => ValueRef::WString(values.get(index)?),
            Self::Message(messages) => ValueRef::Message(messages.get(index)?),
        })
    }

    /// Iterates over the values.
    pub fn iter(&self) -> impl Iterator<Item = ValueRef<'_>> {
        (0..self.len()).filter_map(|index| self.get(index))
    }
}

impl Messages {
    /// The number of messages.
    #[must_use]
    pub fn len(&self) -> usize {
        self.count
    }

    /// Returns whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The type of each.
    #[must_use]
    pub fn message_type(&self) -> &DynamicType {
        &self.of
    }

    /// The element at an index.
    #[must_use]
    pub fn get(&self, index: usize) -> Option<MessageRef<'_>> {
        if index >= self.count {
            return None; // Messages without fields have no slots.
        }
        let stride = self.of.message().slots;
        let slots = self.slots.get(index * stride..(index + 1) * stride)?;
        Some(MessageRef::new(&self.of, self.of.index(), slots))
    }
}

impl PartialEq for Messages {
    fn eq(&self, other: &Self) -> bool {
        self.count == other.count && self.slots == other.slots && self.of.name() == other.of.name()
    }
}

impl std::fmt::Debug for Messages {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries((0..self.count).filter_map(|index| self.get(index))).finish()
    }
}

/// An element type of an [`Array`].
pub trait ArrayElement: Sized {
    /// The values, if they are of this type.
    fn slice(array: &Array) -> Option<&[Self]>;
}

macro_rules! conversions {
    ($($variant:ident $of:ty),* $(,)?) => {$(
        impl From<$of> for Value {
            fn from(value: $of) -> Self {
                Self::$variant(value)
            }
        }

        impl From<Vec<$of>> for Array {
            fn from(values: Vec<$of>) -> Self {
                Self::$variant(values)
            }
        }

        impl From<Vec<$of>> for Value {
            fn from(values: Vec<$of>) -> Self {
                Self::Array(Array::$variant(values))
            }
        }

        impl ArrayElement for $of {
            fn slice(array: &Array) -> Option<&[Self]> {
                match array {
                    Array::$variant(values) => Some(values),
                    _ => None,
                }
            }
        }
    )*};
}

conversions!(
    Bool bool, Int8 i8, UInt8 u8, Int16 i16, UInt16 u16, Int32 i32, UInt32 u32, Int64 i64, UInt64 u64,
    Float32 f32, Float64 f64, String String, WString WString,
);

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::String(text.into())
    }
}

impl From<DynamicMessage> for Value {
    fn from(message: DynamicMessage) -> Self {
        Self::Message(Box::new(message))
    }
}

impl From<Array> for Value {
    fn from(array: Array) -> Self {
        Self::Array(array)
    }
}
