//! The file of an exported topic.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use bytes::Bytes;
use serde_json::value::RawValue;

use super::Format;
use crate::bag::select::Tally;
use downbeat_bags::{BagMessage, RecordedTopic};
use downbeat_bridge::edge::Interfaces;
use downbeat_msgs::printable;
#[cfg(feature = "tables")]
use downbeat_robot::table::ParquetTable;
use downbeat_robot::table::{Cell, Columns, DecodeError, Decoder, Survey};

/// A topic and its file. A failure ends this file alone: the other topics are still useful.
pub(super) struct Table<'a> {
    topic: &'a RecordedTopic,
    path: PathBuf,
    /// Whether the name of the file does not hold the whole name of the topic.
    is_shortened: bool,
    rows: anyhow::Result<Rows>,
    tally: Tally,
}

enum Rows {
    /// The columns are not known yet, so there is no file.
    Survey(Format, Decoder, Survey),
    Csv(Decoder, Columns, Box<csv::Writer<File>>),
    /// Without a decoder: JSON of a type that ROS 2 does not have, as other programs write it.
    Lines(Option<Decoder>, BufWriter<File>),
    #[cfg(feature = "tables")]
    Parquet(Decoder, Columns, Box<ParquetTable>),
}

/// Receive and publish time of a message, in nanoseconds since the epoch: the first columns.
const TIMES: [&str; 2] = ["log_time", "publish_time"];

impl<'a> Table<'a> {
    pub(super) fn new(
        topic: &'a RecordedTopic,
        format: Format,
        interfaces: &Interfaces,
        folder: &Path,
        names: &mut FileNames,
    ) -> Self {
        let name = &topic.info.name;
        let decoder = Decoder::of(topic, interfaces);
        let is_foreign_json = decoder.is_err() && topic.info.is_json();
        if is_foreign_json && !matches!(format, Format::Jsonl) {
            tracing::warn!(
                "{}: its JSON has no ROS 2 type, so it is exported as JSON lines",
                printable(name)
            );
        }
        let format = if is_foreign_json { Format::Jsonl } else { format };
        let stem = names.stem(name);
        let path = folder.join(format!("{stem}.{}", format.extension()));
        let lines = |decoder| Ok(Rows::Lines(decoder, BufWriter::new(File::create(&path)?)));
        let rows = match (decoder, format) {
            (Err(_), _) if is_foreign_json => lines(None),
            (Err(error), _) => Err(error.into()),
            (Ok(decoder), Format::Jsonl) => lines(Some(decoder)),
            (Ok(decoder), _) => Ok(Rows::Survey(format, decoder, Survey::default())),
        };
        let is_shortened = stem.len() < name.trim_start_matches('/').len();
        Self { topic, path, is_shortened, rows, tally: Tally::default() }
    }

    /// Whether the columns depend on messages that it has not seen.
    pub(super) fn needs_columns(&self) -> bool {
        matches!(self.rows, Ok(Rows::Survey(..)))
    }

    /// Looks at a message for its columns.
    pub(super) fn survey(&mut self, data: Bytes) {
        if let Ok(Rows::Survey(_, decoder, survey)) = &mut self.rows
            // What cannot be read is counted while the file is written.
            && let Ok(message) = decoder.decode(data)
        {
            survey.see(&message);
        }
    }

    /// Creates the file, now that every message was seen.
    pub(super) fn create(self) -> Self {
        let Self { topic, path, is_shortened, rows, tally } = self;
        let rows = rows.and_then(|rows| rows.in_file(&path));
        Self { topic, path, is_shortened, rows, tally }
    }

    pub(super) fn is_written(&self) -> bool {
        self.rows.is_ok()
    }

    /// Writes a message, if it is readable and nothing failed before.
    pub(super) fn push(&mut self, message: BagMessage) {
        if let Ok(rows) = &mut self.rows
            && let Err(error) = rows.push(message, self.topic, &mut self.tally)
        {
            self.rows = Err(error);
        }
    }

    /// Completes the file, and prints what is in it, or logs why the topic is left out. The file is moved to
    /// `folder` later. Returns the number of unreadable messages, or `None` for a topic that is left out.
    pub(super) fn finish(self, folder: &Path) -> Option<usize> {
        self.tally.warn(self.topic);
        let name = printable(&self.topic.info.name);
        if let Err(error) = self.rows.and_then(Rows::finish) {
            tracing::warn!("{name} is left out: {error:#}");
            // It may not exist.
            let _ = std::fs::remove_file(&self.path);
            return None;
        }
        if self.is_shortened {
            let stem = self.path.file_stem().unwrap_or_default().to_string_lossy();
            tracing::warn!("{name}: the name of its file is shortened to {}", printable(&stem));
        }
        let file = folder.join(self.path.file_name().unwrap_or_default());
        println!("{name}: {} messages in {}", self.tally.readable, printable(&file.to_string_lossy()));
        Some(self.tally.broken)
    }
}

