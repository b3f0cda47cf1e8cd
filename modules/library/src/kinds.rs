//! The kinds of modules that this package offers to robot files.

use std::time::Duration;

use downbeat_executor::{SettingValue, Synchrony};
use downbeat_kind::{Kind, ModuleSource};

use crate::LibraryOptions;

/// The kinds.
#[must_use]
pub fn kinds() -> Vec<Kind> {
    vec![
        Kind::foreign(
            "library",
            "a module in C, C++ or Rust: a shared library (docs/libraries.md)",
            [&["path"], &["reload", "isolate", "time_limit"]],
            |source| crate::load(&library(source)?),
            |source| library(source).map(|options| vec![options.path]).unwrap_or_default(),
        )
        .with_synchrony(Synchrony::WhenDue),
    ]
}

/// Reads the keys of a module in a shared library.
fn library(source: &ModuleSource) -> Result<LibraryOptions, String> {
    let Some(SettingValue::Text(path)) = source.keys.get("path") else {
        return Err("`path` is the file of the library, such as \"libfoo.so\"".to_owned());
    };
    Ok(LibraryOptions {
        module: source.module.clone(),
        path: source.file_to_read(&source.folder.join(path)),
        is_reloaded: source.is_set("reload", false)?,
        is_isolated: source.is_set("isolate", false)?,
        time_limit: match source.keys.get("time_limit") {
            // A module that may run for longer is not killed before that is reported.
            None => source.deadline.unwrap_or_default().max(LibraryOptions::TIME_LIMIT),
            Some(SettingValue::Text(text)) => time_limit(text)?,
            Some(other) => {
                return Err(format!("`time_limit` is a time with its unit, such as \"500ms\", not {other}"));
            }
        },
    })
}

fn time_limit(text: &str) -> Result<Duration, String> {
    match downbeat_files::duration::parse(text) {
        Ok(limit) if !limit.is_zero() => Ok(limit),
        Ok(_) => Err("`time_limit` has to be above 0".to_owned()),
        Err(problem) => Err(format!("`time_limit`: {problem}")),
    }
}
