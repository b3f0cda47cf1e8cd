//! `downbeat bag export`

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::iter;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use bytes::Bytes;
use clap::{Args, ValueEnum};
use serde_json::value::RawValue;

use super::open;
use super::select::{Done, Source, TopicArguments, carried_over};
use crate::bags::TopicId;
use crate::msgs::printable;
use crate::program::new_output::{Force, Output};
use crate::program::not_built;
use crate::program::unfinished::Unfinished;
use crate::robot::Catalog;
use crate::table::{Cell, DecodeError, Decoder};

#[derive(Args)]
pub(crate) struct ExportArguments {
    /// A rosbag2 directory or a single file.
    pub(crate) bag: PathBuf,
    /// The new directory, with one file per topic.
    #[arg(long, short, value_name = "DIR")]
    pub(crate) output: PathBuf,
    #[command(flatten)]
    pub(crate) force: Force,
    /// The format of the files.
    #[arg(long, short, value_enum, default_value_t = Format::Csv)]
    pub(crate) format: Format,
    #[command(flatten)]
    pub(crate) topics: TopicArguments,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum Format {
    /// A column per field, bytes in Base64.
    Csv,
    /// One JSON object per message.
    Jsonl,
    /// Apache Parquet: typed columns, for pandas, Polars and DuckDB; if the program is built with the feature
    /// `tables`.
    Parquet,
}

impl Format {
    fn extension(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Jsonl => "jsonl",
            Self::Parquet => "parquet",
        }
    }
}

pub(crate) fn export(arguments: &ExportArguments, catalog: &Catalog) -> anyhow::Result<()> {
    let interfaces = &catalog.interfaces;
    let bag = open(&arguments.bag)?;
    let filter = arguments.topics.filter()?;
    arguments.topics.check(bag.topics().iter().map(|topic| &topic.info))?;
    if cfg!(not(feature = "tables")) && matches!(arguments.format, Format::Parquet) {
        return not_built("tables", "available are csv and jsonl");
    }
    let output = &arguments.output;
    let replaces = (arguments.force, Output::Tables);
    let unfinished = Unfinished::directory(output, replaces, [bag.path()])?;
    std::fs::create_dir(unfinished.written())
        .with_context(|| format!("cannot create the directory {}", output.display()))?;
    let topics = bag.topics().iter().enumerate();
    let wanted: Vec<_> = topics.filter(|(_, topic)| filter.is_wanted(&topic.info)).collect();
    let mut taken = BTreeSet::new();
    let (mut unreadable, mut left_out) = (0, 0);
    for (index, topic) in wanted {
        let Some(id) = TopicId::at(index) else { continue };
        let stem = file_stem(&topic.info.name, &mut taken);
        let (source, name) = (Source::new(&bag, id), printable(&topic.info.name));
        let decoder = Decoder::of(topic, interfaces);
        // Other programs write JSON of types that ROS 2 does not have.
        let is_foreign_json = decoder.is_err() && topic.info.is_json();
        let format = if is_foreign_json { Format::Jsonl } else { arguments.format };
        let name_of_file = format!("{stem}.{}", format.extension());
        let file = unfinished.written().join(&name_of_file);
        let result = match format {
            _ if is_foreign_json => write_foreign_json(&source, &file),
            Format::Csv => {
                decoder.map_err(Into::into).and_then(|decoder| write_csv(&source, &decoder, &file))
            }
            Format::Jsonl => {
                decoder.map_err(Into::into).and_then(|decoder| write_jsonl(&source, &decoder, &file))
            }
            Format::Parquet => {
                decoder.map_err(Into::into).and_then(|decoder| write_parquet(&source, &decoder, &file))
            }
        };
        if result.is_ok() && stem.len() < topic.info.name.trim_start_matches('/').len() {
            tracing::warn!("{name}: the name of its file is shortened to {}", printable(&stem));
        }
        if is_foreign_json && !matches!(arguments.format, Format::Jsonl) {
            tracing::warn!("{name}: its JSON has no ROS 2 type, so it is exported as JSON lines");
        }
        match result {
            Ok(done) => {
                unreadable += done.unreadable;
                let file = output.join(&name_of_file);
                println!("{name}: {} messages in {}", done.messages, printable(&file.to_string_lossy()));
            }
            // The other topics are still useful.
            Err(error) => {
                left_out += 1;
                tracing::warn!("{name} is left out: {error:#}");
                // It may not exist.
                let _ = std::fs::remove_file(&file);
            }
        }
    }
    if std::fs::read_dir(unfinished.written())?.next().is_none() {
        bail!("nothing was exported");
    }
    unfinished.finish()?;
    carried_over(&[bag], unreadable)?;
    if left_out > 0 {
        bail!(
            "incomplete: {left_out} topics are left out, see above; --exclude-topics leaves them out without an error"
        );
    }
    Ok(())
}

