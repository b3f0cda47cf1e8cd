//! The parsed form of `.msg`, `.srv` and `.action` files.

use crate::{Place, TypeName};

/// The most fields and constants of a message: no interface has a hundredth of them, and each takes half a
/// kilobyte.
pub(crate) const MOST_MEMBERS: usize = 1 << 16;

/// The most fields and constants of all messages in one definition text, which may come from anywhere.
pub(crate) const MOST_MEMBERS_OF_TEXT: usize = 1 << 17;

/// A parsed message.
#[derive(Clone, Debug, PartialEq)]
pub struct MessageDefinition {
    /// Its name.
    pub name: TypeName,
    /// Comment lines at the top of the file.
    pub comment: Vec<String>,
    /// Its fields, in order.
    pub fields: Vec<Field>,
    /// Its constants, in order.
    pub constants: Vec<Constant>,
    /// The text it was parsed from, unchanged.
    pub text: String,
    /// The file it comes from.
    pub origin: String,
}

/// A parsed service.
#[derive(Clone, Debug, PartialEq)]
pub struct ServiceDefinition {
    /// Its name.
    pub name: TypeName,
    /// `<name>_Request`.
    pub request: MessageDefinition,
    /// `<name>_Response`.
    pub response: MessageDefinition,
    /// The text it was parsed from, unchanged.
    pub text: String,
    /// The file it comes from.
    pub origin: String,
}

/// A parsed action. The services and messages that rosidl derives from it are in the
/// [`Catalog`](crate::Catalog).
#[derive(Clone, Debug, PartialEq)]
pub struct ActionDefinition {
    /// Its name.
    pub name: TypeName,
    /// `<name>_Goal`.
    pub goal: MessageDefinition,
    /// `<name>_Result`.
    pub result: MessageDefinition,
    /// `<name>_Feedback`.
    pub feedback: MessageDefinition,
    /// The text it was parsed from, unchanged.
    pub text: String,
    /// The file it comes from.
    pub origin: String,
}

/// A field of a message.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Its name.
    pub name: String,
    /// Its type.
    pub field_type: FieldType,
    /// Its initial value, if the definition has one.
    pub default: Option<Value>,
    /// Comment lines directly above it and after it on its line.
    pub comment: Vec<String>,
    /// Where its type is written.
    pub place: Place,
}

/// A named constant of a message.
#[derive(Clone, Debug, PartialEq)]
pub struct Constant {
    /// Its name.
    pub name: String,
    /// Its type: a primitive or an unbounded string.
    pub element: Element,
    /// Its value.
    pub value: Value,
    /// Comment lines directly above it and after it on its line.
    pub comment: Vec<String>,
}

/// The type of a field: one element, or several. `M` refers to the definition of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FieldType<M = TypeName> {
    /// The type of an element.
    pub element: Element<M>,
    /// The number of elements.
    pub shape: Shape,
}

/// The type of an element of a field. `M` refers to the definition of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Element<M = TypeName> {
    /// A number, a byte, or a boolean.
    Primitive(Primitive),
    /// `string`, `string<=N`; the bound counts bytes.
    String {
        /// The bound N.
        bound: Option<u64>,
    },
    /// `wstring`, `wstring<=N`; the bound counts UTF-16 code units.
    WString {
        /// The bound N.
        bound: Option<u64>,
    },
    /// Another message.
    Message(M),
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

/// The primitive types of ROS 2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Primitive {
    /// `bool`
    Bool,
    /// `byte`
    Byte,
    /// `char`, which is an unsigned 8-bit number
    Char,
    /// `int8`
    Int8,
    /// `uint8`
    UInt8,
    /// `int16`
    Int16,
    /// `uint16`
    UInt16,
    /// `int32`
    Int32,
    /// `uint32`
    UInt32,
    /// `int64`
    Int64,
    /// `uint64`
    UInt64,
    /// `float32`
    Float32,
    /// `float64`
    Float64,
}

impl MessageDefinition {
    /// Returns whether both have the same fields, defaults and constants, ignoring comments and spaces.
    #[must_use]
    pub fn means_the_same_as(&self, other: &Self) -> bool {
        let same_fields = self.fields.len() == other.fields.len()
            && self.fields.iter().zip(&other.fields).all(|(one, two)| {
                one.name == two.name
                    && one.field_type.is_same_as(&two.field_type)
                    && match (&one.default, &two.default) {
                        (Some(one), Some(two)) => one.is_same_as(two),
                        (None, None) => true,
                        _ => false,
                    }
            });
        let same_constants = self.constants.len() == other.constants.len()
            && self.constants.iter().zip(&other.constants).all(|(one, two)| {
                one.name == two.name
                    && one.element.is_same_as(&two.element)
                    && one.value.is_same_as(&two.value)
            });
        same_fields && same_constants
    }
}