impl Rows {
    fn in_file(self, path: &Path) -> anyhow::Result<Self> {
        let Self::Survey(format, decoder, survey) = self else { return Ok(self) };
        let columns = survey.columns();
        Ok(match format {
            #[cfg(feature = "tables")]
            Format::Parquet => {
                let table = ParquetTable::create(path, TIMES, &columns)?;
                Self::Parquet(decoder, columns, Box::new(table))
            }
            // The command refuses what is not built in.
            _ => {
                let mut writer = csv::Writer::from_path(path)?;
                let names = columns.iter().map(|column| column.name.as_str());
                writer.write_record(TIMES.into_iter().chain(names))?;
                Self::Csv(decoder, columns, Box::new(writer))
            }
        })
    }

    fn push(&mut self, message: BagMessage, topic: &RecordedTopic, tally: &mut Tally) -> anyhow::Result<()> {
        let BagMessage { log_time, publish_time, data, .. } = message;
        let times = [log_time, publish_time];
        match self {
            Self::Survey(..) => {}
            Self::Csv(decoder, columns, writer) => {
                let Some(content) = tally.readable(topic, decoder.decode(data)) else { return Ok(()) };
                let times = times.map(|time| time.to_string());
                let row = columns.row(&content);
                writer.write_record(times.into_iter().chain(row.iter().map(Cell::to_text)))?;
            }
            Self::Lines(decoder, writer) => {
                let json = match decoder {
                    Some(decoder) => decoder.to_json(data),
                    None => on_one_line(&data),
                };
                let Some(json) = tally.readable(topic, json) else { return Ok(()) };
                let [received, published] = TIMES;
                write!(writer, "{{\"{received}\":{log_time},\"{published}\":{publish_time},\"message\":")?;
                writer.write_all(&json)?;
                writer.write_all(b"}\n")?;
            }
            #[cfg(feature = "tables")]
            Self::Parquet(decoder, columns, table) => {
                let Some(content) = tally.readable(topic, decoder.decode(data)) else { return Ok(()) };
                table.push(times, columns.row(&content))?;
            }
        }
        Ok(())
    }

    fn finish(self) -> anyhow::Result<()> {
        match self {
            Self::Survey(..) => {}
            Self::Csv(_, _, mut writer) => writer.flush()?,
            Self::Lines(_, mut writer) => writer.flush()?,
            #[cfg(feature = "tables")]
            Self::Parquet(_, _, table) => table.finish()?,
        }
        Ok(())
    }
}

/// JSON of any schema, as it is, but without line breaks.
fn on_one_line(data: &[u8]) -> Result<Vec<u8>, DecodeError> {
    let json: &RawValue = serde_json::from_slice(data).map_err(DecodeError::Json)?;
    // A line break is never within a string, so it is a space.
    Ok(json.get().bytes().map(|byte| if matches!(byte, b'\r' | b'\n') { b' ' } else { byte }).collect())
}

/// The longest name of a file, in bytes, without its extension and a number.
const LONGEST_STEM: usize = 200;

/// Names of files, without their extensions.
#[derive(Default)]
pub(super) struct FileNames {
    /// How many topics would have a name; for those, the next number to try.
    taken: HashMap<String, usize>,
}

impl FileNames {
    /// `/imu/data_raw` becomes `imu.data_raw`; a name that is too long for a file keeps its beginning. If
    /// another topic already has that name, which can happen in bags of other recorders, a number is added.
    fn stem(&mut self, topic: &str) -> String {
        let mut plain = topic.trim_start_matches('/').replace('/', ".").replace('\0', "_");
        let is_end = |end: &usize| plain.is_char_boundary(*end);
        plain.truncate((0..=LONGEST_STEM.min(plain.len())).rev().find(is_end).unwrap_or(0));
        let mut stem = plain.clone();
        while self.taken.contains_key(&stem) {
            let number = self.taken.entry(plain.clone()).or_insert(1);
            *number += 1;
            stem = format!("{plain}-{number}");
        }
        self.taken.insert(stem.clone(), 1);
        stem
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_topics_share_a_file() {
        let mut names = FileNames::default();
        let stems = ["/imu/data", "imu.data", "/imu.data", "/imu"].map(|topic| names.stem(topic));
        assert_eq!(stems, ["imu.data", "imu.data-2", "imu.data-3", "imu"]);
        let long = format!("/{}", "é".repeat(2000));
        let stems = [&long, &format!("{long}/b")].map(|topic| names.stem(topic));
        assert_eq!(stems, ["é".repeat(100), format!("{}-2", "é".repeat(100))]);
    }
}
