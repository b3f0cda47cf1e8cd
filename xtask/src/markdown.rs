//! Links and headings of pages in Markdown, as GitHub and mdBook read them.

use std::collections::BTreeMap;
use std::ops::Range;

/// A link or picture of a page that leads into the repository.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Link<'a> {
    /// Relative to the page; empty for the page itself.
    pub(crate) path: &'a str,
    /// What follows `#`.
    pub(crate) anchor: Option<&'a str>,
    /// Counted from 1.
    pub(crate) line: usize,
    /// Of path and anchor in the text of the page, in bytes.
    pub(crate) place: Range<usize>,
}

/// The links of a page, without those to other sites. Code is left out.
pub(crate) fn links(text: &str) -> Vec<Link<'_>> {
    let mut found = Vec::new();
    let mut is_in_span = false;
    for (line, start, number) in prose(text) {
        if line.trim().is_empty() {
            is_in_span = false; // a paragraph ends
        }
        let mut from = 0;
        while let Some(at) = line[from..].find("](") {
            is_in_span ^= line[from..from + at].matches('`').count() % 2 == 1;
            from += at + 2;
            let Some(length) = line[from..].find(')') else { break };
            let target = &line[from..from + length];
            if !is_in_span && !target.contains("://") && !target.starts_with("mailto:") {
                let (path, anchor) = match target.split_once('#') {
                    Some((path, anchor)) => (path, Some(anchor)),
                    None => (target, None),
                };
                let place = start + from..start + from + length;
                found.push(Link { path, anchor, line: number, place });
            }
        }
        is_in_span ^= line[from..].matches('`').count() % 2 == 1;
    }
    found
}

/// The page with other targets: `change` returns what stands in place of a link, if anything.
pub(crate) fn with_targets(text: &str, change: impl Fn(&Link) -> Option<String>) -> String {
    let mut changed = String::new();
    let mut end = 0;
    for link in links(text) {
        if let Some(target) = change(&link) {
            changed.push_str(&text[end..link.place.start]);
            changed.push_str(&target);
            end = link.place.end;
        }
    }
    changed + &text[end..]
}

/// What links to the headings of a page end with.
pub(crate) fn anchors(text: &str) -> Vec<String> {
    let mut times: BTreeMap<String, usize> = BTreeMap::new();
    let headings = prose(text).filter_map(|(line, ..)| heading(line).map(|(_, title)| anchor(&title)));
    headings
        .map(|anchor| {
            let times = times.entry(anchor.clone()).or_default();
            *times += 1;
            if *times == 1 { anchor } else { format!("{anchor}-{}", *times - 1) }
        })
        .collect()
}

/// The level of a heading and its text without links, or `None` if the line is no heading.
pub(crate) fn heading(line: &str) -> Option<(usize, String)> {
    let title = line.trim_start_matches('#');
    let level = line.len() - title.len();
    if !(1..=6).contains(&level) || !title.starts_with(' ') {
        return None;
    }
    let mut plain = title.trim().to_owned();
    while let Some(open) = plain.find("](") {
        let close = plain[open..].find(')').map_or(plain.len(), |length| open + length + 1);
        plain.replace_range(open..close, "");
        if let Some(bracket) = plain[..open].rfind('[') {
            plain.remove(bracket);
        }
    }
    Some((level, plain))
}

fn anchor(title: &str) -> String {
    let kept = |letter: char| letter.is_alphanumeric() || matches!(letter, '-' | '_' | ' ');
    title.chars().filter(|letter| kept(*letter)).collect::<String>().to_lowercase().replace(' ', "-")
}

/// The lines that are not in blocks of code, with their offsets in bytes and their numbers.
fn prose(text: &str) -> impl Iterator<Item = (&str, usize, usize)> {
    let mut is_code = false;
    let mut start = 0;
    text.split_inclusive('\n').zip(1..).filter_map(move |(line, number)| {
        let offset = start;
        start += line.len();
        let is_fence = line.trim_start().starts_with("```");
        is_code ^= is_fence;
        (!is_code && !is_fence).then_some((line.trim_end_matches('\n'), offset, number))
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const PAGE: &str = "See [a](docs/a.md#part), [b](https://b.org) and [c](#here).\n```\n[d](d.md)\n```\n[`e`](../e.md) and `[f](f.md)`\n\
                        and `a span\nover [g](g.md) lines` [h](h.md)\n";

    #[test]
    fn relative_links_outside_of_code_are_found() {
        let found: Vec<_> = links(PAGE).into_iter().map(|link| (link.path, link.anchor, link.line)).collect();
        let expected =
            [("docs/a.md", Some("part"), 1), ("", Some("here"), 1), ("../e.md", None, 5), ("h.md", None, 7)];
        assert_eq!(found, expected);
        assert!(links(PAGE).iter().all(|link| PAGE[link.place.clone()].starts_with(link.path)));
    }

    #[test]
    fn targets_are_replaced_and_everything_else_stays() {
        let changed = with_targets(PAGE, |link| (link.path == "../e.md").then(|| "e.html".to_owned()));
        assert_eq!(changed, PAGE.replace("../e.md", "e.html"));
    }

    #[test]
    fn anchors_are_those_of_the_sites() {
        let page = "# A [`core`](core.md)\n## What works, and what not?\n```\n# no heading\n```\n## Name_of `a-b`\n## A core\n#tag\n";
        assert_eq!(anchors(page), ["a-core", "what-works-and-what-not", "name_of-a-b", "a-core-1"]);
        assert_eq!(heading("### A [`core`](core.md) of [b](c)"), Some((3, "A `core` of b".to_owned())));
    }
}
