//! `[record]`: what is recorded and how it is written.

use std::num::NonZeroUsize;

use downbeat_bridge::expose::TopicPattern;

use super::table::{Table, Value};
use super::{Result, choice};
use crate::record_options::{RECORD_OPTIONS, RecordOption, RecordOptions, Takes, set_preset};

/// What is recorded and how it is written.
#[derive(Clone)]
pub struct RecordEntry {
    pub(crate) line: usize,
    /// Names or patterns of the recorded topics; `None` for all topics.
    pub topics: Option<Vec<String>>,
    /// Names or patterns of topics that are excluded.
    pub except: Vec<String>,
    /// If not empty, only topics of these types are recorded.
    pub types: Vec<String>,
    /// If not empty, only topics that these modules publish are recorded.
    pub modules: Vec<String>,
    /// Records only exposed topics, or only topics that are not exposed; `None` for both.
    pub exposed: Option<bool>,
    /// How the recording is written.
    pub options: RecordOptions,
}

impl Default for RecordEntry {
    fn default() -> Self {
        Self {
            line: 1,
            topics: None,
            except: Vec::new(),
            types: Vec::new(),
            modules: Vec::new(),
            exposed: None,
            options: RecordOptions::default(),
        }
    }
}

pub(super) fn record(value: Value<'_>) -> Result<RecordEntry> {
    let mut table = value.table("[record]")?;
    let topics = table.take("topics");
    let line = topics.map_or(table.line(), |value| value.line());
    let encoding = table.peek("encoding");
    let topics = match topics {
        Some(value) if value.text().is_ok_and(|text| text == "all") => None,
        Some(value) => {
            let names = value.list().map_err(|_| value.error("expected \"all\" or a list of topics"))?;
            Some(names.iter().map(|name| pattern(*name)).collect::<Result<_>>()?)
        }
        None => None,
    };
    let entry = RecordEntry {
        line,
        topics,
        except: list(&mut table, "except", pattern)?,
        types: list(&mut table, "types", |value| Ok(value.text()?.to_owned()))?,
        modules: list(&mut table, "modules", |value| Ok(value.text()?.to_owned()))?,
        exposed: table.take("exposed").map(|value| value.flag()).transpose()?,
        options: options(&mut table)?,
    };
    table.finish()?;
    match (encoding, entry.options.refusal()) {
        (Some(value), Some(reason)) => Err(value.error(reason)),
        _ => Ok(entry),
    }
}

fn options(table: &mut Table<'_>) -> Result<RecordOptions> {
    let mut options = RecordOptions::default();
    for option in RECORD_OPTIONS {
        if let Some(value) = table.take(option.key) {
            set(option, &mut options, value)?;
        }
    }
    Ok(options)
}

/// Applies a value of the file.
fn set(option: &RecordOption, options: &mut RecordOptions, value: Value<'_>) -> Result<()> {
    let applied = match &option.takes {
        Takes::Choice(choices) => {
            let choices: Vec<_> = choices.iter().map(|choice| (choice.name, choice.set)).collect();
            choice(value, &choices)?(options)
        }
        Takes::Preset => {
            let presets = options.writer.storage.storage().presets();
            let presets: Vec<_> = presets.iter().map(|&name| (name, name)).collect();
            set_preset(options, choice(value, &presets)?)
        }
        Takes::Bytes { in_file, set, .. } => {
            let expected = match (in_file.start(), in_file.end()) {
                (least, &i64::MAX) => format!("a number of bytes, {least} or more"),
                (least, most) => format!("{least} to {most} bytes"),
            };
            set(options, value.number_in(in_file.clone(), &expected)?);
            Ok(())
        }
        Takes::Count(set) => {
            if let Some(count) = NonZeroUsize::new(value.count()? as usize) {
                set(options, count);
            }
            Ok(())
        }
        Takes::Time(set) => set(options, value.duration()?),
        Takes::Switch(set) => set(options, value.flag()?),
        Takes::Text(set) => set(options, value.text()?),
        Takes::Entries(set) => {
            for (key, text) in value.table(option.key)?.take_rest() {
                set(options, &key, text.text()?);
            }
            Ok(())
        }
    };
    applied.map_err(|reason| value.error(reason))
}

/// Reads a name or a valid pattern.
fn pattern(value: Value<'_>) -> Result<String> {
    let text = value.text()?;
    TopicPattern::new(text).map_err(|error| value.error(error.to_string()))?;
    Ok(text.to_owned())
}

fn list(
    table: &mut Table<'_>,
    key: &'static str,
    read: impl Fn(Value<'_>) -> Result<String>,
) -> Result<Vec<String>> {
    let Some(value) = table.take(key) else { return Ok(Vec::new()) };
    value.list()?.into_iter().map(read).collect()
}
