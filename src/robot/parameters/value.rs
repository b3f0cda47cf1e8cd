//! Values of parameters.

use downbeat_executor::SettingValue;
use serde_norway::Value;

use crate::robot::file::list_of;

/// The value as a setting holds it. Errors say what was expected and found.
pub(crate) fn setting_value(value: &Value) -> Result<SettingValue, String> {
    match value {
        Value::Bool(value) => Ok(SettingValue::Bool(*value)),
        Value::String(text) => Ok(SettingValue::Text(text.clone())),
        Value::Number(number) => match (number.as_i64(), number.as_f64()) {
            (Some(integer), _) => Ok(SettingValue::Integer(integer)),
            (None, Some(double)) if number.is_f64() => Ok(SettingValue::Double(double)),
            _ => Err(format!("{number} does not fit a whole number of 64 bits")),
        },
        Value::Sequence(elements) => {
            let values = elements.iter().map(setting_value).collect::<Result<Vec<_>, _>>()?;
            list_of(values).ok_or_else(|| {
                "expected a list of numbers only, of texts only, or of truth values only".into()
            })
        }
        Value::Null => Err(expected("nothing")),
        Value::Mapping(_) => Err(expected("a map")),
        Value::Tagged(_) => Err(expected("a value with a tag")),
    }
}

fn expected(found: &str) -> String {
    format!("expected true, false, a number, text, or a list of one of these; found {found}")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn read(text: &str) -> Result<SettingValue, String> {
        setting_value(&serde_norway::from_str(text).unwrap())
    }

    #[test]
    fn values_have_the_type_that_yaml_gives_them() {
        assert_eq!(read("true"), Ok(true.into()));
        assert_eq!(read("True"), Ok(true.into()));
        assert_eq!(read("-3"), Ok(SettingValue::Integer(-3)));
        assert_eq!(read("3.0"), Ok(3.0.into()));
        assert_eq!(read("\"3\""), Ok("3".to_owned().into()));
        assert_eq!(read("/dev/ttyUSB0"), Ok("/dev/ttyUSB0".to_owned().into()));
        assert_eq!(read("[1, 2]"), Ok(vec![1_i64, 2].into()));
        assert_eq!(read("[1, 2.5]"), Ok(vec![1.0, 2.5].into()));
        assert_eq!(read("[true, false]"), Ok(vec![true, false].into()));
        assert_eq!(read("[a, b]"), Ok(vec!["a".to_owned(), "b".to_owned()].into()));
    }

    #[test]
    fn what_no_setting_holds_is_refused() {
        for (text, problem) in [
            ("~", "found nothing"),
            ("[1, a]", "of numbers only, of texts only"),
            ("[true, 1]", "or of truth values only"),
            ("18446744073709551615", "64 bits"),
            ("!x 3", "with a tag"),
        ] {
            let refusal = read(text).unwrap_err();
            assert!(refusal.contains(problem), "{text}: {refusal}");
        }
    }
}
