//! Lines of source files: included files, the width of comments, and `unsafe` without its reason.

use std::path::{Component, Path, PathBuf};

use anyhow::Context;

use super::Problems;
use super::packages::Package;
use super::safety;

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

/// The path in an `include_str!` or `include_bytes!`.
fn included(line: &str) -> Option<&str> {
    let (_, after) = line.split_once("include_str!(").or_else(|| line.split_once("include_bytes!("))?;
    after.trim_start().strip_prefix('"')?.split('"').next()
}

/// Without `..`.
fn normal(path: &Path) -> PathBuf {
    let mut normal = PathBuf::new();
    for component in path.components() {
        match component {
            Component::ParentDir => drop(normal.pop()),
            other => normal.push(other),
        }
    }
    normal
}

#[cfg(test)]
mod tests {
    use super::*;

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
