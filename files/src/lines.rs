//! The line of a byte in a text, from 1.

/// The line of a byte; bytes behind the end are on the last line.
///
/// ```
/// assert_eq!(downbeat_files::lines::line_of("a\nb", 2), 2);
/// ```
#[must_use]
pub fn line_of(text: impl AsRef<[u8]>, offset: usize) -> usize {
    let bytes = text.as_ref();
    1 + bytes[..offset.min(bytes.len())].iter().filter(|&&byte| byte == b'\n').count()
}

/// Where the lines of a text end, for many questions about it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Lines {
    newlines: Vec<usize>,
}

impl Lines {
    /// Finds the ends of all lines.
    #[must_use]
    pub fn new(text: &str) -> Self {
        Self { newlines: text.match_indices('\n').map(|(offset, _)| offset).collect() }
    }

    /// The line of a byte, as [`line_of`] finds it.
    #[must_use]
    pub fn line_of(&self, offset: usize) -> usize {
        1 + self.newlines.partition_point(|newline| *newline < offset)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::{prop_assert_eq, proptest};

    #[test]
    fn lines_count_from_one() {
        let text = "a\nb\nc";
        assert_eq!([0, 1, 2, 4, 99].map(|offset| line_of(text, offset)), [1, 1, 2, 3, 3]);
        assert_eq!(line_of([0xff, b'\n', 0xff], 2), 2);
    }

    proptest! {
        #[test]
        fn counted_and_looked_up_lines_agree(text in "[a\n\r\u{fc}]{0,40}", offset in 0_usize..100) {
            prop_assert_eq!(Lines::new(&text).line_of(offset), line_of(&text, offset));
        }
    }
}
