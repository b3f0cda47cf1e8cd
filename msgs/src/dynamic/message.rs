//! Reading messages, and their defaults.

use std::fmt;

use downbeat_msgs_definitions::{Element, FieldType, Shape, TypeName, nearest};

use super::model::{FieldLayout, MessageLayout};
use super::{
    Array, DynamicMessage, DynamicType, FieldError, FieldProblem, MessageRef, Messages, Value, ValueRef, fit,
};
use crate::WString;

impl DynamicMessage {
    /// A message with the defaults of its definition.
    #[must_use]
    pub fn new(of: &DynamicType) -> Self {
        let mut slots = Vec::with_capacity(of.message().slots);
        append_default(of, of.index(), &mut slots);
        Self { of: of.clone(), slots }
    }

    /// Its type.
    #[must_use]
    pub fn message_type(&self) -> &DynamicType {
        &self.of
    }

    /// As in `sensor_msgs/msg/JointState`.
    #[must_use]
    pub fn type_name(&self) -> &TypeName {
        self.of.name()
    }

    /// Borrows the message, like nested ones.
    #[must_use]
    pub fn as_message(&self) -> MessageRef<'_> {
        MessageRef::new(&self.of, self.of.index(), &self.slots)
    }

    /// The names and values of its fields, in order.
    pub fn fields(&self) -> impl Iterator<Item = (&str, ValueRef<'_>)> {
        self.as_message().fields()
    }

    /// The value of a field, as in `header.stamp.sec` or `points[3].x`.
    ///
    /// # Errors
    /// Returns an error if there is no such field or element; the error names what there is.
    pub fn get(&self, path: &str) -> Result<ValueRef<'_>, FieldError> {
        self.as_message().get(path)
    }
}

impl<'a> MessageRef<'a> {
    /// `slots` are exactly those of the message.
    pub(super) fn new(layout: &'a DynamicType, index: usize, slots: &'a [Value]) -> Self {
        Self { layout, index, slots }
    }

    /// Its type.
    #[must_use]
    pub fn message_type(self) -> DynamicType {
        self.layout.at(self.index)
    }

    /// As in `sensor_msgs/msg/JointState`.
    #[must_use]
    pub fn type_name(self) -> &'a TypeName {
        &self.layout().name
    }

    /// The names and values of its fields, in order.
    pub fn fields(self) -> impl Iterator<Item = (&'a str, ValueRef<'a>)> {
        self.layout().fields.iter().map(move |field| (field.name.as_str(), self.value(field)))
    }

    /// The names, types and values of its fields, in order.
    pub fn fields_with_types(self) -> impl Iterator<Item = (&'a str, &'a FieldType, ValueRef<'a>)> {
        self.layout()
            .fields
            .iter()
            .map(move |field| (field.name.as_str(), &field.field_type, self.value(field)))
    }

    /// The value of a field, as in `header.stamp.sec` or `points[3].x`.
    ///
    /// # Errors
    /// Returns an error if there is no such field or element; the error names what there is.
    pub fn get(self, path: &str) -> Result<ValueRef<'a>, FieldError> {
        self.find(path).map_err(|problem| problem.of(self.type_name(), path))
    }

    /// Returns an owned copy.
    #[must_use]
    pub fn to_message(self) -> DynamicMessage {
        DynamicMessage { of: self.message_type(), slots: self.slots.to_vec() }
    }

    /// Returns whether it has no fields.
    pub(super) fn is_empty(self) -> bool {
        self.layout().fields.is_empty()
    }

    pub(super) fn layout(self) -> &'a MessageLayout {
        self.layout.layout().message(self.index)
    }

    pub(super) fn slots(self) -> &'a [Value] {
        self.slots
    }

    /// The value of a field of the message.
    fn value(self, field: &FieldLayout) -> ValueRef<'a> {
        if field.is_one_message() {
            let count = self.layout.layout().message(field.nested).slots;
            let slots = &self.slots[field.slot..field.slot + count];
            return ValueRef::Message(Self::new(self.layout, field.nested, slots));
        }
        ValueRef::from(&self.slots[field.slot])
    }

    fn find(self, path: &str) -> Result<ValueRef<'a>, FieldProblem> {
        let mut here = ValueRef::Message(self);
        for step in steps(path)? {
            here = match (step, here) {
                (Step::Field(name), ValueRef::Message(message)) => {
                    message.value(field_of(message.layout(), name)?)
                }
                (Step::Element(index), ValueRef::Array(array)) => {
                    array.get(index).ok_or(FieldProblem::Index { index, length: array.len() })?
                }
                (step, other) => return Err(misstep(step, other)),
            };
        }
        Ok(here)
    }
}

