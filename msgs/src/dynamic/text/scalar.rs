//! Scalars as written by PyYAML: plain if that is unambiguous, else in single quotes, else in double quotes.
//!
//! # References
//! PyYAML 6.0.3: `yaml/emitter.py` (`analyze_scalar`, `choose_scalar_style`, `write_single_quoted`,
//! `write_double_quoted`), `yaml/resolver.py` (plain scalars that are not strings), `yaml/representer.py`
//! (floats).

use downbeat_msgs_definitions::python;

/// The context of a scalar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Context {
    /// After a key or a dash.
    Block,
    /// Between brackets.
    Flow,
}

/// Appends a string. A line break within it is followed by `indentation` spaces.
pub fn write_text(out: &mut String, text: &str, context: Context, indentation: usize) {
    let analysis = Analysis::of(text);
    let allows_plain = match context {
        Context::Block => analysis.allows_block_plain,
        Context::Flow => analysis.allows_flow_plain,
    };
    if allows_plain && !is_read_as_other(text) {
        out.push_str(text);
    } else if analysis.allows_single_quotes {
        write_single_quoted(out, text, indentation);
    } else {
        write_double_quoted(out, text);
    }
}

/// Appends a floating-point number as in Python's `repr`, such that YAML reads it as a number.
pub fn write_float(out: &mut String, value: f64) {
    if value.is_nan() {
        return out.push_str(".nan");
    }
    if value.is_infinite() {
        return out.push_str(if value > 0.0 { ".inf" } else { "-.inf" });
    }
    let start = out.len();
    python::write_float(out, value);
    let text = &out[start..];
    // Without a decimal point, YAML 1.1 reads a string.
    if let Some(exponent) = text.find('e').filter(|_| !text.contains('.')) {
        out.insert_str(start + exponent, ".0");
    }
}

/// The permitted forms of a string.
struct Analysis {
    allows_block_plain: bool,
    allows_flow_plain: bool,
    allows_single_quotes: bool,
}

impl Analysis {
    fn of(text: &str) -> Self {
        let characters: Vec<char> = text.chars().collect();
        let Some((first, last)) = characters.first().zip(characters.last()) else {
            return Self { allows_block_plain: true, allows_flow_plain: false, allows_single_quotes: true };
        };
        let is_mark = text.starts_with("---") || text.starts_with("...");
        let (mut block_indicator, mut flow_indicator) = (is_mark, is_mark);
        let (mut has_break, mut is_special, mut space_after_break, mut break_after_space) =
            (false, false, false, false);
        let mut before = None;
        for (index, character) in characters.iter().copied().enumerate() {
            let ends_word = characters.get(index + 1).copied().is_none_or(is_white);
            let begins_word = before.is_none_or(is_white);
            match character {
                '#' | ',' | '[' | ']' | '{' | '}' | '&' | '*' | '!' | '|' | '>' | '\'' | '"' | '%' | '@'
                | '`'
                    if index == 0 =>
                {
                    (block_indicator, flow_indicator) = (true, true);
                }
                '?' | ':' if index == 0 => {
                    flow_indicator = true;
                    block_indicator |= ends_word;
                }
                '-' if index == 0 && ends_word => (block_indicator, flow_indicator) = (true, true),
                ',' | '?' | '[' | ']' | '{' | '}' => flow_indicator = true,
                ':' => {
                    flow_indicator = true;
                    block_indicator |= ends_word;
                }
                '#' if begins_word => (block_indicator, flow_indicator) = (true, true),
                _ => {}
            }
            has_break |= is_break(character);
            is_special |= !is_printable(character);
            space_after_break |= character == ' ' && before.is_some_and(is_break);
            break_after_space |= is_break(character) && before == Some(' ');
            before = Some(character);
        }
        let is_bounded_by_white = [first, last].into_iter().any(|end| *end == ' ' || is_break(*end));
        let allows_single_quotes = !space_after_break && !break_after_space && !is_special;
        let allows_plain = allows_single_quotes && !is_bounded_by_white && !has_break;
        Self {
            allows_block_plain: allows_plain && !block_indicator,
            allows_flow_plain: allows_plain && !flow_indicator,
            allows_single_quotes,
        }
    }
}

