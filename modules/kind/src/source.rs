//! What a robot file says about a module in another language.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use downbeat_edge::foreign::Foreign;
use downbeat_executor::SettingValue;

/// What a robot file says about a module in another language.
#[derive(Clone, Debug, Default)]
pub struct ModuleSource {
    /// The name of the module.
    pub module: String,
    /// The folder of the robot file, which relative paths begin at.
    pub folder: PathBuf,
    /// The keys of the kind, such as `module` or `path`.
    pub keys: BTreeMap<String, SettingValue>,
    /// How long one run of the module may take.
    pub deadline: Option<Duration>,
    /// The folders of interfaces that the robot file names.
    pub interfaces: Vec<PathBuf>,
    /// Of an earlier version in a replay: the file that holds what a file held.
    pub replaced: BTreeMap<PathBuf, PathBuf>,
}

impl ModuleSource {
    /// A module of this name, whose relative paths begin at this folder.
    #[must_use]
    pub fn new(module: impl Into<String>, folder: impl Into<PathBuf>) -> Self {
        Self { module: module.into(), folder: folder.into(), ..Self::default() }
    }

    /// The file to read for this file of the module: itself or, in a replay of an earlier version, another
    /// one with the content that it had.
    #[must_use]
    pub fn file_to_read(&self, file: &Path) -> PathBuf {
        self.replaced.get(file).map_or_else(|| file.to_owned(), Clone::clone)
    }

    /// The value of a key that is true or false.
    ///
    /// # Errors
    /// If the value is neither.
    pub fn is_set(&self, key: &str, default: bool) -> Result<bool, String> {
        match self.keys.get(key) {
            None => Ok(default),
            Some(SettingValue::Bool(value)) => Ok(*value),
            Some(other) => Err(format!("`{key}` is true or false, not {other}")),
        }
    }

    /// True if the robot file says that the module is reloaded.
    #[must_use]
    pub fn is_reloaded(&self) -> bool {
        self.keys.get("reload") == Some(&SettingValue::Bool(true))
    }
}

/// Loads the module that a robot file names.
pub type LoadForeign = dyn Fn(&ModuleSource) -> Result<Box<dyn Foreign>, String> + Send + Sync;
