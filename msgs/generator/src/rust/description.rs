//! The fields of a message, as in the trait `Message`.

use super::RustSource;
use downbeat_msgs_definitions::{Element, Field, MessageDefinition, Primitive, Shape, Value};

impl RustSource<'_> {
    /// The constant `FIELDS`.
    pub(super) fn fields_constant(&self, message: &MessageDefinition) -> String {
        if message.fields.is_empty() {
            return "    const FIELDS: &'static [description::Field] = &[];\n".into();
        }
        let mut source = String::from("    const FIELDS: &'static [description::Field] = &[\n");
        for field in &message.fields {
            let rust_type = self.field_type(&field.field_type, &message.name);
            source.push_str(&format!(
                "        description::Field::of::<{rust_type}>(\"{}\"){},\n",
                field.name,
                modifiers(field)
            ));
        }
        source.push_str("    ];\n");
        source
    }
}

/// Properties that the Rust type does not express.
#[must_use]
pub fn modifiers(field: &Field) -> String {
    let mut source = String::new();
    if let Shape::Bounded(bound) = field.field_type.shape {
        source.push_str(&format!(".bounded({bound})"));
    }
    match field.field_type.element {
        Element::String { bound: Some(bound) } | Element::WString { bound: Some(bound) } => {
            source.push_str(&format!(".bounded_text({bound})"));
        }
        Element::Primitive(Primitive::Byte) => source.push_str(".byte()"),
        _ => {}
    }
    if let Some(value) = &field.default {
        let text = match value {
            Value::Text(text) => text.clone(),
            other => python(other),
        };
        source.push_str(&format!(".with_default({text:?})"));
    }
    source
}

/// A value as in Python's `repr`, which ROS 2 uses in generated type descriptions.
fn python(value: &Value) -> String {
    match value {
        Value::Bool(true) => "True".into(),
        Value::Bool(false) => "False".into(),
        Value::Integer(value) => value.to_string(),
        Value::Float(value) => python_float(*value),
        Value::Text(text) => python_text(text),
        Value::List(values) => match values.as_slice() {
            [one] => format!("({},)", python(one)),
            values => format!("({})", values.iter().map(python).collect::<Vec<_>>().join(", ")),
        },
    }
}

/// The shortest digits that round-trip, with an exponent below 1e-4 and from 1e16.
fn python_float(value: f64) -> String {
    if value.is_nan() {
        return "nan".into();
    }
    if value.is_infinite() {
        return if value > 0.0 { "inf".into() } else { "-inf".into() };
    }
    let magnitude = value.abs();
    if magnitude == 0.0 || (1e-4..1e16).contains(&magnitude) {
        return format!("{value:?}");
    }
    let text = format!("{value:e}");
    let (digits, exponent) = text.split_once('e').unwrap_or((&text, "0"));
    match exponent.strip_prefix('-') {
        Some(exponent) => format!("{digits}e-{exponent:0>2}"),
        None => format!("{digits}e+{exponent:0>2}"),
    }
}

fn python_text(text: &str) -> String {
    let quote = if text.contains('\'') && !text.contains('"') { '"' } else { '\'' };
    let mut quoted = String::from(quote);
    for character in text.chars() {
        match character {
            '\\' => quoted.push_str("\\\\"),
            '\n' => quoted.push_str("\\n"),
            '\r' => quoted.push_str("\\r"),
            '\t' => quoted.push_str("\\t"),
            _ if character == quote => quoted.extend(['\\', quote]),
            _ if character.is_ascii_control() => quoted.push_str(&format!("\\x{:02x}", character as u32)),
            _ => quoted.push(character),
        }
    }
    quoted.push(quote);
    quoted
}

#[cfg(test)]
mod tests {
    use super::python;
    use downbeat_msgs_definitions::Value;

    #[test]
    fn values_are_written_as_python_does() {
        let float = |value| python(&Value::Float(value));
        let floats = [0.0, -0.0, 1.5, 1e-3, 1e-4, 9.5e-5, 1e15, 1e16, -2.5e300, f64::NEG_INFINITY].map(float);
        let expected = [
            "0.0",
            "-0.0",
            "1.5",
            "0.001",
            "0.0001",
            "9.5e-05",
            "1000000000000000.0",
            "1e+16",
            "-2.5e+300",
            "-inf",
        ];
        assert_eq!(floats, expected);
        let text = |text: &str| Value::Text(text.into());
        assert_eq!(
            python(&Value::List(vec![text("a'b"), text("\"'\\"), text("\n")])),
            r#"("a'b", '"\'\\', '\n')"#
        );
        assert_eq!(python(&Value::List(vec![Value::Bool(true)])), "(True,)");
        assert_eq!(python(&Value::List(vec![])), "()");
    }
}
