//! Values of settings as values of parameters.

use downbeat_executor::SettingValue;
use downbeat_msgs::rcl_interfaces::msg::{ParameterType, ParameterValue};

/// The value of the parameter for a setting.
#[must_use]
pub fn parameter_value(value: &SettingValue) -> ParameterValue {
    let mut message = ParameterValue { r#type: parameter_type(value), ..ParameterValue::default() };
    match value.clone() {
        SettingValue::Bool(value) => message.bool_value = value,
        SettingValue::Integer(value) => message.integer_value = value,
        SettingValue::Double(value) => message.double_value = value,
        SettingValue::Text(value) => message.string_value = value,
        SettingValue::Bools(values) => message.bool_array_value = values,
        SettingValue::Bytes(values) => message.byte_array_value = values,
        SettingValue::Integers(values) => message.integer_array_value = values,
        SettingValue::Doubles(values) => message.double_array_value = values,
        SettingValue::Texts(values) => message.string_array_value = values,
    }
    message
}

/// The type of the parameter for a setting, one of [`ParameterType`].
#[must_use]
pub fn parameter_type(value: &SettingValue) -> u8 {
    match value {
        SettingValue::Bool(_) => ParameterType::PARAMETER_BOOL,
        SettingValue::Integer(_) => ParameterType::PARAMETER_INTEGER,
        SettingValue::Double(_) => ParameterType::PARAMETER_DOUBLE,
        SettingValue::Text(_) => ParameterType::PARAMETER_STRING,
        SettingValue::Bools(_) => ParameterType::PARAMETER_BOOL_ARRAY,
        SettingValue::Bytes(_) => ParameterType::PARAMETER_BYTE_ARRAY,
        SettingValue::Integers(_) => ParameterType::PARAMETER_INTEGER_ARRAY,
        SettingValue::Doubles(_) => ParameterType::PARAMETER_DOUBLE_ARRAY,
        SettingValue::Texts(_) => ParameterType::PARAMETER_STRING_ARRAY,
    }
}

/// The value of a setting for a parameter.
///
/// # Errors
/// If the parameter has no value or an unknown type; in words.
pub fn setting_value(message: ParameterValue) -> Result<SettingValue, String> {
    Ok(match message.r#type {
        ParameterType::PARAMETER_NOT_SET => return Err("a setting of a module cannot be removed".to_owned()),
        ParameterType::PARAMETER_BOOL => SettingValue::Bool(message.bool_value),
        ParameterType::PARAMETER_INTEGER => SettingValue::Integer(message.integer_value),
        ParameterType::PARAMETER_DOUBLE => SettingValue::Double(message.double_value),
        ParameterType::PARAMETER_STRING => SettingValue::Text(message.string_value),
        ParameterType::PARAMETER_INTEGER_ARRAY => SettingValue::Integers(message.integer_array_value),
        ParameterType::PARAMETER_DOUBLE_ARRAY => SettingValue::Doubles(message.double_array_value),
        ParameterType::PARAMETER_STRING_ARRAY => SettingValue::Texts(message.string_array_value),
        ParameterType::PARAMETER_BYTE_ARRAY => SettingValue::Bytes(message.byte_array_value),
        ParameterType::PARAMETER_BOOL_ARRAY => SettingValue::Bools(message.bool_array_value),
        unknown => return Err(format!("{unknown} is no type of a parameter")),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_value_survives_as_a_parameter() {
        let values: [SettingValue; 9] = [
            true.into(),
            7_i64.into(),
            0.5.into(),
            "text".to_owned().into(),
            vec![true, false].into(),
            vec![0_u8, 255].into(),
            vec![1_i64, 2].into(),
            vec![0.5, -1.0].into(),
            vec!["a".to_owned()].into(),
        ];
        for value in values {
            assert_eq!(setting_value(parameter_value(&value)), Ok(value));
        }
    }

    #[test]
    fn what_no_setting_holds_is_refused_with_the_reason() {
        for (kind, word) in [(0, "removed"), (10, "no type")] {
            let message = ParameterValue { r#type: kind, ..ParameterValue::default() };
            assert!(setting_value(message).unwrap_err().contains(word));
        }
    }
}
