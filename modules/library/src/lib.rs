//! Modules of robots as shared libraries in C, C++ and Rust.
//!
//! [`load`] loads a library behind the C interface of `include/downbeat.h` and returns its module as a
//! [`Foreign`], which joins a core as a module like any other. With [`LibraryOptions::is_isolated`] the
//! library is loaded by a child process, so that its crash ends the module only; [`child`] is the main
//! function of that process. [`messages`] writes C and C++ structs of ROS 2 interfaces.
//!
//! A library is never unloaded: threads and thread-local values of it may outlive its module. With
//! [`LibraryOptions::is_reloaded`], each version is loaded from a copy of its own, so that writing the file
//! does not disturb those that run; a version stays in memory until the program ends.

mod call;
mod instance;
#[cfg_attr(not(unix), path = "isolated/elsewhere.rs")]
mod isolated;
mod kinds;
mod library;
pub mod messages;
mod module;
pub mod parent;
mod variables;
mod watch;

pub use isolated::{child, set_child_command};
pub use kinds::kinds;
pub use library::LibraryError;

use downbeat_edge::foreign::Foreign;
use std::path::PathBuf;
use std::time::Duration;

/// The header of the interface.
pub const HEADER: &str = include_str!("../include/downbeat.h");
/// The same for C++: classes on top of it.
pub const HEADER_CPP: &str = include_str!("../include/downbeat.hpp");

/// Which library, and how it runs.
#[derive(Clone, Debug)]
pub struct LibraryOptions {
    /// The name of the module in the robot.
    pub module: String,
    /// The file.
    pub path: PathBuf,
    /// Whether a changed file takes over from the loaded one.
    pub is_reloaded: bool,
    /// Whether the library runs in a child process.
    pub is_isolated: bool,
    /// How long a callback may take in a child process before the child is killed.
    pub time_limit: Duration,
}

impl LibraryOptions {
    /// The default of [`Self::time_limit`]: far above what a callback inside the cycle may take, so that a
    /// busy machine kills no child.
    pub const TIME_LIMIT: Duration = Duration::from_secs(2);
}

impl Default for LibraryOptions {
    fn default() -> Self {
        Self {
            module: String::new(),
            path: PathBuf::new(),
            is_reloaded: false,
            is_isolated: false,
            time_limit: Self::TIME_LIMIT,
        }
    }
}

/// Loads a library and creates its module.
///
/// # Errors
/// The sentence of a [`LibraryError`], what the module gave as the reason, or why there is no child process.
pub fn load(options: &LibraryOptions) -> Result<Box<dyn Foreign>, String> {
    match options.is_isolated {
        false => Ok(Box::new(module::LibraryModule::load(options)?)),
        true => isolated::start(options),
    }
}