/// A line break is written twice, since a single one is read as a space.
fn write_single_quoted(out: &mut String, text: &str, indentation: usize) {
    out.push('\'');
    let mut rest = text;
    while let Some(character) = rest.chars().next() {
        let end = if is_break(character) {
            rest.find(|c| !is_break(c)).unwrap_or(rest.len())
        } else {
            rest.find(is_break).unwrap_or(rest.len())
        };
        let (run, next) = rest.split_at(end);
        if is_break(character) {
            if character == '\n' {
                out.push('\n');
            }
            out.push_str(run);
            out.extend(std::iter::repeat_n(' ', indentation));
        } else {
            out.push_str(&run.replace('\'', "''"));
        }
        rest = next;
    }
    out.push('\'');
}

fn write_double_quoted(out: &mut String, text: &str) {
    out.push('"');
    for character in text.chars() {
        let escape = match character {
            '\0' => '0',
            '\x07' => 'a',
            '\x08' => 'b',
            '\t' => 't',
            '\n' => 'n',
            '\x0b' => 'v',
            '\x0c' => 'f',
            '\r' => 'r',
            '\x1b' => 'e',
            '"' => '"',
            '\\' => '\\',
            '\u{85}' => 'N',
            '\u{2028}' => 'L',
            '\u{2029}' => 'P',
            ' '..='~' | '\u{a0}'..='\u{d7ff}' | '\u{e000}'..='\u{fefe}' | '\u{ff00}'..='\u{fffd}' => {
                out.push(character);
                continue;
            }
            other => {
                let code = u32::from(other);
                out.push_str(&match code {
                    0..=0xff => format!("\\x{code:02X}"),
                    0x100..=0xffff => format!("\\u{code:04X}"),
                    _ => format!("\\U{code:08X}"),
                });
                continue;
            }
        };
        out.push('\\');
        out.push(escape);
    }
    out.push('"');
}

fn is_break(character: char) -> bool {
    matches!(character, '\n' | '\u{85}' | '\u{2028}' | '\u{2029}')
}

fn is_white(character: char) -> bool {
    matches!(character, '\0' | ' ' | '\t' | '\r') || is_break(character)
}

fn is_printable(character: char) -> bool {
    matches!(character, '\n' | ' '..='~' | '\u{85}' | '\u{a0}'..='\u{d7ff}' | '\u{e000}'..='\u{fffd}'
        | '\u{10000}'..='\u{10fffe}')
        && character != '\u{feff}'
}

/// Returns whether a plain scalar is read as a boolean, a number, null, a date, a merge key or a value key.
fn is_read_as_other(text: &str) -> bool {
    let is_word =
        matches!(text, "" | "~" | "null" | "Null" | "NULL" | "<<" | "=") || truth_value(text).is_some();
    is_word || is_float(text) || is_integer(text) || is_timestamp(text)
}

/// Parses a boolean.
pub(super) fn truth_value(text: &str) -> Option<bool> {
    match text {
        "yes" | "Yes" | "YES" | "true" | "True" | "TRUE" | "on" | "On" | "ON" => Some(true),
        "no" | "No" | "NO" | "false" | "False" | "FALSE" | "off" | "Off" | "OFF" => Some(false),
        _ => None,
    }
}

/// Parses an integer: decimal, `0x`, `0b`, octal with a leading zero, with `_` anywhere after the first
/// digit. Base 60 (`1:30`) is not supported.
pub(super) fn integer(text: &str) -> Option<i128> {
    if !is_integer(text) {
        return None;
    }
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1, digits),
        None => (1, text.strip_prefix('+').unwrap_or(text)),
    };
    let digits = digits.replace('_', "");
    let magnitude = if let Some(binary) = digits.strip_prefix("0b") {
        i128::from_str_radix(binary, 2)
    } else if let Some(hexadecimal) = digits.strip_prefix("0x") {
        i128::from_str_radix(hexadecimal, 16)
    } else if digits.len() > 1 && digits.starts_with('0') {
        i128::from_str_radix(&digits, 8)
    } else {
        digits.parse()
    };
    magnitude.ok().map(|magnitude| sign * magnitude)
}

