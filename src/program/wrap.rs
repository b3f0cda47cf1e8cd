//! Wraps text to the width of a terminal without splitting entries.

/// A line of the terminal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Line {
    pub(crate) text: String,
    /// The number of entries that end in this line.
    pub(crate) entries: usize,
}

/// Arranges `entries` in lines of at most `width` characters, separated by `separator`.
///
/// An entry that is longer than a line has a line of its own.
pub(crate) fn wrap<T: AsRef<str>>(
    entries: impl IntoIterator<Item = T>,
    separator: &str,
    width: usize,
) -> Vec<Line> {
    let mut lines: Vec<Line> = Vec::new();
    for entry in entries {
        let entry = entry.as_ref();
        match lines.last_mut() {
            Some(line) if length(&line.text) + length(separator) + length(entry) <= width => {
                line.text.push_str(separator);
                line.text.push_str(entry);
                line.entries += 1;
            }
            _ => lines.push(Line { text: entry.to_owned(), entries: 1 }),
        }
    }
    lines
}

/// The text of at most `most` lines; the last one contains the number of omitted entries.
pub(crate) fn shorten(lines: Vec<Line>, most: usize) -> Vec<String> {
    let kept = if lines.len() > most { most.saturating_sub(1) } else { lines.len() };
    let more: usize = lines[kept..].iter().map(|line| line.entries).sum();
    let mut texts: Vec<_> = lines.into_iter().take(kept).map(|line| line.text).collect();
    if more > 0 {
        texts.push(format!("+{more} more"));
    }
    texts
}

/// The number of characters, each assumed to fill one cell.
pub(crate) fn length(text: &str) -> usize {
    text.chars().count()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wrapped(width: usize) -> Vec<Line> {
        wrap(["imu 100/s", "joint_states 125/s", "µs 1/s"], "  ", width)
    }

    #[test]
    fn entries_are_never_split() {
        assert_eq!(shorten(wrapped(29), 3), ["imu 100/s  joint_states 125/s", "µs 1/s"]);
        assert_eq!(shorten(wrapped(28), 3), ["imu 100/s", "joint_states 125/s  µs 1/s"]);
        assert_eq!(shorten(wrapped(3), 3), ["imu 100/s", "joint_states 125/s", "µs 1/s"]);
        assert!(wrap([""; 0], " ", 10).is_empty());
    }

    #[test]
    fn omitted_entries_are_counted() {
        assert_eq!(shorten(wrapped(28), 1), ["+3 more"]);
        assert_eq!(shorten(wrapped(3), 2), ["imu 100/s", "+2 more"]);
        assert_eq!(shorten(wrapped(3), 0), ["+3 more"]);
    }
}
