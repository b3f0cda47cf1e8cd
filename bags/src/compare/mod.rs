//! Compares messages field by field: bit for bit, or with the tolerances of rules.
//!
//! ```
//! use downbeat_bags::{Comparer, FieldRule, TopicDescription};
//!
//! let topic = TopicDescription {
//!     name: "/battery".to_owned(),
//!     type_name: "my_msgs/msg/Battery".to_owned(),
//!     definition: "float32 voltage\n".to_owned(),
//!     ..TopicDescription::default()
//! };
//! let (one, other) = ([0, 1, 0, 0, 0, 0, 64, 65], [0, 1, 0, 0, 1, 0, 64, 65]);
//! let difference = Comparer::new(&topic, &[]).compare(&one, &other).expect("a bit differs");
//! assert_eq!(difference.to_string(), "voltage: 12.0 and 12.000001");
//!
//! let rule = FieldRule::tolerance("battery:voltage=0.001")?;
//! assert_eq!(Comparer::new(&topic, &[rule]).compare(&one, &other), None);
//! # Ok::<(), downbeat_bags::FieldRuleError>(())
//! ```

mod rule;

use std::fmt;

use downbeat_msgs::dynamic::{Definitions, DynamicMessage, DynamicType, MessageRef, ValueRef};

use crate::topic::TopicDescription;
use rule::Allowed;
pub use rule::{FieldRule, FieldRuleError};

/// Compares messages of one topic, given as CDR.
#[derive(Debug)]
pub struct Comparer {
    /// `None` if the definition is unknown: then bytes are compared.
    message_type: Option<DynamicType>,
    rules: Vec<FieldRule>,
}

/// The first field in which two messages differ.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FieldDifference {
    /// The path of the field, `position[3]`; `byte 17` if the fields are unknown.
    pub path: String,
    /// The value in the first message.
    pub first: String,
    /// The value in the second message.
    pub second: String,
}

impl fmt::Display for FieldDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {} and {}", self.path, self.first, self.second)
    }
}

impl Comparer {
    /// Creates a comparer for messages of a topic. It uses the rules that apply to the topic; if several
    /// apply to a field, the last one is used.
    #[must_use]
    pub fn new(topic: &TopicDescription, rules: &[FieldRule]) -> Self {
        let rules = rules.iter().filter(|rule| rule.means_topic(&topic.name)).cloned().collect();
        Self { message_type: message_type(topic), rules }
    }

    /// Returns whether a rule excludes the topic.
    #[must_use]
    pub fn ignores_all(&self) -> bool {
        self.rules.last().is_some_and(FieldRule::ignores_everything)
    }

    /// The first field in which the messages differ by more than the rules allow.
    ///
    /// Numbers are equal if their bits are equal, unless a rule sets a tolerance. If fields cannot be read,
    /// bytes are compared.
    #[must_use]
    pub fn compare(&self, first: &[u8], second: &[u8]) -> Option<FieldDifference> {
        if first == second || self.ignores_all() {
            return None;
        }
        let decode =
            |bytes: &[u8]| self.message_type.as_ref().and_then(|of| DynamicMessage::from_cdr(of, bytes).ok());
        match (decode(first), decode(second)) {
            (Some(first), Some(second)) => {
                first_difference(first.as_message(), second.as_message(), &self.rules)
            }
            _ => Some(bytes_difference(first, second)),
        }
    }
}

/// The definition of the topic's type: that of the bag, or else the built-in one.
fn message_type(topic: &TopicDescription) -> Option<DynamicType> {
    let found = topic.definition_with(&Definitions::new().with_carried());
    found.ok().map(|found| found.definition.message_type)
}

fn bytes_difference(first: &[u8], second: &[u8]) -> FieldDifference {
    let position = first.iter().zip(second).position(|(first, second)| first != second);
    let position = position.unwrap_or(first.len().min(second.len()));
    let at = |bytes: &[u8]| {
        bytes.get(position).map_or_else(|| format!("{} bytes", bytes.len()), |byte| format!("0x{byte:02x}"))
    };
    FieldDifference { path: format!("byte {position}"), first: at(first), second: at(second) }
}

/// Longer strings are truncated in reports.
const LONGEST_TEXT: usize = 80;

fn first_difference(
    first: MessageRef<'_>,
    second: MessageRef<'_>,
    rules: &[FieldRule],
) -> Option<FieldDifference> {
    Walk { rules, path: String::new() }.messages(first, second)
}

struct Walk<'a> {
    rules: &'a [FieldRule],
    path: String,
}

