//! Values as Python prints them: `repr` and `str`.
//!
//! # References
//! `Objects/unicodeobject.c` and `Objects/bytesobject.c` of CPython (how strings are quoted).

use std::fmt::Write;

use crate::Value;

impl Value {
    /// The value as in `str`; lists are tuples. ROS 2 writes the defaults of type descriptions so.
    #[must_use]
    pub fn to_python_str(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            other => other.to_python_repr(),
        }
    }

    /// The value as in `repr`; lists are tuples.
    #[must_use]
    pub fn to_python_repr(&self) -> String {
        let mut out = String::new();
        match self {
            Self::Bool(value) => out.push_str(if *value { "True" } else { "False" }),
            Self::Integer(value) => return value.to_string(),
            Self::Float(value) => write_float(&mut out, *value),
            Self::Text(text) => write_text(&mut out, text),
            Self::List(values) => match values.as_slice() {
                [one] => return format!("({},)", one.to_python_repr()),
                values => {
                    let values: Vec<String> = values.iter().map(Self::to_python_repr).collect();
                    return format!("({})", values.join(", "));
                }
            },
        }
        out
    }
}

/// Appends a floating-point number as in `repr`.
pub fn write_float(out: &mut String, value: f64) {
    if value.is_nan() {
        return out.push_str("nan");
    }
    if value.is_infinite() {
        return out.push_str(if value > 0.0 { "inf" } else { "-inf" });
    }
    // The shortest digits that round-trip: `-1.5e-7`.
    let scientific = format!("{value:e}");
    let (mantissa, exponent) = scientific.split_once('e').unwrap_or((&scientific, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    if (-4..16).contains(&exponent) {
        let _ = write!(out, "{value:?}");
    } else {
        let sign = if exponent < 0 { '-' } else { '+' };
        let _ = write!(out, "{mantissa}e{sign}{:02}", exponent.unsigned_abs());
    }
}

/// Appends a string as in `repr`.
pub fn write_text(out: &mut String, text: &str) {
    let quote = if text.contains('\'') && !text.contains('"') { '"' } else { '\'' };
    out.push(quote);
    for character in text.chars() {
        if character == quote || character == '\\' {
            out.push('\\');
            out.push(character);
        } else {
            write_escaped(out, character);
        }
    }
    out.push(quote);
}

/// Appends bytes as in `repr`.
pub fn write_bytes(out: &mut String, bytes: &[u8]) {
    let quote = if bytes.contains(&b'\'') && !bytes.contains(&b'"') { '"' } else { '\'' };
    out.push('b');
    out.push(quote);
    for byte in bytes {
        match char::from(*byte) {
            '\t' => out.push_str("\\t"),
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            character if character == quote || character == '\\' => {
                out.push('\\');
                out.push(character);
            }
            character @ ' '..='~' => out.push(character),
            _ => {
                let _ = write!(out, "\\x{byte:02x}");
            }
        }
    }
    out.push(quote);
}

fn write_escaped(out: &mut String, character: char) {
    let code = u32::from(character);
    match character {
        '\t' => out.push_str("\\t"),
        '\n' => out.push_str("\\n"),
        '\r' => out.push_str("\\r"),
        // Characters that Python escapes: control characters, direction marks and line separators.
        _ if character.is_control() || code == 0xad => {
            let _ = write!(out, "\\x{code:02x}");
        }
        '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}' => {
            let _ = write!(out, "\\u{code:04x}");
        }
        _ => out.push(character),
    }
}

#[cfg(test)]
mod tests {
    use crate::Value;

    fn text(text: &str) -> Value {
        Value::Text(text.into())
    }

    #[test]
    fn values_are_written_as_python_does() {
        let float = |value| Value::Float(value).to_python_repr();
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
        assert_eq!(
            Value::List(vec![text("a'b"), text("\"'\\"), text("\n")]).to_python_repr(),
            r#"("a'b", '"\'\\', '\n')"#
        );
        assert_eq!(Value::List(vec![Value::Bool(true)]).to_python_repr(), "(True,)");
        assert_eq!(Value::List(vec![]).to_python_repr(), "()");
    }

    #[test]
    fn values_are_written_as_in_python() {
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
            assert_eq!(value.to_python_str(), expected);
        }
    }
}
