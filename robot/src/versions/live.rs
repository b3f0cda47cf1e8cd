//! The versions of a module of a running robot: its files as they are, and whether they were saved since they
//! were loaded.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use downbeat_edge::foreign::{Foreign, Life, Made, Prepared, Versions};
use downbeat_executor::Time;
use parking_lot::Mutex;

use super::{Source, Version};
use crate::kind::{LoadForeign, ModuleSource};

/// A module whose files are on disk.
pub(crate) struct Live {
    load: Arc<LoadForeign>,
    source: ModuleSource,
    files: Vec<PathBuf>,
}

/// What is known of the files and of the module, for all lives of the module and for the thread that watches
/// the files.
#[derive(Default)]
pub(crate) struct LiveState(Mutex<Known>);

#[derive(Default)]
struct Known {
    /// The files as they were when the module was last loaded, or could not be loaded.
    tried: Stamps,
    /// As they were when they were last looked at.
    last: Stamps,
    has_stopped: bool,
    /// Why the module could not be made when it was last made.
    failure: Option<String>,
    prepared: Option<Prepared>,
    /// As they were for the version that a recording knows, once the module was made.
    described: Option<Stamps>,
    /// What they held when the module was last made: what runs, also if they were saved since.
    made: Option<Source>,
}

/// Time of modification and size of each file, `None` for missing files.
type Stamps = Vec<Option<(SystemTime, u64)>>;

impl Live {
    pub(crate) fn new(load: Arc<LoadForeign>, source: &ModuleSource, files: Vec<PathBuf>) -> Self {
        Self { load, source: source.clone(), files }
    }

    /// True once the module has stopped and its files were saved since they were tried last, and have been at
    /// rest since the last call.
    pub(crate) fn was_saved_after_the_end(&self) -> bool {
        let now = stamps(&self.files);
        let mut known = self.source.live.0.lock();
        let is_at_rest = now == known.last;
        known.last.clone_from(&now);
        known.has_stopped && is_at_rest && now != known.tried && now.iter().all(Option::is_some)
    }

    /// Gives the next life this version.
    pub(crate) fn set_prepared(&self, prepared: Prepared) {
        self.source.live.0.lock().prepared = Some(prepared);
    }
}

impl LiveState {
    /// Why the module could not be made when it was last made.
    pub(crate) fn failure(&self) -> Option<String> {
        self.0.lock().failure.clone()
    }

    /// What the module was last made from; `None` if it never was.
    pub(super) fn made(&self) -> Option<Source> {
        self.0.lock().made.clone()
    }
}

impl std::fmt::Debug for LiveState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LiveState").finish_non_exhaustive()
    }
}

impl Versions for Live {
    fn load(&self) -> Result<Box<dyn Foreign>, String> {
        // Before loading, so that a later change is noticed.
        self.source.live.0.lock().tried = stamps(&self.files);
        (self.load)(&self.source)
    }

    fn take_prepared(&self) -> Option<Prepared> {
        self.source.live.0.lock().prepared.take()
    }

    fn successor(&self, running: &mut dyn Foreign, _: Time) -> Result<Option<Box<dyn Foreign>>, String> {
        let before = stamps(&self.files);
        let successor = running.successor();
        if !matches!(successor, Ok(None)) {
            self.source.live.0.lock().tried = before;
        }
        successor
    }

    fn describe(&self, made: Made<'_>) -> Option<Vec<u8>> {
        let source = Source::read(&self.files);
        let mut known = self.source.live.0.lock();
        let had_failed = known.failure.is_some();
        let (failure, reloaded_at) = match made {
            Made::Anew(failure) => (failure.map(str::to_owned), None),
            Made::Reloaded(time) => (None, Some(time.as_nanos())),
        };
        known.failure.clone_from(&failure);
        let tried = known.tried.clone();
        // What the module starts with is in the custom data of a bag.
        let is_known = known.described.as_ref().is_none_or(|described| *described == tried);
        known.described = Some(tried);
        let version = Version { reloaded_at, failure: failure.clone(), ..source.version.clone() };
        known.made = Some(Source { version: Version { failure, ..source.version }, ..source });
        drop(known);
        if reloaded_at.is_none() && version.failure.is_none() && is_known && !had_failed {
            return None;
        }
        serde_json::to_vec(&version).ok()
    }

    fn note(&self, life: Life) {
        self.source.live.0.lock().has_stopped = life == Life::Stopped;
    }

    fn source(&self) -> String {
        names_of(&self.files)
    }
}

/// The names of files, for the log.
pub(super) fn names_of(files: &[PathBuf]) -> String {
    let names = files.iter().filter_map(|file| Some(file.file_name()?.to_string_lossy().into_owned()));
    let names = names.collect::<Vec<_>>().join(", ");
    if names.is_empty() { "the source".to_owned() } else { names }
}

fn stamps(files: &[PathBuf]) -> Stamps {
    files.iter().map(|file| stamp(file)).collect()
}

fn stamp(file: &Path) -> Option<(SystemTime, u64)> {
    let file = std::fs::metadata(file).ok()?;
    Some((file.modified().ok()?, file.len()))
}
