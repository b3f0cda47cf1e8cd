//! Values in IDL: of constants, and of the annotation `@default`.

use crate::{Element, FieldType, Primitive, Shape, Value};

/// The value of a literal or of a named constant.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Literal {
    Bool(bool),
    Integer(i128),
    Float(f64),
    Text(String),
}

impl Literal {
    /// Parses a number: decimal, octal, hexadecimal, floating or fixed point.
    pub(super) fn number(text: &str) -> Option<Self> {
        let lower = text.to_ascii_lowercase();
        if let Some(digits) = lower.strip_prefix("0x") {
            return i128::from_str_radix(digits, 16).ok().map(Self::Integer);
        }
        if lower.bytes().all(|byte| byte.is_ascii_digit()) {
            let radix = if lower.len() > 1 && lower.starts_with('0') { 8 } else { 10 };
            return i128::from_str_radix(&lower, radix).ok().map(Self::Integer);
        }
        let is_exponential = lower.contains('e');
        let digits = if is_exponential { &lower } else { lower.strip_suffix(['d', 'f']).unwrap_or(&lower) };
        digits.parse().ok().map(Self::Float)
    }

    pub(super) fn negated(self) -> Option<Self> {
        match self {
            Self::Integer(value) => value.checked_neg().map(Self::Integer),
            Self::Float(value) => Some(Self::Float(-value)),
            Self::Bool(_) | Self::Text(_) => None,
        }
    }

    /// Converts it to a value of that type, if possible.
    pub(super) fn into_value(self, element: &Element) -> Result<Value, String> {
        let expected = match element {
            Element::Primitive(Primitive::Bool) => "TRUE or FALSE".to_owned(),
            Element::Primitive(of) => match of.range() {
                Some((least, greatest)) => format!("an integer from {least} to {greatest}"),
                None => "a number".into(),
            },
            Element::String { bound: None } | Element::WString { bound: None } => "a string".into(),
            Element::String { bound: Some(bound) } => format!("a string of at most {bound} bytes"),
            Element::WString { bound: Some(bound) } => {
                format!("a string of at most {bound} UTF-16 code units")
            }
            Element::Message(name) => {
                return Err(format!("a field of type {name} cannot have a default value"));
            }
        };
        self.fitting(element).ok_or_else(|| format!("expected {expected} as the value"))
    }

    fn fitting(self, element: &Element) -> Option<Value> {
        let within = |length: usize, bound: &Option<u64>| bound.is_none_or(|bound| length as u64 <= bound);
        match (self, element) {
            (Self::Bool(value), Element::Primitive(Primitive::Bool)) => Some(Value::Bool(value)),
            (Self::Integer(value), Element::Primitive(of)) if of.range().is_some() => {
                let (least, greatest) = of.range()?;
                (least..=greatest).contains(&value).then_some(Value::Integer(value))
            }
            (Self::Integer(value), Element::Primitive(Primitive::Float32 | Primitive::Float64)) => {
                Some(Value::Float(value as f64))
            }
            (Self::Float(value), Element::Primitive(Primitive::Float32 | Primitive::Float64)) => {
                Some(Value::Float(value))
            }
            (Self::Text(text), Element::String { bound }) => {
                within(text.len(), bound).then_some(Value::Text(text))
            }
            (Self::Text(text), Element::WString { bound }) => {
                within(text.encode_utf16().count(), bound).then_some(Value::Text(text))
            }
            _ => None,
        }
    }
}

/// The default of a field. For an array or sequence it is a string that contains a Python tuple: `"(1, 2,
/// 3)"`.
pub(super) fn default_value(literal: Literal, field_type: &FieldType) -> Result<Value, String> {
    if field_type.shape == Shape::Single {
        return literal.into_value(&field_type.element);
    }
    let Literal::Text(text) = literal else {
        return Err(format!("the default of `{field_type}` must be a string that contains a tuple"));
    };
    let items = tuple(&text).ok_or_else(|| format!("`{text}` is not a tuple of values"))?;
    field_type.check_count(items.len())?;
    let values = items.into_iter().map(|item| item.into_value(&field_type.element));
    values.collect::<Result<_, _>>().map(Value::List)
}

