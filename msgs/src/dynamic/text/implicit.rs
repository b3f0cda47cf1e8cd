//! Plain scalars that YAML 1.1 does not read as strings.
//!
//! # References
//! PyYAML 6.0.3, `yaml/resolver.py`.

/// Whether a plain scalar is read as a boolean, a number, null, a date, a merge key or a value key.
pub(super) fn is_read_as_other(text: &str) -> bool {
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
    use super::{integer, is_read_as_other};

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
