//! Types known only at run time and their values. A type has the defaults of its fields, which are values,
//! and a value may be a message, which has a type.
//!
//! A message is a row of slots. A field that is one number or text takes one slot, an array or sequence takes
//! one slot whatever its length, and a field that is one message takes the slots of that message, in place.
//! So a message of any depth is one row, and its type determines the number of slots.

use std::fmt;
use std::sync::Arc;

use downbeat_msgs_definitions::{Element, FieldType, Shape, TypeName};

use crate::WString;

/// The type of a [`DynamicMessage`](super::DynamicMessage): a definition and all definitions it refers to,
/// compiled.
///
/// Cloning is cheap: clones share the layout.
///
/// ```
/// use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
///
/// let text = "string name\nfloat64[] range\n";
/// let scan = DynamicType::from_definition_text("my_msgs/msg/Scan", "ros2msg", text)?;
/// assert_eq!(scan.fields().map(|field| field.name).collect::<Vec<_>>(), ["name", "range"]);
/// assert_eq!(DynamicMessage::new(&scan).get("name")?.as_str(), Some(""));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct DynamicType {
    pub(super) layout: Arc<Layout>,
    pub(super) index: usize,
}

/// A field of a [`DynamicType`].
#[derive(Clone, Debug)]
pub struct DynamicField<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its type, as in the definition.
    pub field_type: &'a FieldType,
    /// The type of the message or messages it holds; `None` for numbers and texts.
    pub message: Option<DynamicType>,
}

/// A message of any type; its [`DynamicType`] describes its fields.
#[derive(Clone)]
pub struct DynamicMessage {
    pub(super) of: DynamicType,
    pub(super) slots: Vec<Value>,
}

/// A borrowed message, possibly nested in another one.
#[derive(Clone, Copy)]
pub struct MessageRef<'a> {
    /// A type with the same layout; `index` selects the message of the layout.
    pub(super) layout: &'a DynamicType,
    pub(super) index: usize,
    pub(super) slots: &'a [Value],
}

/// A value of a field, or a new value for one.
///
/// `byte` and `char` are [`Value::UInt8`], as in the generated structs. Floating-point values compare as in
/// Rust: NaN is not equal to itself.
#[derive(Clone, Debug, PartialEq)]
#[expect(missing_docs, reason = "each is named as the type of ROS 2 that it holds")]
pub enum Value {
    Bool(bool),
    Int8(i8),
    UInt8(u8),
    Int16(i16),
    UInt16(u16),
    Int32(i32),
    UInt32(u32),
    Int64(i64),
    UInt64(u64),
    Float32(f32),
    Float64(f64),
    String(String),
    WString(WString),
    /// One message.
    Message(Box<DynamicMessage>),
    /// An array or a sequence.
    Array(Array),
}

/// The values of an array or sequence, stored contiguously.
#[derive(Clone, Debug, PartialEq)]
#[expect(missing_docs, reason = "each is named as the type of ROS 2 that it holds")]
pub enum Array {
    Bool(Vec<bool>),
    Int8(Vec<i8>),
    UInt8(Vec<u8>),
    Int16(Vec<i16>),
    UInt16(Vec<u16>),
    Int32(Vec<i32>),
    UInt32(Vec<u32>),
    Int64(Vec<i64>),
    UInt64(Vec<u64>),
    Float32(Vec<f32>),
    Float64(Vec<f64>),
    String(Vec<String>),
    WString(Vec<WString>),
    Message(Messages),
}

/// Messages of one type.
#[derive(Clone)]
pub struct Messages {
    pub(super) of: DynamicType,
    pub(super) count: usize,
    /// Their slots, one message after another.
    pub(super) slots: Vec<Value>,
}

