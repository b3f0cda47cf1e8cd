//! Compiles definitions to the layout of a type.

use std::collections::BTreeMap;
use std::sync::Arc;

use downbeat_msgs_definitions::{
    Catalog, DefinitionEncoding, Element, Error as DefinitionError, Place, Shape, TypeName,
};

use super::model::{FieldLayout, Layout, MessageLayout};
use super::{DynamicType, TypeError, Value, fit};

/// Maximum nesting of messages.
const DEEPEST: usize = 32;
/// Maximum number of fields of a message and all nested messages: types that refer to others twice on each
/// level would have 2 to the power of the levels.
const MOST_FIELDS: usize = 1 << 16;
/// Maximum memory in bytes of a default message, which depends on its fixed arrays.
const MOST_MEMORY: u64 = 64 << 20;

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
