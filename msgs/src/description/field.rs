//! Fields and their types.

use super::const_text::compare;
use crate::WString;
use downbeat_msgs_definitions as definitions;
use downbeat_msgs_definitions::{Element, Primitive, Shape};

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
pub type FieldType = downbeat_msgs_definitions::FieldType<&'static Description>;

/// A Rust type that a field of a message can have: numbers, `bool`, [`String`], [`WString`], messages, and
/// arrays and vectors of these.
#[diagnostic::on_unimplemented(
    message = "`{Self}` cannot be the type of a field of a ROS 2 message",
    note = "it can be a number of 8 to 64 bits, `bool`, `String`, `WString`, a message, or an array or `Vec` of one of these"
)]
pub trait FieldValue {
    /// The default ROS 2 type of this Rust type.
    const FIELD_TYPE: FieldType;
}

impl Field {
    /// A field of the type that corresponds to `T`.
    #[must_use]
    pub const fn of<T: FieldValue>(name: &'static str) -> Self {
        Self { name, field_type: T::FIELD_TYPE, default_value: "" }
    }

    /// The description of the message type, if it holds messages.
    pub(super) const fn nested(&self) -> Option<&'static Description> {
        match self.field_type.element {
            Element::Message(nested) => Some(nested),
            _ => None,
        }
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
        match &mut self.field_type.element {
            Element::String { bound: limit } | Element::WString { bound: limit } => *limit = Some(bound),
            _ => {}
        }
        self
    }

    /// Makes it the ROS 2 type `byte`, which is a `u8` in Rust, like `uint8`.
    #[must_use]
    pub const fn byte(mut self) -> Self {
        if let Element::Primitive(Primitive::UInt8) = self.field_type.element {
            self.field_type.element = Element::Primitive(Primitive::Byte);
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

const fn single(element: Element<&'static Description>) -> FieldType {
    FieldType { element, shape: Shape::Single }
}

const fn shaped(mut of: FieldType, shape: Shape) -> FieldType {
    if !matches!(of.shape, Shape::Single) {
        panic!("ROS 2 has no arrays of arrays: put the inner one into a message");
    }
    of.shape = shape;
    of
}

macro_rules! primitives {
    ($($type:ty = $primitive:ident),* $(,)?) => {$(
        impl FieldValue for $type {
            const FIELD_TYPE: FieldType = single(Element::Primitive(Primitive::$primitive));
        }
    )*};
}

primitives! {
    i8 = Int8, u8 = UInt8, i16 = Int16, u16 = UInt16, i32 = Int32, u32 = UInt32, i64 = Int64, u64 = UInt64,
    f32 = Float32, f64 = Float64, bool = Bool,
}

impl FieldValue for String {
    const FIELD_TYPE: FieldType = single(Element::String { bound: None });
}

impl FieldValue for WString {
    const FIELD_TYPE: FieldType = single(Element::WString { bound: None });
}

impl<T: FieldValue> FieldValue for Vec<T> {
    const FIELD_TYPE: FieldType = shaped(T::FIELD_TYPE, Shape::Sequence);
}

impl<T: FieldValue, const N: usize> FieldValue for [T; N] {
    const FIELD_TYPE: FieldType = shaped(T::FIELD_TYPE, Shape::Array(N as u64));
}

/// Fails the build with `message` if the type does not match that of a definition, which names messages.
/// Bounds, `byte` and `char` have no Rust types, so they are not checked.
#[doc(hidden)]
#[track_caller]
pub const fn check<T: FieldValue>(defined: definitions::FieldType<&str>, message: &str) {
    let found = T::FIELD_TYPE;
    let is_shape = match (found.shape, defined.shape) {
        (Shape::Array(found), Shape::Array(defined)) => found == defined,
        (Shape::Single, Shape::Single) | (Shape::Sequence, Shape::Sequence) => true,
        _ => false,
    };
    let is_element = match (found.element, defined.element) {
        (Element::Primitive(Primitive::UInt8), Element::Primitive(Primitive::Byte | Primitive::Char))
        | (Element::String { .. }, Element::String { .. })
        | (Element::WString { .. }, Element::WString { .. }) => true,
        (Element::Primitive(found), Element::Primitive(defined)) => found as u8 == defined as u8,
        (Element::Message(found), Element::Message(defined)) => compare(found.type_name, defined) == 0,
        _ => false,
    };
    if !is_shape || !is_element {
        panic!("{}", message);
    }
}
