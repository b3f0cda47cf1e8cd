//! Expressions of SPDX such as `(MIT OR Apache-2.0) AND Unicode-3.0`, and which of the licences that they
//! offer is chosen.

use anyhow::{Context, ensure};

/// Licences in the order in which they are chosen: that of downbeat first.
const PREFERRED: [&str; 9] =
    ["Apache-2.0", "MIT", "BSD-3-Clause", "BSD-2-Clause", "ISC", "Zlib", "Unicode-3.0", "Unlicense", "0BSD"];

/// A part of the names of licences, and what their texts say and those of others do not, in small letters
/// with single spaces.
const PHRASES: [(&str, &str); 10] = [
    ("Apache-2.0", "apache license version 2.0, january 2004"),
    (
        "MIT",
        "permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated",
    ),
    ("GPL-", "everyone is permitted to copy and distribute verbatim copies of this license document"),
    ("BSD-", "redistributions of source code must retain the above copyright notice"),
    ("ISC", "with or without fee is hereby granted, provided that the above copyright notice"),
    ("0BSD", "with or without fee is hereby granted. the software is provided"),
    ("Zlib", "the origin of this software must not be misrepresented"),
    ("Unlicense", "this is free and unencumbered software released into the public domain"),
    ("BSL-1.0", "boost software license - version 1.0"),
    ("EPL-", "eclipse public license - v 2.0"),
];

/// The licences of an expression: those that are chosen, and those that are not.
pub(super) struct Choice {
    chosen: Vec<String>,
    others: Vec<String>,
}

impl Choice {
    /// Chooses among the licences of an expression; none for an empty one.
    ///
    /// # Errors
    /// If it is no expression of SPDX.
    pub(super) fn of(expression: &str) -> anyhow::Result<Self> {
        // Before SPDX, `/` stood for `OR`.
        let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
        let mut words = spaced.split_whitespace().peekable();
        let mut choice = Self { chosen: Vec::new(), others: Vec::new() };
        if words.peek().is_none() {
            return Ok(choice);
        }
        choice.chosen =
            any_of(&mut words, &mut choice.others).with_context(|| format!("licence {expression:?}"))?;
        ensure!(words.next().is_none(), "licence {expression:?} is no expression of SPDX");
        choice.chosen.sort();
        choice.chosen.dedup();
        let chosen = &choice.chosen;
        choice.others.retain(|other| !chosen.contains(other));
        Ok(choice)
    }

    /// All of them hold.
    pub(super) fn chosen(&self) -> &[String] {
        &self.chosen
    }

    pub(super) fn leaves_out_any(&self) -> bool {
        !self.others.is_empty()
    }

    /// Whether a text is only of licences that were offered and not chosen.
    pub(super) fn leaves_out(&self, text: &str) -> bool {
        let parts = recognised(text);
        let is_of = |licences: &[String], part: &str| licences.iter().any(|licence| licence.contains(part));
        !parts.is_empty() && parts.iter().all(|part| is_of(&self.others, part) && !is_of(&self.chosen, part))
    }
}

/// Whether a text has that of a licence; `None` if it is of none that is known.
pub(super) fn is_text_of(text: &str, licence: &str) -> Option<bool> {
    let parts = recognised(text);
    (!parts.is_empty()).then(|| parts.iter().any(|part| licence.contains(part)))
}

fn recognised(text: &str) -> Vec<&'static str> {
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ").to_lowercase();
    PHRASES.iter().filter(|(_, phrase)| text.contains(phrase)).map(|(part, _)| *part).collect()
}

type Words<'a> = std::iter::Peekable<std::str::SplitWhitespace<'a>>;

/// Alternatives, up to the end or a closing bracket: the licences of the chosen one.
fn any_of(words: &mut Words, others: &mut Vec<String>) -> anyhow::Result<Vec<String>> {
    let mut chosen = all_of(words, others)?;
    while words.next_if_eq(&"OR").is_some() {
        let mut next = all_of(words, others)?;
        if rank(&next) < rank(&chosen) {
            std::mem::swap(&mut next, &mut chosen);
        }
        others.append(&mut next);
    }
    Ok(chosen)
}

fn all_of(words: &mut Words, others: &mut Vec<String>) -> anyhow::Result<Vec<String>> {
    let mut all = Vec::new();
    loop {
        match words.next().context("a licence is missing")? {
            "(" => {
                all.append(&mut any_of(words, others)?);
                ensure!(words.next() == Some(")"), "a bracket is not closed");
            }
            word @ (")" | "OR" | "AND" | "WITH") => anyhow::bail!("a licence is missing before {word}"),
            licence => match words.next_if_eq(&"WITH") {
                None => all.push(licence.to_owned()),
                Some(_) => {
                    let exception = words.next().context("an exception is missing")?;
                    all.push(format!("{licence} WITH {exception}"));
                }
            },
        }
        if words.next_if_eq(&"AND").is_none() {
            return Ok(all);
        }
    }
}

/// The place of the least preferred of some licences.
fn rank(licences: &[String]) -> usize {
    let place = |licence: &String| PREFERRED.iter().position(|preferred| preferred == licence);
    licences.iter().map(|licence| place(licence).unwrap_or(PREFERRED.len())).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn the_most_preferred_licence_is_chosen() {
        for (expression, chosen) in [
            ("MIT OR Apache-2.0", "Apache-2.0"),
            ("MIT/Apache-2.0", "Apache-2.0"),
            ("MIT OR GPL-3.0-only", "MIT"),
            ("GPL-3.0-only OR MIT", "MIT"),
            ("Apache-2.0 WITH LLVM-exception OR Apache-2.0 OR MIT", "Apache-2.0"),
            ("(MIT OR Apache-2.0) AND OFL-1.1", "Apache-2.0 OFL-1.1"),
            ("MIT OR Apache-2.0 AND GPL-2.0-only", "MIT"),
            ("MPL-2.0+", "MPL-2.0+"),
            ("", ""),
        ] {
            assert_eq!(Choice::of(expression).unwrap().chosen().join(" "), chosen, "{expression}");
        }
        assert!(Choice::of("MIT OR GPL-3.0-only").unwrap().leaves_out_any());
        assert!(!Choice::of("MIT AND ISC").unwrap().leaves_out_any());
    }

    #[test]
    fn what_is_no_expression_is_refused() {
        for expression in ["MIT OR", "OR MIT", "(MIT", "MIT)", "MIT ISC", "AND", "MIT WITH"] {
            assert!(Choice::of(expression).is_err(), "{expression}");
        }
    }
}
