//! Parses values of constants and defaults like `rosidl_adapter`.

use std::borrow::Cow;

use crate::{Element, FieldType, Primitive, Shape, Value};

/// Parses the value of a field of that type.
pub(crate) fn parse_value(field_type: &FieldType, text: &str) -> Result<Value, String> {
    if matches!(field_type.element, Element::Message(_)) {
        return Err(format!("a field of type `{field_type}` cannot have a default value"));
    }
    if field_type.shape == Shape::Single {
        return parse_element(&field_type.element, text);
    }
    let inner = text
        .strip_prefix('[')
        .and_then(|rest| rest.strip_suffix(']'))
        .ok_or_else(|| format!("the value of `{field_type}` must be a list in brackets, found `{text}`"))?;
    let items = match field_type.element {
        Element::String { .. } | Element::WString { .. } => split_texts(inner)?,
        _ if inner.trim().is_empty() => Vec::new(),
        _ => inner.split(',').map(|item| item.trim().to_owned()).collect(),
    };
    field_type.check_count(items.len())?;
    items
        .iter()
        .map(|item| parse_element(&field_type.element, item))
        .collect::<Result<_, _>>()
        .map(Value::List)
}

/// Parses one value.
pub(crate) fn parse_element(element: &Element, text: &str) -> Result<Value, String> {
    match element {
        Element::Primitive(Primitive::Bool) => match text.to_ascii_lowercase().as_str() {
            "true" | "1" => Ok(Value::Bool(true)),
            "false" | "0" => Ok(Value::Bool(false)),
            _ => Err(format!("expected `true`, `1`, `false` or `0` (bool), found `{text}`")),
        },
        Element::Primitive(primitive @ (Primitive::Float32 | Primitive::Float64)) => without_underscores(
            text, 10,
        )
        .and_then(|text| text.parse().ok())
        .map(Value::Float)
        .ok_or_else(|| {
            format!("expected a number with `.` as its separator ({}), found `{text}`", primitive.as_str())
        }),
        Element::Primitive(primitive) => integer(*primitive, text),
        Element::String { bound } => {
            let text = unquote(text)?;
            within(&text, text.len() as u64, *bound).map(|()| Value::Text(text))
        }
        Element::WString { bound } => {
            let text = unquote(text)?;
            within(&text, text.encode_utf16().count() as u64, *bound).map(|()| Value::Text(text))
        }
        Element::Message(name) => Err(format!("a value of type `{name}` cannot be written")),
    }
}

fn integer(primitive: Primitive, text: &str) -> Result<Value, String> {
    let (least, greatest) = primitive.range().unwrap_or((0, 0));
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text.strip_prefix('+').unwrap_or(text)),
    };
    let lower = digits.to_ascii_lowercase();
    let bases = [("0x", 16), ("0o", 8), ("0b", 2)];
    let based = bases.iter().find_map(|(prefix, radix)| Some((lower.strip_prefix(prefix)?, *radix)));
    let magnitude = match based {
        // An underscore may also follow the prefix.
        Some((digits, radix)) => {
            let digits = without_underscores(digits.strip_prefix('_').unwrap_or(digits), radix);
            digits.and_then(|digits| i128::from_str_radix(&digits, radix).ok())
        }
        None => without_underscores(&lower, 10).and_then(|digits| digits.parse().ok()),
    };
    // No second sign.
    let magnitude = magnitude.filter(|_: &i128| !digits.contains(['+', '-']));
    match magnitude.map(|magnitude| sign * magnitude) {
        Some(value) if (least..=greatest).contains(&value) => Ok(Value::Integer(value)),
        _ => Err(format!(
            "expected an integer from {least} to {greatest} ({}), found `{text}`",
            primitive.as_str()
        )),
    }
}

/// Removes the underscores that Python permits between two digits.
pub(super) fn without_underscores(text: &str, radix: u32) -> Option<Cow<'_, str>> {
    if !text.contains('_') {
        return Some(text.into());
    }
    let parts: Vec<&str> = text.split('_').collect();
    let ends_in_digit = |part: &&str| part.ends_with(|c: char| c.is_digit(radix));
    let begins_with_digit = |part: &&str| part.starts_with(|c: char| c.is_digit(radix));
    let (_, but_first) = parts.split_first()?;
    let (_, but_last) = parts.split_last()?;
    let is_number = but_last.iter().all(ends_in_digit) && but_first.iter().all(begins_with_digit);
    is_number.then(|| parts.concat().into())
}