/// The field of that name, or an error with the nearest one.
pub(super) fn field_of<'a>(message: &'a MessageLayout, name: &str) -> Result<&'a FieldLayout, FieldProblem> {
    message.fields.iter().find(|field| field.name == name).ok_or_else(|| FieldProblem::NoField {
        message: message.name.to_string(),
        wanted: name.to_owned(),
        hint: hint(message, name),
    })
}

/// The error for a step that does not apply to a value.
pub(super) fn misstep(step: Step<'_>, here: ValueRef<'_>) -> FieldProblem {
    let found = fit::describe(here);
    match step {
        Step::Field(name) => FieldProblem::NoFields { wanted: name.to_owned(), found },
        Step::Element(index) => FieldProblem::NoElements { index, found },
    }
}

fn hint(message: &MessageLayout, name: &str) -> String {
    const SHOWN: usize = 12;
    let names = || message.fields.iter().map(|field| field.name.as_str());
    match nearest(name, names()) {
        Some(known) => format!(", did you mean `{known}`?"),
        None if message.fields.is_empty() => ", it has no fields at all".into(),
        None => {
            let list: Vec<String> = names().take(SHOWN).map(|known| format!("`{known}`")).collect();
            let more = if message.fields.len() > SHOWN { ", …" } else { "" };
            format!(", it has {}{more}", list.join(", "))
        }
    }
}

/// Appends the slots of a message with its defaults.
pub(super) fn append_default(layout: &DynamicType, index: usize, slots: &mut Vec<Value>) {
    for field in &layout.layout().message(index).fields {
        if field.is_one_message() {
            append_default(layout, field.nested, slots);
        } else {
            slots.push(match &field.default {
                Some(value) => value.clone(),
                None => zero(layout, field),
            });
        }
    }
}

/// The value of a field without a default.
fn zero(layout: &DynamicType, field: &FieldLayout) -> Value {
    let count = match field.field_type.shape {
        Shape::Single => {
            return match &field.field_type.element {
                Element::Primitive(primitive) => each_primitive!(primitive, T => Value::from(T::default())),
                Element::WString { .. } => Value::WString(WString::default()),
                _ => Value::String(String::new()),
            };
        }
        // Compiling the type bounded the size of fixed arrays.
        Shape::Array(count) => usize::try_from(count).unwrap_or(0),
        Shape::Bounded(_) | Shape::Sequence => 0,
    };
    Value::Array(match &field.field_type.element {
        Element::Primitive(primitive) => each_primitive!(primitive, T => vec![T::default(); count].into()),
        Element::String { .. } => Array::String(vec![String::new(); count]),
        Element::WString { .. } => Array::WString(vec![WString::default(); count]),
        Element::Message(_) => {
            let mut slots = Vec::with_capacity(count * layout.layout().message(field.nested).slots);
            (0..count).for_each(|_| append_default(layout, field.nested, &mut slots));
            Array::Message(Messages { of: layout.nested(field), count, slots })
        }
    })
}

impl PartialEq for DynamicMessage {
    fn eq(&self, other: &Self) -> bool {
        self.as_message() == other.as_message()
    }
}

