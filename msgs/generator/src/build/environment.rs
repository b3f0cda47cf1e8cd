//! The environment of a build script, from cargo and ROS 2.

use std::collections::BTreeSet;
use std::env;
use std::path::{Path, PathBuf};

use super::BuildError;

/// The folders that a build script uses.
#[derive(Clone, Debug)]
pub(super) struct Environment {
    /// The folder for generated files.
    pub out: PathBuf,
    /// The definitions in `downbeat-msgs`: a folder for each package.
    pub carried: PathBuf,
    /// The packages that it was built with.
    pub enabled: BTreeSet<String>,
    /// Install prefixes.
    pub ament_prefixes: Vec<PathBuf>,
}

impl Environment {
    /// From the environment variables of this process.
    pub fn of_build_script() -> Result<Self, BuildError> {
        let out = env::var_os("OUT_DIR").ok_or(BuildError::NoBuildScript)?;
        // Set by the build script of downbeat-msgs for crates that depend on it directly.
        let carried = env::var_os("DEP_DOWNBEAT_MSGS_INTERFACES").ok_or(BuildError::NoDependency)?;
        let enabled = env::var("DEP_DOWNBEAT_MSGS_PACKAGES").map_err(|_| BuildError::NoDependency)?;
        let prefixes = env::var_os("AMENT_PREFIX_PATH").unwrap_or_default();
        Ok(Self {
            out: out.into(),
            carried: carried.into(),
            enabled: enabled.split(',').map(str::to_owned).collect(),
            ament_prefixes: env::split_paths(&prefixes).filter(|path| !path.as_os_str().is_empty()).collect(),
        })
    }

    /// The folder of a package in `downbeat-msgs`, enabled or not.
    pub fn carried(&self, package: &str) -> Option<PathBuf> {
        Some(self.carried.join(package)).filter(|folder| has_interfaces(folder))
    }

    /// The folder of an installed package. The first prefix that contains it is used, as in ROS 2.
    pub fn installed(&self, package: &str) -> Option<PathBuf> {
        let folders = self.ament_prefixes.iter().map(|prefix| prefix.join("share").join(package));
        folders.into_iter().find(|folder| has_interfaces(folder))
    }
}

/// Returns whether the folder has the layout of a package with interfaces.
pub(super) fn has_interfaces(folder: &Path) -> bool {
    interface_folders(folder).next().is_some()
}

/// The existing folders with the interfaces of a package.
pub(super) fn interface_folders(folder: &Path) -> impl Iterator<Item = PathBuf> {
    ["msg", "srv", "action"].into_iter().map(|kind| folder.join(kind)).filter(|folder| folder.is_dir())
}
