//! How a line of the log looks: the grammar of `RCUTILS_CONSOLE_OUTPUT_FORMAT` (`src/logging.c` of rcutils,
//! branch jazzy).

use std::fmt::Write;

use chrono::{Local, TimeZone};
use downbeat_bridge::rosout::LogLine;
use downbeat_msgs::{printable, write_printable_lines};

/// The default of ROS 2.
pub(super) const DEFAULT: &str = "[{severity}] [{time}] [{name}]: {message}";

/// The default for systemd's journal, which has the rest itself.
pub(super) const IN_JOURNAL: &str = "[{name}]: {message}";

/// The maximum length of a format, as in rcutils.
const LONGEST: usize = 2047;

/// A parsed format.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Format {
    parts: Vec<Part>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Part {
    Text(String),
    Token(Token),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Token {
    Severity,
    Name,
    Message,
    FunctionName,
    FileName,
    LineNumber,
    Seconds,
    Nanoseconds,
    DateTime,
}

const TOKENS: [(&str, Token); 9] = [
    ("{severity}", Token::Severity),
    ("{name}", Token::Name),
    ("{message}", Token::Message),
    ("{function_name}", Token::FunctionName),
    ("{file_name}", Token::FileName),
    ("{line_number}", Token::LineNumber),
    ("{time}", Token::Seconds),
    ("{time_as_nanoseconds}", Token::Nanoseconds),
    ("{date_time_with_ms}", Token::DateTime),
];

impl Format {
    /// Parses a format. As in rcutils, there are no errors: anything but tokens is text.
    pub(super) fn read(format: &str) -> Self {
        let end = (0..=format.len().min(LONGEST)).rev().find(|&end| format.is_char_boundary(end));
        let text = unescaped(&format[..end.unwrap_or(0)]);
        let (mut parts, mut plain, mut rest) = (Vec::new(), String::new(), text.as_str());
        while let Some(first) = rest.chars().next() {
            if let Some((name, token)) = TOKENS.into_iter().find(|(name, _)| rest.starts_with(name)) {
                if !plain.is_empty() {
                    parts.push(Part::Text(std::mem::take(&mut plain)));
                }
                parts.push(Part::Token(token));
                rest = &rest[name.len()..];
            } else {
                plain.push(first);
                rest = &rest[first.len_utf8()..];
            }
        }
        if !plain.is_empty() {
            parts.push(Part::Text(plain));
        }
        Self { parts }
    }

    /// Writes the line without a line break.
    pub(super) fn write(&self, line: &LogLine, logger: &str, text: &mut String) {
        for part in &self.parts {
            // Writing to a `String` cannot fail.
            let _ = match part {
                Part::Text(plain) => text.write_str(plain),
                Part::Token(token) => token.write(line, logger, text),
            };
        }
    }
}

impl Token {
    fn write(self, line: &LogLine, logger: &str, text: &mut String) -> std::fmt::Result {
        let (seconds, nanoseconds) =
            (line.time_ns.div_euclid(1_000_000_000), line.time_ns.rem_euclid(1_000_000_000));
        match self {
            Self::Severity => text.write_str(line.severity.name()),
            Self::Name => text.write_str(&printable(logger)),
            Self::Message => write_message(&line.message, text),
            Self::FunctionName => text.write_str(&printable(&line.function)),
            Self::FileName => text.write_str(&printable(&line.file)),
            Self::LineNumber => write!(text, "{}", line.line),
            Self::Seconds => write!(text, "{seconds:010}.{nanoseconds:09}"),
            Self::Nanoseconds => write!(text, "{:019}", line.time_ns),
            Self::DateTime => {
                let time = Local.timestamp_nanos(line.time_ns);
                write!(text, "{}", time.format("%Y-%m-%d %H:%M:%S%.3f"))
            }
        }
    }
}

/// Messages may contain text from the network or a bag: control characters are escaped, and further lines
/// indented, so that they do not look like log lines.
fn write_message(message: &str, text: &mut String) -> std::fmt::Result {
    for (number, line) in message.split('\n').enumerate() {
        if number > 0 {
            text.push_str("\n    ");
        }
        write_printable_lines(text, line)?;
    }
    Ok(())
}

/// Resolves `\a`, `\b`, `\n`, `\r`, `\t` and `\x1b`; other characters are kept with their backslash.
fn unescaped(format: &str) -> String {
    let (mut text, mut rest) = (String::with_capacity(format.len()), format);
    while let Some(position) = rest.find('\\') {
        text.push_str(&rest[..position]);
        rest = &rest[position..];
        let known = [
            ("\\a", '\x07'),
            ("\\b", '\x08'),
            ("\\n", '\n'),
            ("\\r", '\r'),
            ("\\t", '\t'),
            ("\\x1b", '\x1b'),
        ];
        if let Some((escape, character)) = known.into_iter().find(|(escape, _)| rest.starts_with(escape)) {
            text.push(character);
            rest = &rest[escape.len()..];
        } else {
            let length = rest.chars().take(2).map(char::len_utf8).sum();
            text.push_str(&rest[..length]);
            rest = &rest[length..];
        }
    }
    text + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use downbeat_bridge::rosout::Severity;

    fn written(format: &str) -> String {
        let line = LogLine {
            time_ns: 1_795_239_822_020_566_197,
            severity: Severity::Warn,
            module: None,
            message: "servo 5 is silent".into(),
            file: "bus.rs".into(),
            line: 42,
            function: "darwin_op::bus".into(),
        };
        let mut text = String::new();
        Format::read(format).write(&line, "robot.darwin_op", &mut text);
        text
    }

    #[test]
    fn the_default_is_that_of_ros() {
        assert_eq!(written(DEFAULT), "[WARN] [1795239822.020566197] [robot.darwin_op]: servo 5 is silent");
    }

    #[test]
    fn every_token_is_replaced() {
        let all = "{function_name}|{file_name}:{line_number}|{time_as_nanoseconds}|{message}";
        assert_eq!(written(all), "darwin_op::bus|bus.rs:42|1795239822020566197|servo 5 is silent");
        let date = written("{date_time_with_ms}");
        // The hour depends on the machine.
        assert!(date.starts_with("2026-11-2") && date.ends_with("42.020") && date.len() == 23, "{date}");
    }

    #[test]
    fn anything_but_tokens_is_text() {
        assert_eq!(written("{nmae} {{name}} {name {"), "{nmae} {robot.darwin_op} {name {");
        assert_eq!(written(""), "");
    }

    #[test]
    fn escapes_are_those_of_rcutils() {
        assert_eq!(written(r"\x1b[1m{name}\n\t\q\\n"), "\x1b[1mrobot.darwin_op\n\t\\q\\\\n");
        assert_eq!(written("end\\"), "end\\");
    }

    #[test]
    fn an_overlong_format_is_truncated() {
        assert_eq!(written(&"ä".repeat(3000)).len(), 2046);
    }
}