impl<M> FieldType<M> {
    /// The constant of `type_description_interfaces/msg/FieldType` for element and shape.
    #[must_use]
    pub const fn type_id(&self) -> u8 {
        let element = match &self.element {
            Element::Message(_) => 1,
            Element::Primitive(primitive) => primitive.type_id(),
            Element::String { bound: None } => 17,
            Element::WString { bound: None } => 18,
            Element::String { .. } => 21,
            Element::WString { .. } => 22,
        };
        element
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

    /// The bound of a bounded string, otherwise 0.
    #[must_use]
    pub const fn string_capacity(&self) -> u64 {
        match &self.element {
            Element::String { bound: Some(bound) } | Element::WString { bound: Some(bound) } => *bound,
            _ => 0,
        }
    }
}

impl FieldType {
    /// Checks the number of elements in a default.
    ///
    /// # Errors
    /// Returns the sentence to report.
    pub(crate) fn check_count(&self, found: usize) -> Result<(), String> {
        match self.shape {
            Shape::Array(count) if found as u64 != count => {
                Err(format!("`{self}` needs exactly {count} values, found {found}"))
            }
            Shape::Bounded(bound) if found as u64 > bound => {
                Err(format!("`{self}` takes at most {bound} values, found {found}"))
            }
            _ => Ok(()),
        }
    }

    fn is_same_as(&self, other: &Self) -> bool {
        self.shape == other.shape && self.element.is_same_as(&other.element)
    }
}

impl Element {
    /// `char` is an alias of `uint8`, which IDL does not have.
    fn is_same_as(&self, other: &Self) -> bool {
        let is_byte = |of: &Self| matches!(of, Self::Primitive(Primitive::Char | Primitive::UInt8));
        self == other || (is_byte(self) && is_byte(other))
    }
}

impl Value {
    /// Returns whether both are bitwise equal: NaN equals itself.
    fn is_same_as(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Float(one), Self::Float(two)) => one.to_bits() == two.to_bits(),
            (Self::List(one), Self::List(two)) => {
                one.len() == two.len() && one.iter().zip(two).all(|(one, two)| one.is_same_as(two))
            }
            _ => self == other,
        }
    }
}

impl Primitive {
    /// All primitive types.
    pub const ALL: [Self; 13] = [
        Self::Bool,
        Self::Byte,
        Self::Char,
        Self::Int8,
        Self::UInt8,
        Self::Int16,
        Self::UInt16,
        Self::Int32,
        Self::UInt32,
        Self::Int64,
        Self::UInt64,
        Self::Float32,
        Self::Float64,
    ];

    /// The constant of `type_description_interfaces/msg/FieldType`.
    #[must_use]
    pub const fn type_id(self) -> u8 {
        match self {
            Self::Int8 => 2,
            Self::UInt8 | Self::Char => 3,
            Self::Int16 => 4,
            Self::UInt16 => 5,
            Self::Int32 => 6,
            Self::UInt32 => 7,
            Self::Int64 => 8,
            Self::UInt64 => 9,
            Self::Float32 => 10,
            Self::Float64 => 11,
            Self::Bool => 15,
            Self::Byte => 16,
        }
    }

    /// The name in ROS 2.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Bool => "bool",
            Self::Byte => "byte",
            Self::Char => "char",
            Self::Int8 => "int8",
            Self::UInt8 => "uint8",
            Self::Int16 => "int16",
            Self::UInt16 => "uint16",
            Self::Int32 => "int32",
            Self::UInt32 => "uint32",
            Self::Int64 => "int64",
            Self::UInt64 => "uint64",
            Self::Float32 => "float32",
            Self::Float64 => "float64",
        }
    }

    /// Bytes of one value on the wire; also its alignment.
    #[must_use]
    pub const fn size(self) -> usize {
        match self {
            Self::Bool | Self::Byte | Self::Char | Self::Int8 | Self::UInt8 => 1,
            Self::Int16 | Self::UInt16 => 2,
            Self::Int32 | Self::UInt32 | Self::Float32 => 4,
            Self::Int64 | Self::UInt64 | Self::Float64 => 8,
        }
    }

    /// The least and the greatest value of an integer type; `None` for `bool` and floating-point types.
    #[must_use]
    pub const fn range(self) -> Option<(i128, i128)> {
        Some(match self {
            Self::Byte | Self::Char | Self::UInt8 => (0, u8::MAX as i128),
            Self::Int8 => (i8::MIN as i128, i8::MAX as i128),
            Self::Int16 => (i16::MIN as i128, i16::MAX as i128),
            Self::UInt16 => (0, u16::MAX as i128),
            Self::Int32 => (i32::MIN as i128, i32::MAX as i128),
            Self::UInt32 => (0, u32::MAX as i128),
            Self::Int64 => (i64::MIN as i128, i64::MAX as i128),
            Self::UInt64 => (0, u64::MAX as i128),
            Self::Bool | Self::Float32 | Self::Float64 => return None,
        })
    }
}

/// The value of a constant or of a default.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// Of a `bool`.
    Bool(bool),
    /// Of any integer type.
    Integer(i128),
    /// Of a floating-point type.
    Float(f64),
    /// Of a string type.
    Text(String),
    /// Of an array or sequence.
    List(Vec<Value>),
}

impl std::fmt::Display for FieldType {
    /// The type as in a definition, always with the package of messages.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.element {
            Element::Primitive(primitive) => f.write_str(primitive.as_str())?,
            Element::String { bound: None } => f.write_str("string")?,
            Element::String { bound: Some(bound) } => write!(f, "string<={bound}")?,
            Element::WString { bound: None } => f.write_str("wstring")?,
            Element::WString { bound: Some(bound) } => write!(f, "wstring<={bound}")?,
            Element::Message(name) => f.write_str(&name.in_texts())?,
        }
        match self.shape {
            Shape::Single => Ok(()),
            Shape::Array(count) => write!(f, "[{count}]"),
            Shape::Bounded(count) => write!(f, "[<={count}]"),
            Shape::Sequence => f.write_str("[]"),
        }
    }
}
