//! Random changes of text files in TOML.

use std::fmt::Display;

use crate::{Random, most_in};

/// Values that file readers have to refuse or to tolerate.
const VALUES: [&str; 18] = [
    "nan",
    "inf",
    "-inf",
    "-1",
    "0",
    "254",
    "600.1",
    "1000.0001",
    "1e308",
    "1e-320",
    "9223372036854775807",
    "-9223372036854775808",
    "99999999999999999999",
    "[]",
    "[nan, inf]",
    "[[[[",
    "{a={}}",
    "\"\"",
];

/// Removes, repeats, swaps and damages some lines of a text, and replaces values by those of `VALUES` and
/// `more`.
pub fn change_lines(text: &str, more: &[&str], random: &mut Random) -> String {
    let values: Vec<&str> = VALUES.iter().chain(more).copied().collect();
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    for _ in 0..=random.below(5) {
        let at = random.below(lines.len());
        match random.below(8) {
            0 => drop(lines.remove(at)),
            1 => lines.insert(at, lines[random.below(lines.len())].clone()),
            2 => lines.swap(at, 0),
            3 => {
                let mut bytes = lines[at].clone().into_bytes();
                if let Some(byte) = bytes.get_mut(0) {
                    *byte ^= 1 << random.below(7);
                }
                lines[at] = String::from_utf8_lossy(&bytes).into_owned();
            }
            _ => {
                let key = lines[at].split('=').next().unwrap_or_default().to_owned();
                lines[at] = format!("{key}= {}", random.choose(&values));
            }
        }
    }
    lines.join("\n")
}

/// Asserts that a text is refused with a short error that contains `expected`, in memory proportional to its
/// size.
///
/// # Panics
/// Panics if the text is accepted, or refused in another way.
pub fn assert_refused<T, E: Display>(text: &str, expected: &str, parse: impl FnOnce(&str) -> Result<T, E>) {
    let (most, error) = most_in(|| parse(text).err().map(|error| error.to_string()));
    let error = error.unwrap_or_default();
    let start: String = error.chars().take(300).collect();
    assert!(error.contains(expected) && error.len() < 1_000, "{expected}: {start}");
    assert!(most < 200 * text.len() + (1 << 20), "{expected}: {most} bytes for {}", text.len());
}
