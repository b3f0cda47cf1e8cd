//! The licences of what is compiled in, with their texts: THIRD-PARTY.txt.

mod expression;

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

use anyhow::Context;

use crate::crates::{Crate, Crates};
use crate::steps::workspace;
use expression::Choice;

/// The notices of all crates that are not ours: a list of them, then each text once, with the crates that
/// have it.
///
/// # Errors
/// If a crate has no text of its licence, and it is none whose text is the same everywhere.
pub(crate) fn of(crates: &Crates) -> anyhow::Result<String> {
    let theirs = || crates.crates.iter().filter(|one| !one.is_ours());
    let mut notices = String::from(
        "downbeat contains the crates below, and the standard library of Rust (MIT OR Apache-2.0).\n\
         Where several licences are offered, the one that follows \"used under\" was chosen, and the texts of the\n\
         others are left out. The sources of all are at https://crates.io/crates/NAME/VERSION.\n\n",
    );
    let mut texts: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for one in theirs() {
        let name = format!("{} {}", one.name, one.version);
        let choice = Choice::of(one.license.as_deref().unwrap_or_default()).with_context(|| name.clone())?;
        write!(notices, "{name}: {}", one.license.as_deref().unwrap_or("see its text"))?;
        match choice.leaves_out_any() {
            true => writeln!(notices, "; used under {}", choice.chosen().join(" AND "))?,
            false => writeln!(notices)?,
        }
        for text in licences(one, &choice).with_context(|| name.clone())? {
            texts.entry(text).or_default().push(name.clone());
        }
    }
    let mut texts: Vec<_> = texts.into_iter().collect();
    texts.sort_by(|(_, a), (_, b)| a.cmp(b));
    for (text, names) in texts {
        write!(notices, "\n{}\n{}\n\n{text}", "=".repeat(80), in_lines(&names))?;
    }
    Ok(notices)
}

fn in_lines(names: &[String]) -> String {
    let mut text = String::new();
    let mut width = 0;
    for name in names {
        let comma = if text.is_empty() { "" } else { ", " };
        if width + comma.len() + name.len() > 80 {
            text.push_str(",\n");
            width = 0;
        } else {
            text.push_str(comma);
            width += comma.len();
        }
        text.push_str(name);
        width += name.len();
    }
    text
}

/// The texts that come with a crate, without those of licences that were not chosen; the usual texts of
/// chosen licences that have no file.
fn licences(one: &Crate, choice: &Choice) -> anyhow::Result<Vec<String>> {
    let mut files: Vec<PathBuf> = one.licence_file().into_iter().collect();
    for folder in ["", "LICENSES", "fonts"] {
        let folder = one.folder().join(folder);
        for entry in std::fs::read_dir(&folder).into_iter().flatten() {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            // Each font has its own text.
            if path.is_file() && (is_licence(&name) || folder.ends_with("fonts") && name.ends_with(".txt")) {
                files.push(path);
            }
        }
    }
    files.sort();
    files.dedup();
    let mut texts = Vec::new();
    for file in files {
        let bytes = std::fs::read(&file).with_context(|| file.display().to_string())?;
        texts.push(tidied(&String::from_utf8_lossy(&bytes)));
    }
    complete(texts, choice, &one.name, &one.authors)
}

/// The texts that a crate comes with, as [`licences`] returns them.
fn complete(
    mut texts: Vec<String>,
    choice: &Choice,
    name: &str,
    authors: &[String],
) -> anyhow::Result<Vec<String>> {
    texts.retain(|text| !choice.leaves_out(text));
    // A text that is not recognised may be that of any licence.
    let is_there =
        |licence: &str| texts.iter().any(|text| expression::is_text_of(text, licence) != Some(false));
    let missing: Vec<&String> = choice.chosen().iter().filter(|licence| !is_there(licence)).collect();
    anyhow::ensure!(
        !(choice.chosen().is_empty() && texts.is_empty()),
        "it names no licence and has no file with one: ask its authors"
    );
    for licence in missing {
        match licence.as_str() {
            "Apache-2.0" => {
                let apache = std::fs::read_to_string(workspace().join("LICENSE"));
                texts.push(tidied(&apache.context("cannot read LICENSE")?));
            }
            "MIT" => {
                let authors = match authors {
                    [] => format!("the authors of {name}"),
                    authors => authors.join(", "),
                };
                texts.push(format!("Copyright (c) {authors}\n\n{MIT}"));
            }
            other => anyhow::bail!(
                "no file has the text of its licence ({other:?}): teach xtask/src/notices.rs where it is"
            ),
        }
    }
    Ok(texts)
}

