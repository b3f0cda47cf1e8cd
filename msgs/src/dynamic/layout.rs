//! Types known only at run time, compiled once to a layout.
//!
//! A value of a type is a row of slots. A field that is one number or text takes one slot, an array or
//! sequence takes one slot whatever its length, and a field that is one message takes the slots of that
//! message, in place. So a message of any depth is one row, and its type determines the number of slots.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use downbeat_msgs_definitions::{
    Catalog, DefinitionEncoding, Element, Error as DefinitionError, FieldType, Place, Shape, TypeName,
};

use super::{TypeError, Value, fit};

/// Maximum nesting of messages.
const DEEPEST: usize = 32;
/// Maximum number of fields of a message and all nested messages: types that refer to others twice on each
/// level would have 2 to the power of the levels.
const MOST_FIELDS: usize = 1 << 16;
/// Maximum memory in bytes of a default message, which depends on its fixed arrays.
const MOST_MEMORY: u64 = 64 << 20;

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
    layout: Arc<Layout>,
    index: usize,
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

/// The messages of a type, each after those it contains.
#[derive(Debug)]
pub(super) struct Layout {
    messages: Vec<MessageLayout>,
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

impl FieldLayout {
    /// Returns whether it holds a single message, in place.
    pub(super) fn is_one_message(&self) -> bool {
        matches!((&self.field_type.element, self.field_type.shape), (Element::Message(_), Shape::Single))
    }
}

impl DynamicType {
    /// Compiles the message of that name and all messages it refers to.
    ///
    /// # Errors
    /// Returns an error if one of them is not in the catalog, contains itself, or is too large: nested deeper
    /// than 32 levels, more than 65 536 fields in all, or fixed arrays of more than 64 MiB.
    pub fn new(catalog: &Catalog, name: &TypeName) -> Result<Self, TypeError> {
        let mut compiler =
            Compiler { catalog, messages: Vec::new(), done: BTreeMap::new(), path: Vec::new() };
        let index = compiler.message(name, None)?;
        Ok(Self { layout: Arc::new(Layout { messages: compiler.messages }), index })
    }

    /// Compiles the type `name` from a definition text with its dependencies, as in bags: `encoding` is
    /// `ros2msg` or `ros2idl`, or `unknown`, which rosbag2 writes for services.
    ///
    /// # Errors
    /// Returns an error if the text is not a definition of the type; see also [`DynamicType::new`].
    pub fn from_definition_text(name: &str, encoding: &str, text: &str) -> Result<Self, TypeError> {
        let name: TypeName = name.parse()?;
        let catalog = catalog_of(&name, encoding, text, &format!("definition of {name}"))?;
        Self::new(&catalog, &name)
    }

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

/// Parses the definitions in a text; `origin` names it in errors.
pub(super) fn catalog_of(
    name: &TypeName,
    encoding: &str,
    text: &str,
    origin: &str,
) -> Result<Catalog, DefinitionError> {
    // Jazzy's rosbag2 writes this encoding for the text of a service, which starts with a line of `=`.
    let is_unnoted = encoding == "unknown" && text.starts_with("===");
    let encoding = if is_unnoted { DefinitionEncoding::Ros2Msg } else { encoding.parse()? };
    let mut catalog = Catalog::new();
    catalog.add_definition_text(name, encoding, text, origin)?;
    Ok(catalog)
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

struct Compiler<'a> {
    catalog: &'a Catalog,
    messages: Vec<MessageLayout>,
    done: BTreeMap<TypeName, usize>,
    /// From the root to the message being compiled.
    path: Vec<TypeName>,
}

impl Compiler<'_> {
    /// `named_at` is the place of the field that has this type.
    fn message(&mut self, name: &TypeName, named_at: Option<&Place>) -> Result<usize, TypeError> {
        if let Some(index) = self.done.get(name) {
            return Ok(*index);
        }
        let definition = self.catalog.message(name)?;
        if let (Some(first), Some(place)) = (self.path.iter().position(|above| above == name), named_at) {
            let cycle = self.path[first..].iter().chain([name]).cloned().collect();
            return Err(DefinitionError::Cycle { place: Box::new(place.clone()), cycle }.into());
        }
        if self.path.len() == DEEPEST {
            return Err(TypeError::TooDeep { name: self.path[0].clone(), limit: DEEPEST });
        }
        self.path.push(name.clone());
        let mut message = MessageLayout {
            name: name.clone(),
            fields: Vec::with_capacity(definition.fields.len()),
            all_fields: 0,
            slots: 0,
            least_size: 0,
            memory: 0,
        };
        for field in &definition.fields {
            let nested = match &field.field_type.element {
                Element::Message(name) => self.message(name, Some(&field.place))?,
                _ => 0,
            };
            let mut layout = FieldLayout {
                name: field.name.clone(),
                field_type: field.field_type.clone(),
                slot: message.slots,
                nested,
                default: None,
            };
            if let Some(default) = &field.default {
                // The parser has checked it against the type.
                let value = fit::default_value(&layout.field_type, default)
                    .map_err(|problem| TypeError::Default(Box::new(problem.of(name, &field.name))))?;
                layout.default = Some(value);
            }
            self.measure(&layout, &mut message);
            message.fields.push(layout);
        }
        // A message without fields is sent as one byte.
        message.least_size = message.least_size.max(1);
        if message.all_fields > MOST_FIELDS {
            return Err(TypeError::TooManyFields { name: name.clone(), limit: MOST_FIELDS });
        }
        if message.memory > MOST_MEMORY {
            return Err(TypeError::TooLarge { name: name.clone(), limit: MOST_MEMORY });
        }
        self.path.pop();
        self.messages.push(message);
        self.done.insert(name.clone(), self.messages.len() - 1);
        Ok(self.messages.len() - 1)
    }

    /// Adds the sizes of the field to those of its message.
    fn measure(&self, field: &FieldLayout, message: &mut MessageLayout) {
        const SLOT: u64 = size_of::<Value>() as u64;
        let (slots, least_size, memory) = match &field.field_type.element {
            Element::Primitive(primitive) => (1, primitive.size(), primitive.size() as u64),
            Element::String { .. } | Element::WString { .. } => (1, 4, 24),
            Element::Message(_) => {
                let nested = &self.messages[field.nested];
                (nested.slots, nested.least_size, nested.memory.max(1))
            }
        };
        let (slots, least_size, memory) = match field.field_type.shape {
            Shape::Single if field.is_one_message() => (slots, least_size, memory),
            Shape::Single => (1, least_size, SLOT),
            Shape::Array(count) => (
                1,
                least_size.saturating_mul(usize::try_from(count).unwrap_or(usize::MAX)),
                memory.saturating_mul(count).saturating_add(SLOT),
            ),
            Shape::Bounded(_) | Shape::Sequence => (1, 4, SLOT),
        };
        message.all_fields = message.all_fields.saturating_add(1);
        if let Element::Message(_) = field.field_type.element {
            message.all_fields = message.all_fields.saturating_add(self.messages[field.nested].all_fields);
        }
        message.slots = message.slots.saturating_add(slots);
        message.least_size = message.least_size.saturating_add(least_size);
        message.memory = message.memory.saturating_add(memory);
    }
}
