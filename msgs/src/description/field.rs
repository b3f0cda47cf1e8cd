//! Fields and their types.

use super::text::compare;
use crate::{Message, WString};

/// A type and its fields.
#[derive(Clone, Copy, Debug)]
pub struct Description {
    /// As in `sensor_msgs/msg/JointState`.
    pub type_name: &'static str,
    /// Its definition text, including dependencies.
    pub definition: &'static str,
    /// Its fields, in order.
    pub fields: &'static [Field],
}

/// A field of a message.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Its name.
    pub name: &'static str,
    /// Its type.
    pub field_type: FieldType,
    /// Its default in Python syntax, as in ROS 2's descriptions; empty if the definition has none.
    pub default_value: &'static str,
}

/// The type of a field: one element, or several.
#[derive(Clone, Copy, Debug)]
pub struct FieldType {
    /// The type of an element: one of the constants of
    /// [`FieldType`](crate::type_description_interfaces::msg::FieldType) below 48.
    pub element: u8,
    /// The number of elements.
    pub shape: Shape,
    /// The bound of a bounded string, otherwise 0.
    pub string_capacity: u64,
    /// The description of the message type, if it holds messages.
    pub nested: Option<&'static Description>,
}

/// How many elements a field holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// One element.
    Single,
    /// Exactly this many: `[N]`.
    Array(u64),
    /// At most this many: `[<=N]`.
    Bounded(u64),
    /// Any number: `[]`.
    Sequence,
}

/// A Rust type that a field of a message can have: numbers, `bool`, [`String`], [`WString`], messages, and arrays and vectors
/// of these.
#[diagnostic::on_unimplemented(
    message = "`{Self}` cannot be the type of a field of a ROS 2 message",
    note = "it can be a number of 8 to 64 bits, `bool`, `String`, `WString`, a message, or an array or `Vec` of one of these"
)]
pub trait FieldValue {
    /// The default ROS 2 type of this Rust type.
    const FIELD_TYPE: FieldType;
}

const NESTED: u8 = 1;
const UINT8: u8 = 3;
const BYTE: u8 = 16;
const STRING: u8 = 17;
const WSTRING: u8 = 18;
/// The offset from strings to bounded strings.
const BOUNDED: u8 = 4;

impl Field {
    /// A field of the type that corresponds to `T`.
    #[must_use]
    pub const fn of<T: FieldValue>(name: &'static str) -> Self {
        Self { name, field_type: T::FIELD_TYPE, default_value: "" }
    }

    /// Makes it a sequence of at most `bound` elements.
    #[must_use]
    pub const fn bounded(mut self, bound: u64) -> Self {
        self.field_type.shape = Shape::Bounded(bound);
        self
    }

    /// Limits its strings to that length.
    #[must_use]
    pub const fn bounded_text(mut self, bound: u64) -> Self {
        if matches!(self.field_type.element, STRING | WSTRING) {
            self.field_type.element += BOUNDED;
        }
        self.field_type.string_capacity = bound;
        self
    }

    /// Makes it the ROS 2 type `byte`, which is a `u8` in Rust, like `uint8`.
    #[must_use]
    pub const fn byte(mut self) -> Self {
        if self.field_type.element == UINT8 {
            self.field_type.element = BYTE;
        }
        self
    }

    /// Sets a default in Python syntax.
    #[must_use]
    pub const fn with_default(mut self, value: &'static str) -> Self {
        self.default_value = value;
        self
    }
}

impl FieldType {
    const fn single(element: u8) -> Self {
        Self { element, shape: Shape::Single, string_capacity: 0, nested: None }
    }

    /// A field type of one message with that description.
    #[must_use]
    pub const fn nested(description: &'static Description) -> Self {
        Self { nested: Some(description), ..Self::single(NESTED) }
    }

    const fn shaped(mut self, shape: Shape) -> Self {
        if !matches!(self.shape, Shape::Single) {
            panic!("ROS 2 has no arrays of arrays: put the inner one into a message");
        }
        self.shape = shape;
        self
    }

    /// The constant of [`FieldType`](crate::type_description_interfaces::msg::FieldType) for element and shape.
    #[must_use]
    pub const fn type_id(&self) -> u8 {
        self.element
            + match self.shape {
                Shape::Single => 0,
                Shape::Array(_) => 48,
                Shape::Bounded(_) => 96,
                Shape::Sequence => 144,
            }
    }

    /// The size of an array, the bound of a sequence, otherwise 0.
    #[must_use]
    pub const fn capacity(&self) -> u64 {
        match self.shape {
            Shape::Array(count) | Shape::Bounded(count) => count,
            Shape::Single | Shape::Sequence => 0,
        }
    }
}

macro_rules! values {
    ($($type:ty = $element:expr),* $(,)?) => {$(
        impl FieldValue for $type {
            const FIELD_TYPE: FieldType = FieldType::single($element);
        }
    )*};
}

values! {
    i8 = 2, u8 = UINT8, i16 = 4, u16 = 5, i32 = 6, u32 = 7, i64 = 8, u64 = 9, f32 = 10, f64 = 11, bool = 15,
    String = STRING, WString = WSTRING,
}

impl<T: Message> FieldValue for T {
    const FIELD_TYPE: FieldType = FieldType::nested(T::DESCRIPTION);
}

impl<T: FieldValue> FieldValue for Vec<T> {
    const FIELD_TYPE: FieldType = T::FIELD_TYPE.shaped(Shape::Sequence);
}

impl<T: FieldValue, const N: usize> FieldValue for [T; N] {
    const FIELD_TYPE: FieldType = T::FIELD_TYPE.shaped(Shape::Array(N as u64));
}

/// Fails the build with `message` if the type does not match that of a definition. `element` is its Rust name
/// (`message` for a message, whose name is then `nested`). Bounds and `byte` have no Rust types, so they are
/// not checked.
#[doc(hidden)]
#[track_caller]
pub const fn check<T: FieldValue>(element: &str, shape: Shape, nested: &str, message: &str) {
    let found = T::FIELD_TYPE;
    let is_shape = match (found.shape, shape) {
        (Shape::Array(found), Shape::Array(defined)) => found == defined,
        (Shape::Single, Shape::Single) | (Shape::Sequence, Shape::Sequence) => true,
        _ => false,
    };
    let is_nested = match found.nested {
        Some(found) => compare(found.type_name, nested) == 0,
        None => nested.is_empty(),
    };
    if !is_shape || !is_nested || compare(rust_name(found.element), element) != 0 {
        panic!("{}", message);
    }
}

const fn rust_name(element: u8) -> &'static str {
    match element {
        NESTED => "message",
        2 => "i8",
        UINT8 | BYTE => "u8",
        4 => "i16",
        5 => "u16",
        6 => "i32",
        7 => "u32",
        8 => "i64",
        9 => "u64",
        10 => "f32",
        11 => "f64",
        15 => "bool",
        STRING => "String",
        WSTRING => "WString",
        _ => "",
    }
}
