//! Fills a message from a self-describing serde format: JSON, YAML, CBOR.
//!
//! # References
//! `ros2/rosidl_runtime_py` branch jazzy, `rosidl_runtime_py/set_message.py`: which values are accepted for
//! which field.

use std::cell::{Cell, RefCell};
use std::fmt;

use downbeat_msgs_definitions::{Element, Primitive, Shape, TypeName};
use serde::de::{
    DeserializeSeed, Deserializer, EnumAccess, Error, IgnoredAny, MapAccess, SeqAccess, VariantAccess,
    Visitor,
};

use super::scalar;
use crate::builtin_interfaces::msg::Time;
use crate::dynamic::change::{Place, element_place, field_place, resize};
use crate::dynamic::message::field_of;
use crate::dynamic::{Array, DynamicMessage, FieldError, FieldProblem, Messages, Value, ValueRef, fit};

/// Maximum memory in bytes of the messages in sequences: a few characters can represent a message with long
/// fixed arrays.
const MOST_MEMORY: u64 = 256 << 20;

/// State while a message is filled.
pub(super) struct State<'a> {
    pub type_name: &'a TypeName,
    /// The paths of the times to set when the message is sent.
    pub stamps: RefCell<Vec<String>>,
    /// The structured error, if the format's error only has its text.
    pub error: RefCell<Option<FieldError>>,
    pub memory: Cell<u64>,
    pub nothing: Nothing,
}

/// The meaning of `null` for a number.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Nothing {
    /// JSON has no NaN: serde writes null instead.
    IsNan,
    /// A key without a value: a mistake, as in rclpy.
    IsRefused,
}

/// The value to fill.
pub(super) struct Fill<'a> {
    pub place: Place<'a>,
    pub trail: &'a Trail<'a>,
    pub state: &'a State<'a>,
}

/// The path from the message to a field in it.
pub(super) enum Trail<'a> {
    Root,
    Field(&'a Trail<'a>, &'a str),
    Element(&'a Trail<'a>, usize),
}

impl fmt::Display for Trail<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Root => Ok(()),
            Self::Field(Self::Root, name) => f.write_str(name),
            Self::Field(parent, name) => write!(f, "{parent}.{name}"),
            Self::Element(parent, index) => write!(f, "{parent}[{index}]"),
        }
    }
}

impl<'de> DeserializeSeed<'de> for Fill<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        match self.text_wanted() {
            // In YAML this includes text that looks like a number, unchanged.
            true if self.state.nothing == Nothing::IsRefused => deserializer.deserialize_option(self),
            true => deserializer.deserialize_str(self),
            false => deserializer.deserialize_any(self),
        }
    }
}