/// Whether a file is one with a licence or a notice, by its name.
fn is_licence(name: &str) -> bool {
    let name = name.to_lowercase();
    let begins = ["license", "licence", "copying", "copyright", "notice", "unlicense", "ofl", "ufl"];
    let is_source = [".rs", ".toml", ".html"].iter().any(|end| name.ends_with(end));
    !is_source && begins.iter().any(|begin| name.starts_with(begin))
}

/// Without differences that nobody sees, so that equal texts are one.
fn tidied(text: &str) -> String {
    let lines: Vec<&str> = text.trim_start_matches('\u{feff}').lines().map(str::trim_end).collect();
    format!("{}\n", lines.join("\n").trim_matches('\n'))
}

const MIT: &str = "\
Permission is hereby granted, free of charge, to any person obtaining a copy
of this software and associated documentation files (the \"Software\"), to deal
in the Software without restriction, including without limitation the rights
to use, copy, modify, merge, publish, distribute, sublicense, and/or sell
copies of the Software, and to permit persons to whom the Software is
furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all
copies or substantial portions of the Software.

THE SOFTWARE IS PROVIDED \"AS IS\", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER
LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM,
OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE
SOFTWARE.
";

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn every_crate_in_the_wheel_has_a_text_of_its_licence() {
        let crates = crate::crates::of("downbeat-python", "full,sqlite", "x86_64-unknown-linux-gnu").unwrap();
        let notices = of(&crates).unwrap();
        for part in
            ["\nserialport 4.", "Mozilla Public License Version 2.0", "UBUNTU FONT LICENCE", "\nzenoh 1."]
        {
            assert!(notices.contains(part), "{part:?} is not in the notices");
        }
        assert!(!notices.contains("\ndownbeat"), "ours are no third party");
        assert!(notices.contains(": MIT OR GPL-3.0-only; used under MIT\n"), "the choice is not said");
        assert!(!notices.contains("GNU GENERAL PUBLIC LICENSE"), "the text of a licence that was not chosen");
    }

    #[test]
    fn texts_of_other_licences_are_left_out_and_missing_ones_are_added() {
        let apache = std::fs::read_to_string(workspace().join("LICENSE")).unwrap();
        let notice = "This product contains measurements.\n".to_owned();
        let mit = format!("Copyright (c) 2020 Ann\n\n{MIT}");
        let of = |texts: &[&String], license: &str| {
            let choice = Choice::of(license).unwrap();
            complete(texts.iter().map(|text| (*text).clone()).collect(), &choice, "wire", &[])
        };
        assert_eq!(of(&[&apache, &mit, &notice], "MIT OR Apache-2.0").unwrap(), [&*apache, &*notice]);
        assert_eq!(of(&[&mit], "MIT OR Apache-2.0").unwrap(), [tidied(&apache)]);
        assert_eq!(of(&[&apache, &mit], "MIT AND Apache-2.0").unwrap(), [&*apache, &*mit]);
        // Of something in the crate that its manifest does not mention.
        assert_eq!(of(&[&apache, &mit], "Apache-2.0").unwrap(), [&*apache, &*mit]);
        // Both in one file.
        let both = format!("{apache}\n{mit}");
        assert_eq!(of(&[&both], "MIT/Apache-2.0").unwrap(), [&*both]);
        let generic = of(&[], "MIT").unwrap();
        assert!(generic[0].starts_with("Copyright (c) the authors of wire\n"), "{generic:?}");
        let error = of(&[&mit], "MIT AND ISC").unwrap_err().to_string();
        assert!(error.contains("(\"ISC\")"), "{error}");
        assert!(of(&[], "").is_err());
    }

    #[test]
    fn files_with_licences_are_known_by_their_names() {
        for name in ["LICENSE-MIT", "licence.md", "COPYING", "NOTICE", "OFL.txt"] {
            assert!(is_licence(name), "{name}");
        }
        for name in ["README.md", "license.rs", "Hack-Regular.ttf"] {
            assert!(!is_licence(name), "{name}");
        }
    }

    #[test]
    fn names_stand_in_lines_of_80_columns() {
        let names: Vec<String> = (0..30).map(|number| format!("crate_{number} 1.0.0")).collect();
        let text = in_lines(&names);
        assert!(text.lines().all(|line| line.len() <= 81), "{text}");
        assert_eq!(text.split([',', '\n']).filter(|name| !name.is_empty()).count(), 30);
    }
}
