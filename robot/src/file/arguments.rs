//! Arguments of ROS 2 that change a robot file: `--ros-args`.

use downbeat_bridge::ros::{NodeName, ParameterRule};

use super::{RobotFile, RobotFileError};
use crate::ros_args::{ParameterArgument, RosArgs};

impl RobotFile {
    /// Applies arguments for names. Must be called before anything that depends on the name of the node.
    pub(crate) fn apply_names(&mut self, arguments: &RosArgs) {
        if let (Some(namespace), false) = (&arguments.namespace, self.has_namespace) {
            self.namespace.clone_from(namespace);
        }
        self.remaps = arguments.remaps.iter().chain(self.remaps.rules()).cloned().collect();
        self.is_rosout_disabled = arguments.log.is_rosout_disabled;
    }

    /// Applies values of parameters. A value for another node changes nothing and is reported with a warning.
    pub(crate) fn apply_parameters(&mut self, arguments: &RosArgs) -> Result<(), RobotFileError> {
        for argument in &arguments.parameters {
            match argument {
                ParameterArgument::File(path) => self.set_from_parameter_file(path)?,
                ParameterArgument::Value(rule) => {
                    let node = self.node_name()?;
                    let is_meant = |name: &String| NodeName::new("/", name).is_ok_and(|meant| meant == node);
                    let ParameterRule { name, value, .. } = rule;
                    if rule.node.as_ref().is_none_or(is_meant) {
                        self.set_from_argument(&format!("{name}:={value}"))?;
                    } else {
                        let meant = rule.node.as_deref().unwrap_or_default();
                        tracing::warn!(
                            "-p {meant}:{name}:={value} is for the node /{meant}; this one is {node}"
                        );
                    }
                }
            }
        }
        Ok(())
    }
}
