//! `downbeat bag export`

#[cfg(feature = "tables")]
mod lerobot;
mod table;

use std::collections::HashMap;
use std::num::NonZeroU32;
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
    /// A rosbag2 directory or a single file; for a data set of LeRobot several of them.
    #[arg(required = true, value_name = "BAG")]
    pub(crate) bags: Vec<PathBuf>,
    /// The new directory: with one file per topic, or of a data set.
    #[arg(long, short, value_name = "DIR")]
    pub(crate) output: PathBuf,
    #[command(flatten)]
    pub(crate) force: Force,
    /// The format of the files.
    #[arg(long, short, value_enum, default_value_t = Format::Csv)]
    pub(crate) format: Format,
    #[command(flatten)]
    pub(crate) topics: TopicArguments,
    #[command(flatten)]
    pub(crate) dataset: DatasetArguments,
}

/// What a data set of LeRobot is made of.
#[derive(Args, Default, PartialEq)]
#[command(next_help_heading = "Options of --format lerobot")]
pub(crate) struct DatasetArguments {
    /// Frames per second; 30 if not given.
    #[arg(long)]
    fps: Option<NonZeroU32>,
    /// What the robot does, `observation.state`: a topic, or some of its fields, such as
    /// joint_states:position,velocity. Without fields the positions of joints, or all numbers of messages
    /// without joints; joint_states if not given.
    #[arg(long, value_name = "TOPIC[:FIELD,…]")]
    state: Option<String>,
    /// What it is commanded, `action`; joint_commands if not given.
    #[arg(long, value_name = "TOPIC[:FIELD,…]")]
    action: Option<String>,
    /// A camera, `observation.images.NAME`: front=camera/image_raw.
    #[arg(long, num_args = 1.., value_name = "NAME=TOPIC")]
    images: Vec<String>,
    /// What is done, in words, in episodes for which the bag does not say it.
    #[arg(long)]
    task: Option<String>,
    /// The kind of robot: so101_follower.
    #[arg(long, value_name = "NAME")]
    robot_type: Option<String>,
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
    /// A data set of LeRobot (v3.0) from which policies learn; needs `tables` too.
    Lerobot,
}

impl Format {
    /// How many topics are written while the bag is read once: as many as may have open files, and a Parquet
    /// file buffers up to 32 MB.
    fn together(self) -> usize {
        match self {
            Self::Csv | Self::Jsonl => 256,
            Self::Parquet | Self::Lerobot => 8,
        }
    }

    fn extension(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Jsonl => "jsonl",
            Self::Parquet | Self::Lerobot => "parquet",
        }
    }
}

pub(crate) fn export(arguments: &ExportArguments, catalog: &Catalog) -> anyhow::Result<()> {
    let interfaces = &catalog.interfaces;
    if cfg!(not(feature = "tables")) && matches!(arguments.format, Format::Parquet | Format::Lerobot) {
        return not_built("tables", "available are csv and jsonl");
    }
    #[cfg(feature = "tables")]
    if let Format::Lerobot = arguments.format {
        return lerobot::export(arguments, interfaces);
    }
    if arguments.dataset != DatasetArguments::default() {
        bail!("--fps, --state, --action, --images, --task and --robot-type are of --format lerobot");
    }
    let [bag] = &*arguments.bags else {
        bail!("tables are made of one bag; `downbeat bag convert` joins several")
    };
    let bag = open(bag)?;
    let filter = arguments.topics.filter()?;
    arguments.topics.check(bag.topics().iter().map(|topic| &topic.info))?;
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
