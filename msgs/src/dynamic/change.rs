//! Changing messages by the paths of their fields.

use downbeat_msgs_definitions::Shape;

use super::fit::{self, Scalar as _};
use super::message::{Step, append_default, field_of, misstep, steps};
use super::model::{FieldLayout, Messages};
use super::{Array, DynamicMessage, DynamicType, FieldError, FieldProblem, Value, ValueRef};
use crate::WString;

impl DynamicMessage {
    /// Sets a field, or an element of one.
    ///
    /// Integers are converted if they are in range. Integers and floating-point numbers are converted to each
    /// other if nothing is lost. A message must have the type of the field.
    ///
    /// ```
    /// # use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
    /// # let of = DynamicType::from_definition_text("my_msgs/msg/Scan", "ros2msg", "uint8 mode\nfloat64[3] range\n")?;
    /// let mut scan = DynamicMessage::new(&of);
    /// scan.set("mode", 3)?;
    /// scan.set("range", vec![1, 2, 3])?;
    /// scan.set("range[1]", 2.5)?;
    /// assert_eq!(scan.get("range[1]")?.as_f64(), Some(2.5));
    /// assert_eq!(
    ///     scan.set("mode", 256).unwrap_err().to_string(),
    ///     "my_msgs/msg/Scan, field `mode`: takes a uint8, which cannot hold 256"
    /// );
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// Returns an error if there is no such field, or it cannot have this value. The message is then
    /// unchanged.
    pub fn set(&mut self, path: &str, value: impl Into<Value>) -> Result<(), FieldError> {
        self.at(path, |place| place.set(value.into()))
    }

    /// Appends an element to a sequence.
    ///
    /// # Errors
    /// Returns an error if there is no such sequence, it is full, or it cannot have this value. The message
    /// is then unchanged.
    pub fn push(&mut self, path: &str, value: impl Into<Value>) -> Result<(), FieldError> {
        self.at(path, |place| place.push(value.into()))
    }

    /// Resizes a sequence: removes its last elements, or appends elements with the defaults of their type.
    ///
    /// # Errors
    /// Returns an error if there is no such sequence, or `count` exceeds its bound.
    pub fn resize(&mut self, path: &str, count: usize) -> Result<(), FieldError> {
        self.at(path, |place| place.resize(count))
    }

    fn at(
        &mut self,
        path: &str,
        act: impl FnOnce(Place<'_>) -> Result<(), FieldProblem>,
    ) -> Result<(), FieldError> {
        let Self { of, slots } = self;
        let whole = Place::Message { layout: of, index: of.index(), slots };
        steps(path)
            .and_then(|steps| steps.into_iter().try_fold(whole, Place::step))
            .and_then(act)
            .map_err(|problem| problem.of(of.name(), path))
    }
}

/// The target of a path.
pub(super) enum Place<'a> {
    Message { layout: &'a DynamicType, index: usize, slots: &'a mut [Value] },
    Slot { layout: &'a DynamicType, field: &'a FieldLayout, value: &'a mut Value },
    Element { field: &'a FieldLayout, array: &'a mut Array, index: usize },
}

impl<'a> Place<'a> {
    fn step(self, step: Step<'_>) -> Result<Self, FieldProblem> {
        match (step, self) {
            (Step::Field(name), Place::Message { layout, index, slots }) => {
                let field = field_of(layout.layout().message(index), name)?;
                Ok(field_place(layout, field, slots))
            }
            (Step::Element(index), Place::Slot { field, value: Value::Array(array), .. }) => {
                let length = array.len();
                if index >= length {
                    return Err(FieldProblem::Index { index, length });
                }
                Ok(match array {
                    Array::Message(messages) => {
                        element_place(messages, index).ok_or(FieldProblem::Index { index, length })?
                    }
                    array => Place::Element { field, array, index },
                })
            }
            (step, Place::Slot { value, .. }) => Err(misstep(step, ValueRef::from(&*value))),
            (step, Place::Element { array, index, .. }) => Err(match array.get(index) {
                Some(value) => misstep(step, value),
                None => FieldProblem::Index { index, length: array.len() },
            }),
            (Step::Element(index), Place::Message { layout, index: message, .. }) => {
                let found = format!("a {}", layout.layout().message(message).name);
                Err(FieldProblem::NoElements { index, found })
            }
        }
    }

    pub(super) fn set(self, value: Value) -> Result<(), FieldProblem> {
        match self {
            Place::Message { layout, index, slots } => match value {
                Value::Message(message) if message.of == layout.at(index) => {
                    slots.clone_from_slice(&message.slots);
                    Ok(())
                }
                other => {
                    let expected = format!("a {}", layout.layout().message(index).name);
                    Err(fit::kind(expected, ValueRef::from(&other)))
                }
            },
            Place::Slot { layout, field, value: slot } => {
                let nested = layout.nested(field);
                *slot = fit::fit(&field.field_type, Some(&nested), value)?;
                Ok(())
            }
            Place::Element { field, array, index } => {
                let value = fit::fit_element(&field.field_type.element, value)?;
                put(array, index, value)
            }
        }
    }

