//! A version of a module: what its files held when it was made.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

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

    pub(super) fn keep_in(&self, bag: &Path) {
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
    pub(super) fn kept_name(&self) -> String {
        let name = Path::new(&self.path).file_name().unwrap_or_default().to_string_lossy();
        format!("{}-{name}", self.sha256)
    }
}

pub(super) fn read(path: &Path) -> std::io::Result<Vec<u8>> {
    downbeat_msgs::user_file::read_within(path, LARGEST)
}

pub(super) fn hash(content: &[u8]) -> String {
    hex(Sha256::digest(content).as_slice())
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// What one module was made from.
#[derive(Clone, Debug)]
pub(super) struct Source {
    pub(super) version: Version,
    pub(super) joint_hash: String,
}

impl Source {
    pub(super) fn read(files: &[PathBuf]) -> Self {
        Self { version: Version::read(files), joint_hash: joint_hash(files) }
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

/// The names of files, for the log.
pub(super) fn names_of(files: &[PathBuf]) -> String {
    let names = files.iter().filter_map(|file| Some(file.file_name()?.to_string_lossy().into_owned()));
    let names = names.collect::<Vec<_>>().join(", ");
    if names.is_empty() { "the source".to_owned() } else { names }
}
