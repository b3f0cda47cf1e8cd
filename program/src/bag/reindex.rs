//! `downbeat bag reindex`

use std::path::PathBuf;

use clap::Args;
use downbeat_bags::reindex as reindex_bag;

#[derive(Args)]
pub(crate) struct ReindexArguments {
    /// A rosbag2 directory.
    pub(crate) bag: PathBuf,
}

pub(crate) fn reindex(arguments: &ReindexArguments) -> anyhow::Result<()> {
    let metadata = reindex_bag(&arguments.bag)?;
    let (messages, topics) = (metadata.message_count, metadata.topics.len());
    println!(
        "wrote metadata.yaml of {messages} messages on {topics} topics in {} files",
        metadata.files.len()
    );
    Ok(())
}