impl<'de> Visitor<'de> for Fill<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} for the field `{}`", self.wanted(), self.trail)
    }

    fn visit_bool<E: Error>(self, value: bool) -> Result<(), E> {
        self.scalar(Value::Bool(value))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<(), E> {
        self.scalar(Value::Int64(value))
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<(), E> {
        self.scalar(Value::UInt64(value))
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<(), E> {
        self.scalar(Value::Float64(value))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<(), E> {
        if let Place::Message { layout, index, .. } = &self.place {
            let name = &layout.layout().message(*index).name;
            let is_within = !matches!(self.trail, Trail::Root);
            let stamp = match text {
                "auto" if is_within && is_header(name) => Some(format!("{}.stamp", self.trail)),
                "now" if is_within && is_time(name) => Some(self.trail.to_string()),
                _ => None,
            };
            if let Some(stamp) = stamp {
                self.state.stamps.borrow_mut().push(stamp);
                return Ok(());
            }
        }
        self.scalar(Value::String(text.into()))
    }

    fn visit_none<E: Error>(self) -> Result<(), E> {
        self.visit_unit()
    }

    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_str(self)
    }

    fn visit_unit<E: Error>(self) -> Result<(), E> {
        if self.state.nothing == Nothing::IsRefused && !matches!(self.trail, Trail::Root) {
            return Err(fail(self.state, self.trail, FieldProblem::Empty));
        }
        if let Some(Element::Primitive(Primitive::Float32 | Primitive::Float64)) = self.element() {
            return self.scalar(Value::Float64(f64::NAN));
        }
        Err(self.fail_kind("nothing".into()))
    }

    /// A value with a tag of its own, such as `!binary`, which stands for YAML's `!!binary`.
    fn visit_enum<A: EnumAccess<'de>>(self, tagged: A) -> Result<(), A::Error> {
        let (tag, content) = tagged.variant::<String>()?;
        let found = format!("a value with the tag `{tag}`");
        let name = tag.trim_start_matches('!');
        if !matches!(name, "bool" | "int" | "float") && (name != "binary" || !self.takes_bytes()) {
            return Err(self.fail_kind(found));
        }
        let text = content.newtype_variant::<String>()?;
        // As PyYAML constructs them.
        let value = match name {
            "bool" => scalar::truth_value(&text.to_lowercase()).map(Value::Bool),
            "int" => whole_number(&text),
            "float" => scalar::float(&text).map(Value::Float64),
            _ => {
                return match base64(&text) {
                    Some(bytes) => self.visit_bytes(&bytes),
                    None => Err(self.fail_kind("bytes that are not Base64".into())),
                };
            }
        };
        match value {
            Some(value) => self.scalar(value),
            None => Err(self.fail_kind(format!("`{text}` with the tag `!!{name}`"))),
        }
    }

    fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<(), E> {
        match (self.element(), bytes) {
            (Some(Element::Primitive(Primitive::Byte)), [byte]) => self.assign(Value::UInt8(*byte)),
            _ => self.assign(Value::from(bytes.to_vec())),
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        let Self { place, trail, state } = self;
        let Place::Message { layout, index, slots } = place else {
            return Err(Self { place, trail, state }.fail_kind("a mapping".into()));
        };
        while let Some(name) = map.next_key::<String>()? {
            let trail = Trail::Field(trail, &name);
            match field_of(layout.layout().message(index), &name) {
                Ok(field) => {
                    let place = field_place(layout, field, slots);
                    map.next_value_seed(Fill { place, trail: &trail, state })?;
                }
                Err(problem) => return Err(fail(state, &trail, problem)),
            }
        }
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<(), A::Error> {
        let Self { place, trail, state } = self;
        let Place::Slot { field, value: Value::Array(array), .. } = place else {
            while elements.next_element::<IgnoredAny>()?.is_some() {}
            return Err(Self { place, trail, state }.fail_kind("a sequence".into()));
        };
        let most = match field.field_type.shape {
            Shape::Array(count) | Shape::Bounded(count) => usize::try_from(count).unwrap_or(usize::MAX),
            _ => usize::MAX,
        };
        let mut filled = empty_like(array);
        let memory = match &filled {
            Array::Message(messages) => messages.of.message().memory.max(1),
            _ => 0,
        };
        let mut count = 0;
        loop {
            let trail = Trail::Element(trail, count);
            if count == most {
                // The array is full; check that no element follows.
                if elements.next_element::<IgnoredAny>()?.is_some() {
                    let problem = fit::check_count(field.field_type.shape, count + 1);
                    return Err(fail(
                        state,
                        &trail,
                        problem.err().unwrap_or(FieldProblem::Index { index: count, length: count }),
                    ));
                }
                break;
            }
            state.memory.set(state.memory.get().saturating_add(memory));
            if state.memory.get() > MOST_MEMORY {
                return Err(fail(state, &trail, FieldProblem::Memory { limit: MOST_MEMORY }));
            }
            resize(&mut filled, count + 1);
            let place = match &mut filled {
                Array::Message(messages) => element_place(messages, count),
                array => Some(Place::Element { field, array, index: count }),
            };
            let Some(place) = place else { break };
            if elements.next_element_seed(Fill { place, trail: &trail, state })?.is_none() {
                break;
            }
            count += 1;
        }
        resize(&mut filled, count);
        match fit::check_count(field.field_type.shape, count) {
            Ok(()) => *array = filled,
            Err(problem) => return Err(fail(state, trail, problem)),
        }
        Ok(())
    }
}

impl Fill<'_> {
    fn scalar<E: Error>(self, value: Value) -> Result<(), E> {
        let value = match self.element() {
            Some(element) => lenient(element, value),
            None => value,
        };
        self.assign(value)
    }

    fn assign<E: Error>(self, value: Value) -> Result<(), E> {
        let Self { place, trail, state } = self;
        place.set(value).map_err(|problem| fail(state, trail, problem))
    }

    /// The type of a single value; `None` for messages and arrays.
    fn element(&self) -> Option<&Element> {
        match &self.place {
            Place::Slot { field, .. } if field.field_type.shape == Shape::Single => {
                Some(&field.field_type.element)
            }
            Place::Element { field, .. } => Some(&field.field_type.element),
            _ => None,
        }
    }

    /// Whether it is an array of bytes, or a byte.
    fn takes_bytes(&self) -> bool {
        let Place::Slot { field, .. } = &self.place else { return false };
        match (&field.field_type.element, field.field_type.shape) {
            (Element::Primitive(Primitive::Byte), _) => true,
            (Element::Primitive(Primitive::Char | Primitive::UInt8), shape) => shape != Shape::Single,
            _ => false,
        }
    }

    fn text_wanted(&self) -> bool {
        matches!(self.element(), Some(Element::String { .. } | Element::WString { .. }))
    }

    fn wanted(&self) -> String {
        match &self.place {
            Place::Message { layout, index, .. } => {
                format!("a mapping ({})", layout.layout().message(*index).name)
            }
            Place::Slot { field, .. } => format!("a {}", field.field_type),
            Place::Element { field, .. } => format!("an element of a {}", field.field_type),
        }
    }

    #[cold]
    fn fail_kind<E: Error>(&self, found: String) -> E {
        fail(self.state, self.trail, FieldProblem::Kind { expected: self.wanted(), found })
    }
}

/// Decodes Base64 (RFC 4648, section 4) with white space anywhere.
fn base64(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<u8> = text.bytes().filter(|byte| !byte.is_ascii_whitespace()).collect();
    if !digits.len().is_multiple_of(4) {
        return None;
    }
    let padding = digits.iter().rev().take_while(|digit| **digit == b'=').count();
    let (mut bytes, mut bits, mut count) = (Vec::new(), 0_u32, 0);
    for digit in &digits[..digits.len() - padding] {
        let value = match digit {
            b'A'..=b'Z' => digit - b'A',
            b'a'..=b'z' => digit - b'a' + 26,
            b'0'..=b'9' => digit - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        bits = (bits << 6) | u32::from(value);
        count += 6;
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count) as u8);
        }
    }
    (padding <= 2).then_some(bytes)
}

