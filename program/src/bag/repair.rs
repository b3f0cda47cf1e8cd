//! `downbeat bag repair`

use std::path::{Path, PathBuf};

use anyhow::bail;
use clap::Args;

use super::output::{LayoutArguments, Progress, write};
use super::warn_of_oddities;
use downbeat_bags::{Check, Copy, Reader, Truncation, check};

#[derive(Args)]
pub(crate) struct RepairArguments {
    /// A rosbag2 directory or a single file; it is not changed. The new bag has its storage, unless -s names
    /// another.
    pub(crate) bag: PathBuf,
    /// The new rosbag2 directory; default is the name of the bag with `_repaired`.
    #[arg(long, short, value_name = "DIR")]
    pub(crate) output: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) layout: LayoutArguments,
}

pub(crate) fn repair(arguments: &RepairArguments) -> anyhow::Result<()> {
    let bags = [Reader::open(&arguments.bag)?];
    warn_of_oddities(&bags[0]);
    let truncations: Vec<_> = bags[0].truncation().collect();
    for truncation in &truncations {
        println!("{truncation}");
    }
    if truncations.is_empty() {
        println!("no file is truncated");
    }
    let output = arguments.output.clone().unwrap_or_else(|| beside(&arguments.bag));
    let storage = bags[0].storage();
    let copied = write(Copy::of(&bags, |_| true)?, &bags, &output, &arguments.layout, storage)?;
    let is_declared = bags[0].metadata().is_some_and(|metadata| metadata.message_count > 0);
    let is_damaged =
        is_declared || !copied.unreadable.is_empty() || bags[0].truncation().any(Truncation::loses_messages);
    if copied.summary.message_count() == 0 && is_damaged {
        bail!("no message of {} can be read", arguments.bag.display());
    }
    ensure_whole(&output)
}

/// Fails if the new bag has problems, which were copied with the messages.
fn ensure_whole(bag: &Path) -> anyhow::Result<()> {
    let reader = Reader::open(bag)?;
    let mut progress = Progress::new("checking", reader.message_count());
    let Check { problems, .. } = check(&reader, |read| progress.at(read))?;
    drop(progress);
    for problem in &problems {
        println!("{problem}");
    }
    if !problems.is_empty() {
        bail!("{} has problems that cannot be repaired, see above", bag.display());
    }
    Ok(())
}

fn beside(bag: &Path) -> PathBuf {
    let mut name =
        bag.file_stem().filter(|_| bag.is_file()).or(bag.file_name()).unwrap_or_default().to_owned();
    name.push("_repaired");
    bag.with_file_name(name)
}
