//! The robot file on the disk, and the file beside it with the places of modules.

use serde_json::{Map, Value, json};
use std::ffi::OsString;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use downbeat_msgs::user_file;

/// Longer files are no robot files.
const LONGEST_FILE: u64 = 4 << 20;

/// The version of the file with the places.
const LAYOUT_VERSION: u64 = 1;

/// Where a robot file is.
pub(super) struct Place {
    path: PathBuf,
}

/// A file as it was read or written; without text if there was none.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Saved(Option<String>);

impl Saved {
    pub(super) fn text(&self) -> Option<&str> {
        self.0.as_deref()
    }
}

impl Place {
    /// The place that a path names, behind links.
    pub(super) fn new(path: &Path) -> io::Result<Self> {
        match path.canonicalize() {
            Ok(path) => Ok(Self { path }),
            Err(error) if error.kind() == ErrorKind::NotFound => {
                let name = path.file_name().ok_or_else(|| io::Error::other("this is no name of a file"))?;
                let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
                Ok(Self { path: folder.unwrap_or(Path::new(".")).canonicalize()?.join(name) })
            }
            Err(error) => Err(error),
        }
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn read(&self) -> io::Result<Saved> {
        match fs::metadata(&self.path) {
            Ok(metadata) if metadata.len() > LONGEST_FILE => {
                return Err(io::Error::other(format!("it has more than {LONGEST_FILE} bytes")));
            }
            Ok(_) => {}
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Saved(None)),
            Err(error) => return Err(error),
        }
        user_file::read_text(&self.path).map(|text| Saved(Some(text)))
    }

    /// Writes the whole file or nothing.
    pub(super) fn write(&self, text: &str) -> io::Result<Saved> {
        user_file::replace(&self.path, text)?;
        Ok(Saved(Some(text.to_owned())))
    }

    /// The places of modules; none if the file is missing or damaged.
    pub(super) fn read_layout(&self) -> Map<String, Value> {
        let text = user_file::read_text(self.layout()).ok();
        let layout: Option<Value> = text.and_then(|text| serde_json::from_str(&text).ok());
        let layout = layout.filter(|layout| layout["version"] == LAYOUT_VERSION);
        let mut modules =
            layout.and_then(|layout| layout["modules"].as_object().cloned()).unwrap_or_default();
        modules.retain(|_, place| ["x", "y"].iter().all(|key| place[key].is_number()));
        modules
    }

    /// Writes the places of modules; without any, there is no file.
    pub(super) fn write_layout(&self, modules: &Map<String, Value>) -> io::Result<()> {
        if modules.is_empty() {
            return match fs::remove_file(self.layout()) {
                Err(error) if error.kind() != ErrorKind::NotFound => Err(error),
                _ => Ok(()),
            };
        }
        let layout = json!({ "version": LAYOUT_VERSION, "modules": modules });
        user_file::replace(self.layout(), &format!("{layout:#}\n"))
    }

    /// Writes files beside the robot file, except those that exist.
    ///
    /// # Errors
    /// In words for the user, if a file cannot be written.
    pub(super) fn add_files(&self, files: &[(&str, &str)]) -> Result<(), String> {
        for (name, text) in files {
            let path = self.path.with_file_name(name);
            let written = match path.exists() {
                true => Ok(()),
                false => user_file::replace(&path, text),
            };
            written.map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        }
        Ok(())
    }

    /// A folder for a new bag beside the robot file.
    pub(super) fn new_bag(&self, time: &str) -> PathBuf {
        let stem = self.path.file_stem().map(|stem| stem.to_string_lossy()).unwrap_or_default();
        let names = std::iter::once(format!("{stem}_{time}"))
            .chain((2..).map(|number| format!("{stem}_{time}_{number}")));
        let mut paths = names.map(|name| self.path.with_file_name(name));
        paths.find(|path| !path.exists()).unwrap_or_default()
    }

    /// The words for a failure.
    pub(super) fn failed(&self, what: &str, error: &io::Error) -> String {
        format!("cannot {what} {}: {error}", self.path.display())
    }

    fn layout(&self) -> PathBuf {
        let mut name = OsString::from(self.path.file_name().unwrap_or_default());
        name.push(".layout.json");
        self.path.with_file_name(name)
    }
}
