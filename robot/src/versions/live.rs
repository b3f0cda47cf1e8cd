//! A module of a running robot, in the versions that its files have.

use std::path::PathBuf;
use std::sync::Arc;

use downbeat_edge::foreign::{Foreign, Life, Made, Prepared, Versions};
use downbeat_executor::Time;
use downbeat_kind::{LoadForeign, ModuleSource};

use super::state::{LiveState, stamps};
use super::version::{Source, Version, names_of};

/// A module whose files are on disk.
pub(crate) struct Live {
    load: Arc<LoadForeign>,
    source: ModuleSource,
    files: Vec<PathBuf>,
    state: Arc<LiveState>,
}

impl Live {
    pub(super) fn new(
        load: Arc<LoadForeign>,
        source: &ModuleSource,
        files: Vec<PathBuf>,
        state: Arc<LiveState>,
    ) -> Self {
        Self { load, source: source.clone(), files, state }
    }

    /// True once the module has stopped and its files were saved since they were tried last, and have been at
    /// rest since the last call.
    pub(crate) fn was_saved_after_the_end(&self) -> bool {
        let now = stamps(&self.files);
        let mut known = self.state.0.lock();
        let is_at_rest = now == known.last;
        known.last.clone_from(&now);
        known.has_stopped && is_at_rest && now != known.tried && now.iter().all(Option::is_some)
    }

    /// Gives the next life this version.
    pub(crate) fn set_prepared(&self, prepared: Prepared) {
        self.state.0.lock().prepared = Some(prepared);
    }
}

impl Versions for Live {
    fn load(&self) -> Result<Box<dyn Foreign>, String> {
        // Before loading, so that a later change is noticed.
        self.state.0.lock().tried = stamps(&self.files);
        (self.load)(&self.source)
    }

    fn take_prepared(&self) -> Option<Prepared> {
        self.state.0.lock().prepared.take()
    }

    fn successor(&self, running: &mut dyn Foreign, _: Time) -> Result<Option<Box<dyn Foreign>>, String> {
        let before = stamps(&self.files);
        let successor = running.successor();
        if !matches!(successor, Ok(None)) {
            self.state.0.lock().tried = before;
        }
        successor
    }

    fn describe(&self, made: Made<'_>) -> Option<Vec<u8>> {
        let source = Source::read(&self.files);
        let mut known = self.state.0.lock();
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
        self.state.0.lock().has_stopped = life == Life::Stopped;
    }

    fn source(&self) -> String {
        names_of(&self.files)
    }
}
