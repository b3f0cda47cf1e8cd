//! The types of scalars in parameter files: as rcl gives them, which is neither YAML 1.1 nor 1.2.
//!
//! A scalar in quotes is text. Others are, in this order: one of the words for true and false of YAML 1.1; a
//! whole number as `strtol` of C reads it, so that `010` is 8; a number as `strtod` reads it; text.
//!
//! # References
//! `get_value` in `rcl_yaml_param_parser/src/parse.c` (branch jazzy).

use std::fmt;

use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_norway::value::{Tag, TaggedValue};
use serde_norway::{Mapping, Value};

use downbeat_msgs::yaml;

/// The tag of a word that means no value in YAML, and is text in rcl.
pub(super) const NULL_WORD: &str = "!null";

/// Parses YAML as rcl does. Scalars without a value stay `Null`; words such as `null` have the tag
/// `!null`.
///
/// # Errors
/// If the text is not YAML.
pub fn values_in(text: &str) -> Result<Value, serde_norway::Error> {
    let text = &*yaml::with_local_tags(text);
    let value: Value = yaml::from_str(text)?;
    let scalars = Scalars { text, read: &value }.deserialize(yaml::deserializer(text)?);
    // A text without a value cannot be read as one.
    if value.is_null() { Ok(scalars.unwrap_or(value)) } else { scalars }
}

/// Reads again what was read as a value, for the types of its scalars.
struct Scalars<'v, 't> {
    text: &'t str,
    read: &'v Value,
}

impl<'de> DeserializeSeed<'de> for Scalars<'_, 'de> {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        match self.read {
            Value::Sequence(_) => deserializer.deserialize_seq(self),
            Value::Mapping(_) => deserializer.deserialize_map(self),
            // Of tags, rcl knows only that of text.
            Value::Tagged(tagged) if ["bool", "int", "float"].iter().any(|tag| tagged.tag == *tag) => {
                deserializer.deserialize_str(self)
            }
            // Of those with another tag, the parameter files of ROS 2 have only `!!binary`.
            Value::Tagged(_) => {
                deserializer.deserialize_ignored_any(IgnoredAny)?;
                Ok(self.read.clone())
            }
            _ => deserializer.deserialize_str(self),
        }
    }
}

