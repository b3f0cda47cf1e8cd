//! `downbeat bag repair`

use std::path::{Path, PathBuf};

use crate::bags::{Copy, Reader};
use clap::Args;

use super::output::{LayoutArguments, write};

#[derive(Args)]
pub(crate) struct RepairArguments {
    /// A rosbag2 directory or a single file; it is not changed.
    pub(crate) bag: PathBuf,
    /// The new rosbag2 directory; default is the name of the bag with `_repaired`.
    #[arg(long, short, value_name = "DIR")]
    pub(crate) output: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) layout: LayoutArguments,
}

pub(crate) fn repair(arguments: &RepairArguments) -> anyhow::Result<()> {
    let bags = [Reader::open(&arguments.bag)?];
    let truncations: Vec<_> = bags[0].truncation().collect();
    for truncation in &truncations {
        println!("{truncation}");
    }
    if truncations.is_empty() {
        println!("no file is truncated");
    }
    let output = arguments.output.clone().unwrap_or_else(|| beside(&arguments.bag));
    write(Copy::of(&bags, |_| true)?, &bags, &output, &arguments.layout)?;
    Ok(())
}

fn beside(bag: &Path) -> PathBuf {
    let mut name =
        bag.file_stem().filter(|_| bag.is_file()).or(bag.file_name()).unwrap_or_default().to_owned();
    name.push("_repaired");
    bag.with_file_name(name)
}
