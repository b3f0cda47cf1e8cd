//! `downbeat bag export`

mod table;

use std::collections::HashMap;
use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::{Args, ValueEnum};

use super::open;
use super::select::{TopicArguments, carried_over, each_message};
use crate::new_output::{Force, Output};
use crate::not_built;
use crate::unfinished::Unfinished;
use downbeat_bags::{Reader, TopicId};
use downbeat_robot::Catalog;
use table::{FileNames, Table};

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
    /// How many topics are written while the bag is read once: as many as may have open files, and a Parquet
    /// file buffers up to 32 MB.
    fn together(self) -> usize {
        match self {
            Self::Csv | Self::Jsonl => 256,
            Self::Parquet => 8,
        }
    }

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
    let written_to = unfinished.written();
    std::fs::create_dir(written_to)
        .with_context(|| format!("cannot create the directory {}", output.display()))?;
    let topics = bag.topics().iter().enumerate();
    let wanted: Vec<_> = topics
        .filter(|(_, topic)| filter.is_wanted(&topic.info))
        .filter_map(|(index, _)| TopicId::at(index))
        .collect();
    let mut names = FileNames::default();
    let (mut unreadable, mut left_out) = (0, 0);
    for together in wanted.chunks(arguments.format.together()) {
        let table = |id: &TopicId| {
            Table::new(&bag.topics()[id.index()], arguments.format, interfaces, written_to, &mut names)
        };
        let tables = together.iter().map(table).collect();
        let (tables, lost_parts) = written(&bag, together, tables)?;
        unreadable += lost_parts;
        for table in tables {
            match table.finish(output) {
                Some(broken) => unreadable += broken,
                None => left_out += 1,
            }
        }
    }
    if std::fs::read_dir(written_to)?.next().is_none() {
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

/// Reads the bag once, or twice if there are columns to find, and writes the messages into the files of their
/// topics. Returns also the number of parts of the bag that cannot be read.
fn written<'a>(
    bag: &Reader,
    ids: &[TopicId],
    mut tables: Vec<Table<'a>>,
) -> anyhow::Result<(Vec<Table<'a>>, usize)> {
    let places: HashMap<_, _> = ids.iter().copied().zip(0..).collect();
    let of_those = |tables: &[Table<'a>], is_one: fn(&Table<'a>) -> bool| -> Vec<_> {
        ids.iter().zip(tables).filter(|(_, table)| is_one(table)).map(|(id, _)| *id).collect()
    };
    let surveyed = of_those(&tables, Table::needs_columns);
    if !surveyed.is_empty() {
        each_message(bag, surveyed, "looking", |message| {
            tables[places[&message.topic]].survey(message.data);
            Ok(())
        })?;
    }
    tables = tables.into_iter().map(Table::create).collect();
    let writable = of_those(&tables, Table::is_written);
    if writable.is_empty() {
        return Ok((tables, 0));
    }
    let lost_parts = each_message(bag, writable, "writing", |message| {
        tables[places[&message.topic]].push(message);
        Ok(())
    })?;
    Ok((tables, lost_parts))
}
