//! Pages and manifests: links, the index of the pages, the code map, and what each dependency is for.

use std::path::{Path, PathBuf};

use anyhow::Context;

use super::Problems;

pub(super) fn problems(root: &Path) -> anyhow::Result<Problems> {
    let read =
        |name: &str| std::fs::read_to_string(root.join(name)).with_context(|| format!("cannot read {name}"));
    let mut problems = Problems::new();
    let mut pages = Vec::new();
    collect(root, &mut pages)?;
    for page in &pages {
        let name = page.strip_prefix(root).unwrap_or(page).display().to_string();
        let text = read(&name)?;
        for (link, line) in links(&text) {
            if !page.with_file_name(link).exists() {
                problems.push(format!("{name}:{line}: the link {link} leads nowhere"));
            }
        }
    }
    let index = read("docs/README.md")?;
    for page in pages.iter().filter(|page| page.parent() == Some(&root.join("docs"))) {
        let name = page.file_name().unwrap_or_default().to_string_lossy();
        if name != "README.md" && !index.contains(&format!("({name})")) {
            problems.push(format!("docs/README.md: lacks {name}"));
        }
    }
    let map = read("ARCHITECTURE.md")?;
    for folder in ["", "executor/src", "modules", "modules/football", "bridge"] {
        for entry in std::fs::read_dir(root.join(folder))? {
            let path = entry?.path();
            let name = path.strip_prefix(root).unwrap_or(&path).display().to_string();
            let is_part = path.is_dir()
                && !is_left_out(&path)
                && !["src", "tests"].iter().any(|own| name.ends_with(&format!("/{own}")));
            if is_part && !map.contains(&format!("`{name}/`")) && !map.contains(&format!("`{name}`")) {
                problems.push(format!("ARCHITECTURE.md: the code map lacks {name}/"));
            }
        }
    }
    problems.extend(without_purpose(&read("Cargo.toml")?));
    Ok(problems)
}

/// The dependencies of the workspace that are not its own and do not say what they are for, in a comment
/// behind or above them.
fn without_purpose(manifest: &str) -> Problems {
    let mut problems = Problems::new();
    let lines = manifest.lines().skip_while(|line| *line != "[workspace.dependencies]").skip(1);
    let mut before = "";
    for line in lines.take_while(|line| !line.starts_with('[')) {
        let is_foreign = line.contains('=') && !line.starts_with('#') && !line.contains("path = ");
        if is_foreign && !line.contains(" # ") && !before.starts_with('#') {
            let name = line.split('=').next().unwrap_or(line).trim();
            problems.push(format!("Cargo.toml: say what {name} is for"));
        }
        before = line;
    }
    problems
}

/// Relative links of a page with their lines, without what follows `#`. Code is left out.
fn links(text: &str) -> Vec<(&str, usize)> {
    let mut found = Vec::new();
    let mut is_code = false;
    for (line, number) in text.lines().zip(1..) {
        if line.trim_start().starts_with("```") {
            is_code = !is_code;
        }
        if is_code {
            continue;
        }
        for after in line.split("](").skip(1) {
            let link = after.split([')', '#']).next().unwrap_or_default();
            if !link.is_empty() && !link.contains("://") && !link.starts_with("mailto:") {
                found.push((link, number));
            }
        }
    }
    found
}

/// The pages of the project.
fn collect(folder: &Path, pages: &mut Vec<PathBuf>) -> anyhow::Result<()> {
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        if path.is_dir() && !is_left_out(&path) {
            collect(&path, pages)?;
        } else if path.extension().is_some_and(|extension| extension == "md") {
            pages.push(path);
        }
    }
    pages.sort();
    Ok(())
}

/// Folders that are not of the project, and those of projects that `downbeat new` makes.
fn is_left_out(folder: &Path) -> bool {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with('.') || ["target", "templates", "node_modules", "__pycache__"].contains(&&*name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relative_links_outside_of_code_are_found() {
        let text =
            "See [a](docs/a.md#part), [b](https://b.org) and [c](#here).\n```\n[d](d.md)\n```\n[e](../e.md)";
        assert_eq!(links(text), [("docs/a.md", 1), ("../e.md", 5)]);
    }

    #[test]
    fn a_dependency_without_purpose_is_a_problem() {
        let manifest = "[workspace.dependencies]\nours = { path = \"ours\" }\na = \"1\"   # words\n# Numbers:\nb = \"2\"\nc = \"3\"\n\n[package]\nd = \"4\"\n";
        assert_eq!(without_purpose(manifest), ["Cargo.toml: say what c is for"]);
    }
}
