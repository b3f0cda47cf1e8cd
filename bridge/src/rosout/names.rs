//! Which logger a line is of.

use super::{LogLine, logger_name};
use crate::ros::NodeName;
use parking_lot::RwLock;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The names of the loggers of a program: that of its node, those of modules below it, and those of modules
/// that have a node of their own. Clones share them.
///
/// ```
/// use downbeat_bridge::ros::NodeName;
/// use downbeat_bridge::rosout::LoggerNames;
///
/// let names = LoggerNames::new("downbeat"); // While there is no node.
/// names.set_node(&NodeName::new("/robot", "nao")?);
/// names.set_module("camera", &NodeName::new("/robot", "front_camera")?);
/// assert_eq!(names.of_module(Some("walker")), "robot.nao.walker");
/// assert_eq!(names.of_module(Some("camera")), "robot.front_camera");
/// assert_eq!(names.of_module(None), "robot.nao");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct LoggerNames {
    names: Arc<RwLock<Names>>,
}

#[derive(Debug)]
struct Names {
    node: String,
    of_modules: BTreeMap<String, String>,
}

impl LoggerNames {
    /// All lines are of the logger `program`, or below it.
    #[must_use]
    pub fn new(program: &str) -> Self {
        let names = Names { node: program.to_owned(), of_modules: BTreeMap::new() };
        Self { names: Arc::new(RwLock::new(names)) }
    }

    /// Lines are from now on those of a node.
    pub fn set_node(&self, node: &NodeName) {
        self.names.write().node = logger_name(node);
    }

    /// Assigns the lines of a module to its own node.
    pub fn set_module(&self, module: &str, node: &NodeName) {
        let mut names = self.names.write();
        names.of_modules.insert(module.to_owned(), logger_name(node));
    }

    /// The logger of a module, or that of the node.
    #[must_use]
    pub fn of_module(&self, module: Option<&str>) -> String {
        let names = self.names.read();
        match module {
            None => names.node.clone(),
            Some(module) => {
                names.of_modules.get(module).cloned().unwrap_or_else(|| format!("{}.{module}", names.node))
            }
        }
    }

    /// The logger of a line.
    #[must_use]
    pub fn of(&self, line: &LogLine) -> String {
        self.of_module(line.module.as_deref())
    }
}
