//! The directories of runs that share a name.

use std::path::{Path, PathBuf};

/// Returns the directory if there is nothing of its name yet, else the first of `DIR_2`, `DIR_3`, … of which
/// that is true: each run has a bag of its own.
#[must_use]
pub fn unused_directory(directory: &Path) -> PathBuf {
    let is_unused = |path: &Path| path.symlink_metadata().is_err();
    let numbered = (2_u64..).map(|run| {
        let mut name = directory.file_name().unwrap_or_default().to_owned();
        name.push(format!("_{run}"));
        directory.with_file_name(name)
    });
    let mut candidates = std::iter::once(directory.to_owned()).chain(numbered);
    candidates.find(|path| is_unused(path)).unwrap_or_else(|| directory.to_owned())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn each_run_has_a_directory_of_its_own() {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("morning.run");
        let name = |path: PathBuf| path.file_name().unwrap().to_str().unwrap().to_owned();
        assert_eq!(name(unused_directory(&bag)), "morning.run");
        std::fs::create_dir(&bag).unwrap();
        assert_eq!(name(unused_directory(&bag)), "morning.run_2");
        std::fs::write(folder.path().join("morning.run_2"), "").unwrap();
        assert_eq!(name(unused_directory(&bag)), "morning.run_3");
    }
}
