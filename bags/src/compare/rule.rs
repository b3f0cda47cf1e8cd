//! Rules for how exactly fields are compared.

use std::fmt;

/// How exactly certain fields are compared.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldRule {
    topic: String,
    field: String,
    allowed: Allowed,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Allowed {
    Anything,
    /// Maximum absolute difference.
    Absolute(f64),
    /// Maximum difference relative to the larger value.
    Relative(f64),
}

/// A text is not a valid rule.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("\"{text}\" is not a rule: {expected}")]
pub struct FieldRuleError {
    text: String,
    expected: &'static str,
}

impl FieldRule {
    /// A tolerance for numbers: `TOPIC:FIELD=AMOUNT`, where the amount is a number or a percentage of the
    /// larger value: `joint_states:position=1e-6`, `imu/*:linear_acceleration.x=0.1%`.
    ///
    /// In the topic, `*` matches any characters of one part of a name, `**` any number of parts; without a
    /// topic the rule applies to all topics. A field includes everything below it, and all elements of an
    /// array unless one is given (`position[3]`); without a field the rule applies to all numbers.
    ///
    /// # Errors
    /// Returns an error if the text does not have this form.
    pub fn tolerance(text: &str) -> Result<Self, FieldRuleError> {
        let error = || FieldRuleError {
            text: text.to_owned(),
            expected: "write TOPIC:FIELD=AMOUNT, for example joint_states:position=1e-6 or imu/*=0.1%",
        };
        let (place, amount) = text.rsplit_once('=').ok_or_else(error)?;
        let (number, is_percentage) =
            amount.strip_suffix('%').map_or((amount, false), |number| (number, true));
        let number: f64 = number.trim().parse().map_err(|_| error())?;
        if !number.is_finite() || number < 0.0 {
            return Err(error());
        }
        let allowed =
            if is_percentage { Allowed::Relative(number / 100.0) } else { Allowed::Absolute(number) };
        let (topic, field) = place_of(place);
        Ok(Self { topic, field, allowed })
    }

    /// Fields that are not compared: `TOPIC:FIELD` as for [`FieldRule::tolerance`], `TOPIC` or `:FIELD`.
    ///
    /// # Errors
    /// Returns an error if the text is empty.
    pub fn ignore(text: &str) -> Result<Self, FieldRuleError> {
        let (topic, field) = place_of(text);
        if topic.is_empty() && field.is_empty() {
            let expected = "write TOPIC, TOPIC:FIELD or :FIELD, for example imu/data_raw:header.stamp";
            return Err(FieldRuleError { text: text.to_owned(), expected });
        }
        Ok(Self { topic, field, allowed: Allowed::Anything })
    }

    pub(super) fn means_topic(&self, topic: &str) -> bool {
        let topic = topic.trim_start_matches('/');
        self.topic.is_empty() || matches(&parts(&self.topic), &parts(topic))
    }

    /// Returns whether it applies to the field at that path, or to one that contains it.
    pub(super) fn means_field(&self, path: &str) -> bool {
        is_at_or_below(path, &self.field) || is_at_or_below(&without_indices(path), &self.field)
    }

    pub(super) fn allowed(&self) -> Allowed {
        self.allowed
    }

    pub(super) fn ignores_everything(&self) -> bool {
        self.allowed == Allowed::Anything && self.field.is_empty()
    }
}

impl fmt::Display for FieldRule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.topic.is_empty() { "**" } else { &self.topic })?;
        if !self.field.is_empty() {
            write!(f, ":{}", self.field)?;
        }
        match self.allowed {
            Allowed::Anything => f.write_str(" ignored"),
            Allowed::Absolute(amount) => write!(f, " ± {amount:?}"),
            Allowed::Relative(amount) => write!(f, " ± {:?} %", amount * 100.0),
        }
    }
}

fn place_of(text: &str) -> (String, String) {
    let (topic, field) = text.split_once(':').unwrap_or((text, ""));
    (topic.trim().trim_start_matches('/').to_owned(), field.trim().to_owned())
}

fn parts(name: &str) -> Vec<&str> {
    name.split('/').collect()
}

fn matches(pattern: &[&str], name: &[&str]) -> bool {
    match (pattern.split_first(), name.split_first()) {
        (None, None) => true,
        (Some((&"**", rest)), _) => (0..=name.len()).any(|skipped| matches(rest, &name[skipped..])),
        (Some((pattern, patterns)), Some((part, parts))) => {
            matches_part(pattern, part) && matches(patterns, parts)
        }
        _ => false,
    }
}

fn matches_part(pattern: &str, part: &str) -> bool {
    let Some((start, rest)) = pattern.split_once('*') else { return pattern == part };
    let Some(left) = part.strip_prefix(start) else { return false };
    let ends = left.char_indices().map(|(at, _)| at).chain([left.len()]);
    ends.into_iter().any(|at| matches_part(rest, &left[at..]))
}

fn is_at_or_below(path: &str, field: &str) -> bool {
    field.is_empty()
        || path.strip_prefix(field).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
}

fn without_indices(path: &str) -> String {
    let mut is_index = false;
    path.chars()
        .filter(|&character| {
            is_index |= character == '[';
            let is_kept = !is_index;
            is_index &= character != ']';
            is_kept
        })
        .collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn rules_are_parsed_and_printed() {
        let text = |rule: FieldRule| rule.to_string();
        assert_eq!(text(FieldRule::tolerance("/a/b:c.d=1e-6").unwrap()), "a/b:c.d ± 1e-6");
        assert_eq!(text(FieldRule::tolerance("=5%").unwrap()), "** ± 5.0 %");
        assert_eq!(text(FieldRule::ignore(":header.stamp").unwrap()), "**:header.stamp ignored");
        for wrong in ["a:b", "a:b=", "a=-1", "a=nan", "a=1 m", "="] {
            assert!(FieldRule::tolerance(wrong).is_err(), "{wrong}");
        }
        assert!(FieldRule::ignore(" ").is_err());
    }

    #[test]
    fn topics_are_matched_part_by_part() {
        let means = |pattern: &str, topic: &str| FieldRule::ignore(pattern).unwrap().means_topic(topic);
        assert!(means("imu/*", "/imu/data_raw") && means("*/data*w", "/imu/data_raw"));
        assert!(means("**", "/a") && means("**/c", "/a/b/c") && means("a/**", "/a/b/c"));
        assert!(!means("imu", "/imu/data_raw") && !means("*", "/imu/data_raw") && !means("imu/*", "/imu"));
    }
}
