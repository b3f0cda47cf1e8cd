//! Options for the bag that a command creates.

use std::fs;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::Args;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::custom_data;
use super::record_options::{Copying, GivenOptions};
use crate::new_output::{Force, Output};
use crate::unfinished::Unfinished;
use downbeat_bags::{Copied, Copy, Reader, Storage, StorageOptions, WriterOptions};
use downbeat_robot::{RecordOptions, SOURCES_FOLDER};

/// How a new bag is written.
#[derive(Args)]
pub(crate) struct OutputArguments {
    /// The new rosbag2 directory.
    #[arg(long, short, value_name = "DIR")]
    pub(crate) output: PathBuf,
    #[command(flatten)]
    pub(crate) layout: LayoutArguments,
}

/// The layout of its files, and whether they may replace others.
#[derive(Args)]
pub(crate) struct LayoutArguments {
    #[command(flatten)]
    force: Force,
    #[command(flatten)]
    options: GivenOptions<Copying>,
}

impl LayoutArguments {
    /// How the bag is written; in the storage `default` unless the options name one.
    pub(super) fn writer(&self, default: Storage) -> anyhow::Result<WriterOptions> {
        let mut record = RecordOptions::default();
        record.writer.storage = StorageOptions::of(default)?;
        self.options.apply(&mut record)?;
        Ok(record.writer)
    }

    /// The folder of the bag while it is written.
    pub(super) fn unfinished<'a>(
        &self,
        directory: &Path,
        inputs: impl IntoIterator<Item = &'a Path>,
    ) -> anyhow::Result<Unfinished> {
        Unfinished::directory(directory, (self.force, Output::Bag), inputs)
    }
}

/// Writes the copy of `bags` into a new bag, with their custom data, their distribution of ROS 2 and the
/// versions of modules in them, and prints its summary. The storage is `default` unless the options name one.
pub(crate) fn write(
    copy: Copy<'_>,
    bags: &[Reader],
    directory: &Path,
    layout: &LayoutArguments,
    default: Storage,
) -> anyhow::Result<Copied> {
    let unfinished = layout.unfinished(directory, bags.iter().map(Reader::path))?;
    let options = layout.writer(default)?;
    let storage = options.storage.storage();
    let options = custom_data(bags).fold(options, |options, (key, value)| options.custom_data(key, value));
    let options = match ros_distro(bags) {
        Some(ros_distro) => options.ros_distro(ros_distro),
        None => options,
    };
    let mut progress = Progress::new("writing", copy.message_count());
    let copied = copy.into_writer(options.create(unfinished.written())?, |written| progress.at(written))?;
    drop(progress);
    bags.iter().try_for_each(|bag| copy_versions(bag.path(), unfinished.written()))?;
    unfinished.finish()?;
    for note in &copied.completed {
        tracing::info!("{note}");
    }
    for error in &copied.unreadable {
        tracing::warn!("{error}");
    }
    for problem in &copied.undecodable {
        tracing::warn!("{problem}");
    }
    if copied.without_publish_time > 0 {
        tracing::warn!(
            "the publish times of {} messages are lost: {storage} only stores receive times",
            copied.without_publish_time
        );
    }
    println!("wrote {} messages into {}", copied.summary.message_count(), directory.display());
    Ok(copied)
}

/// The distribution of ROS 2 of all bags that name one; `None` if they differ.
fn ros_distro(bags: &[Reader]) -> Option<&str> {
    let named = bags.iter().filter_map(|bag| Some(bag.metadata()?.ros_distro.as_str()));
    let mut named = named.filter(|name| !name.is_empty());
    let first = named.next()?;
    named.all(|other| other == first).then_some(first)
}

/// Copies the files of modules that a bag, a directory or a file in one, has in its folder.
fn copy_versions(from: &Path, to: &Path) -> anyhow::Result<()> {
    let from = if from.is_dir() { from } else { from.parent().unwrap_or(from) };
    let (from, to) = (from.join(SOURCES_FOLDER), to.join(SOURCES_FOLDER));
    if !from.is_dir() {
        return Ok(());
    }
    let reads = || format!("cannot read {}", from.display());
    for entry in fs::read_dir(&from).with_context(reads)? {
        let entry = entry.with_context(reads)?;
        // A link may lead anywhere.
        if entry.file_type().with_context(reads)?.is_file() {
            let copy = to.join(entry.file_name());
            let writes = || format!("cannot copy {} to {}", entry.path().display(), copy.display());
            fs::create_dir_all(&to).with_context(writes)?;
            fs::copy(entry.path(), &copy).with_context(writes)?;
        }
    }
    Ok(())
}

/// The progress bar of an operation.
pub(crate) struct Progress {
    bar: ProgressBar,
    started: Instant,
    is_shown: bool,
}

/// Shorter operations show no bar.
const PATIENCE: Duration = Duration::from_secs(1);

impl Progress {
    /// Creates a bar for the operation `what` on `total` messages.
    pub(crate) fn new(what: &'static str, total: u64) -> Self {
        let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::hidden());
        let style = "{prefix} {wide_bar} {human_pos}/{human_len} messages, {per_sec}, {eta} left";
        if let Ok(style) = ProgressStyle::with_template(style) {
            bar.set_style(style);
        }
        bar.set_prefix(what);
        Self { bar, started: Instant::now(), is_shown: false }
    }

    /// Updates the number of processed messages.
    pub(crate) fn at(&mut self, messages: u64) {
        if !self.is_shown && self.started.elapsed() >= PATIENCE && std::io::stderr().is_terminal() {
            self.bar.set_draw_target(ProgressDrawTarget::stderr());
            self.is_shown = true;
        }
        self.bar.set_position(messages);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