/// The longest name of a file, in bytes, without its extension and a number.
const LONGEST_STEM: usize = 200;

/// `/imu/data_raw` becomes `imu.data_raw`; a name that is too long for a file keeps its beginning. If another topic already has that name,
/// which can happen in bags of other recorders, a number is added.
fn file_stem(topic: &str, taken: &mut BTreeSet<String>) -> String {
    let mut plain = topic.trim_start_matches('/').replace('/', ".").replace('\0', "_");
    let is_end = |end: &usize| plain.is_char_boundary(*end);
    plain.truncate((0..=LONGEST_STEM.min(plain.len())).rev().find(is_end).unwrap_or(0));
    let numbered = (2..).map(|number| format!("{plain}-{number}"));
    let mut candidates = iter::once(plain.clone()).chain(numbered);
    candidates.find(|stem| taken.insert(stem.clone())).unwrap_or_default()
}

/// Receive and publish time of a message, in nanoseconds since the epoch: the first columns.
const TIMES: [&str; 2] = ["log_time", "publish_time"];

fn write_csv(source: &Source<'_>, decoder: &Decoder, path: &Path) -> anyhow::Result<Done> {
    let columns = source.columns(decoder)?;
    let mut writer = csv::Writer::from_path(path)?;
    let names = columns.iter().map(|column| column.name.as_str());
    writer.write_record(TIMES.into_iter().chain(names))?;
    let rows = |data| Ok(columns.row(&decoder.decode(data)?));
    let done = source.each("writing", rows, |times, row| {
        let times = times.map(|time| time.to_string());
        Ok(writer.write_record(times.into_iter().chain(row.iter().map(Cell::to_text)))?)
    })?;
    writer.flush()?;
    Ok(done)
}

#[cfg(not(feature = "tables"))]
fn write_parquet(_: &Source<'_>, _: &Decoder, _: &Path) -> anyhow::Result<Done> {
    not_built("tables", "")
}

#[cfg(feature = "tables")]
fn write_parquet(source: &Source<'_>, decoder: &Decoder, path: &Path) -> anyhow::Result<Done> {
    let columns = source.columns(decoder)?;
    let mut table = crate::table::ParquetTable::create(path, TIMES, &columns)?;
    let rows = |data| Ok(columns.row(&decoder.decode(data)?));
    let done = source.each("writing", rows, |times, row| Ok(table.push(times, row)?))?;
    table.finish()?;
    Ok(done)
}

fn write_jsonl(source: &Source<'_>, decoder: &Decoder, path: &Path) -> anyhow::Result<Done> {
    write_lines(source, |data| decoder.to_json(data), path)
}

/// Writes messages that are JSON of any schema, one per line, as they are.
fn write_foreign_json(source: &Source<'_>, path: &Path) -> anyhow::Result<Done> {
    let on_one_line = |data: Bytes| {
        let json: &RawValue = serde_json::from_slice(&data).map_err(DecodeError::Json)?;
        // A line break is never within a string, so it is a space.
        Ok(json.get().bytes().map(|byte| if matches!(byte, b'\r' | b'\n') { b' ' } else { byte }).collect())
    };
    write_lines(source, on_one_line, path)
}

fn write_lines(
    source: &Source<'_>,
    json: impl Fn(Bytes) -> Result<Vec<u8>, DecodeError>,
    path: &Path,
) -> anyhow::Result<Done> {
    let mut writer = BufWriter::new(File::create(path)?);
    let done = source.each("writing", json, |times, json| {
        for (name, time) in TIMES.into_iter().zip(times) {
            write!(writer, "{}\"{name}\":{time}", if name == TIMES[0] { '{' } else { ',' })?;
        }
        writer.write_all(b",\"message\":")?;
        writer.write_all(&json)?;
        Ok(writer.write_all(b"}\n")?)
    })?;
    writer.flush()?;
    Ok(done)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_topics_share_a_file() {
        let mut taken = BTreeSet::new();
        let stems = ["/imu/data", "imu.data", "/imu.data", "/imu"].map(|topic| file_stem(topic, &mut taken));
        assert_eq!(stems, ["imu.data", "imu.data-2", "imu.data-3", "imu"]);
        let long = format!("/{}", "é".repeat(2000));
        let stems = [&long, &format!("{long}/b")].map(|topic| file_stem(topic, &mut taken));
        assert_eq!(stems, ["é".repeat(100), format!("{}-2", "é".repeat(100))]);
    }
}
