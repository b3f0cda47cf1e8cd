//! Determines which messages have a fixed layout, wherever they are.

use downbeat_msgs_definitions::{Catalog, Element, Error, Field, MessageDefinition, Primitive, Shape};

/// The layout of a message whose values all have the same layout and need no padding between them.
pub(super) struct Layout<'a> {
    /// A value starts at a multiple of it.
    pub alignment: u64,
    /// The size of a value in bytes: a multiple of the alignment.
    pub size: u64,
    pub parts: Vec<Part<'a>>,
}

pub(super) enum Part<'a> {
    Padding(u64),
    Field(&'a Field),
}

/// The layout of a message, if it has a fixed one. It must be the same in both versions of XCDR except for
/// the start of the value. In version 2 that is a multiple of 4 instead of 8, so that padding before eight
/// bytes would differ.
pub(super) fn plain_layout<'a>(
    catalog: &Catalog,
    message: &'a MessageDefinition,
) -> Result<Option<Layout<'a>>, Error> {
    let mut layout = Layout { alignment: 0, size: 0, parts: Vec::new() };
    for field in &message.fields {
        let count = match field.field_type.shape {
            Shape::Single => 1,
            Shape::Array(count) if count > 0 => count,
            _ => return Ok(None),
        };
        let (alignment, size) = match &field.field_type.element {
            // A boolean must be validated.
            Element::Primitive(Primitive::Bool) | Element::String { .. } | Element::WString { .. } => {
                return Ok(None);
            }
            Element::Primitive(primitive) => (primitive.size() as u64, primitive.size() as u64),
            Element::Message(name) => match plain_layout(catalog, catalog.message(name)?)? {
                Some(inner) => (inner.alignment, inner.size),
                None => return Ok(None),
            },
        };
        if layout.alignment == 0 {
            layout.alignment = alignment;
        }
        let padding = layout.size.next_multiple_of(alignment) - layout.size;
        if alignment > layout.alignment || (alignment == 8 && padding > 0) {
            return Ok(None);
        }
        if padding > 0 {
            layout.parts.push(Part::Padding(padding));
        }
        layout.parts.push(Part::Field(field));
        let Some(end) = size.checked_mul(count).and_then(|size| size.checked_add(layout.size + padding))
        else {
            return Ok(None);
        };
        layout.size = end;
    }
    if message.fields.is_empty() {
        // It is sent as one byte.
        layout = Layout { alignment: 1, size: 1, parts: vec![Part::Padding(1)] };
    }
    Ok(layout.size.is_multiple_of(layout.alignment).then_some(layout))
}
