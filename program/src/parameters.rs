//! Options that set settings of modules.

#[cfg(feature = "football")]
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::Args;

use downbeat_robot::{Catalog, RobotFile, RobotFileError, RosArgs};

/// Values of settings that override the robot file.
#[derive(Args)]
pub(crate) struct ParameterArguments {
    /// Take settings from this ROS 2 parameter file; they override the robot file. May be given more than
    /// once: later ones take precedence.
    #[arg(long = "params-file", value_name = "FILE.yaml")]
    files: Vec<PathBuf>,
    /// Set a module's setting to this value, in YAML; it overrides all files. May be given more than once.
    #[arg(short = 'p', long = "param", value_name = "MODULE.SETTING:=VALUE")]
    values: Vec<String>,
}

impl ParameterArguments {
    /// As arguments for another process.
    #[cfg(feature = "football")]
    pub(crate) fn to_arguments(&self) -> Vec<OsString> {
        let files =
            self.files.iter().flat_map(|file| ["--params-file".into(), file.clone().into_os_string()]);
        let values = self.values.iter().flat_map(|value| ["--param".into(), value.clone().into()]);
        files.chain(values).collect()
    }

    pub(crate) fn read_robot(
        &self,
        path: &Path,
        catalog: &Catalog,
        ros: &RosArgs,
    ) -> Result<RobotFile, RobotFileError> {
        ros.warn_about_what_is_ignored();
        let mut file = RobotFile::read_with(path, catalog, ros)?;
        self.files.iter().try_for_each(|path| file.set_from_parameter_file(path))?;
        self.values.iter().try_for_each(|value| file.set_from_argument(value))?;
        Ok(file)
    }
}