impl<'de> Visitor<'de> for Scalars<'_, 'de> {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the same value again")
    }

    /// A part of the text itself: what is in front of it tells whether it is in quotes.
    fn visit_borrowed_str<E: Error>(self, scalar: &'de str) -> Result<Value, E> {
        let start = (scalar.as_ptr() as usize).wrapping_sub(self.text.as_ptr() as usize);
        let before = self.text.get(..start).unwrap_or_default();
        let is_text = before.ends_with(['"', '\'']) || before.trim_end().ends_with("!!str");
        Ok(match is_text {
            true => Value::String(scalar.to_owned()),
            false => plain(scalar),
        })
    }

    /// A part of the text that had to be changed, as only text in quotes and blocks has.
    fn visit_str<E: Error>(self, scalar: &str) -> Result<Value, E> {
        Ok(Value::String(scalar.to_owned()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<Value, A::Error> {
        let mut values = Vec::new();
        let read = self.read.as_sequence().map(Vec::as_slice).unwrap_or_default();
        while let Some(read) = read.get(values.len())
            && let Some(value) = elements.next_element_seed(Scalars { text: self.text, read })?
        {
            values.push(value);
        }
        while elements.next_element::<IgnoredAny>()?.is_some() {}
        Ok(Value::Sequence(values))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Value, A::Error> {
        let mut values = Mapping::new();
        for (key, read) in self.read.as_mapping().into_iter().flatten() {
            if entries.next_key::<IgnoredAny>()?.is_none() {
                break;
            }
            values.insert(key.clone(), entries.next_value_seed(Scalars { text: self.text, read })?);
        }
        while entries.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
        Ok(Value::Mapping(values))
    }
}

/// The value of a scalar without quotes.
fn plain(scalar: &str) -> Value {
    match scalar {
        "" => Value::Null,
        "~" | "null" | "Null" | "NULL" => {
            let (tag, value) = (Tag::new(NULL_WORD), Value::String(scalar.to_owned()));
            Value::Tagged(Box::new(TaggedValue { tag, value }))
        }
        "Y" | "y" | "yes" | "Yes" | "YES" | "true" | "True" | "TRUE" | "on" | "On" | "ON" => true.into(),
        "N" | "n" | "no" | "No" | "NO" | "false" | "False" | "FALSE" | "off" | "Off" | "OFF" => false.into(),
        _ => match (whole_number(scalar), number(scalar)) {
            (Some(number), _) => number.into(),
            (None, Some(number)) => number.into(),
            (None, None) => scalar.into(),
        },
    }
}

/// As `strtol` with the base 0 reads the whole text: decimal, octal after `0`, hexadecimal after `0x`.
fn whole_number(text: &str) -> Option<i64> {
    let (sign, digits) = sign_of(text);
    let (digits, radix) = match digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X")) {
        Some(digits) => (digits, 16),
        None if digits.len() > 1 && digits.starts_with('0') => (digits, 8),
        None => (digits, 10),
    };
    let is_number = !digits.is_empty() && digits.chars().all(|digit| digit.is_digit(radix));
    is_number.then(|| i64::from_str_radix(&format!("{sign}{digits}"), radix).ok()).flatten()
}

/// As `strtod` reads the whole text, or rcl the words of YAML. Out of the range of a double, it is no number.
fn number(text: &str) -> Option<f64> {
    let (sign, digits) = sign_of(text);
    let size = match digits {
        ".nan" | ".NaN" | ".NAN" => f64::NAN,
        ".inf" | ".Inf" | ".INF" => f64::INFINITY,
        _ if digits.starts_with(['+', '-']) => return None,
        _ => match digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X")) {
            Some(digits) => hexadecimal(digits)?,
            None => digits.parse().ok()?,
        },
    };
    let has_digits = digits.starts_with(|c: char| c.is_ascii_digit() || c == '.')
        && digits.contains(|c: char| c.is_ascii_digit());
    let mantissa = digits.split(['e', 'E', 'p', 'P']).next().unwrap_or_default();
    let is_zero = !mantissa
        .trim_start_matches("0x")
        .trim_start_matches("0X")
        .contains(|c: char| c.is_ascii_hexdigit() && c != '0');
    let is_in_range = !has_digits || is_zero || size.is_normal();
    is_in_range.then_some(if sign == "-" { -size } else { size })
}

/// A hexadecimal number of C without its sign and `0x`: digits, perhaps a point and more, perhaps `p` and an
/// exponent of 2.
fn hexadecimal(text: &str) -> Option<f64> {
    let (digits, exponent) = match text.split_once(['p', 'P']) {
        Some((digits, exponent)) => (digits, exponent.parse::<i32>().ok()?),
        None => (text, 0),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    if whole.is_empty() && fraction.is_empty() {
        return None;
    }
    let mut size = 0.0;
    for digit in whole.chars().chain(fraction.chars()) {
        size = size * 16.0 + f64::from(digit.to_digit(16)?);
    }
    let places = i32::try_from(fraction.len()).ok()?;
    Some(size * 2_f64.powi(exponent.checked_sub(places.checked_mul(4)?)?))
}

fn sign_of(text: &str) -> (&'static str, &str) {
    match text.strip_prefix('-') {
        Some(digits) => ("-", digits),
        None => ("", text.strip_prefix('+').unwrap_or(text)),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// The type that rcl gives a scalar, and the value as text.
    fn shown(text: &str) -> (&'static str, String) {
        match values_in(&format!("x: {text}\n")).unwrap()["x"].clone() {
            Value::Bool(value) => ("BOOL", if value { "True" } else { "False" }.to_owned()),
            Value::Number(value) if value.is_i64() => ("INTEGER", value.to_string()),
            Value::Number(value) => ("DOUBLE", format!("{:?}", value.as_f64().unwrap())),
            Value::String(text) => ("STRING", text),
            Value::Tagged(word) => ("STRING", word.value.as_str().unwrap().to_owned()),
            other => ("", format!("{other:?}")),
        }
    }

    /// Scalars by their type and value in rcl.
    const SCALARS: &[(&str, &str, &str)] = &[
        ("on On ON yes Yes YES y Y true True TRUE", "BOOL", "True"),
        ("off Off OFF no No NO n N false False FALSE", "BOOL", "False"),
        ("010 8 +8 0x8 0X8 +010", "INTEGER", "8"),
        ("-5 -05 -0x5", "INTEGER", "-5"),
        ("0 00 -0", "INTEGER", "0"),
        ("9223372036854775807", "INTEGER", "9223372036854775807"),
        ("-9223372036854775808", "INTEGER", "-9223372036854775808"),
        ("9223372036854775808", "DOUBLE", "9.223372036854776e18"),
        ("08 8. 8.0 +8.0 0x1p3 0x.8p4", "DOUBLE", "8.0"),
        ("1e3 1E3 1.0e+3", "DOUBLE", "1000.0"),
        (".5 +.5", "DOUBLE", "0.5"),
        ("nan NaN .nan .NaN .NAN", "DOUBLE", "NaN"),
        ("inf .inf +.inf infinity Inf .Inf .INF", "DOUBLE", "inf"),
        ("-inf -.inf", "DOUBLE", "-inf"),
        (
            "tRue oN 0o17 0b11 1_000 . ~ null Null 12:30:45 2001-01-01 0xg 0x --5 1f 1e 1e400 1e-400 = +-5 1,5 NULL",
            "STRING",
            "",
        ),
        ("'on' \"yes\" '010' '1' 'null' ''", "STRING", "'"),
    ];

    /// Each scalar with its type and value.
    fn scalars() -> impl Iterator<Item = (&'static str, &'static str, String)> {
        SCALARS.iter().flat_map(|&(texts, kind, value)| {
            texts.split(' ').map(move |text| {
                let value = match value {
                    "" => text,
                    "'" => text.trim_matches(['\'', '"']),
                    value => value,
                };
                (text, kind, value.to_owned())
            })
        })
    }

    /// rcl looks at the tag of text only.
    #[test]
    fn tags_of_other_types_change_nothing() {
        for (text, kind, value) in scalars() {
            for tag in ["!!bool", "!!int", "!!float"] {
                assert_eq!(shown(&format!("{tag} {text}")), (kind, value.clone()), "{tag} {text}");
            }
            let bare = text.trim_matches(['\'', '"']);
            assert_eq!(shown(&format!("!!str {text}")), ("STRING", bare.to_owned()), "{text}");
        }
    }

    #[test]
    fn scalars_have_the_types_that_rcl_gives_them() {
        for (text, kind, value) in scalars() {
            assert_eq!(shown(text), (kind, value), "{text}");
        }
        for (text, kind, value) in [
            ("a b", "STRING", "a b"),
            ("!!str on", "STRING", "on"),
            ("!!str 5", "STRING", "5"),
            ("!!int 5", "INTEGER", "5"),
            ("!!float 5", "INTEGER", "5"),
            ("\"a\\tb\"", "STRING", "a\tb"),
            ("", "", "Null"),
        ] {
            assert_eq!(shown(text), (kind, value.to_owned()), "{text}");
        }
    }

    #[test]
    fn rclpy_declares_the_same() {
        let Some(python) = python_peer::Python::find() else { return };
        let texts: Vec<_> = scalars().map(|(text, ..)| text).collect();
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/python/parameter_scalars.py");
        let printed = python_peer::with_file(&texts.join("\n"), |file| python.run(script, &[file]));
        let theirs: Vec<serde_json::Value> =
            printed.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert_eq!(theirs.len(), texts.len());
        for ((text, kind, value), theirs) in scalars().zip(theirs) {
            assert_eq!(theirs[0], kind, "{text}");
            if kind != "DOUBLE" {
                assert_eq!(theirs[1], value.as_str(), "{text}");
            }
        }
    }

    #[test]
    fn scalars_in_lists_maps_and_aliases_have_types_too() {
        let value = values_in("a: &a [on, 'on', 010]\nb: {c: *a, off: no}\n").unwrap();
        let list: Value = vec![true.into(), Value::from("on"), 8.into()].into();
        assert_eq!((&value["a"], &value["b"]["c"], &value["b"]["off"]), (&list, &list, &false.into()));
        assert_eq!(values_in("").unwrap(), Value::Null);
        assert_eq!(values_in("# nothing\n").unwrap(), Value::Null);
        assert_eq!(values_in("no").unwrap(), Value::Bool(false));
    }
}
