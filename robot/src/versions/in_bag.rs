//! The versions that a bag holds, each with the cycle in which it joined.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

use downbeat_bags::Reader;
use downbeat_executor::Time;
use downbeat_msgs::downbeat_interfaces::msg::ModuleEvent;
use downbeat_msgs::printable;
use tempfile::TempDir;

use super::joined::{Joined, ReplayedTime, Versions};
use super::log::{logged_in, logged_of};
use super::sources::Sources;
use super::version::{FOLDER, SourceFile, Version, hash, names_of, read};
use crate::RobotFile;

/// The versions of a module that were made while the robot ran, each with the time from which on it was in
/// force.
fn made_of(module: &str, events: &[ModuleEvent]) -> impl Iterator<Item = (i64, Version)> {
    let made = events.iter().filter(move |event| event.kind == ModuleEvent::MADE && event.module == module);
    made.filter_map(|event| {
        let version: Version = serde_json::from_slice(&event.data).ok()?;
        Some((version.reloaded_at.unwrap_or(event.stamp.as_nanos()), version))
    })
}

/// The times of the runs in which a module replaced itself by a newer version.
pub(crate) fn reloads_of(module: &str, events: &[ModuleEvent]) -> Vec<i64> {
    made_of(module, events).filter_map(|(_, version)| version.reloaded_at).collect()
}

/// The versions in their order, each with the time from which on it was in force: that with which the bag
/// begins, and those that were made during it. `later` may name one twice; the first is taken, which is
/// complete.
fn in_force(
    start: Option<Version>,
    later: impl Iterator<Item = (i64, Version)>,
    begin: Option<i64>,
) -> Vec<(i64, Version)> {
    let mut later: Vec<_> = later.collect();
    later.sort_by_key(|(from, _)| *from);
    later.dedup_by(|(from, version), (other_from, other)| {
        from == other_from && version.has_same_files(other) && version.failure == other.failure
    });
    let mut recorded: Vec<_> = start.into_iter().map(|version| (i64::MIN, version)).chain(later).collect();
    // The recording was paused until then, or this is a part of a bag.
    let is_before = |(from, _): &(i64, Version)| begin.is_some_and(|begin| *from < begin);
    if let Some(first) = recorded.iter().rposition(is_before) {
        recorded.drain(..first);
        if let Some((from, version)) = recorded.first_mut() {
            (*from, version.reloaded_at) = (i64::MIN, None);
        }
    }
    recorded
}

/// What a replay says about the versions of modules.
#[derive(Debug, Default)]
pub(crate) struct VersionsInBag {
    /// The last version of each module.
    pub(crate) last: BTreeMap<String, Version>,
    /// Sentences about modules of several versions, and about files that are missing.
    pub(crate) notes: Vec<String>,
    /// The time that the modules go by.
    pub(crate) reached: ReplayedTime,
    /// The files whose content was in the bag.
    folder: Option<TempDir>,
}

/// Which version of a module is the last one in a replay.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LastVersion {
    /// The file as it is now: for a test of a change.
    #[default]
    AsItIs,
    /// The recorded one.
    AsRecorded,
}

impl VersionsInBag {
    /// Has the modules of a robot file run in the versions in which they were recorded.
    pub(crate) fn use_in(
        file: &mut RobotFile,
        reader: &Reader,
        events: &[ModuleEvent],
        last: LastVersion,
    ) -> Self {
        let mut starts = reader.metadata().map(Sources::in_bag).unwrap_or_default();
        let logged = reader.metadata().map(logged_in).unwrap_or_default();
        let mut in_bag = Self::default();
        let places = Places::of(reader);
        for module in &mut file.modules {
            let files = module.kind.source_files(&module.source);
            if !module.kind.is_foreign() {
                continue;
            }
            if !module.source.replaced.is_empty() {
                // Another version was asked for.
                let joined = Joined {
                    from: i64::MIN,
                    reloaded_at: None,
                    failure: None,
                    replaced: module.source.replaced.clone(),
                };
                let reached = in_bag.reached.clone();
                let versions = Versions { versions: vec![joined], reached, current: AtomicUsize::new(0) };
                module.versions.recorded = Some(Arc::new(versions));
                continue;
            }
            let start = starts.remove(&module.name);
            let later = made_of(&module.name, events).chain(logged_of(&module.name, &logged));
            let recorded = in_force(start, later, reader.start_time());
            let mut joined = Vec::new();
            for (position, (from, version)) in recorded.iter().enumerate() {
                let is_last = position + 1 == recorded.len();
                let mut replaced = BTreeMap::new();
                if !(is_last && last == LastVersion::AsItIs) {
                    for (path, source) in files.iter().zip(&version.files) {
                        if let Some(found) = in_bag.find(&module.name, path, source, &places) {
                            replaced.insert(path.clone(), found);
                        }
                    }
                }
                let (reloaded_at, failure) = (version.reloaded_at, version.failure.clone());
                joined.push(Joined { from: *from, reloaded_at, failure, replaced });
            }
            in_bag.note_versions(&module.name, &files, &recorded);
            if let Some((_, version)) = recorded.into_iter().next_back() {
                in_bag.last.insert(module.name.clone(), version);
            }
            let versions =
                Versions { versions: joined, reached: in_bag.reached.clone(), current: AtomicUsize::new(0) };
            module.versions.recorded = Some(Arc::new(versions));
        }
        in_bag
    }

