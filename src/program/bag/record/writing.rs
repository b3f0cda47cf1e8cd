//! Converts the command line and a robot file's `[record]` to the options of a recording.

use std::time::Duration;

use crate::bags::{
    RecordingOptions, SnapshotLimits, StorageOptions, StoragePreset, SyncPolicy, WhenDiskFull, WhenSlow,
    WriterOptions,
};
use crate::robot::RecordEntry;
use anyhow::bail;

use super::arguments::{OnTrouble, SyncWhen, WritingArguments};

/// The cache of rosbag2 (each of its two buffers): 100 MiB.
pub(super) const DEFAULT_CACHE_BYTES: usize = 100 * 1024 * 1024;

/// Overrides the entry with the command line.
pub(super) fn apply(arguments: &WritingArguments, entry: &mut RecordEntry) -> anyhow::Result<()> {
    let storage = arguments.storage.unwrap_or(entry.storage.storage());
    if let Some(preset) = &arguments.storage_preset_profile {
        entry.storage = StorageOptions::preset(storage, preset)?;
    } else if storage != entry.storage.storage() {
        entry.storage = StorageOptions::of(storage)?;
    }
    if arguments.zstd {
        let (mcap, fast) = (entry.storage.mcap_mut()?, StoragePreset::ZstdFast.options());
        (mcap.compression, mcap.level) = (fast.compression, fast.level);
    }
    if let Some(path) = &arguments.storage_config_file {
        entry.storage = entry.storage.clone().with_config_file(path)?;
    }
    if let Some(bytes) = arguments.max_bag_size {
        entry.split.max_bytes = (bytes > 0).then_some(bytes);
    }
    if let Some(seconds) = arguments.max_bag_duration {
        entry.split.max_duration = (seconds > 0).then_some(Duration::from_secs(seconds));
    }
    entry.max_bag_files = arguments.max_bag_files.or(entry.max_bag_files);
    entry.cache_bytes = arguments.max_cache_size.unwrap_or(entry.cache_bytes);
    entry.encoding = arguments.encoding.unwrap_or(entry.encoding);
    if let Some(reason) = entry.refusal() {
        bail!(reason);
    }
    match arguments.when_slow {
        Some(OnTrouble::Drop) => entry.slow_disk = WhenSlow::Drop,
        Some(OnTrouble::Stop) => entry.slow_disk = WhenSlow::Stop,
        None => {}
    }
    match arguments.when_disk_full {
        Some(OnTrouble::Drop) => entry.disk_full = WhenDiskFull::Drop,
        Some(OnTrouble::Stop) => entry.disk_full = WhenDiskFull::Stop,
        None => {}
    }
    match arguments.sync {
        Some(SyncWhen::Never) => entry.sync = SyncPolicy::Never,
        Some(SyncWhen::Files) => entry.sync = SyncPolicy::Files,
        Some(SyncWhen::Chunks) => entry.sync = SyncPolicy::Chunks,
        None => {}
    }
    if arguments.snapshot_mode && entry.cache_bytes == 0 {
        bail!("Max cache size must be greater than 0 when snapshot mode is enabled");
    }
    Ok(())
}

/// The options of the writer.
pub(super) fn writer_options(arguments: &WritingArguments, entry: &RecordEntry) -> WriterOptions {
    let options = arguments
        .custom_data
        .iter()
        .fold(entry.writer_options(), |options, (key, value)| options.custom_data(key, value));
    match arguments.flush_interval {
        Some(interval) => options.flush_interval(interval),
        None => options,
    }
}

/// The options of the recording thread.
pub(super) fn recording_options(
    arguments: &WritingArguments,
    entry: &RecordEntry,
    start_paused: bool,
) -> RecordingOptions {
    let mut options = entry.recording_options();
    if arguments.snapshot_mode {
        let max_duration = arguments.snapshot_duration.or(entry.snapshot);
        options = options.snapshot(SnapshotLimits { max_bytes: entry.cache_bytes, max_duration });
    }
    if start_paused { options.start_paused() } else { options }
}