    fn push(self, value: Value) -> Result<(), FieldProblem> {
        let (field, array) = self.sequence("an element")?;
        fit::check_count(field.field_type.shape, array.len() + 1)?;
        match (array, value) {
            (Array::Message(messages), Value::Message(message)) if message.of == messages.of => {
                messages.slots.extend(message.slots);
                messages.count += 1;
                Ok(())
            }
            (Array::Message(messages), other) => {
                Err(fit::kind(format!("a {}", messages.of.name()), ValueRef::from(&other)))
            }
            (array, value) => {
                let value = fit::fit_element(&field.field_type.element, value)?;
                let index = array.len();
                resize(array, index + 1);
                put(array, index, value)
            }
        }
    }

    fn resize(self, count: usize) -> Result<(), FieldProblem> {
        let (field, array) = self.sequence("another length")?;
        fit::check_count(field.field_type.shape, count)?;
        resize(array, count);
        Ok(())
    }

    /// The array at this place, if its length can change; `wanted` names the operation in errors.
    fn sequence(self, wanted: &str) -> Result<(&'a FieldLayout, &'a mut Array), FieldProblem> {
        let expected = || format!("a sequence for {wanted}");
        match self {
            Place::Slot { field, value: Value::Array(array), .. } => match field.field_type.shape {
                Shape::Array(_) => Err(FieldProblem::Kind {
                    expected: expected(),
                    found: format!("`{}`, whose length is fixed", field.field_type),
                }),
                _ => Ok((field, array)),
            },
            Place::Slot { value, .. } => Err(fit::kind(expected(), ValueRef::from(&*value))),
            Place::Element { field, .. } => Err(FieldProblem::Kind {
                expected: expected(),
                found: format!("an element of `{}`", field.field_type),
            }),
            Place::Message { layout, index, .. } => Err(FieldProblem::Kind {
                expected: expected(),
                found: format!("a {}", layout.layout().message(index).name),
            }),
        }
    }
}

/// The place of a field within a message.
pub(super) fn field_place<'a>(
    layout: &'a DynamicType,
    field: &'a FieldLayout,
    slots: &'a mut [Value],
) -> Place<'a> {
    if field.is_one_message() {
        let count = layout.layout().message(field.nested).slots;
        let slots = &mut slots[field.slot..field.slot + count];
        return Place::Message { layout, index: field.nested, slots };
    }
    Place::Slot { layout, field, value: &mut slots[field.slot] }
}

/// The place of one of several messages.
pub(super) fn element_place(messages: &mut Messages, index: usize) -> Option<Place<'_>> {
    let stride = messages.of.message().slots;
    let Messages { of, count, slots } = messages;
    if index >= *count {
        return None;
    }
    let slots = slots.get_mut(index * stride..(index + 1) * stride)?;
    Some(Place::Message { layout: of, index: of.index(), slots })
}

/// Resizes an array, with the defaults of their type for new elements.
pub(super) fn resize(array: &mut Array, count: usize) {
    match array {
        Array::Bool(values) => values.resize(count, false),
        Array::Int8(values) => values.resize(count, 0),
        Array::UInt8(values) => values.resize(count, 0),
        Array::Int16(values) => values.resize(count, 0),
        Array::UInt16(values) => values.resize(count, 0),
        Array::Int32(values) => values.resize(count, 0),
        Array::UInt32(values) => values.resize(count, 0),
        Array::Int64(values) => values.resize(count, 0),
        Array::UInt64(values) => values.resize(count, 0),
        Array::Float32(values) => values.resize(count, 0.0),
        Array::Float64(values) => values.resize(count, 0.0),
        Array::String(values) => values.resize(count, String::new()),
        Array::WString(values) => values.resize(count, WString::default()),
        Array::Message(messages) => {
            messages.slots.truncate(count.saturating_mul(messages.of.message().slots));
            for _ in messages.count..count {
                append_default(&messages.of, messages.of.index(), &mut messages.slots);
            }
            messages.count = count;
        }
    }
}

/// Replaces an element by a value of the array's type.
fn put(array: &mut Array, index: usize, value: Value) -> Result<(), FieldProblem> {
    let length = array.len();
    let none = || FieldProblem::Index { index, length };
    macro_rules! put {
        ($values:ident, $of:ty) => {
            *$values.get_mut(index).ok_or_else(none)? = <$of>::fit(ValueRef::from(&value))?
        };
    }
    match array {
        Array::Bool(values) => put!(values, bool),
        Array::Int8(values) => put!(values, i8),
        Array::UInt8(values) => put!(values, u8),
        Array::Int16(values) => put!(values, i16),
        Array::UInt16(values) => put!(values, u16),
        Array::Int32(values) => put!(values, i32),
        Array::UInt32(values) => put!(values, u32),
        Array::Int64(values) => put!(values, i64),
        Array::UInt64(values) => put!(values, u64),
        Array::Float32(values) => put!(values, f32),
        Array::Float64(values) => put!(values, f64),
        Array::String(values) => put!(values, String),
        Array::WString(values) => put!(values, WString),
        Array::Message(messages) => {
            return Err(fit::kind(format!("a {}", messages.of.name()), ValueRef::from(&value)));
        }
    }
    Ok(())
}
