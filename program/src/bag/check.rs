//! `downbeat bag check`

use std::path::PathBuf;

use anyhow::bail;
use clap::Args;
use serde_json::json;

use super::output::Progress;
use super::warn_of_oddities;
use downbeat_bags::{Check, Reader, check_with};
use downbeat_msgs::printable;
use downbeat_robot::Catalog;

#[derive(Args)]
pub(crate) struct CheckBagArguments {
    /// A rosbag2 directory or a single file.
    pub(crate) bag: PathBuf,
    /// Print what was found as JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

pub(crate) fn check(arguments: &CheckBagArguments, catalog: &Catalog) -> anyhow::Result<()> {
    let reader = Reader::open(&arguments.bag)?;
    warn_of_oddities(&reader);
    let mut progress = Progress::new("reading", reader.message_count());
    let found = check_with(&reader, &catalog.interfaces.definitions(), |read| progress.at(read))?;
    drop(progress);
    let Check { messages, decoded, problems, notes } = &found;
    if arguments.json {
        let problems: Vec<_> = problems.iter().map(ToString::to_string).collect();
        let report =
            json!({ "messages": messages, "decoded": decoded, "problems": problems, "notes": notes });
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        for note in notes {
            println!("note: {}", printable(note));
        }
        for problem in problems {
            println!("{problem}");
        }
        println!("read {messages} messages, decoded {decoded} of them, found {} problems", problems.len());
    }
    if !problems.is_empty() {
        bail!("{} has problems", arguments.bag.display());
    }
    Ok(())
}
