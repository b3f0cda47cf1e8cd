//! Notices that the file of a library has changed.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Watches a file by its time of modification and its size.
#[derive(Debug)]
pub(crate) struct Watch {
    path: PathBuf,
    /// As it was when the file was last loaded, or could not be loaded.
    tried: Option<Stamp>,
    /// As it was when last looked at.
    last: Option<Stamp>,
}

type Stamp = (SystemTime, u64);

impl Watch {
    /// Starts with the file as it is.
    pub(crate) fn new(path: &Path) -> Self {
        let stamp = stamp(path);
        Self { path: path.to_owned(), tried: stamp, last: stamp }
    }

    /// Whether the file has changed and stays as it is, since a linker writes a file in several steps. True
    /// once for each change.
    pub(crate) fn has_changed(&mut self) -> bool {
        let now = stamp(&self.path);
        let is_at_rest = now == self.last;
        self.last = now;
        let has_changed = is_at_rest && now.is_some() && now != self.tried;
        if has_changed {
            self.tried = now;
        }
        has_changed
    }
}

fn stamp(path: &Path) -> Option<Stamp> {
    let file = std::fs::metadata(path).ok()?;
    Some((file.modified().ok()?, file.len()))
}
