//! Parts of generated code, for the derive macro: it adds the same code to a struct.

use downbeat_msgs_definitions::{Element, FieldType, Shape};

pub use super::cdr::decode_call;
pub use super::description::modifiers;
pub use super::names::primitive;

/// A type in Rust terms, for error messages.
#[must_use]
pub fn in_rust(field_type: &FieldType) -> String {
    let element = match &field_type.element {
        Element::Primitive(of) => primitive(*of).to_owned(),
        Element::String { .. } => "String".into(),
        Element::WString { .. } => "WString".into(),
        Element::Message(name) => format!("the struct of {name}"),
    };
    match (field_type.shape, &field_type.element) {
        (Shape::Single, Element::Message(_)) => element,
        (Shape::Single, _) => format!("`{element}`"),
        (shape, Element::Message(_)) => format!("{} of {element}", in_words(shape)),
        (Shape::Array(count), _) => format!("`[{element}; {count}]`"),
        (Shape::Bounded(_) | Shape::Sequence, _) => format!("`Vec<{element}>`"),
    }
}

fn in_words(shape: Shape) -> String {
    match shape {
        Shape::Array(count) => format!("an array of length {count}"),
        _ => "a `Vec`".into(),
    }
}
