//! Text for a terminal of some width: entries stay whole.

/// A line of the terminal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Line {
    pub(crate) text: String,
    /// How many entries end in this line.
    pub(crate) entries: usize,
}

/// Lays `entries` out in lines of at most `width` characters, with `separator` between those of one line.
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

/// The texts of at most `most` lines; the last one says how many entries the lines that are left out hold.
pub(crate) fn shorten(lines: Vec<Line>, most: usize) -> Vec<String> {
    let kept = if lines.len() > most { most.saturating_sub(1) } else { lines.len() };
    let more: usize = lines[kept..].iter().map(|line| line.entries).sum();
    let mut texts: Vec<_> = lines.into_iter().take(kept).map(|line| line.text).collect();
    if more > 0 {
        texts.push(format!("+{more} more"));
    }
    texts
}

/// Characters, each of which is taken to fill one cell.
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
    fn entries_that_are_left_out_are_counted() {
        assert_eq!(shorten(wrapped(28), 1), ["+3 more"]);
        assert_eq!(shorten(wrapped(3), 2), ["imu 100/s", "+2 more"]);
        assert_eq!(shorten(wrapped(3), 0), ["+3 more"]);
    }
}
