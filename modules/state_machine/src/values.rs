//! Messages as values of expressions, and back.

use downbeat_msgs::dynamic::{Array, DynamicMessage, DynamicType, FieldError, MessageRef, Value, ValueRef};
use rhai::{Dynamic, Map};

/// A message as a map. Bytes become an array of integers.
pub(crate) fn to_map(message: MessageRef<'_>) -> Map {
    message.fields().map(|(name, value)| (name.into(), to_dynamic(value))).collect()
}

fn to_dynamic(value: ValueRef<'_>) -> Dynamic {
    match value {
        ValueRef::Message(message) => to_map(message).into(),
        ValueRef::Array(array) => array.iter().map(to_dynamic).collect::<Vec<_>>().into(),
        ValueRef::Bool(value) => value.into(),
        ValueRef::Float32(value) => f64::from(value).into(),
        ValueRef::Float64(value) => value.into(),
        ValueRef::String(text) | ValueRef::WString(text) => text.to_owned().into(),
        // Beyond the integers of the language, the nearest number.
        integer => {
            integer.as_i64().map_or_else(|| integer.as_f64().unwrap_or_default().into(), Dynamic::from_int)
        }
    }
}

/// A message of a type with the fields of a map; the others have their defaults. A key may be a path:
/// `linear.x`. A value that is no map becomes the only field of a message with one.
pub(crate) fn to_message(of: &DynamicType, value: &Dynamic) -> Result<DynamicMessage, String> {
    let mut message = DynamicMessage::new(of);
    if value.is_unit() {
        return Ok(message);
    }
    if let Ok(map) = value.as_map_ref() {
        set_fields(&mut message, "", &map).map_err(|error| error.to_string())?;
        return Ok(message);
    }
    let names: Vec<String> = of.fields().map(|field| field.name.to_owned()).collect();
    let [only] = &names[..] else {
        return Err(format!("a {} has the fields {}; give them with <param>", of.name(), names.join(", ")));
    };
    set(&mut message, only, value).map_err(|error| error.to_string())?;
    Ok(message)
}

fn set_fields(message: &mut DynamicMessage, prefix: &str, map: &Map) -> Result<(), FieldError> {
    for (name, value) in map {
        let path = if prefix.is_empty() { name.to_string() } else { format!("{prefix}.{name}") };
        set(message, &path, value)?;
    }
    Ok(())
}

fn set(message: &mut DynamicMessage, path: &str, value: &Dynamic) -> Result<(), FieldError> {
    if let Ok(map) = value.as_map_ref() {
        return set_fields(message, path, &map);
    }
    let Ok(array) = value.as_array_ref() else { return message.set(path, scalar(value)) };
    if array.iter().any(Dynamic::is_map) {
        message.resize(path, array.len())?;
        return array
            .iter()
            .enumerate()
            .try_for_each(|(index, element)| set(message, &format!("{path}[{index}]"), element));
    }
    let array = if array.iter().all(Dynamic::is_int) {
        Array::Int64(array.iter().filter_map(|value| value.as_int().ok()).collect())
    } else if array.iter().all(|value| value.is_int() || value.is_float()) {
        let number =
            |value: &Dynamic| value.as_float().or_else(|_| value.as_int().map(|integer| integer as f64));
        Array::Float64(array.iter().filter_map(|value| number(value).ok()).collect())
    } else if array.iter().all(Dynamic::is_bool) {
        Array::Bool(array.iter().filter_map(|value| value.as_bool().ok()).collect())
    } else {
        Array::String(array.iter().map(Dynamic::to_string).collect())
    };
    message.set(path, array)
}

fn scalar(value: &Dynamic) -> Value {
    match (value.as_bool(), value.as_int(), value.as_float()) {
        (Ok(value), ..) => Value::Bool(value),
        (_, Ok(value), _) => Value::Int64(value),
        (_, _, Ok(value)) => Value::Float64(value),
        _ => Value::String(value.to_string()),
    }
}