/// Parses a number with the tag `!!float`, which may also be an integer.
pub(super) fn float(text: &str) -> Option<f64> {
    let (sign, digits) = match text.strip_prefix('-') {
        Some(digits) => (-1.0, digits),
        None => (1.0, text.strip_prefix('+').unwrap_or(text)),
    };
    let size = match &*digits.replace('_', "").to_lowercase() {
        ".inf" => f64::INFINITY,
        ".nan" => f64::NAN,
        digits if digits.starts_with(|c: char| c.is_ascii_digit() || c == '.') => digits.parse().ok()?,
        _ => return None,
    };
    Some(sign * size)
}

fn is_integer(text: &str) -> bool {
    let unsigned = unsigned(text);
    let all = |digits: &str, allowed: fn(u8) -> bool| {
        !digits.is_empty() && digits.bytes().all(|byte| byte == b'_' || allowed(byte))
    };
    if let Some(binary) = unsigned.strip_prefix("0b") {
        return all(binary, |byte| matches!(byte, b'0' | b'1'));
    }
    if let Some(hexadecimal) = unsigned.strip_prefix("0x") {
        return all(hexadecimal, |byte| byte.is_ascii_hexdigit());
    }
    if let Some(octal) = unsigned.strip_prefix('0') {
        return octal.is_empty() || all(octal, |byte| (b'0'..=b'7').contains(&byte));
    }
    // 1:30 is a number in base 60.
    let whole = unsigned.split(':').next().unwrap_or_default();
    whole.starts_with(|c: char| c.is_ascii_digit())
        && all(whole, |byte| byte.is_ascii_digit())
        && are_sixtieths(&unsigned[whole.len()..])
}

fn is_float(text: &str) -> bool {
    let bare = unsigned(text);
    if matches!(bare, ".inf" | ".Inf" | ".INF") || matches!(text, ".nan" | ".NaN" | ".NAN") {
        return true;
    }
    let Some((whole, rest)) = bare.split_once('.') else { return false };
    let end = rest.find(|c: char| c != '_' && !c.is_ascii_digit()).unwrap_or(rest.len());
    let (fraction, exponent) = rest.split_at(end);
    if whole.is_empty() {
        // No sign is allowed here.
        return text.starts_with('.')
            && fraction.starts_with(|c: char| c.is_ascii_digit())
            && is_exponent(exponent);
    }
    let degrees = whole.split(':').next().unwrap_or_default();
    let is_whole = degrees.starts_with(|c: char| c.is_ascii_digit())
        && degrees.bytes().all(|byte| byte == b'_' || byte.is_ascii_digit());
    match &whole[degrees.len()..] {
        "" => is_whole && is_exponent(exponent),
        sixtieths => is_whole && are_sixtieths(sixtieths) && exponent.is_empty(),
    }
}

/// Empty, or an exponent such as `e+5`, with its sign.
fn is_exponent(text: &str) -> bool {
    let Some(rest) = text.strip_prefix(['e', 'E']) else { return text.is_empty() };
    rest.strip_prefix(['+', '-']).is_some_and(is_digits)
}

/// Any number of parts such as `:59`.
fn are_sixtieths(text: &str) -> bool {
    match text.strip_prefix(':') {
        None => text.is_empty(),
        Some(rest) => rest.split(':').all(|part| {
            is_digits(part) && (part.len() == 1 || part.len() == 2 && part.as_bytes()[0] <= b'5')
        }),
    }
}

/// `2001-12-14`, or with a time `2001-12-14t21:59:43.10-05:00`, `2001-12-14 21:59:43.10 -5`.
fn is_timestamp(text: &str) -> bool {
    let mut parts = text.splitn(3, '-');
    let (Some(year), Some(month), Some(rest)) = (parts.next(), parts.next(), parts.next()) else {
        return false;
    };
    let is_short = |part: &str| is_digits(part) && part.len() <= 2;
    if !(is_digits(year) && year.len() == 4 && is_short(month)) {
        return false;
    }
    let day_end = rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len());
    let (day, rest) = rest.split_at(day_end);
    if rest.is_empty() {
        return month.len() == 2 && day.len() == 2;
    }
    let time = match rest.strip_prefix(['T', 't']) {
        Some(time) => time,
        None if rest.starts_with([' ', '\t']) => rest.trim_start_matches([' ', '\t']),
        None => return false,
    };
    let clock_end = time.find(|c: char| c != ':' && !c.is_ascii_digit()).unwrap_or(time.len());
    let (clock, rest) = time.split_at(clock_end);
    let clock: Vec<&str> = clock.split(':').collect();
    let [hour, minute, second] = clock.as_slice() else { return false };
    let is_clock = is_short(hour) && [minute, second].iter().all(|part| is_digits(part) && part.len() == 2);
    let rest = match rest.strip_prefix('.') {
        Some(fraction) => fraction.trim_start_matches(|c: char| c.is_ascii_digit()),
        None => rest,
    };
    is_short(day) && is_clock && is_zone(rest)
}

