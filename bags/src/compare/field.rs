//! The first field in which two messages of one type differ.

use downbeat_msgs::dynamic::{MessageRef, ValueRef};

use super::FieldDifference;
use super::rule::{Allowed, FieldRule};

/// Longer strings are truncated in reports.
const LONGEST_TEXT: usize = 80;

pub(super) fn first_difference(
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
