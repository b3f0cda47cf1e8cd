//! Escaping of names for JSON, DOT and Mermaid.

use std::fmt::Write;

/// The text as a JSON string, with its quotation marks.
pub(crate) fn json_string(text: &str) -> String {
    let mut json = String::with_capacity(text.len() + 2);
    json.push('"');
    for c in text.chars() {
        match c {
            '"' => json.push_str("\\\""),
            '\\' => json.push_str("\\\\"),
            c if c < ' ' => {
                let _ = write!(json, "\\u{:04x}", u32::from(c));
            }
            c => json.push(c),
        }
    }
    json.push('"');
    json
}

/// The lines as a string of the DOT language, with its quotation marks. Control characters in names become
/// spaces.
pub(crate) fn dot_string<'a>(lines: impl IntoIterator<Item = &'a str>) -> String {
    let escape = |line: &str| {
        let line = line.replace('\\', "\\\\").replace('"', "\\\"");
        line.replace(char::is_control, " ")
    };
    let lines: Vec<_> = lines.into_iter().map(escape).collect();
    format!("\"{}\"", lines.join("\\n"))
}

/// The lines as a string of Mermaid, with its quotation marks. Characters with a meaning in markup become
/// entity codes.
pub(crate) fn mermaid_string<'a>(lines: impl IntoIterator<Item = &'a str>) -> String {
    let escape = |line: &str| {
        let mut text = String::with_capacity(line.len());
        for c in line.chars() {
            match c {
                '"' | '#' | '&' | '<' | '>' | '`' | '\\' => {
                    let _ = write!(text, "#{};", u32::from(c));
                }
                c if c.is_control() => text.push(' '),
                c => text.push(c),
            }
        }
        text
    };
    let lines: Vec<_> = lines.into_iter().map(escape).collect();
    format!("\"{}\"", lines.join("<br/>"))
}

/// The Rust type without the paths of modules: `Option<JointState>` for
/// `core::option::Option<msgs::sensor_msgs::JointState>`.
pub(crate) fn short_type(path: &str) -> String {
    let mut short = String::new();
    for part in path.split_inclusive(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':')) {
        short.push_str(part.rsplit("::").next().unwrap_or(part));
    }
    short
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_json_string_is_read_back_as_it_was() {
        for text in ["", "plain", "a \"b\" \\ \n\t\u{1}", "größe 机"] {
            assert_eq!(serde_json::from_str::<String>(&json_string(text)).ok().as_deref(), Some(text));
        }
    }

    #[test]
    fn a_name_cannot_end_a_string_of_dot() {
        assert_eq!(dot_string(["a\" -> b\\", "c\nd"]), r#""a\" -> b\\\nc d""#);
    }

    #[test]
    fn a_name_cannot_end_a_string_of_mermaid() {
        assert_eq!(mermaid_string(["a\"]", "Vec<u8>#1"]), r#""a#34;]<br/>Vec#60;u8#62;#35;1""#);
    }

    #[test]
    fn types_are_shown_without_paths() {
        assert_eq!(short_type("u32"), "u32");
        assert_eq!(short_type("a::b::C"), "C");
        assert_eq!(short_type("core::option::Option<(a::B, [c::d::E; 3])>"), "Option<(B, [E; 3])>");
        assert_eq!(short_type("sensor_msgs/msg/Imu"), "sensor_msgs/msg/Imu");
    }
}
