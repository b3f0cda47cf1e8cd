//! Names of topics by pattern.

use std::fmt;
use thiserror::Error;

/// A name, or a pattern for names: `*` stands for any characters of one part of a name, `**` as a part of its
/// own for any number of parts, none among them.
///
/// ```
/// use downbeat_bridge::expose::TopicPattern;
///
/// let cameras = TopicPattern::new("camera/*/image_*")?;
/// assert!(cameras.matches("camera/left/image_raw"));
/// assert!(!cameras.matches("camera/left/raw/image_raw"));
/// assert_eq!(cameras.rename("camera/left/image_raw", "/cam_*/*").as_deref(), Some("/cam_left/raw"));
/// assert!(TopicPattern::new("camera/**")?.matches("camera/left/raw/image_raw"));
/// # Ok::<(), downbeat_bridge::expose::PatternError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct TopicPattern {
    parts: Vec<Part>,
}

/// A text that is no pattern, or no new name for what a pattern matches.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("pattern \"{pattern}\": {reason}")]
pub struct PatternError {
    pattern: String,
    reason: String,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Part {
    /// `**`
    Any,
    /// Texts with a `*` between each two.
    One(Vec<String>),
}

impl TopicPattern {
    /// Reads a pattern. A slash before the first part means nothing.
    ///
    /// # Errors
    /// [`PatternError`] if a part is empty, or `**` is only a section of a part.
    pub fn new(pattern: &str) -> Result<Self, PatternError> {
        let refuse = |reason: String| PatternError { pattern: pattern.to_owned(), reason };
        let parts = pattern.strip_prefix('/').unwrap_or(pattern).split('/').map(|part| match part {
            "" => Err(refuse("a part of it is empty".to_owned())),
            "**" => Ok(Part::Any),
            _ if part.contains("**") => {
                Err(refuse(format!("\"**\" stands between slashes; write \"*\" within \"{part}\"")))
            }
            _ => Ok(Part::One(part.split('*').map(str::to_owned).collect())),
        });
        Ok(Self { parts: parts.collect::<Result<_, _>>()? })
    }

    /// True if the text has a wildcard, so that it may match several names.
    #[must_use]
    pub fn is_pattern(text: &str) -> bool {
        text.contains('*')
    }

    /// Checks that a new name has the wildcards of this pattern, in the same order.
    ///
    /// # Errors
    /// [`PatternError`] of the new name.
    pub fn check_rename(&self, new_name: &str) -> Result<(), PatternError> {
        let wildcards = wildcards(new_name);
        let expected = wildcards_of(self);
        if wildcards == expected {
            return Ok(());
        }
        let expected = if expected.is_empty() { "none".to_owned() } else { expected.join(" and ") };
        let reason = format!(
            "a new name has the wildcards of the pattern in their order, here {expected}: what each of them matched \
             stands there"
        );
        Err(PatternError { pattern: new_name.to_owned(), reason })
    }

    /// True if the pattern matches the whole name.
    #[must_use]
    pub fn matches(&self, name: &str) -> bool {
        self.captures(name).is_some()
    }

    /// `new_name` with each wildcard replaced by what it matched in `name`; `None` if the pattern does not
    /// match.
    #[must_use]
    pub fn rename(&self, name: &str, new_name: &str) -> Option<String> {
        let mut captures = self.captures(name)?.into_iter();
        let mut renamed = String::new();
        let mut rest = new_name;
        while let Some((before, after)) = rest.split_once('*') {
            renamed.push_str(before);
            renamed.push_str(&captures.next()?);
            rest = after.strip_prefix('*').unwrap_or(after);
        }
        renamed.push_str(rest);
        Some(without_empty_parts(&renamed))
    }

    /// What each wildcard matched, in their order.
    fn captures(&self, name: &str) -> Option<Vec<String>> {
        let parts: Vec<_> = name.strip_prefix('/').unwrap_or(name).split('/').collect();
        let mut captures = Vec::new();
        capture_parts(&self.parts, &parts, &mut captures).then_some(captures)
    }
}

impl fmt::Display for TopicPattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (position, part) in self.parts.iter().enumerate() {
            f.write_str(if position == 0 { "" } else { "/" })?;
            match part {
                Part::Any => f.write_str("**")?,
                Part::One(texts) => f.write_str(&texts.join("*"))?,
            }
        }
        Ok(())
    }
}

/// Names and patterns are written by hand and short, so trying every length is quick enough.
fn capture_parts(pattern: &[Part], name: &[&str], captures: &mut Vec<String>) -> bool {
    let Some((first, rest)) = pattern.split_first() else { return name.is_empty() };
    let before = captures.len();
    match first {
        Part::Any => (0..=name.len()).any(|taken| {
            captures.truncate(before);
            captures.push(name[..taken].join("/"));
            capture_parts(rest, &name[taken..], captures)
        }),
        Part::One(texts) => {
            let Some((part, others)) = name.split_first() else { return false };
            capture_texts(texts, part, captures) && capture_parts(rest, others, captures)
        }
    }
}

