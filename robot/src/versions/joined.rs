//! The versions of a module in a replay, and which of them is in force.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicUsize, Ordering};

/// The time that a replay has reached, in nanoseconds of the robot's time: it decides which versions are in
/// force.
#[derive(Clone, Debug)]
pub(crate) struct ReplayedTime(Arc<AtomicI64>);

impl Default for ReplayedTime {
    fn default() -> Self {
        Self(Arc::new(AtomicI64::new(i64::MIN)))
    }
}

impl ReplayedTime {
    /// Goes on, or back to the start.
    pub(crate) fn set(&self, time: i64) {
        self.0.store(time, Ordering::Relaxed);
    }

    /// Before the start.
    pub(crate) fn reset(&self) {
        self.set(i64::MIN);
    }

    /// After the end: the last version of each module that could be made is in force.
    pub(crate) fn finish(&self) {
        self.set(i64::MAX);
    }

    fn get(&self) -> i64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// The versions of one module.
#[derive(Debug)]
pub(crate) struct Versions {
    /// In the order in which they joined; the first is that of the start.
    pub(super) versions: Vec<Joined>,
    pub(super) reached: ReplayedTime,
    /// The position of that which runs.
    pub(super) current: AtomicUsize,
}

impl Versions {
    /// The position of the version that is in force.
    pub(super) fn in_force(&self) -> usize {
        let reached = self.reached.get();
        let is_it =
            |version: &Joined| version.from <= reached && !(reached == i64::MAX && version.failure.is_some());
        self.versions.iter().rposition(is_it).unwrap_or(0)
    }

    /// Whether there are others than that of the start.
    pub(crate) fn are_several(&self) -> bool {
        self.versions.len() > 1
    }
}

/// A version, and from when on it is in force.
#[derive(Debug)]
pub(super) struct Joined {
    pub(super) from: i64,
    pub(super) reloaded_at: Option<i64>,
    pub(super) failure: Option<String>,
    /// The file with the content of each file of the module that has another content now.
    pub(super) replaced: BTreeMap<PathBuf, PathBuf>,
}
