//! The files below a folder.

use std::path::{Path, PathBuf};

use anyhow::Context;

pub(crate) struct File {
    /// Within the folder.
    pub(crate) path: PathBuf,
    /// In bytes.
    pub(crate) size: u64,
}

/// All files below a folder, links among them, in the order of their paths.
pub(crate) fn below(folder: &Path) -> anyhow::Result<Vec<File>> {
    let (mut found, mut waiting) = (Vec::new(), vec![folder.to_owned()]);
    while let Some(inner) = waiting.pop() {
        for entry in std::fs::read_dir(&inner).with_context(|| inner.display().to_string())? {
            let entry = entry?;
            let metadata = entry.metadata()?;
            match metadata.is_dir() {
                true => waiting.push(entry.path()),
                false => found
                    .push(File { path: entry.path().strip_prefix(folder)?.to_owned(), size: metadata.len() }),
            }
        }
    }
    found.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(found)
}

/// Their sum in bytes.
pub(crate) fn size(files: &[File]) -> u64 {
    files.iter().map(|file| file.size).sum()
}