    fn note_versions(&mut self, module: &str, files: &[PathBuf], recorded: &[(i64, Version)]) {
        let later = recorded.iter().skip(1).filter(|(_, version)| version.failure.is_none());
        let hashes =
            later.filter_map(|(_, version)| Some(version.files.first()?.sha256.get(..12)?.to_owned()));
        let hashes: Vec<String> = hashes.collect();
        if !hashes.is_empty() {
            let (count, hashes) = (hashes.len(), hashes.join(", "));
            let times = if count == 1 { "once".to_owned() } else { format!("{count} times") };
            self.notes.push(format!(
                "{} of {module} was saved and taken {times} during the recording: {}",
                names_of(files),
                printable(&hashes)
            ));
        }
    }

    /// The file that holds what `path` held; `None` if that is what it holds now, or the content is lost,
    /// which is noted.
    fn find(&mut self, module: &str, path: &Path, source: &SourceFile, places: &Places) -> Option<PathBuf> {
        if has_hash(path, &source.sha256) {
            return None;
        }
        if let Some(text) = source.text.as_ref().filter(|text| hash(text.as_bytes()) == source.sha256) {
            match self.write(path, &source.sha256, text) {
                Ok(written) => return Some(written),
                Err(error) => self.notes.push(format!("no version of {module} can be written: {error}")),
            }
        }
        let found = places.candidates(path, source).into_iter().find(|file| has_hash(file, &source.sha256));
        if found.is_none() {
            let time = Time::from_nanos(source.modified);
            self.notes.push(format!(
                "a version of {module} is missing: {} of {time}, with the SHA-256 {}; the file as it is now takes its place. \
                 If you have that file, put it into {} under any name and replay again",
                printable(&source.path),
                printable(&source.sha256),
                places.folder.display()
            ));
        }
        found
    }

    fn write(&mut self, path: &Path, sha256: &str, text: &str) -> std::io::Result<PathBuf> {
        let folder = match &mut self.folder {
            Some(folder) => folder,
            none => none.insert(TempDir::with_prefix("downbeat-replay-")?),
        };
        // A folder for each version, so that the name of the file stays.
        let folder = folder.path().join(sha256);
        std::fs::create_dir_all(&folder)?;
        let written = folder.join(path.file_name().unwrap_or_default());
        std::fs::write(&written, text)?;
        Ok(written)
    }
}

/// Where files of earlier versions may be.
struct Places {
    /// The folder in the bag.
    folder: PathBuf,
    /// The folder with the bag.
    beside: PathBuf,
}

impl Places {
    fn of(reader: &Reader) -> Self {
        let path = reader.path();
        let bag = if path.is_dir() { path } else { path.parent().unwrap_or(path) };
        let beside = std::path::absolute(bag).ok().and_then(|bag| bag.parent().map(Path::to_owned));
        Self { folder: bag.join(FOLDER), beside: beside.unwrap_or_else(|| bag.to_owned()) }
    }

    /// The files that may be the one: the copy in the bag, all others in its folder, and those beside the bag
    /// and beside the file that have the beginning of its name.
    fn candidates(&self, path: &Path, source: &SourceFile) -> Vec<PathBuf> {
        let mut candidates = vec![self.folder.join(source.kept_name())];
        candidates.extend(files_in(&self.folder));
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let has_stem =
            |file: &PathBuf| file.file_name().is_some_and(|name| name.to_string_lossy().starts_with(&*stem));
        let folders = [Some(self.beside.as_path()), path.parent()];
        candidates.extend(folders.into_iter().flatten().flat_map(files_in).filter(has_stem));
        candidates
    }
}

fn files_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> = entries.filter(|path| path.is_file()).collect();
    files.sort();
    files
}

fn has_hash(path: &Path, sha256: &str) -> bool {
    read(path).is_ok_and(|content| hash(&content) == sha256)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn version(sha256: &str, text: Option<&str>) -> Version {
        let (path, text) = ("m.py".to_owned(), text.map(str::to_owned));
        let file = SourceFile { path, sha256: sha256.to_owned(), modified: 0, text };
        Version { files: vec![file], reloaded_at: Some(0), failure: None }
    }

    #[test]
    fn a_bag_begins_with_the_version_that_was_made_last_before_it() {
        let in_event = version("c", Some("text"));
        // The second was made while the recording was paused: only the log has it.
        let later = || vec![(30, in_event.clone()), (10, version("b", None)), (30, version("c", None))];
        let of = |begin| in_force(Some(version("a", Some("old"))), later().into_iter(), begin);
        let hashes = |recorded: &[(i64, Version)]| -> Vec<(i64, String)> {
            recorded.iter().map(|(from, version)| (*from, version.files[0].sha256.clone())).collect()
        };
        let whole = of(Some(5));
        assert_eq!(hashes(&whole), [(i64::MIN, "a".into()), (10, "b".into()), (30, "c".into())]);
        assert_eq!(whole[2].1, in_event, "the one with its text");
        let part = of(Some(20));
        assert_eq!(hashes(&part), [(i64::MIN, "b".into()), (30, "c".into())]);
        assert_eq!(part[0].1.reloaded_at, None);
        assert_eq!(hashes(&of(Some(31))), [(i64::MIN, "c".into())]);
        assert_eq!(of(None).len(), 3);
    }
}
