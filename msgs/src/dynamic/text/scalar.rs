//! Scalars as written by PyYAML: plain if that is unambiguous, else in single quotes, else in double quotes.
//!
//! # References
//! PyYAML 6.0.3: `yaml/emitter.py` (`analyze_scalar`, `choose_scalar_style`, `write_single_quoted`,
//! `write_double_quoted`), `yaml/resolver.py` (plain scalars that are not strings), `yaml/representer.py`
//! (floats).

use super::implicit::is_read_as_other;
use super::python;

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

#[cfg(test)]
mod tests {
    use super::{Context, write_float, write_text};

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
}
