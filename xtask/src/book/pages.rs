//! Which pages the book has, in which order, and how they differ from those of the repository: README.md is
//! the index of its folder, and links to files without a page lead to the address of the repository.

use std::collections::BTreeSet;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;

use crate::markdown::{Link, heading, links, with_targets};
use crate::paths::normal;

/// The page that lists all others.
const INDEX: &str = "docs/README.md";
const PICTURES: [&str; 3] = ["jpg", "png", "svg"];

/// The pages of the book, as paths from the root of the repository.
pub(super) struct Pages {
    root: PathBuf,
    parts: Vec<(String, Vec<Chapter>)>,
}

struct Chapter {
    page: PathBuf,
    /// The READMEs that it links to in folders below its own.
    below: Vec<PathBuf>,
}

impl Pages {
    /// Those that the tables of docs/README.md name in their first column, under its headings.
    pub(super) fn of_repository(root: &Path) -> anyhow::Result<Self> {
        let mut pages = Self { root: root.to_owned(), parts: Vec::new() };
        let index = read(root, Path::new(INDEX))?;
        for line in index.lines() {
            if let Some((2, title)) = heading(line) {
                pages.parts.push((title, Vec::new()));
            }
            let (Some(cell), Some((_, chapters))) =
                (line.strip_prefix('|').and_then(|row| row.split('|').next()), pages.parts.last_mut())
            else {
                continue;
            };
            for link in links(cell) {
                let page = readme(root, target(Path::new(INDEX), &link));
                chapters.push(Chapter { page, below: Vec::new() });
            }
        }
        let mut known: BTreeSet<PathBuf> = pages.all().map(Path::to_owned).collect();
        for chapter in pages.parts.iter_mut().flat_map(|(_, chapters)| chapters) {
            chapter.below = below(root, &chapter.page)?;
            chapter.below.retain(|page| known.insert(page.clone()));
        }
        Ok(pages)
    }

    fn all(&self) -> impl Iterator<Item = &Path> {
        let chapters = self.parts.iter().flat_map(|(_, chapters)| chapters);
        let listed = chapters.flat_map(|chapter| std::iter::once(&chapter.page).chain(&chapter.below));
        [Path::new("README.md"), Path::new(INDEX)].into_iter().chain(listed.map(PathBuf::as_path))
    }

    /// Writes the pages, their pictures and the table of contents. `crates` is the page about the crates.
    pub(super) fn write(&self, to: &Path, repository: &str, crates: &str) -> anyhow::Result<()> {
        let known: BTreeSet<&Path> = self.all().collect();
        for page in &known {
            let text = read(&self.root, page)?;
            for link in links(&text) {
                let picture = target(page, &link);
                if is_picture(&picture) {
                    put(&to.join(&picture), &std::fs::read(self.root.join(&picture))?)?;
                }
            }
            let text = with_targets(&text, |link| self.in_book(page, link, &known, repository));
            put(&to.join(place(page)), text.as_bytes())?;
        }
        put(&to.join("crates.md"), crates.as_bytes())?;
        put(&to.join("SUMMARY.md"), self.summary()?.as_bytes())
    }

    /// What a link is in the book, if it is something else than in the repository.
    fn in_book(&self, page: &Path, link: &Link, known: &BTreeSet<&Path>, repository: &str) -> Option<String> {
        if link.path.is_empty() {
            return None;
        }
        let to = target(page, link);
        if is_picture(&to) {
            return None;
        }
        let anchor = link.anchor.map(|anchor| format!("#{anchor}")).unwrap_or_default();
        let to_page = readme(&self.root, to.clone());
        if known.contains(to_page.as_path()) {
            let up = "../".repeat(page.components().count() - 1);
            return Some(format!("{up}{}{anchor}", place(&to_page).display()));
        }
        let kind = if self.root.join(&to).is_dir() { "tree" } else { "blob" };
        Some(format!("{repository}/{kind}/main/{}{anchor}", to.display()))
    }

