//! The versions that were made during a recording, for the custom data of its bag.

use std::path::Path;
use std::sync::Arc;

use downbeat_bags::WriterOptions;
use downbeat_bags::metadata::Metadata;
use downbeat_executor::{ModuleEvent, ModuleEventKind};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

use super::version::{SourceFile, Version};

/// The key of a bag's custom data that holds them, as JSON.
const KEY: &str = "module_versions_made";

/// The versions that were made so far; clones share them.
///
/// A bag has them as events too, but for those that were made while its recording was paused, or before a
/// part of it.
#[derive(Clone, Default)]
pub(crate) struct VersionLog(Arc<Mutex<Vec<MadeVersion>>>);

/// A version that was made while the robot ran. Texts are in the folder of the bag, not here.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct MadeVersion {
    module: String,
    /// The time from which on it was in force, in nanoseconds of the robot's time.
    from: i64,
    version: Version,
}

impl VersionLog {
    /// Makes a bag list the versions.
    pub(crate) fn note_in(&self, writer: WriterOptions) -> WriterOptions {
        let made = Arc::clone(&self.0);
        // Strings and numbers have a place in JSON.
        writer.counted_data(KEY, move || serde_json::to_string(&*made.lock()).unwrap_or_default())
    }

    /// Takes in an event of the core, and copies the files of a new version into the bag.
    pub(crate) fn take(&self, event: &ModuleEvent, bag: &Path) {
        if let ModuleEventKind::Made { module, description } = &event.kind
            && let Ok(mut version) = serde_json::from_slice::<Version>(description)
        {
            version.keep_in(bag);
            version.files.iter_mut().for_each(|SourceFile { text, .. }| *text = None);
            let from = version.reloaded_at.unwrap_or(event.time.as_nanos());
            self.0.lock().push(MadeVersion { module: module.to_string(), from, version });
        }
    }
}

/// The versions of one module that a bag lists, each with the time from which on it was in force.
pub(super) fn logged_of(module: &str, made: &[MadeVersion]) -> impl Iterator<Item = (i64, Version)> {
    let of_module = made.iter().filter(move |made| made.module == module);
    of_module.map(|made| (made.from, made.version.clone()))
}

/// The versions that a bag lists.
pub(super) fn logged_in(bag: &Metadata) -> Vec<MadeVersion> {
    let text = bag.custom_data.get(KEY);
    text.and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default()
}
