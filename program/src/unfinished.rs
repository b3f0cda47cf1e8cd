//! Output that has its name only when it is whole.
//!
//! It is written beside its place, under a name with [`ENDING`], and moved there at the end. An error and a
//! signal remove what is unfinished; what a killed process leaves is known by its name.

use std::ffi::OsString;
use std::fs;
use std::io;
use std::mem;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use anyhow::{Context, bail};
use parking_lot::Mutex;

use super::new_output::{Force, Output};
use super::stop;

/// The end of the name of what is unfinished.
const ENDING: &str = ".unfinished";

/// What is unfinished in this process. The thread that ends the process keeps the lock, so that nothing is
/// written or finished after it.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// A directory or file that is being written. Removed when dropped.
pub(crate) struct Unfinished {
    /// Its place.
    path: PathBuf,
    /// Where it is written.
    written: PathBuf,
    /// What is removed: a folder, or the written file.
    temporary: PathBuf,
    /// How existing output is replaced.
    replaces: (Force, Output),
}

impl Unfinished {
    /// Makes the folder for a directory. The directory itself, [`written`](Self::written), does not exist
    /// yet; its name is already right, as bags name their files after it. Existing output is replaced at the
    /// end; `inputs` never are.
    pub(crate) fn directory<'a>(
        path: &Path,
        (force, output): (Force, Output),
        inputs: impl IntoIterator<Item = &'a Path>,
    ) -> anyhow::Result<Self> {
        force.check_with(output, path, inputs)?;
        let (temporary, name) = beside(path)?;
        let written = temporary.join(&name);
        if temporary.exists() {
            let is_left =
                |entry: io::Result<fs::DirEntry>| entry.is_ok_and(|entry| entry.file_name() == name);
            let is_ours = fs::read_dir(&temporary).is_ok_and(|mut entries| entries.all(is_left));
            if !force.force || !is_ours {
                bail!(
                    "{} exists already: another command is writing it, or was killed; remove it{}",
                    temporary.display(),
                    if is_ours { ", or replace it with --force" } else { "" }
                );
            }
            fs::remove_dir_all(&temporary)
                .with_context(|| format!("cannot replace {}", temporary.display()))?;
        }
        let unfinished = Self { path: path.to_owned(), written, temporary, replaces: (force, output) };
        UNFINISHED.lock().push(unfinished.temporary.clone());
        fs::create_dir(&unfinished.temporary)
            .with_context(|| format!("cannot create the directory {}", unfinished.temporary.display()))?;
        Ok(unfinished)
    }

    /// Where it is written.
    pub(crate) fn written(&self) -> &Path {
        &self.written
    }

    /// Moves it to its place.
    pub(crate) fn finish(mut self) -> anyhow::Result<()> {
        let mut unfinished = UNFINISHED.lock();
        let (force, output) = self.replaces;
        force.make_way(output, &self.path, [])?;
        let failed = || format!("cannot move {} to {}", self.written.display(), self.path.display());
        fs::rename(&self.written, &self.path).with_context(failed)?;
        if self.temporary != self.written {
            // What it contained has been moved.
            let _ = fs::remove_dir(&self.temporary);
        }
        let temporary = mem::take(&mut self.temporary);
        unfinished.retain(|path| *path != temporary);
        drop(unfinished);
        Ok(())
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        let temporary = mem::take(&mut self.temporary);
        if temporary.as_os_str().is_empty() {
            return;
        }
        let mut unfinished = UNFINISHED.lock();
        remove(&temporary);
        unfinished.retain(|path| *path != temporary);
    }
}

/// Writes a file as a whole. What is not a file, such as a pipe, is written directly.
pub(crate) fn write_file(path: &Path, contents: impl AsRef<[u8]>) -> anyhow::Result<()> {
    let is_other = fs::metadata(path).is_ok_and(|metadata| !metadata.is_file());
    if is_other {
        return fs::write(path, contents).with_context(|| format!("cannot write {}", path.display()));
    }
    // A link stays one.
    let path = &fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let (temporary, _) = beside(path)?;
    let replaces = (Force { force: true }, Output::File);
    let unfinished = Unfinished { path: path.to_owned(), written: temporary.clone(), temporary, replaces };
    UNFINISHED.lock().push(unfinished.temporary.clone());
    fs::write(unfinished.written(), contents).with_context(|| format!("cannot write {}", path.display()))?;
    unfinished.finish()
}

/// The place for what is unfinished, and the name of the output.
fn beside(path: &Path) -> anyhow::Result<(PathBuf, OsString)> {
    let name =
        path.file_name().with_context(|| format!("{} does not name a file or directory", path.display()))?;
    let mut temporary = name.to_owned();
    temporary.push(ENDING);
    Ok((path.with_file_name(temporary), name.to_owned()))
}

fn remove(path: &Path) {
    // Another thread may be writing into it.
    for _ in 0..10 {
        let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
        if removed.is_ok() || !path.exists() {
            return;
        }
        thread::sleep(Duration::from_millis(5));
    }
}

/// Ends the process at the first signal that asks for it, without what is unfinished: for commands that run
/// until they are done.
pub(crate) fn end_on_signals() -> anyhow::Result<()> {
    let end = |signal: i32| {
        let unfinished = UNFINISHED.lock();
        unfinished.iter().for_each(|path| remove(path));
        stop::end_now(128 + signal)
    };
    stop::on_signals(end).context("cannot handle signals")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn output_has_its_name_when_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bag");
        let names = || {
            let names = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name());
            let mut names: Vec<_> = names.map(|name| name.into_string().unwrap()).collect();
            names.sort();
            names
        };
        let begin = |force| Unfinished::directory(&path, (Force { force }, Output::Bag), []);
        let unfinished = begin(false).unwrap();
        fs::create_dir(unfinished.written()).unwrap();
        fs::write(unfinished.written().join("x"), "").unwrap();
        assert_eq!(names(), ["bag.unfinished"]);
        let refused = begin(false).err().unwrap().to_string();
        assert!(
            refused.contains("bag.unfinished exists already") && refused.contains("--force"),
            "{refused}"
        );
        drop(unfinished);
        assert!(names().is_empty());

        // As a killed process leaves it.
        fs::create_dir_all(folder.path().join("bag.unfinished/bag")).unwrap();
        let unfinished = begin(true).unwrap();
        fs::create_dir(unfinished.written()).unwrap();
        unfinished.finish().unwrap();
        assert_eq!(names(), ["bag"]);
        assert!(begin(false).is_err());
        fs::write(path.join("bag_0.mcap"), "").unwrap();
        drop(begin(true).unwrap());
        assert!(path.join("bag_0.mcap").exists(), "it stays until it is replaced");
        let unfinished = begin(true).unwrap();
        fs::create_dir(unfinished.written()).unwrap();
        unfinished.finish().unwrap();
        assert!(!path.join("bag_0.mcap").exists());

        fs::create_dir(folder.path().join("bag.unfinished")).unwrap();
        fs::write(folder.path().join("bag.unfinished/thesis.tex"), "").unwrap();
        assert!(begin(true).is_err());
        assert_eq!(names(), ["bag", "bag.unfinished"]);
    }

    #[test]
    fn files_are_replaced_as_a_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trace.json");
        for text in ["long text", "short"] {
            write_file(&path, text).unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), text);
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        let error = write_file(&folder.path().join("no/such/folder.json"), "").unwrap_err().to_string();
        assert!(error.contains("folder.json"), "{error}");
        write_file(Path::new("/dev/null"), "x").unwrap();
    }
}
