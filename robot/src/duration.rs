//! Parsing of durations with units: `20ms`, `10s`, `5m`.

use std::time::Duration;

/// Parses a duration with its unit: `us`, `ms`, `s`, `m` or `min`, `h`.
///
/// ```
/// use std::time::Duration;
///
/// assert_eq!(downbeat_robot::duration::parse("1.5ms"), Ok(Duration::from_micros(1500)));
/// ```
///
/// # Errors
/// Returns a message if the text is not a duration.
pub fn parse(text: &str) -> Result<Duration, String> {
    let number_ends = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let (number, unit) = text.split_at(number_ends);
    let seconds_per_unit = match unit {
        "us" | "µs" => 1e-6,
        "ms" => 0.001,
        "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err(format!("\"{text}\" is not a time; write 500ms, 10s, 5m or 1h")),
    };
    let number: f64 = number.parse().map_err(|_| format!("\"{number}\" is not a number"))?;
    Duration::try_from_secs_f64(number * seconds_per_unit).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_have_units() {
        assert_eq!(parse("20us"), Ok(Duration::from_micros(20)));
        assert_eq!(parse("500ms"), Ok(Duration::from_millis(500)));
        assert_eq!(parse("1.5m"), Ok(Duration::from_secs(90)));
        assert!(parse("10").is_err() && parse("s").is_err() && parse("-1s").is_err());
    }
}