fn capture_texts(texts: &[String], part: &str, captures: &mut Vec<String>) -> bool {
    let [first, rest @ ..] = texts else { return false };
    let Some(mut remaining) = part.strip_prefix(first.as_str()) else { return false };
    let [between @ .., last] = rest else { return remaining.is_empty() };
    for text in between {
        let Some((captured, after)) = remaining.split_once(text.as_str()) else { return false };
        captures.push(captured.to_owned());
        remaining = after;
    }
    let Some(captured) = remaining.strip_suffix(last.as_str()) else { return false };
    captures.push(captured.to_owned());
    true
}

fn wildcards(text: &str) -> Vec<&'static str> {
    let mut found = Vec::new();
    let mut rest = text;
    while let Some((_, after)) = rest.split_once('*') {
        let (wildcard, after) = after.strip_prefix('*').map_or(("*", after), |after| ("**", after));
        found.push(wildcard);
        rest = after;
    }
    found
}

fn wildcards_of(pattern: &TopicPattern) -> Vec<&'static str> {
    let of_part = |part: &Part| match part {
        Part::Any => vec!["**"],
        Part::One(texts) => vec!["*"; texts.len() - 1],
    };
    pattern.parts.iter().flat_map(of_part).collect()
}

/// `**` may have matched nothing: `/a/**/b` becomes `/a//b`.
fn without_empty_parts(name: &str) -> String {
    let is_absolute = name.starts_with('/');
    let parts: Vec<_> = name.split('/').filter(|part| !part.is_empty()).collect();
    format!("{}{}", if is_absolute { "/" } else { "" }, parts.join("/"))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn matches(pattern: &str, name: &str) -> bool {
        TopicPattern::new(pattern).unwrap().matches(name)
    }

    #[test]
    fn a_star_stays_within_a_part_and_two_cross_parts() {
        for (pattern, name, expected) in [
            ("imu", "imu", true),
            ("/imu", "imu", true),
            ("imu", "imu/data", false),
            ("*", "imu", true),
            ("*", "imu/data", false),
            ("**", "imu/data", true),
            ("imu/*", "imu", false),
            ("imu/**", "imu", true),
            ("imu/**", "imu/a/b", true),
            ("**/raw", "raw", true),
            ("**/raw", "a/b/raw", true),
            ("**/raw", "a/b/raw/c", false),
            ("a/**/c/*", "a/b/c/c/d", true),
            ("cam*_raw", "camera_raw", true),
            ("cam*_raw", "cam_raw", true),
            ("cam*_raw", "camera_raw_2", false),
            ("*a*a", "banana", true),
            ("*ana", "banana", true),
            ("a*a", "a", false),
        ] {
            assert_eq!(matches(pattern, name), expected, "{pattern} and {name}");
        }
    }

    #[test]
    fn a_new_name_takes_what_the_wildcards_matched() {
        let renamed = |pattern: &str, name: &str, to: &str| {
            TopicPattern::new(pattern).unwrap().rename(name, to).unwrap()
        };
        assert_eq!(renamed("camera/*", "camera/left", "/cam/*"), "/cam/left");
        assert_eq!(renamed("**", "imu/data", "/robot/**"), "/robot/imu/data");
        assert_eq!(renamed("imu/**", "imu", "/sensors/**"), "/sensors");
        assert_eq!(renamed("**/raw", "raw", "~/**/unfiltered"), "~/unfiltered");
        assert_eq!(renamed("*/joint_*", "left/joint_1", "arm_*/j*"), "arm_left/j1");
        assert_eq!(TopicPattern::new("a/*").unwrap().rename("b/c", "/d/*"), None);
    }

    #[test]
    fn what_is_no_pattern_is_refused_with_the_reason() {
        for (wrong, reason) in
            [("", "empty"), ("a//b", "empty"), ("a/", "empty"), ("a/b**", "within \"b**\"")]
        {
            let error = TopicPattern::new(wrong).unwrap_err().to_string();
            assert!(error.contains(reason) && error.contains(wrong), "{error}");
        }
        let pattern = TopicPattern::new("a/*/**").unwrap();
        assert!(pattern.check_rename("/b/*/**").is_ok());
        for wrong in ["/b", "/b/*", "/b/**/*", "/b/*/*/**"] {
            let error = pattern.check_rename(wrong).unwrap_err().to_string();
            assert!(error.contains("* and **"), "{error}");
        }
        assert!(
            TopicPattern::new("a").unwrap().check_rename("/b/*").unwrap_err().to_string().contains("none")
        );
    }

    #[test]
    fn a_pattern_is_shown_as_it_was_given() {
        for text in ["a/*/b*c", "**", "imu"] {
            assert_eq!(TopicPattern::new(text).unwrap().to_string(), text);
        }
    }
}
