//! A robot from its robot file: modules in a core, ready to run.

mod build;
mod file;
mod kinds;

pub use build::Robot;
pub use file::{Direction, ExposeEntry, LauncherChoice, ModuleEntry, RecordEntry, RobotFile, RobotFileError};
pub use kinds::{KINDS, Kind};