impl PartialEq for MessageRef<'_> {
    /// Returns whether the type has the same name and the fields have the same names and values.
    fn eq(&self, other: &Self) -> bool {
        self.type_name() == other.type_name() && self.slots == other.slots && self.names().eq(other.names())
    }
}

impl<'a> MessageRef<'a> {
    fn names(self) -> impl Iterator<Item = &'a str> {
        self.layout().fields.iter().map(|field| field.name.as_str())
    }
}

impl fmt::Debug for DynamicMessage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.as_message().fmt(f)
    }
}

impl fmt::Debug for MessageRef<'_> {
    /// Formats like the generated structs, with the full name of the type.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.type_name().to_string();
        let mut shown = f.debug_struct(&name);
        for (name, value) in self.fields() {
            match value {
                ValueRef::Message(message) => shown.field(name, &message),
                ValueRef::Array(array) => each_array!(array, values => shown.field(name, values)),
                ValueRef::String(text) | ValueRef::WString(text) => shown.field(name, &text),
                ValueRef::Bool(value) => shown.field(name, &value),
                ValueRef::Float32(value) => shown.field(name, &value),
                ValueRef::Float64(value) => shown.field(name, &value),
                ValueRef::UInt64(value) => shown.field(name, &value),
                integer => shown.field(name, &integer.as_i64().unwrap_or_default()),
            };
        }
        shown.finish()
    }
}

/// One step of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Step<'a> {
    Field(&'a str),
    Element(usize),
}

/// The steps of a path, in order; at least one.
pub(super) fn steps(path: &str) -> Result<Vec<Step<'_>>, FieldProblem> {
    let mut steps = Vec::new();
    let mut rest = path;
    loop {
        let at = path.len() - rest.len();
        let end = rest.find(['.', '[']).unwrap_or(rest.len());
        let name = &rest[..end];
        if name.is_empty() || name.contains(|c: char| c != '_' && !c.is_ascii_alphanumeric()) {
            return Err(FieldProblem::Path { at, expected: "the name of a field" });
        }
        steps.push(Step::Field(name));
        rest = &rest[end..];
        while let Some(inner) = rest.strip_prefix('[') {
            let at = path.len() - inner.len();
            let number = inner.split(']').next().filter(|number| number.len() < inner.len());
            let Some(number) = number else {
                return Err(FieldProblem::Path { at, expected: "a number and `]`" });
            };
            let is_number = number.bytes().all(|byte| byte.is_ascii_digit());
            match number.parse() {
                Ok(index) if is_number => steps.push(Step::Element(index)),
                _ => return Err(FieldProblem::Path { at, expected: "a number" }),
            }
            rest = &inner[number.len() + 1..];
        }
        match rest.strip_prefix('.') {
            Some(next) => rest = next,
            None if rest.is_empty() => return Ok(steps),
            None => return Err(FieldProblem::Path { at: path.len() - rest.len(), expected: "`.` or `[`" }),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::{Step, steps};

    #[test]
    fn a_path_is_split_into_steps() {
        let expected =
            [Step::Field("a"), Step::Element(3), Step::Field("b_2"), Step::Field("c"), Step::Element(0)];
        assert_eq!(steps("a[3].b_2.c[0]").unwrap(), expected);
    }

    #[test]
    fn invalid_paths_are_reported_with_the_position() {
        for (path, at) in [
            ("", 0),
            (".a", 0),
            ("a.", 2),
            ("a..b", 2),
            ("a[", 2),
            ("a[1", 2),
            ("a[]", 2),
            ("a[-1]", 2),
            ("a[+1]", 2),
            ("a[1]b", 4),
            ("a[99999999999999999999]", 2),
            ("a b", 0),
            ("[0]", 0),
            ("ü", 0),
        ] {
            let problem = steps(path).unwrap_err().to_string();
            assert!(problem.contains(&format!("at byte {at},")), "{path}: {problem}");
        }
    }
}