#[cold]
fn fail<E: Error>(state: &State<'_>, trail: &Trail<'_>, problem: FieldProblem) -> E {
    let error = problem.of(state.type_name, &trail.to_string());
    let shown = E::custom(&error);
    *state.error.borrow_mut() = Some(error);
    shown
}

/// Parses strings as numbers and booleans like YAML 1.1 and Python.
fn lenient(element: &Element, value: Value) -> Value {
    let Element::Primitive(primitive) = element else { return value };
    let is_float = matches!(primitive, Primitive::Float32 | Primitive::Float64);
    let read = match (primitive, &value) {
        (Primitive::Bool, Value::String(text)) => scalar::truth_value(text).map(Value::Bool),
        (Primitive::Bool, number) => match ValueRef::from(number).as_i64() {
            Some(number @ (0 | 1)) => Some(Value::Bool(number == 1)),
            _ => None,
        },
        // The format of `ros2 topic echo`.
        (Primitive::Byte, Value::String(text)) => {
            let mut characters = text.chars();
            match (characters.next().map(u8::try_from), characters.next()) {
                (Some(Ok(byte)), None) => Some(Value::UInt8(byte)),
                _ => None,
            }
        }
        (_, Value::String(text)) if is_float => text.trim().parse().ok().map(Value::Float64),
        (_, Value::String(text)) => whole_number(text.trim()),
        _ => None,
    };
    read.unwrap_or(value)
}

fn whole_number(text: &str) -> Option<Value> {
    let number = scalar::integer(text)?;
    let signed = i64::try_from(number).map(Value::Int64);
    signed.or_else(|_| u64::try_from(number).map(Value::UInt64)).ok()
}

/// An array of the same kind without elements.
fn empty_like(array: &Array) -> Array {
    match array {
        Array::Message(messages) => {
            Array::Message(Messages { of: messages.of.clone(), count: 0, slots: Vec::new() })
        }
        Array::Bool(_) => Array::Bool(Vec::new()),
        Array::Int8(_) => Array::Int8(Vec::new()),
        Array::UInt8(_) => Array::UInt8(Vec::new()),
        Array::Int16(_) => Array::Int16(Vec::new()),
        Array::UInt16(_) => Array::UInt16(Vec::new()),
        Array::Int32(_) => Array::Int32(Vec::new()),
        Array::UInt32(_) => Array::UInt32(Vec::new()),
        Array::Int64(_) => Array::Int64(Vec::new()),
        Array::UInt64(_) => Array::UInt64(Vec::new()),
        Array::Float32(_) => Array::Float32(Vec::new()),
        Array::Float64(_) => Array::Float64(Vec::new()),
        Array::String(_) => Array::String(Vec::new()),
        Array::WString(_) => Array::WString(Vec::new()),
    }
}

/// The times of a message that its text asks the sender to set: `header: auto` and `stamp: now`, as in `ros2
/// topic pub`.
///
/// ```
/// use downbeat_msgs::builtin_interfaces::msg::Time;
/// use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
/// use downbeat_msgs::sensor_msgs::msg::JointState;
///
/// let mut joints = DynamicMessage::new(&DynamicType::of::<JointState>()?);
/// let stamps = joints.fill_yaml("{header: auto, name: [pan], position: [0.25]}")?;
/// stamps.set(&mut joints, Time { sec: 5, nanosec: 0 })?; // before each time it is sent
/// assert_eq!(joints.get("header.stamp.sec")?.as_i64(), Some(5));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stamps {
    pub(super) paths: Vec<String>,
}

impl Stamps {
    /// Returns whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.paths.is_empty()
    }

    /// The paths of the times.
    pub fn paths(&self) -> impl Iterator<Item = &str> {
        self.paths.iter().map(String::as_str)
    }

    /// Sets all of them to this value.
    ///
    /// # Errors
    /// Returns an error if the message has a different type than the filled one.
    pub fn set(&self, message: &mut DynamicMessage, time: Time) -> Result<(), FieldError> {
        for path in &self.paths {
            message.set(&format!("{path}.sec"), time.sec)?;
            message.set(&format!("{path}.nanosec"), time.nanosec)?;
        }
        Ok(())
    }
}

fn is_header(name: &TypeName) -> bool {
    name.package == "std_msgs" && name.kind.as_str() == "msg" && name.name == "Header"
}

fn is_time(name: &TypeName) -> bool {
    name.package == "builtin_interfaces" && name.kind.as_str() == "msg" && name.name == "Time"
}