impl Walk<'_> {
    fn messages(&mut self, first: MessageRef<'_>, second: MessageRef<'_>) -> Option<FieldDifference> {
        for ((name, first), (_, second)) in first.fields().zip(second.fields()) {
            let length = self.path.len();
            if length > 0 {
                self.path.push('.');
            }
            self.path.push_str(name);
            let difference = self.values(first, second);
            self.path.truncate(length);
            if difference.is_some() {
                return difference;
            }
        }
        None
    }

    fn values(&mut self, first: ValueRef<'_>, second: ValueRef<'_>) -> Option<FieldDifference> {
        let allowed = self.allowed();
        if allowed == Some(Allowed::Anything) {
            return None;
        }
        match (first, second) {
            (ValueRef::Message(first), ValueRef::Message(second)) => self.messages(first, second),
            (ValueRef::Array(first), ValueRef::Array(second)) => {
                if first.len() != second.len() {
                    let count = |count: usize| format!("{count} values");
                    return Some(self.difference(count(first.len()), count(second.len())));
                }
                for (index, (first, second)) in first.iter().zip(second.iter()).enumerate() {
                    let length = self.path.len();
                    self.path.push_str(&format!("[{index}]"));
                    let difference = self.values(first, second);
                    self.path.truncate(length);
                    if difference.is_some() {
                        return difference;
                    }
                }
                None
            }
            _ if is_same(first, second) => None,
            _ if allowed.is_some_and(|allowed| is_near(first, second, allowed)) => None,
            _ => {
                let (mut one, mut other) = (text(first), text(second));
                if one == other {
                    one += &bits(first);
                    other += &bits(second);
                }
                Some(self.difference(one, other))
            }
        }
    }

    /// The tolerance of the last rule that applies to this field.
    fn allowed(&self) -> Option<Allowed> {
        self.rules.iter().rev().find(|rule| rule.means_field(&self.path)).map(FieldRule::allowed)
    }

    fn difference(&self, first: String, second: String) -> FieldDifference {
        FieldDifference { path: self.path.clone(), first, second }
    }
}

/// Compares floating-point numbers by their bits: a NaN equals itself, and zeros have a sign.
fn is_same(first: ValueRef<'_>, second: ValueRef<'_>) -> bool {
    match (first, second) {
        (ValueRef::Float32(first), ValueRef::Float32(second)) => first.to_bits() == second.to_bits(),
        (ValueRef::Float64(first), ValueRef::Float64(second)) => first.to_bits() == second.to_bits(),
        _ => first == second,
    }
}

fn is_near(first: ValueRef<'_>, second: ValueRef<'_>, allowed: Allowed) -> bool {
    let (Some(first), Some(second)) = (first.as_f64(), second.as_f64()) else { return false };
    let distance = (first - second).abs();
    let is_within = match allowed {
        Allowed::Anything => true,
        Allowed::Absolute(most) => distance <= most,
        Allowed::Relative(part) => distance <= part * first.abs().max(second.abs()),
    };
    // Equal infinities have no finite distance; NaN only matches NaN.
    is_within || first == second || (first.is_nan() && second.is_nan())
}

fn text(value: ValueRef<'_>) -> String {
    match value {
        ValueRef::String(text) | ValueRef::WString(text) => {
            let short: String = text.chars().take(LONGEST_TEXT).collect();
            let more = if short.len() < text.len() { "…" } else { "" };
            format!("{short:?}{more}")
        }
        ValueRef::Bool(value) => value.to_string(),
        ValueRef::Float32(value) => format!("{value:?}"),
        ValueRef::Float64(value) => format!("{value:?}"),
        other => other
            .as_i64()
            .map(|value| value.to_string())
            .or_else(|| other.as_u64().map(|value| value.to_string()))
            .unwrap_or_default(),
    }
}

