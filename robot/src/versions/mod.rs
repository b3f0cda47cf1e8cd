//! The versions of modules in other languages: what their files held when they were made.
//!
//! A bag holds those with which it begins in its custom data, and each later one in an event of the cycle in
//! which it joined. Files of text are in them; others, such as shared libraries, are copied into the bag's
//! folder where their module is reloaded, and found by their hash. The custom data also lists the later ones,
//! whose files are all copied: a recording may be paused while a module is reloaded, and a part of a bag may
//! begin after it.

mod live;
mod log;
mod recorded;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use downbeat_bags::metadata::Metadata;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::RobotFile;
pub(crate) use live::{Live, LiveState};
pub(crate) use log::VersionLog;
pub use recorded::LastVersion;
pub(crate) use recorded::{Recorded, ReplayedTime, Versions, VersionsInBag, reloads_of};

/// What a module was made from.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Version {
    pub(crate) files: Vec<SourceFile>,
    /// If it replaced a running version: when that noticed it, in nanoseconds of the robot's time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) reloaded_at: Option<i64>,
    /// Why it could not be made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) failure: Option<String>,
}

/// A file as it was when a module was made.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct SourceFile {
    pub(crate) path: String,
    pub(crate) sha256: String,
    /// When it was written, in nanoseconds since the epoch; 0 if not known.
    pub(crate) modified: i64,
    /// The content of a file of text, unless it is long.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) text: Option<String>,
}

/// The longest file whose content a bag holds, in bytes.
const LONGEST_TEXT: usize = 256 << 10;

/// The largest file that is read, in bytes.
const LARGEST: u64 = 1 << 30;

/// The folder in a bag with copies of files.
pub const FOLDER: &str = "module_sources";

impl Version {
    /// Reads the files as they are now. A file that cannot be read counts as empty: loading the module
    /// reports it.
    pub(crate) fn read(files: &[PathBuf]) -> Self {
        let files = files.iter().map(|path| SourceFile::read(path));
        Self { files: files.collect(), ..Self::default() }
    }

    pub(crate) fn has_same_files(&self, other: &Self) -> bool {
        self.files.iter().map(|file| &file.sha256).eq(other.files.iter().map(|file| &file.sha256))
    }

    /// Copies all files into the folder of a bag, unless they have changed meanwhile.
    pub(crate) fn keep_in(&self, bag: &Path) {
        self.files.iter().for_each(|file| file.keep_in(bag));
    }
}

impl SourceFile {
    fn read(path: &Path) -> Self {
        let modified = std::fs::metadata(path).and_then(|file| file.modified());
        let since_epoch = modified.ok().and_then(|time| time.duration_since(SystemTime::UNIX_EPOCH).ok());
        let modified = since_epoch.and_then(|time| i64::try_from(time.as_nanos()).ok()).unwrap_or(0);
        let content = read(path).unwrap_or_default();
        let sha256 = hash(&content);
        let text = String::from_utf8(content).ok().filter(|text| text.len() <= LONGEST_TEXT);
        Self { path: path.display().to_string(), sha256, modified, text }
    }

    fn keep_in(&self, bag: &Path) {
        let content = self.text.as_ref().map(|text| text.clone().into_bytes());
        let content = content.or_else(|| read(Path::new(&self.path)).ok());
        let content = content.filter(|content| hash(content) == self.sha256);
        let kept = content.ok_or_else(|| "it has changed meanwhile".to_owned()).and_then(|content| {
            let folder = bag.join(FOLDER);
            let written = std::fs::create_dir_all(&folder)
                .and_then(|()| std::fs::write(folder.join(self.kept_name()), content));
            written.map_err(|error| error.to_string())
        });
        if let Err(problem) = kept {
            tracing::warn!(
                "{} with the SHA-256 {} is not kept for a replay: {problem}",
                self.path,
                self.sha256
            );
        }
    }

    /// The name of the copy in a bag.
    fn kept_name(&self) -> String {
        let name = Path::new(&self.path).file_name().unwrap_or_default().to_string_lossy();
        format!("{}-{name}", self.sha256)
    }
}

fn read(path: &Path) -> std::io::Result<Vec<u8>> {
    downbeat_msgs::user_file::read_within(path, LARGEST)
}

