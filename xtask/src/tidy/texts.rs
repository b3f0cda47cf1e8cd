//! Lines of source files: included files, the width of comments, and `unsafe` without its reason.

use std::path::{Path, PathBuf};

use anyhow::Context;

use super::Problems;
use super::packages::Package;
use super::safety;
use crate::paths::normal;

/// The width of comments, as rustfmt has it for code.
const WIDTH: usize = 110;

/// The problems in the Rust files under the folders that the targets of a package have.
pub(super) fn problems(root: &Path, package: &Package) -> anyhow::Result<Problems> {
    let mut problems = Problems::new();
    let mut files = Vec::new();
    for folder in ["src", "tests", "examples", "benches"] {
        collect(&package.folder.join(folder), &mut files)?;
    }
    for file in files {
        let source =
            std::fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))?;
        let name = file.strip_prefix(root).unwrap_or(&file).display().to_string();
        let naked = safety::naked(&source).into_iter();
        problems.extend(
            naked.map(|line| format!("{name}:{line}: `unsafe` without a comment `// SAFETY: …` above")),
        );
        let mut is_code = false;
        for (line, number) in source.lines().zip(1..) {
            let at = || format!("{name}:{number}");
            // The code of a documentation test has its own width.
            is_code ^= line.trim_start().trim_start_matches(['/', '!']).trim_start().starts_with("```");
            if !is_code && is_wide_comment(line) {
                problems.push(format!("{}: a comment wider than {WIDTH} columns", at()));
            }
            if let Some(path) = (!is_code).then(|| linked_file(line)).flatten() {
                problems.push(format!("{}: a link to {path}, which docs.rs does not have", at()));
            }
            let outside = included(line)
                .filter(|path| !normal(&file.with_file_name(path)).starts_with(&package.folder));
            if let Some(path) = outside {
                problems.push(format!("{}: includes {path}, which is outside of the package", at()));
            }
        }
    }
    Ok(problems)
}

/// The Rust files under a folder, if there is one; templates are projects of their own.
fn collect(folder: &Path, files: &mut Vec<PathBuf>) -> anyhow::Result<()> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Ok(()) };
    for entry in entries {
        let path = entry.with_context(|| folder.display().to_string())?.path();
        if path.is_dir() && !path.ends_with("templates") {
            collect(&path, files)?;
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
    files.sort();
    Ok(())
}

/// Tables and addresses cannot be broken.
fn is_wide_comment(line: &str) -> bool {
    let text = line.trim_start();
    let is_comment = text.starts_with("//");
    let cannot_break =
        text.contains("://") || text.trim_start_matches(['/', '!']).trim_start().starts_with('|');
    is_comment && !cannot_break && line.chars().count() > WIDTH
}

/// The file that a documentation comment links to by its path. Paths of Rust have `::`.
fn linked_file(line: &str) -> Option<&str> {
    let comment = line.trim_start();
    let text = comment.strip_prefix("///").or_else(|| comment.strip_prefix("//!"))?;
    let targets = text.split("](").skip(1).filter_map(|after| after.split(')').next());
    let is_path = |target: &&str| !target.contains("://") && target.contains(['/', '.']);
    targets.filter(is_path).find(|target| !target.contains("::"))
}

/// The path in an `include_str!` or `include_bytes!`.
fn included(line: &str) -> Option<&str> {
    let (_, after) = line.split_once("include_str!(").or_else(|| line.split_once("include_bytes!("))?;
    after.trim_start().strip_prefix('"')?.split('"').next()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_to_files_in_documentation_are_found() {
        assert_eq!(
            linked_file("    /// See [a](crate::a), [b](https://b.org) and [c](../c.md)."),
            Some("../c.md")
        );
        assert_eq!(linked_file("//! See [the page](docs/log.md)."), Some("docs/log.md"));
        for line in ["/// [a](Self::b)", "// [a](b/c.md) of no reader", "let a = \"[a](b/c.md)\";"] {
            assert_eq!(linked_file(line), None, "{line}");
        }
    }

    #[test]
    fn included_files_and_wide_comments_are_found() {
        assert_eq!(included(r#"const A: &str = include_str!("../../b.toml");"#), Some("../../b.toml"));
        assert_eq!(included("let a = 1;"), None);
        assert_eq!(normal(Path::new("/a/src/../../b.toml")), Path::new("/b.toml"));
        let wide = "word ".repeat(25);
        assert!(is_wide_comment(&format!("    /// {wide}")));
        assert!(!is_wide_comment(&format!("    let text = \"{wide}\";")));
        assert!(!is_wide_comment(&format!("//! | {wide} |")));
    }
}
