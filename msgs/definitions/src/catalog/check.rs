//! Whether the references between definitions lead somewhere, and come to an end.

use std::collections::BTreeMap;

use super::Catalog;
use crate::{Element, Error, Field, MessageDefinition, Shape, TypeName};

/// Deeper than any interface is nested (that of rosbag2 is 50), and shallow enough to be followed on any stack.
const DEEPEST_NESTING: usize = 64;

/// What is known of a message when all it contains has been looked at.
#[derive(Clone, Copy)]
struct Measure {
    /// Levels of messages, itself included.
    height: usize,
    /// The fewest bytes on the wire, padding not counted.
    size: u64,
}

/// Those that have been looked at.
type Measured<'a> = BTreeMap<&'a TypeName, Measure>;

impl Catalog {
    /// Checks that every type a field names is there, that no message contains itself or is nested without end, and that
    /// each is small enough to be sent.
    ///
    /// # Errors
    /// [`Error::UnknownType`], [`Error::Cycle`], [`Error::TooDeep`] or [`Error::TooLarge`], the first one found.
    pub fn check(&self) -> Result<(), Error> {
        let mut measured = Measured::new();
        self.messages
            .values()
            .try_for_each(|message| self.measure(message, &mut Vec::new(), &mut measured).map(|_| ()))
    }

    /// As [`Catalog::check`], of one type and what it refers to.
    ///
    /// # Errors
    /// As [`Catalog::check`], and [`Error::NotInCatalog`].
    pub fn check_type(&self, name: &TypeName) -> Result<(), Error> {
        let description = self.type_description(name);
        let mut measured = Measured::new();
        let mut check = |name: &TypeName| match self.messages.get(name) {
            Some(message) => self.measure(message, &mut Vec::new(), &mut measured).map(|_| ()),
            None => Ok(()),
        };
        check(name)?;
        // Of a service or an action it names the parts.
        for part in &description?.referenced_type_descriptions {
            check(&part.type_name.parse()?)?;
        }
        Ok(())
    }

    /// The fewest bytes the CDR of a message takes, padding not counted.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`] for the message itself, and as [`Catalog::check`] for what it contains.
    pub fn least_wire_size(&self, name: &TypeName) -> Result<u64, Error> {
        Ok(self.measure(self.message(name)?, &mut Vec::new(), &mut Measured::new())?.size)
    }

    /// `path` is the way from where the check began: messages, and the field by which each leads on.
    fn measure<'a>(
        &'a self,
        message: &'a MessageDefinition,
        path: &mut Vec<&'a TypeName>,
        measured: &mut Measured<'a>,
    ) -> Result<Measure, Error> {
        if let Some(known) = measured.get(&message.name) {
            return Ok(*known);
        }
        path.push(&message.name);
        let mut height = 1;
        let mut size: u64 = 0;
        for field in &message.fields {
            let element = match &field.field_type.element {
                Element::Primitive(primitive) => primitive.size() as u64,
                Element::String { .. } | Element::WString { .. } => 4,
                Element::Message(wanted) => {
                    let inner = self.measure_field(message, field, wanted, path, measured)?;
                    height = height.max(inner.height + 1);
                    inner.size
                }
            };
            size = size.saturating_add(match field.field_type.shape {
                Shape::Single => element,
                Shape::Array(count) => element.saturating_mul(count),
                Shape::Bounded(_) | Shape::Sequence => 4,
            });
            let (place, name) = (|| Box::new(field.place.clone()), || Box::new(message.name.clone()));
            if height > DEEPEST_NESTING {
                return Err(Error::TooDeep { place: place(), name: name(), bound: DEEPEST_NESTING });
            }
            if size > u32::MAX.into() {
                return Err(Error::TooLarge { place: place(), name: name(), size });
            }
        }
        path.pop();
        // An empty message is sent as one byte.
        let measure = Measure { height, size: size.max(1) };
        measured.insert(&message.name, measure);
        Ok(measure)
    }

    /// Of the message a field holds.
    fn measure_field<'a>(
        &'a self,
        owner: &'a MessageDefinition,
        field: &'a Field,
        wanted: &'a TypeName,
        path: &mut Vec<&'a TypeName>,
        measured: &mut Measured<'a>,
    ) -> Result<Measure, Error> {
        let place = || Box::new(field.place.clone());
        let Some(inner) = self.messages.get(wanted) else {
            return Err(Error::UnknownType {
                place: place(),
                owner: Box::new(owner.name.clone()),
                field: field.name.clone(),
                wanted: Box::new(wanted.clone()),
                hint: self.hint_for_field(wanted),
            });
        };
        if let Some(first) = path.iter().position(|name| *name == wanted) {
            let cycle = path[first..].iter().copied().chain([wanted]).cloned().collect();
            return Err(Error::Cycle { place: place(), cycle });
        }
        if path.len() > DEEPEST_NESTING {
            let name = Box::new(owner.name.clone());
            return Err(Error::TooDeep { place: place(), name, bound: DEEPEST_NESTING });
        }
        self.measure(inner, path, measured)
    }
}