fn within(text: &str, length: u64, bound: Option<u64>) -> Result<(), String> {
    match bound {
        Some(bound) if length > bound => {
            Err(format!("the string may have {bound} characters, `{text}` has {length}"))
        }
        _ => Ok(()),
    }
}

/// Removes the outer quotes, if both exist, and the backslashes before inner ones.
fn unquote(text: &str) -> Result<String, String> {
    for quote in ['"', '\''] {
        if let Some(rest) = text.strip_prefix(quote)
            && text.ends_with(quote)
        {
            // A single quote is both.
            let inner = rest.strip_suffix(quote).unwrap_or(rest);
            let mut before = None;
            for character in inner.chars() {
                if character == quote && before != Some('\\') {
                    return Err(format!("the quotes within {text} need a backslash before them"));
                }
                before = Some(character);
            }
            return Ok(inner.replace(&format!("\\{quote}"), &quote.to_string()));
        }
    }
    Ok(text.to_owned())
}

/// Splits a list of strings at the commas outside of quotes; the quotes stay.
fn split_texts(inner: &str) -> Result<Vec<String>, String> {
    let mut items = Vec::new();
    let mut item = String::new();
    let mut open: Option<char> = None;
    let mut before = None;
    for character in inner.chars() {
        match open {
            Some(quote) if character == quote && before != Some('\\') => open = None,
            None if item.trim().is_empty() && matches!(character, '"' | '\'') => open = Some(character),
            None if character == ',' => {
                items.push(std::mem::take(&mut item).trim().to_owned());
                before = Some(character);
                continue;
            }
            _ => {}
        }
        item.push(character);
        before = Some(character);
    }
    if let Some(quote) = open {
        return Err(format!("the list [{inner}] has an opening {quote} without its closing one"));
    }
    if !item.trim().is_empty() {
        items.push(item.trim().to_owned());
    }
    if items.iter().any(String::is_empty) {
        return Err(format!("the list [{inner}] has an empty item; an empty string is written \"\""));
    }
    Ok(items)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::{parse_element, parse_value};
    use crate::{Element, FieldType, Primitive, Shape, Value};

    const TEXT: Element = Element::String { bound: None };

    fn text(literal: &str) -> Result<Value, String> {
        parse_element(&TEXT, literal)
    }

    #[test]
    fn quotes_are_removed_and_escapes_resolved() {
        assert_eq!(text(r#""Hello world!""#).unwrap(), Value::Text("Hello world!".into()));
        assert_eq!(text(r"'Hello\'world!'").unwrap(), Value::Text("Hello'world!".into()));
        assert_eq!(text(r#"'Hello"world!'"#).unwrap(), Value::Text("Hello\"world!".into()));
        assert_eq!(text("plain").unwrap(), Value::Text("plain".into()));
        assert!(text(r#""a"b""#).is_err());
    }

    #[test]
    fn commas_within_quotes_do_not_split_a_list() {
        let strings = FieldType { element: TEXT, shape: Shape::Sequence };
        let texts =
            |list: &[&str]| Value::List(list.iter().map(|item| Value::Text((*item).into())).collect());
        assert_eq!(
            parse_value(&strings, r#"["", "max value", 'a,"b']"#).unwrap(),
            texts(&["", "max value", "a,\"b"])
        );
        assert_eq!(parse_value(&strings, "[]").unwrap(), texts(&[]));
        assert!(parse_value(&strings, r#"["a]"#).is_err());
        assert!(parse_value(&strings, r#"["a",,"b"]"#).is_err());
    }

    #[test]
    fn integers_are_checked_against_the_range_of_their_type() {
        let byte = Element::Primitive(Primitive::UInt8);
        assert_eq!(parse_element(&byte, "0xff").unwrap(), Value::Integer(255));
        assert!(parse_element(&byte, "256").is_err());
        assert!(parse_element(&byte, "-1").is_err());
        assert!(parse_element(&byte, "--1").is_err());
        let long = Element::Primitive(Primitive::Int64);
        assert_eq!(parse_element(&long, "-9223372036854775808").unwrap(), Value::Integer(i64::MIN.into()));
    }

    #[test]
    fn a_list_has_the_length_its_type_requires() {
        let three = FieldType { element: Element::Primitive(Primitive::Int8), shape: Shape::Array(3) };
        assert!(parse_value(&three, "[1, 2]").is_err());
        let at_most = FieldType { shape: Shape::Bounded(3), ..three };
        assert!(parse_value(&at_most, "[1, 2]").is_ok());
        assert!(parse_value(&at_most, "[1, 2, 3, 4]").is_err());
    }
}
