//! Settings of modules as parameters of the protocol, named `<module>.<setting>`.

use crate::protocol::Parameter;
use base64::prelude::{BASE64_STANDARD, Engine};
use downbeat_executor::{CoreHandle, SettingInfo, SettingValue};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// All settings of a core, by their names as parameters.
pub(crate) type Settings = BTreeMap<String, (String, SettingInfo)>;

/// The settings of all modules; `None` if the core does not answer within `patience`.
pub(crate) fn settings(core: &CoreHandle, patience: Duration) -> Option<Settings> {
    let deadline = Instant::now() + patience;
    let left = || deadline.saturating_duration_since(Instant::now());
    let graph = core.graph().wait(left())?;
    // All are asked before the first answer is awaited: one sync phase answers them.
    let asked: Vec<_> =
        graph.modules.into_iter().map(|module| (core.settings(&module.name), module.name)).collect();
    let mut found = Settings::new();
    for (receipt, module) in asked {
        // A module may have left since.
        for info in receipt.wait(left())?.unwrap_or_default() {
            found.insert(format!("{module}.{}", info.name), (module.clone(), info));
        }
    }
    Some(found)
}

/// The type of a setting as ROS 2 names it, and its value in JSON. A number that is not finite has none
/// there.
pub(crate) fn typed(value: &SettingValue) -> (&'static str, Option<Value>) {
    let kind = match value {
        SettingValue::Bool(_) => "bool",
        SettingValue::Integer(_) => "integer",
        SettingValue::Double(_) => "double",
        SettingValue::Text(_) => "string",
        SettingValue::Bools(_) => "bool_array",
        SettingValue::Bytes(_) => "byte_array",
        SettingValue::Integers(_) => "integer_array",
        SettingValue::Doubles(_) => "double_array",
        SettingValue::Texts(_) => "string_array",
    };
    (kind, in_json(value).0)
}

/// A parameter as viewers read it. A number that is not finite has no value, since JSON has none.
pub(crate) fn parameter(name: &str, value: &SettingValue) -> Value {
    let mut parameter = json!({ "name": name });
    let (value, kind) = in_json(value);
    if let Some(value) = value {
        parameter["value"] = value;
    }
    if let Some(kind) = kind {
        parameter["type"] = json!(kind);
    }
    parameter
}

/// The value in JSON, and the type that the protocol names because JSON does not tell it.
fn in_json(value: &SettingValue) -> (Option<Value>, Option<&'static str>) {
    let finite = |number: &f64| number.is_finite();
    match value {
        SettingValue::Bool(value) => (Some(json!(value)), None),
        SettingValue::Integer(value) => (Some(json!(value)), None),
        SettingValue::Double(value) => (Some(value).filter(|v| finite(v)).map(|v| json!(v)), Some("float64")),
        SettingValue::Text(value) => (Some(json!(value)), None),
        SettingValue::Bools(values) => (Some(json!(values)), None),
        SettingValue::Bytes(values) => (Some(json!(BASE64_STANDARD.encode(values))), Some("byte_array")),
        SettingValue::Integers(values) => (Some(json!(values)), None),
        SettingValue::Doubles(values) => {
            (Some(values).filter(|v| v.iter().all(finite)).map(|v| json!(v)), Some("float64_array"))
        }
        SettingValue::Texts(values) => (Some(json!(values)), None),
    }
}

/// The value that a viewer asks for, of the type that the setting has.
///
/// # Errors
/// In words, if the value is of another type.
pub(crate) fn wanted(parameter: &Parameter, present: &SettingValue) -> Result<SettingValue, String> {
    let value = &parameter.value;
    fn all<T>(value: &Value, each: impl Fn(&Value) -> Option<T>) -> Option<Vec<T>> {
        value.as_array()?.iter().map(each).collect()
    }
    // JavaScript has one type of numbers: 2.0 arrives as 2, and 2 may arrive as 2.0.
    let integer = |value: &Value| {
        let whole = |number: &f64| number.fract() == 0.0 && number.abs() < 9e15;
        value.as_i64().or_else(|| value.as_f64().filter(whole).map(|number| number as i64))
    };
    let text = |value: &Value| value.as_str().map(str::to_owned);
    let found = match present {
        SettingValue::Bool(_) => value.as_bool().map(SettingValue::Bool),
        SettingValue::Integer(_) => integer(value).map(SettingValue::Integer),
        SettingValue::Double(_) => value.as_f64().map(SettingValue::Double),
        SettingValue::Text(_) => text(value).map(SettingValue::Text),
        SettingValue::Bools(_) => all(value, Value::as_bool).map(SettingValue::Bools),
        SettingValue::Bytes(_) => {
            value.as_str().and_then(|text| BASE64_STANDARD.decode(text).ok()).map(SettingValue::Bytes)
        }
        SettingValue::Integers(_) => all(value, integer).map(SettingValue::Integers),
        SettingValue::Doubles(_) => all(value, Value::as_f64).map(SettingValue::Doubles),
        SettingValue::Texts(_) => all(value, text).map(SettingValue::Texts),
    };
    let expected = match present {
        SettingValue::Bool(_) => "true or false",
        SettingValue::Integer(_) => "a whole number",
        SettingValue::Double(_) => "a number",
        SettingValue::Text(_) => "text",
        SettingValue::Bools(_) => "a list of true and false",
        SettingValue::Bytes(_) => "bytes in base64",
        SettingValue::Integers(_) => "a list of whole numbers",
        SettingValue::Doubles(_) => "a list of numbers",
        SettingValue::Texts(_) => "a list of texts",
    };
    found.ok_or_else(|| format!("{}: expected {expected}, found {value}", parameter.name))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn sent(value: Value) -> Parameter {
        Parameter { name: "walk.x".into(), value }
    }

    #[test]
    fn a_value_survives_as_a_parameter() {
        let values: [SettingValue; 10] = [
            true.into(),
            7_i64.into(),
            0.5.into(),
            2.0.into(),
            "text".to_owned().into(),
            vec![true, false].into(),
            vec![0_u8, 255].into(),
            vec![1_i64, 2].into(),
            vec![0.5, -1.0].into(),
            vec!["a".to_owned()].into(),
        ];
        for value in values {
            let json = parameter("walk.x", &value);
            assert_eq!(json["name"], "walk.x");
            assert_eq!(wanted(&sent(json["value"].clone()), &value), Ok(value));
        }
    }

    #[test]
    fn numbers_have_the_type_of_the_setting() {
        assert_eq!(wanted(&sent(json!(2)), &0.5.into()), Ok(2.0.into()));
        assert_eq!(wanted(&sent(json!(2.0)), &1_i64.into()), Ok(2_i64.into()));
        assert!(wanted(&sent(json!(2.5)), &1_i64.into()).is_err());
        assert_eq!(wanted(&sent(json!([])), &vec![0.5].into()), Ok(Vec::<f64>::new().into()));
        assert_eq!(parameter("a.b", &2.0.into()), json!({ "name": "a.b", "value": 2.0, "type": "float64" }));
        assert_eq!(parameter("a.b", &f64::NAN.into()), json!({ "name": "a.b", "type": "float64" }));
    }

    #[test]
    fn a_value_of_another_type_is_refused_with_both() {
        let error = wanted(&sent(json!("fast")), &0.5.into()).unwrap_err();
        assert_eq!(error, "walk.x: expected a number, found \"fast\"");
        assert!(wanted(&sent(Value::Null), &true.into()).is_err());
        assert!(wanted(&sent(json!("%%")), &vec![0_u8].into()).is_err());
    }
}