fn bits(value: ValueRef<'_>) -> String {
    match value {
        ValueRef::Float32(value) => format!(" (0x{:08x})", value.to_bits()),
        ValueRef::Float64(value) => format!(" (0x{:016x})", value.to_bits()),
        ValueRef::String(text) | ValueRef::WString(text) => format!(" ({} bytes)", text.len()),
        _ => String::new(),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    const TEXT: &str = "string name\nfloat64[] angles\nPart[] parts\n\
        ================================================================================\n\
        MSG: my_msgs/Part\nint32 id\nfloat32 mass\n";

    fn topic() -> TopicDescription {
        TopicDescription {
            name: "/robot/legs".to_owned(),
            type_name: "my_msgs/msg/Legs".to_owned(),
            definition: TEXT.to_owned(),
            ..TopicDescription::default()
        }
    }

    fn legs(change: impl Fn(&mut DynamicMessage)) -> Vec<u8> {
        let of = DynamicType::from_definition_text("my_msgs/msg/Legs", "ros2msg", TEXT).unwrap();
        let mut message = DynamicMessage::new(&of);
        message.set("name", "left").unwrap();
        message.set("angles", vec![0.5, f64::NAN, -0.0]).unwrap();
        message.resize("parts", 2).unwrap();
        message.set("parts[1].id", 7).unwrap();
        message.set("parts[1].mass", 0.25_f32).unwrap();
        change(&mut message);
        message.to_cdr()
    }

    fn difference(rules: &[&str], change: impl Fn(&mut DynamicMessage)) -> Option<String> {
        let rules: Vec<_> = rules
            .iter()
            .map(|rule| FieldRule::tolerance(rule).or_else(|_| FieldRule::ignore(rule)).unwrap())
            .collect();
        let comparer = Comparer::new(&topic(), &rules);
        comparer.compare(&legs(|_| {}), &legs(change)).map(|found| found.to_string())
    }

    #[test]
    fn the_first_difference_is_reported_with_path_and_both_values() {
        assert_eq!(difference(&[], |_| {}), None, "a NaN equals itself");
        type Change = fn(&mut DynamicMessage);
        let cases: [(&str, Change); 5] = [
            ("name: \"left\" and \"right\"", |legs| legs.set("name", "right").unwrap()),
            ("angles[2]: -0.0 and 0.0", |legs| legs.set("angles[2]", 0.0).unwrap()),
            ("angles: 3 values and 2 values", |legs| legs.resize("angles", 2).unwrap()),
            ("parts[1].id: 7 and 8", |legs| legs.set("parts[1].id", 8).unwrap()),
            ("parts[1].mass: 0.25 and 0.5", |legs| legs.set("parts[1].mass", 0.5_f32).unwrap()),
        ];
        for (expected, change) in cases {
            assert_eq!(difference(&[], change).as_deref(), Some(expected));
        }
    }

    #[test]
    fn a_different_nan_is_reported_by_its_bits() {
        let other = f64::from_bits(f64::NAN.to_bits() ^ 1);
        let found = difference(&[], |legs| legs.set("angles[1]", other).unwrap()).unwrap();
        assert_eq!(found, "angles[1]: NaN (0x7ff8000000000000) and NaN (0x7ff8000000000001)");
    }

    #[test]
    fn a_tolerance_applies_to_the_fields_and_topics_that_it_names() {
        let change = |legs: &mut DynamicMessage| legs.set("parts[1].mass", 0.26_f32).unwrap();
        for allowed in [
            "robot/legs:parts.mass=0.02",
            "robot/*:parts[1].mass=0.02",
            "**:parts=5%",
            "=0.02",
            "/robot/legs=5%",
        ] {
            assert_eq!(difference(&[allowed], change), None, "{allowed}");
        }
        for refused in
            ["robot/legs:parts.mass=0.001", "robot/arms=1", "parts=1", ":mass=1", "robot/legs:parts[0]=1"]
        {
            assert!(difference(&[refused], change).is_some(), "{refused}");
        }
        assert!(difference(&["=1", ":parts=0"], change).is_some(), "the last rule applies");
    }

    #[test]
    fn ignored_fields_may_have_any_value_and_length() {
        let change = |legs: &mut DynamicMessage| {
            legs.set("name", "right").unwrap();
            legs.resize("parts", 9).unwrap();
        };
        assert_eq!(difference(&["**:name", ":parts"], change), None);
        assert_eq!(difference(&["robot/legs"], change), None);
        assert!(difference(&[":name"], change).is_some_and(|found| found.starts_with("parts: 2 values")));
    }

    #[test]
    fn messages_of_unknown_types_are_compared_as_bytes() {
        let unknown =
            TopicDescription { type_name: "no_msgs/msg/Thing".to_owned(), ..TopicDescription::default() };
        let comparer = Comparer::new(&unknown, &[]);
        assert_eq!(comparer.compare(&[1, 2, 3], &[1, 9, 3]).unwrap().to_string(), "byte 1: 0x02 and 0x09");
        assert_eq!(comparer.compare(&[1, 2], &[1, 2, 3]).unwrap().to_string(), "byte 2: 2 bytes and 0x03");
    }
}
