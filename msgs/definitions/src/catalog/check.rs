//! Checks that the references between definitions resolve and do not form cycles.

use std::collections::BTreeMap;

use super::Catalog;
use crate::{Element, Error, Field, MessageDefinition, Shape, TypeName};

/// Deeper than any interface (rosbag2's limit is 50), and shallow enough for any stack.
const DEEPEST_NESTING: usize = 64;

/// What is known of a message after visiting everything it contains.
#[derive(Clone, Copy)]
struct Measure {
    /// Levels of nesting, including the message itself.
    height: usize,
    /// The minimum size on the wire, without padding.
    size: u64,
}

/// The visited messages.
type Measured<'a> = BTreeMap<&'a TypeName, Measure>;

impl Catalog {
    /// Checks that the type of every field exists, that no message contains itself or is nested too deeply,
    /// and that each is small enough to be sent.
    ///
    /// # Errors
    /// [`Error::UnknownType`], [`Error::Cycle`], [`Error::TooDeep`] or [`Error::TooLarge`], the first one
    /// found.
    pub fn check(&self) -> Result<(), Error> {
        let mut measured = Measured::new();
        self.messages
            .values()
            .try_for_each(|message| self.measure(message, &mut Vec::new(), &mut measured).map(|_| ()))
    }

    /// Like [`Catalog::check`], for one type and the types it refers to.
    ///
    /// # Errors
    /// The errors of [`Catalog::check`], and [`Error::NotInCatalog`].
    pub fn check_type(&self, name: &TypeName) -> Result<(), Error> {
        let description = self.type_description(name);
        let mut measured = Measured::new();
        let mut check = |name: &TypeName| match self.messages.get(name) {
            Some(message) => self.measure(message, &mut Vec::new(), &mut measured).map(|_| ()),
            None => Ok(()),
        };
        check(name)?;
        // For a service or an action these are its parts.
        for part in &description?.referenced_type_descriptions {
            check(&part.type_name.parse()?)?;
        }
        Ok(())
    }

    /// The minimum size of a message in CDR, without padding.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`] for the message itself, and the errors of [`Catalog::check`] for its contents.
    pub fn least_wire_size(&self, name: &TypeName) -> Result<u64, Error> {
        Ok(self.measure(self.message(name)?, &mut Vec::new(), &mut Measured::new())?.size)
    }

    /// `path` leads here from the start of the check: messages, each with the field that refers to the next
    /// one.
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

    /// Measures the message in a field.
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