fn hash(content: &[u8]) -> String {
    hex(Sha256::digest(content).as_slice())
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// What the modules of a robot in other languages were made from, by the names of the modules.
#[derive(Debug, Default)]
pub(crate) struct Sources(BTreeMap<String, (Source, Keeping)>);

/// What one module was made from.
#[derive(Clone, Debug)]
struct Source {
    version: Version,
    joint_hash: String,
}

impl Source {
    fn read(files: &[PathBuf]) -> Self {
        Self { version: Version::read(files), joint_hash: joint_hash(files) }
    }
}

/// Whether the files of a module that are no text are copied into a bag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Keeping {
    Copies,
    Hashes,
}

/// The modules of a robot in other languages, which know what they were made from.
#[derive(Debug, Default)]
pub(crate) struct SourcedModules(Vec<SourcedModule>);

#[derive(Debug)]
struct SourcedModule {
    name: String,
    files: Vec<PathBuf>,
    live: Arc<LiveState>,
    keeping: Keeping,
}

impl SourcedModules {
    pub(crate) fn of(file: &RobotFile) -> Self {
        let modules = file.modules.iter().map(|module| SourcedModule {
            name: module.name.clone(),
            files: module.kind.source_files(&module.source),
            live: Arc::clone(&module.source.live),
            keeping: if module.reloads() { Keeping::Copies } else { Keeping::Hashes },
        });
        Self(modules.filter(|module| !module.files.is_empty()).collect())
    }

    /// What the modules were last made from: what runs. Of a module that was never made, what its files hold
    /// now.
    pub(crate) fn sources(&self) -> Sources {
        let source = |module: &SourcedModule| {
            let made = module.live.made().unwrap_or_else(|| Source::read(&module.files));
            (module.name.clone(), (made, module.keeping))
        };
        Sources(self.0.iter().map(source).collect())
    }
}

impl Sources {
    /// The key of a bag's custom data that holds one hash for each module, as JSON.
    const HASHES: &'static str = "module_sources";
    /// The key of the versions.
    const VERSIONS: &'static str = "module_versions";

    /// The sources of a robot, see [`SourcedModules::sources`].
    pub(crate) fn of(file: &RobotFile) -> Self {
        SourcedModules::of(file).sources()
    }

    /// The entries of a bag's custom data.
    pub(crate) fn entries(&self) -> Vec<(&'static str, String)> {
        if self.0.is_empty() {
            return Vec::new();
        }
        let hashes: BTreeMap<&String, &String> =
            self.0.iter().map(|(module, (source, _))| (module, &source.joint_hash)).collect();
        let versions: BTreeMap<&String, &Version> =
            self.0.iter().map(|(module, (source, _))| (module, &source.version)).collect();
        vec![
            (Self::HASHES, serde_json::json!(hashes).to_string()),
            (Self::VERSIONS, serde_json::json!(versions).to_string()),
        ]
    }

    /// True without modules in other languages.
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Copies the libraries of modules that are reloaded into a bag.
    pub(crate) fn keep_in(&self, bag: &Path) {
        let copied = self.0.values().filter(|(_, keeping)| *keeping == Keeping::Copies);
        let files = copied.flat_map(|(source, _)| &source.version.files);
        files.filter(|file| file.text.is_none()).for_each(|file| file.keep_in(bag));
    }

    /// The versions with which the modules started when a bag was recorded.
    pub(crate) fn in_bag(recorded: &Metadata) -> BTreeMap<String, Version> {
        let text = recorded.custom_data.get(Self::VERSIONS);
        text.and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default()
    }

    /// The modules whose sources are not as they were when the bag was recorded. `last` holds the last
    /// versions in the bag, where it has versions.
    pub(crate) fn changed_since(&self, recorded: &Metadata, last: &BTreeMap<String, Version>) -> Vec<String> {
        let hashes = recorded.custom_data.get(Self::HASHES);
        let hashes: BTreeMap<String, String> =
            hashes.and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default();
        let has_changed = |module: &String, source: &Source| match last.get(module) {
            Some(last) => !last.has_same_files(&source.version),
            None => hashes.get(module).is_some_and(|old| *old != source.joint_hash),
        };
        let changed = self.0.iter().filter(|(module, (source, _))| has_changed(module, source));
        changed.map(|(module, _)| module.clone()).collect()
    }
}

/// One hash for the content of all files.
fn joint_hash(files: &[PathBuf]) -> String {
    let mut joint = Sha256::new();
    for file in files {
        let content = downbeat_msgs::user_file::read(file).unwrap_or_default();
        joint.update((content.len() as u64).to_le_bytes());
        joint.update(content);
    }
    hex(joint.finalize().as_slice())
}