/// Empty, or ` Z`, `+1`, `-05:30`.
fn is_zone(text: &str) -> bool {
    if text.is_empty() {
        return true;
    }
    let zone = text.trim_start_matches([' ', '\t']);
    let Some(offset) = zone.strip_prefix(['+', '-']) else { return zone == "Z" };
    let (hours, minutes) = match offset.split_once(':') {
        Some((hours, minutes)) => (hours, Some(minutes)),
        None => (offset, None),
    };
    is_digits(hours)
        && hours.len() <= 2
        && minutes.is_none_or(|minutes| is_digits(minutes) && minutes.len() == 2)
}

fn is_digits(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

fn unsigned(text: &str) -> &str {
    text.strip_prefix(['-', '+']).unwrap_or(text)
}

#[cfg(test)]
mod tests {
    use super::{Context, integer, is_read_as_other, write_float, write_text};

    fn float(value: f64) -> String {
        let mut out = String::new();
        write_float(&mut out, value);
        out
    }

    #[test]
    fn floats_are_written_as_in_python() {
        for (value, expected) in [
            (0.0, "0.0"),
            (-0.0, "-0.0"),
            (1e15, "1000000000000000.0"),
            (1e16, "1.0e+16"),
            (1.5e22, "1.5e+22"),
            (1e-4, "0.0001"),
            (1e-5, "1.0e-05"),
            (-1.25e-7, "-1.25e-07"),
            (5e-324, "5.0e-324"),
            (f64::MAX, "1.7976931348623157e+308"),
            (f64::NAN, ".nan"),
            (f64::INFINITY, ".inf"),
            (f64::NEG_INFINITY, "-.inf"),
            (f64::from(0.1_f32), "0.10000000149011612"),
        ] {
            assert_eq!(float(value), expected);
        }
    }

    #[test]
    fn a_line_break_is_followed_by_the_indentation() {
        let mut out = String::new();
        write_text(&mut out, "a'b\n\nc\n", Context::Block, 2);
        assert_eq!(out, "'a''b\n\n\n  c\n\n  '");
    }

    #[test]
    fn scalars_that_are_not_strings_are_recognised() {
        for text in [
            "yes",
            "OFF",
            "~",
            "",
            "null",
            "=",
            "<<",
            "0",
            "-0",
            "+12",
            "1_000",
            "0b1_0",
            "017",
            "0x1F",
            "1:30",
            "-1:30:59",
            "1.",
            "1.5",
            "-1_0.5e+3",
            ".5",
            ".5e-10",
            "1:30.5",
            ".inf",
            "-.INF",
            ".NaN",
            "2001-12-14",
            "2001-1-4T1:59:43",
            "2001-12-14 \t 21:59:43.10 -5",
            "2001-12-14t21:59:43.1-05:00",
            "2001-12-14 21:59:43Z",
        ] {
            assert!(is_read_as_other(text), "{text}");
        }
        for text in [
            "y",
            "N",
            "yEs",
            "nul",
            "1e5",
            "1.5e3",
            "08",
            "0b2",
            "0xg",
            "1:60",
            "1:",
            "-",
            "+",
            ".",
            "-.5",
            "-.nan",
            "_1",
            "2001-1-4",
            "2001-12-14 ",
            "2001-12-14T21:59",
            "2001-12-14 21:59:43 z",
            "1-2-3",
            "12-12-2001",
            "a.b",
            "1.5.6",
        ] {
            assert!(!is_read_as_other(text), "{text}");
        }
    }

    #[test]
    fn integers_have_their_value() {
        for (text, value) in [("-1_000", -1000), ("0x1F", 31), ("017", 15), ("0b101", 5), ("+7", 7), ("0", 0)]
        {
            assert_eq!(integer(text), Some(value), "{text}");
        }
        assert_eq!(integer("1:30"), None);
        assert_eq!(integer(&"9".repeat(60)), None);
    }
}
