//! The settings of a robot as a ROS 2 parameter file.

use std::fmt::Write;

use downbeat_executor::SettingValue;

use crate::Robot;

impl Robot {
    /// Returns all settings with their values and descriptions as a ROS 2 parameter file for the robot's
    /// node.
    ///
    /// Reading the file gives the same settings. Other ROS 2 nodes can read it as well, except for empty
    /// lists, which rcl does not accept.
    #[must_use]
    pub fn parameters(&self) -> String {
        // Names that ROS 2 does not accept were refused when the robot was built.
        let node =
            self.file.node_name().map_or_else(|_| format!("/{}", self.file.node), |node| node.to_string());
        let mut modules = String::new();
        for module in self.file.modules.iter().map(|module| &module.name) {
            let settings = self.core.settings(module).unwrap_or_default();
            if !settings.is_empty() {
                modules.push_str(&format!("    {}:\n", key(module)));
            }
            for setting in settings {
                // Writing to a String does not fail.
                for line in setting.description.lines() {
                    let _ = writeln!(modules, "      # {line}");
                }
                let _ = writeln!(modules, "      {}: {}", key(&setting.name), value(&setting.value));
            }
        }
        let modules = if modules.is_empty() { " {}\n".into() } else { format!("\n{modules}") };
        format!("{node}:\n  ros__parameters:{modules}")
    }
}

/// Words that are not strings in YAML 1.1 or 1.2.
const OTHER_THAN_TEXT: [&str; 9] = ["true", "false", "yes", "no", "on", "off", "y", "n", "null"];

fn key(name: &str) -> String {
    let is_plain = name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
        && name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | '.' | '/'))
        && !OTHER_THAN_TEXT.contains(&name.to_ascii_lowercase().as_str());
    if is_plain { name.to_owned() } else { text(name) }
}

fn value(value: &SettingValue) -> String {
    match value {
        SettingValue::Bool(value) => value.to_string(),
        SettingValue::Integer(value) => value.to_string(),
        SettingValue::Double(value) => double(*value),
        SettingValue::Text(value) => text(value),
        SettingValue::Bools(values) => list(values, ToString::to_string),
        SettingValue::Bytes(values) => list(values, ToString::to_string),
        SettingValue::Integers(values) => list(values, ToString::to_string),
        SettingValue::Doubles(values) => list(values, |&value| double(value)),
        SettingValue::Texts(values) => list(values, |value| text(value)),
    }
}

fn list<T>(values: &[T], write: impl Fn(&T) -> String) -> String {
    format!("[{}]", values.iter().map(write).collect::<Vec<_>>().join(", "))
}

/// Formats a number with a decimal point and a signed exponent. Without them, YAML 1.1 parsers read an
/// integer or a string.
fn double(value: f64) -> String {
    if value.is_nan() {
        return ".nan".into();
    }
    if value.is_infinite() {
        return if value > 0.0 { ".inf".into() } else { "-.inf".into() };
    }
    let text = format!("{value:?}");
    let Some((mantissa, exponent)) = text.split_once('e') else { return text };
    let point = if mantissa.contains('.') { "" } else { ".0" };
    let sign = if exponent.starts_with('-') { "" } else { "+" };
    format!("{mantissa}{point}e{sign}{exponent}")
}

fn text(text: &str) -> String {
    let mut quoted = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            '\n' => quoted.push_str("\\n"),
            '\r' => quoted.push_str("\\r"),
            '\t' => quoted.push_str("\\t"),
            // Not printable in YAML, or a line break.
            c if c.is_control()
                || matches!(c, '\u{2028}' | '\u{2029}' | '\u{feff}' | '\u{fffe}' | '\u{ffff}') =>
            {
                let _ = write!(quoted, "\\u{:04x}", u32::from(c));
            }
            c => quoted.push(c),
        }
    }
    quoted.push('"');
    quoted
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::parameters::setting_value;

    #[test]
    fn every_value_round_trips() {
        let texts = [
            "",
            "yes",
            "1.0",
            "a: b # c",
            "\\\"'",
            " two\nlines\r\n\ttab ",
            "\u{0}\u{7f}\u{85}\u{2028}",
            "µ 😀",
        ];
        let texts = texts.map(str::to_owned);
        let doubles =
            [0.0, -2.0, 0.1, 1e300, -2.5e-300, f64::MAX, f64::MIN_POSITIVE, f64::INFINITY, -f64::INFINITY];
        let mut values = vec![
            SettingValue::Bool(true),
            SettingValue::Integer(i64::MIN),
            vec![true, false].into(),
            vec![1_i64, -2].into(),
            doubles.to_vec().into(),
            texts.to_vec().into(),
        ];
        values.extend(texts.map(SettingValue::Text));
        values.extend(doubles.map(SettingValue::Double));
        for expected in values {
            let written = value(&expected);
            assert_eq!(setting_value(&serde_norway::from_str(&written).unwrap()), Ok(expected), "{written}");
        }
    }

    #[test]
    fn doubles_are_doubles_to_every_reader() {
        assert_eq!([2.0, 1e300, 1.5e-9].map(double), ["2.0", "1.0e+300", "1.5e-9"]);
    }

    #[test]
    fn keys_are_text_to_every_reader() {
        assert_eq!(
            ["gain", "arm.gain", "on", "N", "a b"].map(key),
            ["gain", "arm.gain", "\"on\"", "\"N\"", "\"a b\""]
        );
    }
}
