//! Converts the modules that a robot file exposes with their lifecycle to managed nodes.

use std::collections::BTreeSet;

use downbeat_bridge::lifecycle::LifecycleExposure;

use super::Robot;
use super::file::{LifecycleEntry, RobotFileError, suggestion};

type Result<T> = std::result::Result<T, RobotFileError>;

impl Robot {
    /// Returns the modules that are exposed as managed nodes of ROS 2, in the order of the entries and
    /// modules of the file.
    ///
    /// # Errors
    /// Returns an error with path and line if an entry matches no module of the file, or two nodes would have
    /// the same name.
    pub fn lifecycle_exposures(&self) -> Result<Vec<LifecycleExposure>> {
        let file = &self.file;
        let mut exposures = Vec::new();
        let mut taken = BTreeSet::from([file.node_name()?]);
        for entry in &file.expose.lifecycle {
            for module in self.meant(entry, &exposures)? {
                let refuse = |problem: String| file.source.error(entry.line, problem);
                let node = file.node_beside(entry.node.as_deref().unwrap_or(module), entry.line)?;
                let remapped = file.remaps.node(&node).map_err(|error| refuse(error.to_string()))?;
                if !taken.insert(remapped.clone()) {
                    return Err(refuse(format!(
                        "module \"{module}\" would be the node {remapped}, which already exists; give it another \
                         with node = \"…\""
                    )));
                }
                exposures.push(LifecycleExposure { module: module.to_owned(), node });
            }
        }
        Ok(exposures)
    }

    /// Returns the modules that match this entry and no earlier one.
    fn meant<'a>(&'a self, entry: &LifecycleEntry, before: &[LifecycleExposure]) -> Result<Vec<&'a str>> {
        let names = || self.file.modules.iter().map(|module| module.name.as_str());
        let meant: Vec<_> = names().filter(|name| entry.modules.matches(name)).collect();
        if meant.is_empty() {
            let hint = suggestion(&entry.modules.to_string(), names());
            let problem = format!("the robot has no module \"{}\"{hint}", entry.modules);
            return Err(self.file.source.error(entry.line, problem));
        }
        let is_new = |name: &&str| before.iter().all(|exposure| exposure.module != *name);
        Ok(meant.into_iter().filter(is_new).collect())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::path::Path;

    use downbeat_executor::Core;

    use super::*;
    use crate::RobotFile;
    use crate::file::Source;

    fn exposures(lifecycle: &str) -> Result<Vec<(String, String)>> {
        let text = format!(
            "[robot]\nname = \"r\"\nnamespace = \"/robot\"\n[[module]]\nkind = \"stand_nod_wave\"\nname = \"motion\"\n\
             [[module]]\nkind = \"joint_command_mux\"\nname = \"r\"\n[expose]\nlifecycle = {lifecycle}\n"
        );
        let (file, _) =
            RobotFile::parse(Source::new(Path::new("robot.toml"), text), &crate::Catalog::built_in())?;
        let exposures =
            Robot { file, core: Core::new(), latencies: Default::default() }.lifecycle_exposures()?;
        Ok(exposures.into_iter().map(|exposure| (exposure.module, exposure.node.to_string())).collect())
    }

    #[test]
    fn modules_are_separate_nodes_in_the_namespace_of_the_robot() {
        let named = exposures("[{ module = \"r\", node = \"/arm/mux\" }, \"m*\"]").unwrap();
        let expected = [("r", "/arm/mux"), ("motion", "/robot/motion")];
        assert_eq!(named, expected.map(|(module, node)| (module.to_owned(), node.to_owned())));
    }

    #[test]
    fn invalid_nodes_are_reported_with_their_line() {
        for (lifecycle, problem) in [
            ("[\"moton\"]", "the robot has no module \"moton\", did you mean \"motion\"?"),
            ("[\"r\"]", "would be the node /robot/r, which already exists"),
            ("[{ module = \"*\", node = \"x\" }]", "not for a pattern"),
        ] {
            let error = exposures(lifecycle).unwrap_err().to_string();
            assert!(error.starts_with("robot.toml:11: ") && error.contains(problem), "{error}");
        }
    }
}
