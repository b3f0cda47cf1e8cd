//! `downbeat bag import`

use std::path::PathBuf;

use clap::Args;

use super::output::{OutputArguments, Progress};
use downbeat_bags::Storage;
use downbeat_robot::dataset::Dataset;

#[derive(Args)]
pub(crate) struct ImportArguments {
    /// The folder of a data set of LeRobot (v3.0), with `meta` and `data`.
    pub(crate) dataset: PathBuf,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
    /// The time of the first frame, in seconds since the epoch.
    #[arg(long, default_value_t = 1.0)]
    pub(crate) start: f64,
}

pub(crate) fn import(arguments: &ImportArguments) -> anyhow::Result<()> {
    let ImportArguments { dataset: folder, output: OutputArguments { output, layout }, start } = arguments;
    // Stamps of messages have 31 bits of seconds.
    if !(0.0..2e9).contains(start) {
        anyhow::bail!("--start {start}: a time from 0 to 2e9 s can be written");
    }
    let unfinished = layout.unfinished(output, [folder.as_path()])?;
    let dataset = Dataset::open(folder)?;
    let mut writer = layout.writer(Storage::default())?.create(unfinished.written())?;
    let mut progress = Progress::new("writing", dataset.frames());
    let imported = dataset.write_into(&mut writer, (start * 1e9) as i64, |frames| progress.at(frames))?;
    drop(progress);
    writer.finish()?;
    unfinished.finish()?;
    for (feature, why) in &imported.left_out {
        tracing::warn!("{feature} is left out: {why}");
    }
    if imported.missing > 0 {
        tracing::warn!(
            "{} values of frames are not in the data set, such as pictures in files beside it",
            imported.missing
        );
    }
    let (episodes, frames) = (imported.episodes, imported.frames);
    println!("wrote {episodes} episodes with {frames} frames into {}", output.display());
    Ok(())
}
