//! Pages and manifests: links, the index of the pages, the code map, and what each dependency is for.

use std::path::{Path, PathBuf};

use anyhow::Context;

use super::Problems;
use crate::markdown::{Link, anchors, links};

pub(super) fn problems(root: &Path) -> anyhow::Result<Problems> {
    let read =
        |name: &str| std::fs::read_to_string(root.join(name)).with_context(|| format!("cannot read {name}"));
    let mut problems = Problems::new();
    let mut pages = Vec::new();
    collect(root, &mut pages)?;
    for page in &pages {
        let name = page.strip_prefix(root).unwrap_or(page).display().to_string();
        let text = read(&name)?;
        for link in links(&text) {
            if let Err(reason) = follow(page, &text, &link) {
                problems.push(format!("{name}:{}: the link {} {reason}", link.line, &text[link.place]));
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

/// Whether a link of a page leads to a file or folder, and to a heading of it.
fn follow(page: &Path, text: &str, link: &Link) -> Result<(), &'static str> {
    let target = if link.path.is_empty() { page.to_owned() } else { page.with_file_name(link.path) };
    if !target.exists() {
        return Err("leads nowhere");
    }
    let Some(anchor) = link.anchor else { return Ok(()) };
    let headings = if link.path.is_empty() {
        anchors(text)
    } else {
        anchors(&std::fs::read_to_string(&target).map_err(|_| "names a heading of what is no page")?)
    };
    if headings.iter().any(|heading| heading == anchor) { Ok(()) } else { Err("names no heading there") }
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
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_link_leads_to_a_file_and_its_heading() {
        let folder = tempfile::tempdir().unwrap();
        let page = folder.path().join("page.md");
        std::fs::write(folder.path().join("other.md"), "# Other\n## A part\n").unwrap();
        let problems = |text: &str| -> Vec<_> {
            links(text).iter().filter_map(|link| follow(&page, text, link).err()).collect()
        };
        std::fs::write(&page, "").unwrap();
        assert!(problems("# Here\n[a](other.md) [b](other.md#a-part) [c](#here) [d](.)\n").is_empty());
        assert_eq!(problems("[a](gone.md)\n"), ["leads nowhere"]);
        assert_eq!(problems("[a](other.md#gone) [b](#gone)\n"), ["names no heading there"; 2]);
        assert_eq!(problems("[a](.#part)\n"), ["names a heading of what is no page"]);
    }

    #[test]
    fn a_dependency_without_purpose_is_a_problem() {
        let manifest = "[workspace.dependencies]\nours = { path = \"ours\" }\na = \"1\"   # words\n# Numbers:\nb = \"2\"\nc = \"3\"\n\n[package]\nd = \"4\"\n";
        assert_eq!(without_purpose(manifest), ["Cargo.toml: say what c is for"]);
    }
}
