//! Default values as in the `.json` files of ROS 2 packages, which use Python's syntax.
//!
//! # References
//! `to_idl_literal` in `rosidl_adapter/rosidl_adapter/msg/__init__.py` and `serialize_field` in
//! `rosidl_generator_type_description`, both of ros2/rosidl, branch jazzy.

use crate::msgs::definitions::Value;

/// The result of Python's `str`; lists are printed as tuples.
pub(super) fn default_value(value: &Value) -> String {
    match value {
        Value::Text(text) => text.clone(),
        other => literal(other),
    }
}

/// The result of Python's `repr`.
fn literal(value: &Value) -> String {
    match value {
        Value::Bool(true) => "True".into(),
        Value::Bool(false) => "False".into(),
        Value::Integer(integer) => integer.to_string(),
        Value::Float(float) => float_literal(*float),
        Value::Text(text) => text_literal(text),
        Value::List(values) => match values.as_slice() {
            [one] => format!("({},)", literal(one)),
            several => format!("({})", several.iter().map(literal).collect::<Vec<_>>().join(", ")),
        },
    }
}

/// Both languages print the shortest digits that round-trip, and switch to exponents at the same sizes, but
/// Python's exponents have a sign and two digits.
fn float_literal(float: f64) -> String {
    if float.is_nan() {
        return "nan".into();
    }
    let text = format!("{float:?}");
    match text.split_once('e') {
        Some((digits, exponent)) => match exponent.strip_prefix('-') {
            Some(negative) => format!("{digits}e-{negative:0>2}"),
            None => format!("{digits}e+{exponent:0>2}"),
        },
        None => text,
    }
}

/// In single quotes, unless only double quotes avoid an escape.
fn text_literal(text: &str) -> String {
    let quote = if text.contains('\'') && !text.contains('"') { '"' } else { '\'' };
    let mut literal = String::from(quote);
    for character in text.chars() {
        if character == quote || character == '\\' {
            literal.push('\\');
        }
        literal.push(character);
    }
    literal.push(quote);
    literal
}

#[cfg(test)]
mod tests {
    use super::{Value, default_value};

    #[test]
    fn values_are_written_as_in_python() {
        let text = |text: &str| Value::Text(text.into());
        for (value, expected) in [
            (Value::Bool(true), "True"),
            (Value::Integer(-50), "-50"),
            (Value::Float(1.0), "1.0"),
            (Value::Float(1e-5), "1e-05"),
            (Value::Float(1.5e300), "1.5e+300"),
            (Value::Float(f64::NAN), "nan"),
            (Value::Float(f64::NEG_INFINITY), "-inf"),
            (text("Hello'world!"), "Hello'world!"),
            (Value::List(vec![Value::Integer(1)]), "(1,)"),
            (Value::List(vec![]), "()"),
            (Value::List(vec![text(""), text("it's"), text("a\"'")]), r#"('', "it's", 'a"\'')"#),
        ] {
            assert_eq!(default_value(&value), expected);
        }
    }
}
