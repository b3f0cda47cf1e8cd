//! A disk that is small enough to be filled.

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use tempfile::TempDir;

use crate::skips::skipped;

/// An in-memory file system, unmounted when dropped.
#[derive(Debug)]
pub struct SmallDisk {
    /// Where it is mounted.
    pub path: PathBuf,
    _folder: TempDir,
}

impl SmallDisk {
    /// Mounts a disk of that many KiB. Returns `None` and reports a skipped test if that is not permitted.
    #[track_caller]
    pub fn mount(kibibytes: u32) -> Option<Self> {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("disk");
        fs::create_dir(&path).expect("a folder in a temporary one");
        let mut mount = Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", &format!("size={kibibytes}k"), "downbeat_test"]).arg(&path);
        if !mount.stderr(Stdio::null()).status().is_ok_and(|status| status.success()) {
            skipped("only root can mount a small disk");
            return None;
        }
        Some(Self { path, _folder: folder })
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.path).status();
    }
}