/// A borrowed value of a field.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(missing_docs, reason = "each is named as the type of ROS 2 that it holds")]
pub enum ValueRef<'a> {
    Bool(bool),
    Int8(i8),
    UInt8(u8),
    Int16(i16),
    UInt16(u16),
    Int32(i32),
    UInt32(u32),
    Int64(i64),
    UInt64(u64),
    Float32(f32),
    Float64(f64),
    String(&'a str),
    WString(&'a str),
    /// One message.
    Message(MessageRef<'a>),
    /// An array or a sequence.
    Array(&'a Array),
}

/// The messages of a type, each after those it contains.
#[derive(Debug)]
pub(super) struct Layout {
    pub(super) messages: Vec<MessageLayout>,
}

#[derive(Debug)]
pub(super) struct MessageLayout {
    pub name: TypeName,
    pub fields: Vec<FieldLayout>,
    /// The number of fields, including all nested ones.
    pub all_fields: usize,
    /// The number of slots of a value.
    pub slots: usize,
    /// The minimum size of a value on the wire, without padding; at least 1.
    pub least_size: usize,
    /// The approximate memory of a default value in bytes.
    pub memory: u64,
}

#[derive(Debug)]
pub(super) struct FieldLayout {
    pub name: String,
    pub field_type: FieldType,
    /// The index of its first slot in the message.
    pub slot: usize,
    /// The layout of the messages it holds; meaningless for other fields.
    pub nested: usize,
    /// The default in the definition.
    pub default: Option<Value>,
}

impl DynamicType {
    /// As in `sensor_msgs/msg/JointState`.
    #[must_use]
    pub fn name(&self) -> &TypeName {
        &self.message().name
    }

    /// The fields, in order.
    pub fn fields(&self) -> impl Iterator<Item = DynamicField<'_>> {
        self.message().fields.iter().map(|field| DynamicField {
            name: &field.name,
            field_type: &field.field_type,
            message: match field.field_type.element {
                Element::Message(_) => Some(self.nested(field)),
                _ => None,
            },
        })
    }

    /// The layout of the message itself.
    pub(super) fn message(&self) -> &MessageLayout {
        // Both are created together and never change.
        &self.layout.messages[self.index]
    }

    /// The type of the message or messages in a field of this type.
    pub(super) fn nested(&self, field: &FieldLayout) -> Self {
        Self { layout: Arc::clone(&self.layout), index: field.nested }
    }

    pub(super) fn layout(&self) -> &Layout {
        &self.layout
    }

    pub(super) fn index(&self) -> usize {
        self.index
    }

    /// The type at another index of the same layout.
    pub(super) fn at(&self, index: usize) -> Self {
        Self { layout: Arc::clone(&self.layout), index }
    }
}

impl FieldLayout {
    /// Returns whether it holds a single message, in place.
    pub(super) fn is_one_message(&self) -> bool {
        matches!((&self.field_type.element, self.field_type.shape), (Element::Message(_), Shape::Single))
    }
}

impl Layout {
    /// An index comes from [`DynamicType::index`] or [`FieldLayout::nested`] of the same layout.
    pub(super) fn message(&self, index: usize) -> &MessageLayout {
        &self.messages[index]
    }
}

impl PartialEq for DynamicType {
    /// Returns whether the names and the fields are equal, including those of nested messages.
    fn eq(&self, other: &Self) -> bool {
        fn same(ours: &DynamicType, theirs: &DynamicType) -> bool {
            let (a, b) = (ours.message(), theirs.message());
            a.name == b.name
                && a.fields.len() == b.fields.len()
                && a.fields.iter().zip(&b.fields).all(|(a, b)| {
                    a.name == b.name
                        && a.field_type == b.field_type
                        && (!matches!(a.field_type.element, Element::Message(_))
                            || same(&ours.nested(a), &theirs.nested(b)))
                })
        }
        (Arc::ptr_eq(&self.layout, &other.layout) && self.index == other.index) || same(self, other)
    }
}

impl fmt::Debug for DynamicType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "DynamicType({})", self.name())
    }
}
