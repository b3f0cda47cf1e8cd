//! Every `unsafe` block and implementation says why it is sound, also where clippy does not look: in code for
//! other systems and behind features that the test run leaves off.

/// The numbers of the lines with `unsafe` that no comment with `SAFETY` precedes.
pub(super) fn naked(source: &str) -> Vec<usize> {
    let lines: Vec<&str> = source.lines().collect();
    let is_naked =
        |index: &usize| begins_unsafe(lines[*index]) && !explained(&lines[..*index], lines[*index]);
    (0..lines.len()).filter(is_naked).map(|index| index + 1).collect()
}

/// Whether a block or an implementation begins in this line. Functions state their contract in their
/// documentation instead.
fn begins_unsafe(line: &str) -> bool {
    let code = line.split("//").next().unwrap_or_default();
    code.match_indices("unsafe").any(|(at, word)| {
        let is_word =
            !code[..at].ends_with(|letter: char| letter.is_alphanumeric() || "_\"".contains(letter));
        let after = code[at + word.len()..].trim_start();
        is_word && (after.starts_with('{') || after.starts_with("impl"))
    })
}

/// Whether a comment above the statement, or in its line before it, explains it.
fn explained(before: &[&str], line: &str) -> bool {
    let is_end =
        |line: &&&str| (line.ends_with([';', '{', '}']) || line.ends_with("},")) && !line.starts_with("//");
    let above = before.iter().rev().map(|line| line.trim());
    let statement: Vec<&str> = above.take_while(|line| !is_end(&line)).collect();
    let comments = statement.iter().filter(|line| line.starts_with("//"));
    line.contains("SAFETY") || comments.into_iter().any(|comment| comment.contains("SAFETY"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Found by the check itself if it stood here as it is written.
    fn planted(source: &str) -> Vec<usize> {
        naked(&source.replace("UNSAFE", "unsafe"))
    }

    #[test]
    fn a_naked_block_or_implementation_is_found() {
        let source = "
fn f() {
    // SAFETY: of another statement.
    let a = UNSAFE { g() };
    let b = UNSAFE { g() };
    if a {
        UNSAFE {
            g()
        }
    }
}
UNSAFE impl Send for A {}
";
        assert_eq!(planted(source), [5, 7, 12]);
    }

    #[test]
    fn an_explained_block_and_the_word_elsewhere_are_no_problem() {
        let source = "
#![expect(UNSAFE_code)]
/// An UNSAFE { } in a comment.
UNSAFE fn f() {
    // SAFETY: the reason
    // in two lines.
    #[expect(clippy::cast)]
    let long =
        first(UNSAFE { g() });
    match a {
        // SAFETY: the reason.
        1 => UNSAFE { g() },
        _ => /* SAFETY: the reason */ UNSAFE { g() },
    }
}
";
        assert_eq!(planted(source), [0; 0]);
    }
}
