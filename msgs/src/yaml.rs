//! Parses untrusted YAML: input that would keep the parser busy for long is rejected first.
//!
//! The parser, a translation of libyaml, visits every open bracket for every token: 100 kB of `[` take
//! seconds. So the work is estimated first.

use std::borrow::Cow;

use serde::de::{DeserializeOwned, Error as _};
use serde_norway::{Deserializer, Error};

/// Characters times open brackets, about one second of parsing in a debug build.
const MOST_WORK: usize = 100_000_000;

/// The longest text, in bytes.
const LONGEST: usize = 64 * 1024 * 1024;

/// Reads a value from a YAML text.
///
/// # Errors
/// Returns an error if the text is not YAML, does not have this structure, or is unreasonably long or deeply
/// nested.
pub fn from_str<T: DeserializeOwned>(text: &str) -> Result<T, Error> {
    T::deserialize(deserializer(text)?)
}

/// A deserializer for a YAML text.
///
/// # Errors
/// Returns an error if the text is unreasonably long or deeply nested.
pub fn deserializer(text: &str) -> Result<Deserializer<'_>, Error> {
    if text.len() > LONGEST {
        return Err(Error::custom(format_args!("{} bytes of YAML, the limit is {LONGEST}", text.len())));
    }
    if work(text) > MOST_WORK {
        return Err(Error::custom("too many nested brackets"));
    }
    Ok(Deserializer::from_str(text))
}

/// The tags whose values the parser either does not pass on, or reads other than YAML 1.1.
const LOCAL_TAGS: [&str; 4] = ["binary", "bool", "int", "float"];

/// Replaces tags such as `!!binary` by `!binary `: the parser passes on only tags of the latter kind. Quotes
/// and comments are left alone, and so are the places of everything else.
#[must_use]
pub fn with_local_tags(yaml: &str) -> Cow<'_, str> {
    if !yaml.contains("!!") {
        return Cow::Borrowed(yaml);
    }
    let tag_at = |text: &str| {
        let name = text.strip_prefix("!!")?;
        LOCAL_TAGS.into_iter().find(|tag| {
            let after = name.strip_prefix(tag);
            after.is_some_and(|after| {
                !after.starts_with(|c: char| c.is_alphanumeric() || c == '_' || c == '-')
            })
        })
    };
    let mut replaced = String::with_capacity(yaml.len());
    let (mut quote, mut is_escaped, mut is_comment, mut previous, mut skipped) = (None, false, false, ' ', 0);
    // The last character that is neither white space nor in a comment: a value begins after a few of them
    // only.
    let mut last = ':';
    for (at, c) in yaml.char_indices() {
        if at < skipped {
            continue;
        }
        let begins = (previous.is_whitespace() || "[{,".contains(previous)) && "[{,:-?".contains(last);
        match quote {
            _ if is_comment => is_comment = c != '\n',
            Some('"') if is_escaped => is_escaped = false,
            Some('"') if c == '\\' => is_escaped = true,
            Some(open) => quote = Some(open).filter(|open| *open != c),
            None if c == '\n' => last = if last == '|' || last == '>' { last } else { ':' },
            None if begins && (c == '"' || c == '\'') => quote = Some(c),
            None if c == '#' && previous.is_whitespace() => is_comment = true,
            None if begins && let Some(tag) = tag_at(&yaml[at..]) => {
                replaced.push('!');
                replaced.push_str(tag);
                replaced.push(' ');
                skipped = at + "!!".len() + tag.len();
                // Quotes may follow.
                (previous, last) = (' ', ':');
                continue;
            }
            None => {}
        }
        replaced.push(c);
        previous = c;
        if !c.is_whitespace() && !is_comment {
            last = c;
        }
    }
    Cow::Owned(replaced)
}

/// The number of open brackets, summed up over all characters: an upper bound.
///
/// Only the parser knows whether a bracket is part of a string or a comment. So every opening bracket counts,
/// and a closing one cancels the last opening one only if nothing between them could start a string or a
/// comment.
fn work(text: &str) -> usize {
    let (mut open, mut closable, mut work) = (0_usize, 0_usize, 0_usize);
    for byte in text.bytes() {
        match byte {
            b'[' | b'{' => {
                open += 1;
                closable += 1;
            }
            b']' | b'}' if closable > 0 => {
                open -= 1;
                closable -= 1;
            }
            b'"' | b'\'' | b'#' | b'|' | b'>' => closable = 0,
            _ => {}
        }
        work = work.saturating_add(open);
    }
    work
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::time::{Duration, Instant};

    use serde_norway::Value;

    use super::*;

    #[test]
    fn nesting_that_takes_the_parser_seconds_is_refused_at_once() {
        let deep = [
            "[".repeat(100_000),
            "{".repeat(100_000),
            "[{".repeat(50_000),
            "a: {b: ".repeat(50_000),
            r#"["]", "#.repeat(50_000),
            format!("a: it's\nb: {}", r#"["]", "#.repeat(50_000)),
            format!("a: foo\n  'bar\nb: {}", "['x]', ".repeat(50_000)),
        ];
        for text in deep {
            let begun = Instant::now();
            let error = from_str::<Value>(&text).unwrap_err().to_string();
            assert!(error.contains("brackets"), "{error}");
            assert!(begun.elapsed() < Duration::from_secs(5), "{:.20}", text);
        }
        for text in
            ["- ".repeat(100_000), "? ".repeat(100_000), "&a ".repeat(100_000), "a:\n ".repeat(50_000)]
        {
            let begun = Instant::now();
            assert!(from_str::<Value>(&text).is_err(), "{:.20}", text);
            assert!(begun.elapsed() < Duration::from_secs(5), "{:.20}", text);
        }
    }

    #[test]
    fn long_texts_with_many_small_brackets_are_read() {
        let points = r#"- {frame: "it's [a map]", at: [1, 2.5, {z: 3}]} # [ "#.to_owned() + "\n";
        let list: Vec<Value> = from_str(&points.repeat(500)).unwrap();
        assert_eq!(list.len(), 500);
        let plain: Vec<Value> = from_str(&"- {x: 1, y: [2, 3]}\n".repeat(10_000)).unwrap();
        assert_eq!(plain.len(), 10_000);
    }
}
