//! What is known of a module of a running robot: its files as they are, and whether they were saved since
//! they were loaded.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use downbeat_edge::foreign::Prepared;
use parking_lot::Mutex;

use super::version::Source;

/// What is known of the files and of the module, for all lives of the module and for the thread that watches
/// the files.
#[derive(Default)]
pub(crate) struct LiveState(pub(super) Mutex<Known>);

#[derive(Default)]
pub(super) struct Known {
    /// The files as they were when the module was last loaded, or could not be loaded.
    pub(super) tried: Stamps,
    /// As they were when they were last looked at.
    pub(super) last: Stamps,
    pub(super) has_stopped: bool,
    /// Why the module could not be made when it was last made.
    pub(super) failure: Option<String>,
    pub(super) prepared: Option<Prepared>,
    /// As they were for the version that a recording knows, once the module was made.
    pub(super) described: Option<Stamps>,
    /// What they held when the module was last made: what runs, also if they were saved since.
    pub(super) made: Option<Source>,
}

/// Time of modification and size of each file, `None` for missing files.
pub(super) type Stamps = Vec<Option<(SystemTime, u64)>>;

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

pub(super) fn stamps(files: &[PathBuf]) -> Stamps {
    files.iter().map(|file| stamp(file)).collect()
}

fn stamp(file: &Path) -> Option<(SystemTime, u64)> {
    let file = std::fs::metadata(file).ok()?;
    Some((file.modified().ok()?, file.len()))
}
