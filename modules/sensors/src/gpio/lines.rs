//! Which lines of a chip a module uses, and how.

use std::time::Duration;

/// How an input is held while nothing drives it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Bias {
    /// As the board has it.
    #[default]
    AsIs,
    /// To the supply.
    PullUp,
    /// To ground.
    PullDown,
    /// Not at all.
    None,
}

/// How an output drives its line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Drive {
    /// Both ways.
    #[default]
    PushPull,
    /// To ground only.
    OpenDrain,
    /// To the supply only.
    OpenSource,
}

/// What a line is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Use {
    /// It is read.
    Input {
        /// How it is held.
        bias: Bias,
        /// Changes that last shorter are no changes.
        debounce: Duration,
    },
    /// It is set.
    Output {
        /// How it is driven.
        drive: Drive,
        /// What it is before the first command, after silence, and at the end.
        safe: bool,
    },
}

/// A line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// Its name in topics.
    pub name: String,
    /// Its number on the chip, or the name that the chip has for it.
    pub line: String,
    /// Whether a low voltage is true.
    pub is_active_low: bool,
    /// Whether it is an input or an output, with what belongs to that.
    pub purpose: Use,
}

/// The most lines of a module.
pub const MOST_LINES: usize = 64;

/// The direction that a setting is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Direction {
    In,
    Out,
}

/// Reads lines, such as `button = 17, pull_up, active_low, debounce_ms=10`.
///
/// # Errors
/// Which text is none, and why.
pub(super) fn parse_all(texts: &[String], direction: Direction) -> Result<Vec<Line>, String> {
    let lines = texts.iter().map(|text| parse(text, direction).map_err(|why| format!("\"{text}\": {why}")));
    let lines = lines.collect::<Result<Vec<_>, String>>()?;
    for (place, line) in lines.iter().enumerate() {
        if let Some(other) =
            lines.iter().take(place).find(|other| other.name == line.name || other.line == line.line)
        {
            return Err(format!("\"{}\" and \"{}\" have the same name or line", other.name, line.name));
        }
    }
    Ok(lines)
}

fn parse(text: &str, direction: Direction) -> Result<Line, String> {
    let mut words = text.split(',').map(str::trim);
    let (name, line) = words
        .next()
        .and_then(|first| first.split_once('='))
        .map(|(name, line)| (name.trim(), line.trim()))
        .filter(|(_, line)| !line.is_empty() && line.len() < 32)
        .ok_or("expected a name and a line, such as \"button = 17\" or \"button = GPIO17\"")?;
    let is_name = name.starts_with(|c: char| c.is_ascii_alphabetic())
        && name.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
    if !is_name {
        return Err(format!("\"{name}\" is no name of a topic: letters, digits and _, first a letter"));
    }
    let (mut is_active_low, mut bias, mut debounce) = (false, Bias::AsIs, Duration::ZERO);
    let (mut drive, mut safe) = (Drive::PushPull, false);
    for word in words {
        let (key, value) = match word.split_once('=') {
            Some((key, value)) => (key.trim(), Some(value.trim())),
            None => (word, None),
        };
        match (direction, key, value) {
            (_, "active_low", None) => is_active_low = true,
            (Direction::In, "pull_up", None) => bias = Bias::PullUp,
            (Direction::In, "pull_down", None) => bias = Bias::PullDown,
            (Direction::In, "no_bias", None) => bias = Bias::None,
            (Direction::In, "debounce_ms", Some(ms)) => {
                let ms: f64 = ms.parse().map_err(|_| format!("debounce_ms is a number, not \"{ms}\""))?;
                let is_some = (0.0..=10_000.0).contains(&ms);
                debounce = Duration::try_from_secs_f64(ms * 1e-3)
                    .ok()
                    .filter(|_| is_some)
                    .ok_or_else(|| format!("debounce_ms is {ms}, expected 0 to 10000"))?;
            }
            (Direction::Out, "open_drain", None) => drive = Drive::OpenDrain,
            (Direction::Out, "open_source", None) => drive = Drive::OpenSource,
            (Direction::Out, "safe", Some("true" | "1")) => safe = true,
            (Direction::Out, "safe", Some("false" | "0")) => safe = false,
            (Direction::In, ..) => {
                return Err(format!(
                    "\"{word}\" is none of active_low, pull_up, pull_down, no_bias, debounce_ms=…"
                ));
            }
            (Direction::Out, ..) => {
                return Err(format!(
                    "\"{word}\" is none of active_low, open_drain, open_source, safe=true, safe=false"
                ));
            }
        }
    }
    let purpose = match direction {
        Direction::In => Use::Input { bias, debounce },
        Direction::Out => Use::Output { drive, safe },
    };
    Ok(Line { name: name.to_owned(), line: line.to_owned(), is_active_low, purpose })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn lines_are_read_and_what_is_wrong_is_told() {
        let read =
            |text: &str, direction| parse_all(&[text.to_owned()], direction).map(|mut lines| lines.remove(0));
        let button = read("button = 17, pull_up, active_low, debounce_ms=2.5", Direction::In).unwrap();
        let purpose = Use::Input { bias: Bias::PullUp, debounce: Duration::from_micros(2_500) };
        assert_eq!(button, Line { name: "button".into(), line: "17".into(), is_active_low: true, purpose });
        let lamp = read("lamp=GPIO27,safe=1,open_drain", Direction::Out).unwrap();
        assert_eq!(lamp.purpose, Use::Output { drive: Drive::OpenDrain, safe: true });
        for (text, problem) in [
            (
                "button",
                "\"button\": expected a name and a line, such as \"button = 17\" or \"button = GPIO17\"",
            ),
            ("9 = 17", "\"9 = 17\": \"9\" is no name of a topic: letters, digits and _, first a letter"),
            (
                "a=1, safe=1",
                "\"a=1, safe=1\": \"safe=1\" is none of active_low, pull_up, pull_down, no_bias, debounce_ms=…",
            ),
            ("a=1, debounce_ms=-1", "\"a=1, debounce_ms=-1\": debounce_ms is -1, expected 0 to 10000"),
            ("a=1, debounce_ms=x", "\"a=1, debounce_ms=x\": debounce_ms is a number, not \"x\""),
        ] {
            assert_eq!(read(text, Direction::In).unwrap_err(), problem);
        }
        assert!(read("a=1, pull_up", Direction::Out).is_err());
        let twice = ["a = 1".to_owned(), "b = 1".to_owned()];
        assert_eq!(
            parse_all(&twice, Direction::In).unwrap_err(),
            "\"a\" and \"b\" have the same name or line"
        );
    }

    proptest! {
        #[test]
        fn any_text_is_a_line_or_an_error(text in "[a-z]{0,3} ?= ?[0-9]{0,3}(,[a-z_]{0,12}(=[-0-9.a-zN]{0,9})?){0,4}") {
            for direction in [Direction::In, Direction::Out] {
                let _ = parse_all(std::slice::from_ref(&text), direction);
            }
        }
    }
}
