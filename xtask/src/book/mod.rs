//! `cargo xtask book`: README.md and the pages of docs/ as a site with search, and the documentation of the
//! crates beside it. Then each crate is documented as docs.rs does it.
//!
//! The order of the pages is that of docs/README.md. Links between pages stay links between pages; those to
//! other files of the repository lead to its address.

mod check;
mod docs_rs;
mod pages;

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;
use serde::Deserialize;

use crate::crates::repository;
use crate::steps::{output_of, run, workspace};
use crate::test::ALL;
use pages::Pages;

const MDBOOK: &str = "0.5.4";

/// What cargo says of a package.
#[derive(Deserialize)]
struct Package {
    name: String,
    description: Option<String>,
    publish: Option<Vec<String>>,
    /// Null if its manifest has none.
    metadata: serde_json::Value,
}

/// Writes the site to target/book/html and checks its links.
///
/// # Errors
/// If a page or a heading that a link leads to is missing, or a tool fails.
pub(crate) fn book() -> anyhow::Result<()> {
    let root = workspace();
    let folder = root.join("target/book");
    let packages = published()?;
    let repository = repository()?;
    if folder.exists() {
        std::fs::remove_dir_all(&folder).with_context(|| folder.display().to_string())?;
    }
    let pages = Pages::of_repository(&root)?;
    pages.write(&folder.join("src"), &repository, &api_page(&packages))?;
    let settings = include_str!("book.toml").replace("REPOSITORY", &repository);
    std::fs::write(folder.join("book.toml"), settings)?;
    std::fs::write(folder.join("wide.css"), include_str!("wide.css"))?;
    run(Command::new(mdbook()?).arg("build").arg(&folder))?;
    let html = folder.join("html");
    let api = html.join("api");
    document(&packages, &api)?;
    // Rustdoc has checked its links, and repeats some of other crates that lead somewhere only there.
    let broken = check::broken_links(&html, &api)?;
    for link in &broken {
        println!("{link}");
    }
    anyhow::ensure!(broken.is_empty(), "{} broken links in {}", broken.len(), html.display());
    println!("{}", html.join("index.html").display());
    docs_rs::document(&packages)
}

/// The packages that are published.
fn published() -> anyhow::Result<Vec<Package>> {
    #[derive(Deserialize)]
    struct Metadata {
        packages: Vec<Package>,
    }
    let text = output_of(Command::new(env!("CARGO")).args(["metadata", "--format-version=1", "--no-deps"]))?;
    let Metadata { mut packages } = serde_json::from_str(&text).context("cargo metadata")?;
    packages.retain(|package| package.publish.as_ref().is_none_or(|registries| !registries.is_empty()));
    packages.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(packages)
}

/// The page that leads to the documentation of the crates.
fn api_page(packages: &[Package]) -> String {
    let mut page = String::from(
        "# Crates\n\nAfter this page you know where each type and function is described. Most robots need only \
         [`downbeat`](api/downbeat/index.html), which has the other crates as its modules.\n\n\
         | crate | what it has |\n| --- | --- |\n",
    );
    for Package { name, description, .. } in packages {
        let module = name.replace('-', "_");
        let purpose = description.as_deref().unwrap_or_default();
        page.push_str(&format!("| [`{name}`](api/{module}/index.html) | {purpose} |\n"));
    }
    page
}

/// Writes the documentation of the packages to a folder. It is written anew, so that its index has nothing of
/// packages that are not published.
fn document(packages: &[Package], to: &Path) -> anyhow::Result<()> {
    let written = workspace().join("target/doc");
    if written.exists() {
        std::fs::remove_dir_all(&written).with_context(|| written.display().to_string())?;
    }
    // Rustdoc links to another crate if its folder is there, and cargo documents them in any order.
    for package in packages {
        std::fs::create_dir_all(written.join(package.name.replace('-', "_")))?;
    }
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(["doc", "--no-deps", "--quiet"]).args(ALL);
    run(cargo.args(packages.iter().flat_map(|package| ["--package", &package.name])))?;
    copy(&written, to)?;
    // Its pages about itself link to an index.
    let index = "<!doctype html><meta http-equiv=\"refresh\" content=\"0; url=../crates.html\"><a href=\"../crates.html\">Crates</a>\n";
    std::fs::write(to.join("index.html"), index).context("cannot write the index of the crates")
}

fn copy(from: &Path, to: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(to).with_context(|| to.display().to_string())?;
    for entry in std::fs::read_dir(from).with_context(|| from.display().to_string())? {
        let path = entry?.path();
        let to = to.join(path.file_name().unwrap_or_default());
        if path.is_dir() {
            copy(&path, &to)?;
        } else {
            std::fs::copy(&path, &to).with_context(|| path.display().to_string())?;
        }
    }
    Ok(())
}

/// Compiles the program if it is missing, and returns its path.
fn mdbook() -> anyhow::Result<PathBuf> {
    let folder = workspace().join("target/tools").join(format!("mdbook-{MDBOOK}"));
    let program = folder.join("bin/mdbook");
    if !program.exists() {
        // Without its server, which a few files do not need.
        let chosen = ["--version", MDBOOK, "--no-default-features", "--features", "search"];
        let mut cargo = Command::new(env!("CARGO"));
        run(cargo.args(["install", "mdbook", "--locked"]).args(chosen).arg("--root").arg(&folder))?;
    }
    Ok(program)
}
