//! Constants, defaults and strings as Rust literals.

use downbeat_msgs_definitions::{Element, FieldType, Primitive, Shape, Value};

/// A value as an expression of the field's type.
pub(super) fn expression(value: &Value, field_type: &FieldType, runtime: &str) -> String {
    match (value, field_type.shape) {
        (Value::List(values), shape) => {
            let items: Vec<String> =
                values.iter().map(|value| element_expression(value, &field_type.element, runtime)).collect();
            let list = items.join(", ");
            if matches!(shape, Shape::Array(_)) { format!("[{list}]") } else { format!("vec![{list}]") }
        }
        _ => element_expression(value, &field_type.element, runtime),
    }
}

/// The value of a constant.
pub(super) fn constant(value: &Value, element: &Element) -> String {
    match (value, element) {
        (Value::Bool(value), _) => value.to_string(),
        (Value::Integer(value), _) => value.to_string(),
        (Value::Float(value), Element::Primitive(Primitive::Float32)) => {
            float("f32", &format!("{:?}", *value as f32))
        }
        (Value::Float(value), _) => float("f64", &format!("{value:?}")),
        (Value::Text(text), _) => format!("{text:?}"),
        (Value::List(_), _) => unreachable!("the parser refuses constants that are lists"),
    }
}

/// Returns whether the value equals the type's own default.
pub(super) fn is_zero(value: &Value) -> bool {
    match value {
        Value::Bool(value) => !value,
        Value::Integer(value) => *value == 0,
        Value::Float(value) => *value == 0.0 && value.is_sign_positive(),
        Value::Text(text) => text.is_empty(),
        Value::List(values) => values.is_empty(),
    }
}

/// The zero of a primitive type.
pub(super) fn zero(primitive: Primitive) -> &'static str {
    match primitive {
        Primitive::Bool => "false",
        Primitive::Float32 | Primitive::Float64 => "0.0",
        _ => "0",
    }
}

/// A string literal of the text: raw, unless it contains a carriage return.
pub(super) fn text_literal(text: &str) -> String {
    if text.contains('\r') || !text.contains('\n') {
        return format!("{text:?}");
    }
    let mut hashes = String::new();
    while text.contains(&format!("\"{hashes}")) {
        hashes.push('#');
    }
    format!("r{hashes}\"{text}\"{hashes}")
}

/// If the line starts a raw string of several lines, the end of that string.
pub(super) fn opens_raw_string(line: &str) -> Option<String> {
    let literal = line.trim_start().strip_prefix("const DEFINITION: &'static str = r")?;
    let hashes = &literal[..literal.len() - literal.trim_start_matches('#').len()];
    let end = format!("\"{hashes};");
    if line.ends_with(&end) { None } else { Some(end) }
}

fn element_expression(value: &Value, element: &Element, runtime: &str) -> String {
    let literal = constant(value, element);
    match element {
        Element::String { .. } => format!("{literal}.into()"),
        Element::WString { .. } => format!("{runtime}::WString({literal}.into())"),
        _ => literal,
    }
}

fn float(float_type: &str, literal: &str) -> String {
    match literal {
        "inf" => format!("{float_type}::INFINITY"),
        "-inf" => format!("{float_type}::NEG_INFINITY"),
        "NaN" => format!("{float_type}::NAN"),
        _ => literal.into(),
    }
}
