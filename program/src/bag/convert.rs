//! `downbeat bag convert`

use std::path::PathBuf;

use clap::Args;

use super::open;
use super::output::{OutputArguments, write};
use super::select::{TopicArguments, carried_over};
use downbeat_bags::{Copy, Reader, Storage};

#[derive(Args)]
pub(crate) struct ConvertArguments {
    /// Bags to merge into one by receive time: rosbag2 directories or single files.
    #[arg(required = true)]
    pub(crate) bags: Vec<PathBuf>,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
    #[command(flatten)]
    pub(crate) topics: TopicArguments,
}

pub(crate) fn convert(arguments: &ConvertArguments) -> anyhow::Result<()> {
    let bags = arguments.bags.iter().map(|bag| open(bag)).collect::<anyhow::Result<Vec<Reader>>>()?;
    let filter = arguments.topics.filter()?;
    arguments.topics.check(bags.iter().flat_map(Reader::topics).map(|topic| &topic.info))?;
    let copy = Copy::of(&bags, |topic| filter.is_wanted(topic))?;
    let OutputArguments { output, layout } = &arguments.output;
    let copied = write(copy, &bags, output, layout, Storage::default())?;
    carried_over(&bags, copied.unreadable.len() + copied.undecodable.len())
}
