//! Escapes untrusted text for terminals: names and values from messages, bags and the network.

use std::borrow::Cow;
use std::fmt::{self, Write};

/// Escapes control characters, including line ends, as in JSON: `\u001b`. So no name can clear the screen,
/// move the cursor, or look like a separate line.
#[must_use]
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.contains(is_harmful) {
        return Cow::Borrowed(text);
    }
    let mut escaped = String::with_capacity(text.len() + 16);
    // Writing to a `String` cannot fail.
    let _ = write_escaped(&mut escaped, text, is_harmful);
    Cow::Owned(escaped)
}

/// Like [`printable`], but keeps line ends and tabs, for output of several lines.
///
/// # Errors
/// Those of `to`.
pub fn write_printable_lines(to: &mut impl Write, text: &str) -> fmt::Result {
    write_escaped(to, text, |character| is_harmful(character) && !matches!(character, '\n' | '\t'))
}

fn write_escaped(to: &mut impl Write, text: &str, is_escaped: impl Fn(char) -> bool) -> fmt::Result {
    let mut rest = text;
    while let Some(position) = rest.find(&is_escaped) {
        to.write_str(&rest[..position])?;
        let mut characters = rest[position..].chars();
        if let Some(character) = characters.next() {
            write!(to, "\\u{:04x}", u32::from(character))?;
        }
        rest = characters.as_str();
    }
    to.write_str(rest)
}

/// Terminal controls (C0, DEL, C1), and marks that change the direction of text.
fn is_harmful(character: char) -> bool {
    character.is_control()
        || matches!(character, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped_and_other_text_is_kept() {
        assert_eq!(printable("/cam\u{1b}[2J\n/x\u{9b}\u{202e}"), "/cam\\u001b[2J\\u000a/x\\u009b\\u202e");
        assert!(matches!(printable("/köpf/µ"), Cow::Borrowed("/köpf/µ")));
        let mut lines = String::new();
        assert!(write_printable_lines(&mut lines, "a\tb\n\u{7}\r").is_ok());
        assert_eq!(lines, "a\tb\n\\u0007\\u000d");
    }
}
