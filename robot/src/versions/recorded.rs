//! A module in a replay, in the versions with which it was recorded.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use downbeat_edge::foreign::{self, Foreign};
use downbeat_executor::Time;
use downbeat_kind::{LoadForeign, ModuleSource};

use super::joined::{Joined, Versions};
use super::version::names_of;

/// A module with recorded versions.
pub(crate) struct Recorded {
    load: Arc<LoadForeign>,
    source: ModuleSource,
    files: Vec<PathBuf>,
    versions: Arc<Versions>,
}

impl Recorded {
    pub(crate) fn new(
        load: Arc<LoadForeign>,
        source: &ModuleSource,
        files: Vec<PathBuf>,
        versions: Arc<Versions>,
    ) -> Self {
        Self { load, source: source.clone(), files, versions }
    }

    /// Why the version in force could not be made when it was recorded.
    pub(crate) fn failure(&self) -> Option<&str> {
        self.versions.versions.get(self.versions.in_force())?.failure.as_deref()
    }

    fn load_version(&self, position: usize) -> Result<Box<dyn Foreign>, String> {
        self.versions.current.store(position, Ordering::Relaxed);
        let Some(version) = self.versions.versions.get(position) else { return (self.load)(&self.source) };
        if let Some(failure) = &version.failure {
            return Err(failure.clone());
        }
        let replaced = version.replaced.clone();
        (self.load)(&ModuleSource { replaced, ..self.source.clone() })
    }
}

impl foreign::Versions for Recorded {
    fn load(&self) -> Result<Box<dyn Foreign>, String> {
        self.load_version(self.versions.in_force())
    }

    fn successor(&self, _: &mut dyn Foreign, now: Time) -> Result<Option<Box<dyn Foreign>>, String> {
        let current = self.versions.current.load(Ordering::Relaxed);
        let is_due = |version: &Joined| version.reloaded_at.is_some_and(|time| time <= now.as_nanos());
        let mut later = self.versions.versions.iter().enumerate().skip(current + 1);
        let Some((position, _)) = later.find(|(_, version)| is_due(version)) else { return Ok(None) };
        self.load_version(position).map(Some)
    }

    fn has_successors(&self) -> bool {
        self.versions.versions.iter().any(|version| version.reloaded_at.is_some())
    }

    fn next_reload(&self) -> Option<Time> {
        let current = self.versions.current.load(Ordering::Relaxed);
        let mut later = self.versions.versions.iter().skip(current + 1);
        later.find_map(|version| version.reloaded_at).map(Time::from_nanos)
    }

    fn source(&self) -> String {
        names_of(&self.files)
    }
}