    /// The table of contents as mdBook reads it.
    fn summary(&self) -> anyhow::Result<String> {
        let entry = |page: &Path| -> anyhow::Result<String> {
            let text = read(&self.root, page)?;
            let title = text.lines().find_map(heading).context("no heading");
            let (_, title) = title.with_context(|| page.display().to_string())?;
            Ok(format!("[{title}]({})", place(page).display()))
        };
        let mut summary =
            format!("# Summary\n\n{}\n{}\n", entry(Path::new("README.md"))?, entry(Path::new(INDEX))?);
        for (title, chapters) in &self.parts {
            write!(summary, "\n# {title}\n\n")?;
            for chapter in chapters {
                writeln!(summary, "- {}", entry(&chapter.page)?)?;
                for below in &chapter.below {
                    writeln!(summary, "  - {}", entry(below)?)?;
                }
            }
        }
        summary.push_str("\n# Rust\n\n- [Crates](crates.md)\n");
        Ok(summary)
    }
}

fn read(root: &Path, page: &Path) -> anyhow::Result<String> {
    std::fs::read_to_string(root.join(page)).with_context(|| page.display().to_string())
}

/// The READMEs that a README links to in folders below its own.
fn below(root: &Path, page: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let folder = page.parent().unwrap_or(page);
    let text = if page.ends_with("README.md") { read(root, page)? } else { String::new() };
    let linked = links(&text).into_iter().map(|link| readme(root, target(page, &link)));
    let is_below =
        |to: &PathBuf| to.starts_with(folder) && to.ends_with("README.md") && root.join(to).is_file();
    Ok(linked.filter(is_below).collect())
}

/// The path of what a link of a page leads to.
fn target(page: &Path, link: &Link) -> PathBuf {
    normal(&page.with_file_name(link.path))
}

/// A folder is its README.
fn readme(root: &Path, path: PathBuf) -> PathBuf {
    if root.join(&path).is_dir() { path.join("README.md") } else { path }
}

fn is_picture(path: &Path) -> bool {
    path.extension().is_some_and(|end| PICTURES.iter().any(|picture| end == *picture))
}

/// The file of a page in the book.
fn place(page: &Path) -> PathBuf {
    if page.ends_with("README.md") { page.with_file_name("index.md") } else { page.to_owned() }
}

fn put(file: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let folder = file.parent().unwrap_or(file);
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    std::fs::write(file, bytes).with_context(|| file.display().to_string())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn pages_are_in_the_order_of_the_index_and_link_to_each_other() {
        let root = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| put(&root.path().join(name), text.as_bytes()).unwrap();
        write("README.md", "# Robots\n[all](docs/README.md), [a](docs/a.md#part), ![p](docs/p.png)\n");
        let index = "# All\n[not](../src/x.rs) in a table\n## Start\n| [b](b.md), [a](a.md) | [c](c.md) |\n\
                     ## More\n| [examples](../examples/README.md) | |\n";
        write("docs/README.md", index);
        write(
            "docs/a.md",
            "# The `a`\n## Part\n[home](../README.md) [x](../src/x.rs#L1) [examples](../examples)\n",
        );
        write("docs/b.md", "# Bees\n[folder](../src) [here](#bees)\n");
        write("docs/c.md", "# No row names this\n");
        write("docs/p.png", "picture");
        write("src/x.rs", "");
        write("examples/README.md", "# Examples\n[one](one) [other](../docs/b.md)\n");
        write("examples/one/README.md", "# One\n[`robot.toml`](robot.toml)\n");
        write("examples/one/robot.toml", "");

        let out = root.path().join("out");
        Pages::of_repository(root.path()).unwrap().write(&out, "https://x.org/r", "# Crates\n").unwrap();
        let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
        let summary = "# Summary\n\n[Robots](index.md)\n[All](docs/index.md)\n\n# Start\n\n- [Bees](docs/b.md)\n- [The `a`](docs/a.md)\n\
                       \n# More\n\n- [Examples](examples/index.md)\n  - [One](examples/one/index.md)\n\n# Rust\n\n- [Crates](crates.md)\n";
        assert_eq!(read("SUMMARY.md"), summary);
        assert_eq!(
            read("index.md"),
            "# Robots\n[all](docs/index.md), [a](docs/a.md#part), ![p](docs/p.png)\n"
        );
        let a =
            "[home](../index.md) [x](https://x.org/r/blob/main/src/x.rs#L1) [examples](../examples/index.md)";
        assert!(read("docs/a.md").contains(a), "{}", read("docs/a.md"));
        assert!(read("docs/b.md").contains("[folder](https://x.org/r/tree/main/src) [here](#bees)"));
        assert!(
            read("examples/one/index.md").contains("(https://x.org/r/blob/main/examples/one/robot.toml)")
        );
        assert_eq!(read("docs/p.png"), "picture");
        assert!(!out.join("docs/c.md").exists());
    }
}
