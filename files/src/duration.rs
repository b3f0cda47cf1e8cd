//! Times with units: `20ms`, `1.5s`, `5min`.

use std::time::Duration;

/// Parses a time with its unit: `ns`, `us` or `µs`, `ms`, `s`, `min`, `h`.
///
/// The times of CSS, which statecharts use, are among them: `.5s`, `500ms`.
///
/// ```
/// use std::time::Duration;
///
/// assert_eq!(downbeat_files::duration::parse("1.5ms"), Ok(Duration::from_micros(1500)));
/// ```
///
/// # Errors
/// Returns a message that says what to write if the text is not a time, or is negative.
pub fn parse(text: &str) -> Result<Duration, String> {
    let text = text.trim();
    let number = text.trim_end_matches(char::is_alphabetic);
    let unit = &text[number.len()..];
    let seconds_per_unit = match unit {
        "ns" => 1e-9,
        "us" | "\u{b5}s" | "\u{3bc}s" => 1e-6,
        "ms" => 1e-3,
        "s" => 1.0,
        "min" => 60.0,
        "h" => 3600.0,
        // A minute for some, a month or a millisecond for others.
        "m" => {
            return Err(format!(
                "\"{text}\" is not a time; write {number}min for minutes, {number}ms for milliseconds"
            ));
        }
        _ => return Err(format!("\"{text}\" is not a time; write 500ms, 10s, 5min or 1h")),
    };
    let number = number.trim_end();
    let seconds: f64 = number.parse().map_err(|_| format!("\"{number}\" is not a number"))?;
    Duration::try_from_secs_f64(seconds * seconds_per_unit).map_err(|error| error.to_string())
}

/// Parses a time with its unit; a number without one is in seconds, as in the commands of ROS 2.
///
/// # Errors
/// As [`parse`].
pub fn parse_or_seconds(text: &str) -> Result<Duration, String> {
    match text.parse::<f64>() {
        Ok(seconds) => Duration::try_from_secs_f64(seconds).map_err(|error| error.to_string()),
        Err(_) => parse(text),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use proptest::{prop_assert_eq, proptest};

    #[test]
    fn times_have_units() {
        for (text, nanoseconds) in [
            ("7ns", 7),
            ("20us", 20_000),
            ("20µs", 20_000),
            ("20\u{3bc}s", 20_000),
            ("500ms", 500_000_000),
            (".5s", 500_000_000),
            ("+0.5s", 500_000_000),
            (" 2 s ", 2_000_000_000),
            ("1.5min", 90_000_000_000),
            ("1h", 3_600_000_000_000),
        ] {
            assert_eq!(parse(text), Ok(Duration::from_nanos(nanoseconds)), "{text}");
        }
    }

    #[test]
    fn what_is_no_time_is_refused_with_what_to_write() {
        for text in ["10", "s", "-1s", "infs", "nans", "1e400s", "1d", "", "1 2s", "1S"] {
            assert!(parse(text).is_err(), "{text}");
        }
        assert_eq!(parse("10").unwrap_err(), "\"10\" is not a time; write 500ms, 10s, 5min or 1h");
        assert_eq!(
            parse("5m").unwrap_err(),
            "\"5m\" is not a time; write 5min for minutes, 5ms for milliseconds"
        );
    }

    #[test]
    fn a_number_can_be_in_seconds() {
        assert_eq!(parse_or_seconds("1.5"), Ok(Duration::from_millis(1500)));
        assert_eq!(parse_or_seconds("1.5ms"), Ok(Duration::from_micros(1500)));
        assert!(parse_or_seconds("-1").is_err() && parse_or_seconds("inf").is_err());
    }

    proptest! {
        // The form in which the settings of a connection are shown.
        #[test]
        fn what_debug_writes_is_read(nanoseconds in 0_u64..1 << 50) {
            let time = Duration::from_nanos(nanoseconds);
            prop_assert_eq!(parse(&format!("{time:?}")), Ok(time));
        }
    }
}
