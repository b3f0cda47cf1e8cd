//! Values of parameters as text.

use downbeat_executor::SettingValue;
use serde_norway::Value;

use downbeat_msgs::dynamic::python;
use downbeat_msgs::rcl_interfaces::msg::ParameterType;
use downbeat_robot::parameters::{setting_value, yaml_values};

/// The name of a parameter type in the output of tools.
pub(super) fn type_name(kind: u8) -> &'static str {
    match kind {
        ParameterType::PARAMETER_BOOL => "boolean",
        ParameterType::PARAMETER_INTEGER => "integer",
        ParameterType::PARAMETER_DOUBLE => "double",
        ParameterType::PARAMETER_STRING => "string",
        ParameterType::PARAMETER_BYTE_ARRAY => "byte array",
        ParameterType::PARAMETER_BOOL_ARRAY => "boolean array",
        ParameterType::PARAMETER_INTEGER_ARRAY => "integer array",
        ParameterType::PARAMETER_DOUBLE_ARRAY => "double array",
        ParameterType::PARAMETER_STRING_ARRAY => "string array",
        _ => "not set",
    }
}

/// The label that `param get` prints before a value.
pub(super) fn label(value: &SettingValue) -> &'static str {
    match value {
        SettingValue::Bool(_) => "Boolean value is: ",
        SettingValue::Integer(_) => "Integer value is: ",
        SettingValue::Double(_) => "Double value is: ",
        SettingValue::Text(_) => "String value is: ",
        SettingValue::Bytes(_) => "Byte values are: ",
        SettingValue::Bools(_) => "Boolean values are: ",
        SettingValue::Integers(_) => "Integer values are: ",
        SettingValue::Doubles(_) => "Double values are: ",
        SettingValue::Texts(_) => "String values are: ",
    }
}

/// The value as printed by Python.
pub(super) fn python_value(value: &SettingValue) -> String {
    match value {
        SettingValue::Bool(value) => truth(*value).to_owned(),
        SettingValue::Integer(value) => value.to_string(),
        SettingValue::Double(value) => python_float(*value),
        SettingValue::Text(text) => text.clone(),
        SettingValue::Bytes(bytes) => list(bytes, |out, byte| python::write_bytes(out, &[*byte])),
        SettingValue::Bools(values) => list(values, |out, value| out.push_str(truth(*value))),
        SettingValue::Integers(values) => list(values, |out, value| out.push_str(&value.to_string())),
        SettingValue::Doubles(values) => list(values, |out, value| python::write_float(out, *value)),
        SettingValue::Texts(texts) => list(texts, |out, text| python::write_text(out, text)),
    }
}

pub(super) fn python_float(value: f64) -> String {
    let mut out = String::new();
    python::write_float(&mut out, value);
    out
}

fn truth(value: bool) -> &'static str {
    if value { "True" } else { "False" }
}

fn list<T>(values: &[T], write: impl Fn(&mut String, &T)) -> String {
    let mut out = String::from("[");
    for (index, value) in values.iter().enumerate() {
        out.push_str(if index == 0 { "" } else { ", " });
        write(&mut out, value);
    }
    out + "]"
}

/// Parses a value with the type that rcl gives it. Text that is not YAML is a string.
///
/// # Errors
/// Returns an error if the text is YAML but not a parameter value, such as a map.
pub(super) fn value_in(text: &str) -> Result<SettingValue, String> {
    match yaml_values(text) {
        Err(_) | Ok(Value::Null) => Ok(SettingValue::Text(text.to_owned())),
        Ok(value) => setting_value(&value),
    }
}

/// Returns whether it is an empty list, whose type YAML does not determine.
pub(super) fn is_empty_list(value: &SettingValue) -> bool {
    matches!(value, SettingValue::Integers(values) if values.is_empty())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_bridge::expose::parameter_value;

    #[test]
    fn a_value_has_its_yaml_type() {
        let shown = |text: &str| {
            let value = value_in(text).unwrap();
            format!("{} {}", type_name(parameter_value(&value).r#type), python_value(&value))
        };
        for (text, expected) in [
            ("true", "boolean True"),
            ("on", "boolean True"),
            ("'on'", "string on"),
            ("off", "boolean False"),
            ("010", "integer 8"),
            ("3", "integer 3"),
            ("-2.50", "double -2.5"),
            ("'3'", "string 3"),
            ("a: b", "refused"),
            ("/dev/ttyUSB0", "string /dev/ttyUSB0"),
            ("[a, \"it's\"]", "string array ['a', \"it's\"]"),
            ("[1, 2]", "integer array [1, 2]"),
            ("[1.0, 2]", "double array [1.0, 2.0]"),
        ] {
            match expected {
                "refused" => assert!(value_in(text).is_err(), "{text}"),
                expected => assert_eq!(shown(text), expected, "{text}"),
            }
        }
        assert!(is_empty_list(&value_in("[]").unwrap()));
    }
}
