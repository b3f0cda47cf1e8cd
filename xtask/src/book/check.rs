//! Links of a site in a folder that lead nowhere.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::Context;

use crate::paths::normal;

/// The links of all pages under a folder whose file, or whose place in it, does not exist. Links to other
/// sites are not followed, and pages in `others` are only looked at as targets of links.
pub(super) fn broken_links(site: &Path, others: &Path) -> anyhow::Result<Vec<String>> {
    let mut pages = Vec::new();
    collect(site, others, &mut pages)?;
    let places: RefCell<BTreeMap<PathBuf, BTreeSet<String>>> = RefCell::default();
    let has_place = |page: &Path, place: &str| -> anyhow::Result<bool> {
        if !places.borrow().contains_key(page) {
            let text = std::fs::read_to_string(page).with_context(|| page.display().to_string())?;
            let ids = attributes(&text, "id").map(str::to_owned).collect();
            places.borrow_mut().insert(page.to_owned(), ids);
        }
        Ok(places.borrow().get(page).is_some_and(|ids| ids.contains(place)))
    };
    let mut broken = BTreeSet::new();
    for page in pages {
        // A server shows it in place of any other, so its links begin at the root of the site.
        if page == site.join("404.html") {
            continue;
        }
        let text = std::fs::read_to_string(&page).with_context(|| page.display().to_string())?;
        for link in attributes(&text, "href").chain(attributes(&text, "src")) {
            if link.contains(':') || link.starts_with("//") {
                continue;
            }
            let (path, place) = link.split_once('#').unwrap_or((link, ""));
            let path = path.split('?').next().unwrap_or(path);
            let mut to = if path.is_empty() { page.clone() } else { normal(&page.with_file_name(path)) };
            if to.is_dir() {
                to.push("index.html");
            }
            let is_page = to.extension().is_some_and(|end| end == "html");
            let is_whole = place.is_empty() || !is_page;
            if !to.is_file() || !is_whole && !has_place(&to, place)? {
                let name = page.strip_prefix(site).unwrap_or(&page).display();
                broken.insert(format!("{name}: the link {link} leads nowhere"));
            }
        }
    }
    Ok(broken.into_iter().collect())
}

/// The values of an attribute, wherever it is in the page. Quotes in text are escaped, so they are no end.
fn attributes<'a>(text: &'a str, name: &str) -> impl Iterator<Item = &'a str> {
    let begin = format!(" {name}=\"");
    let values: Vec<&str> =
        text.split(begin.as_str()).skip(1).filter_map(|after| after.split('"').next()).collect();
    values.into_iter()
}

fn collect(folder: &Path, others: &Path, pages: &mut Vec<PathBuf>) -> anyhow::Result<()> {
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        if path.is_dir() && path != others {
            collect(&path, others, pages)?;
        } else if path.extension().is_some_and(|end| end == "html") {
            pages.push(path);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn links_without_a_file_or_a_place_are_broken() {
        let site = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            std::fs::create_dir_all(site.path().join(name).parent().unwrap()).unwrap();
            std::fs::write(site.path().join(name), text).unwrap();
        };
        write("docs/a.html", "<h2 id=\"part\"><a class=\"header\" href=\"#part\">Part</a></h2>");
        write("docs/b.html", "<a href=\"../docs/a.html#gone\"><a href=\"../api/index.html#main\">");
        write("api/index.html", "<main id=\"main\"><a href=\"gone.html\">");
        write(
            "index.html",
            "<a href=\"docs/a.html#part\"><a href=\"docs/c.html\"><img src=\"p.png\"><a href=\"https://x.org/y\"><a href=\"api/\">",
        );
        let broken = broken_links(site.path(), &site.path().join("api")).unwrap();
        let expected = [
            "docs/b.html: the link ../docs/a.html#gone leads nowhere",
            "index.html: the link docs/c.html leads nowhere",
            "index.html: the link p.png leads nowhere",
        ];
        assert_eq!(broken, expected);
    }
}