/// Parses Python's `repr` of a tuple of booleans, numbers or strings.
fn tuple(text: &str) -> Option<Vec<Literal>> {
    let mut rest = text.trim().strip_prefix('(')?.strip_suffix(')')?.trim_start();
    let mut items = Vec::new();
    while !rest.is_empty() {
        let (item, behind) = match rest.chars().next()? {
            quote @ ('\'' | '"') => {
                let (text, behind) = python_string(&rest[1..], quote)?;
                (Literal::Text(text), behind)
            }
            _ => {
                let (item, behind) = rest.split_at(rest.find(',').unwrap_or(rest.len()));
                (python_scalar(item.trim_end())?, behind)
            }
        };
        items.push(item);
        let behind = behind.trim_start();
        rest = match behind.strip_prefix(',') {
            Some(rest) => rest.trim_start(),
            None if behind.is_empty() => behind,
            None => return None,
        };
    }
    Some(items)
}

fn python_scalar(text: &str) -> Option<Literal> {
    match text {
        "True" => Some(Literal::Bool(true)),
        "False" => Some(Literal::Bool(false)),
        _ => match text.parse() {
            Ok(value) => Some(Literal::Integer(value)),
            Err(_) => text.parse().ok().map(Literal::Float),
        },
    }
}

/// Returns the string, and the text after its closing quote.
fn python_string(text: &str, quote: char) -> Option<(String, &str)> {
    let mut value = String::new();
    let mut characters = text.chars();
    loop {
        match characters.next()? {
            end if end == quote => return Some((value, characters.as_str())),
            '\\' => {
                let escape = characters.next()?;
                let digits = match escape {
                    'x' => 2,
                    'u' => 4,
                    'U' => 8,
                    _ => {
                        value.push(match escape {
                            'n' => '\n',
                            'r' => '\r',
                            't' => '\t',
                            same => same,
                        });
                        continue;
                    }
                };
                let rest = characters.as_str();
                let code = u32::from_str_radix(rest.get(..digits)?, 16).ok()?;
                value.push(char::from_u32(code)?);
                characters = rest.get(digits..)?.chars();
            }
            character => value.push(character),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::{Literal, default_value, tuple};
    use crate::{Element, FieldType, Primitive, Shape, Value};

    #[test]
    fn numbers_are_read_in_every_notation() {
        for (text, value) in [("12", 12), ("0x1F", 31), ("017", 15), ("0", 0)] {
            assert_eq!(Literal::number(text), Some(Literal::Integer(value)), "{text}");
        }
        for (text, value) in [("1.5", 1.5), ("1e-05", 1e-5), (".5", 0.5), ("2.d", 2.0), ("1E+3", 1e3)] {
            assert_eq!(Literal::number(text), Some(Literal::Float(value)), "{text}");
        }
        for text in ["08", "0x", "1.2.3", "1e", "12ab"] {
            assert_eq!(Literal::number(text), None, "{text}");
        }
    }

    #[test]
    fn a_tuple_is_read_as_python_writes_it() {
        let texts = |list: &[&str]| list.iter().map(|text| Literal::Text((*text).into())).collect::<Vec<_>>();
        assert_eq!(tuple("()").unwrap(), []);
        assert_eq!(tuple("(1,)").unwrap(), [Literal::Integer(1)]);
        assert_eq!(tuple("(True, -2, 1e-05)").unwrap().len(), 3);
        assert_eq!(
            tuple(r#"('', "it's", 'a, (b)', '\'"\u6f22\x41')"#).unwrap(),
            texts(&["", "it's", "a, (b)", "'\"漢A"])
        );
        for text in ["", "(", "1", "(1 2)", "('a)", "('a' 'b')", "(,)", r"('\u12')", r"('\x漢')"] {
            assert_eq!(tuple(text), None, "{text}");
        }
    }

    #[test]
    fn a_default_has_the_length_and_range_of_its_type() {
        let three = FieldType { element: Element::Primitive(Primitive::Int8), shape: Shape::Array(3) };
        let of = |text: &str| default_value(Literal::Text(text.into()), &three);
        assert_eq!(
            of("(1, 2, 3)").unwrap(),
            Value::List(vec![Value::Integer(1), Value::Integer(2), Value::Integer(3)])
        );
        assert_eq!(of("(1, 2)").unwrap_err(), "`int8[3]` needs exactly 3 values, found 2");
        assert_eq!(of("(1, 2, 300)").unwrap_err(), "expected an integer from -128 to 127 as the value");
        assert!(default_value(Literal::Integer(1), &three).is_err());
    }
}
