//! Sizes on the wire that generated code states.

use crate::{Catalog, Element, Error, FieldType, Shape, TypeName};

impl Catalog {
    /// The fewest bytes the CDR of a message takes, padding not counted.
    ///
    /// # Errors
    /// [`Error::NotInCatalog`] for the message itself or one it contains.
    pub fn least_wire_size(&self, name: &TypeName) -> Result<u64, Error> {
        let mut size: u64 = 0;
        for field in &self.message(name)?.fields {
            size = size.saturating_add(self.least_field_size(&field.field_type)?);
        }
        // An empty message is sent as one byte.
        Ok(size.max(1))
    }

    fn least_field_size(&self, field_type: &FieldType) -> Result<u64, Error> {
        let element = match &field_type.element {
            Element::Primitive(primitive) => primitive.size() as u64,
            Element::String { .. } | Element::WString { .. } => 4,
            Element::Message(name) => self.least_wire_size(name)?,
        };
        Ok(match field_type.shape {
            Shape::Single => element,
            Shape::Array(count) => element.saturating_mul(count),
            Shape::Bounded(_) | Shape::Sequence => 4,
        })
    }
}
