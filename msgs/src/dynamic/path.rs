//! Paths of fields: `header.stamp.sec`, `points[3].x`.

use super::FieldProblem;

/// One step of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Step<'a> {
    Field(&'a str),
    Element(usize),
}

/// The steps of a path, in order; at least one.
pub(super) fn steps(path: &str) -> Result<Vec<Step<'_>>, FieldProblem> {
    let mut steps = Vec::new();
    let mut rest = path;
    loop {
        let at = path.len() - rest.len();
        let end = rest.find(['.', '[']).unwrap_or(rest.len());
        let name = &rest[..end];
        if name.is_empty() || name.contains(|c: char| c != '_' && !c.is_ascii_alphanumeric()) {
            return Err(FieldProblem::Path { at, expected: "the name of a field" });
        }
        steps.push(Step::Field(name));
        rest = &rest[end..];
        while let Some(inner) = rest.strip_prefix('[') {
            let at = path.len() - inner.len();
            let number = inner.split(']').next().filter(|number| number.len() < inner.len());
            let Some(number) = number else {
                return Err(FieldProblem::Path { at, expected: "a number and `]`" });
            };
            let is_number = number.bytes().all(|byte| byte.is_ascii_digit());
            match number.parse() {
                Ok(index) if is_number => steps.push(Step::Element(index)),
                _ => return Err(FieldProblem::Path { at, expected: "a number" }),
            }
            rest = &inner[number.len() + 1..];
        }
        match rest.strip_prefix('.') {
            Some(next) => rest = next,
            None if rest.is_empty() => return Ok(steps),
            None => return Err(FieldProblem::Path { at: path.len() - rest.len(), expected: "`.` or `[`" }),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::{Step, steps};

    #[test]
    fn a_path_is_split_into_steps() {
        let expected =
            [Step::Field("a"), Step::Element(3), Step::Field("b_2"), Step::Field("c"), Step::Element(0)];
        assert_eq!(steps("a[3].b_2.c[0]").unwrap(), expected);
    }

    #[test]
    fn invalid_paths_are_reported_with_the_position() {
        for (path, at) in [
            ("", 0),
            (".a", 0),
            ("a.", 2),
            ("a..b", 2),
            ("a[", 2),
            ("a[1", 2),
            ("a[]", 2),
            ("a[-1]", 2),
            ("a[+1]", 2),
            ("a[1]b", 4),
            ("a[99999999999999999999]", 2),
            ("a b", 0),
            ("[0]", 0),
            ("ü", 0),
        ] {
            let problem = steps(path).unwrap_err().to_string();
            assert!(problem.contains(&format!("at byte {at},")), "{path}: {problem}");
        }
    }
}
