//! Why the directory of robots, or a name in it, cannot be had.

use std::io;
use std::path::PathBuf;

/// Error while opening the directory for sockets.
#[derive(Debug, thiserror::Error)]
pub enum DirectoryError {
    /// The directory cannot be created or read.
    #[error("cannot use {} for the sockets of running robots: {source}", path.display())]
    Io {
        /// The path of the directory.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// Other users could create sockets in the directory or connect to them.
    #[error(
        "{} is not private: it belongs to user {owner} and has mode {mode:03o}; remove it, or make it yours with \
         mode 700",
        path.display()
    )]
    NotPrivate {
        /// The path of the directory.
        path: PathBuf,
        /// The id of the user that owns it.
        owner: u32,
        /// The permission bits.
        mode: u32,
    },
    /// This system has no Unix sockets.
    #[error(
        "commands that look into a running robot (top, trace, view, expose) work on Linux and macOS only; here look at the \
         robot's page (`downbeat run ROBOT --view`) or at its topics"
    )]
    Unsupported,
}

/// Error while a robot claims a node name.
#[derive(Debug, thiserror::Error)]
pub enum ClaimError {
    /// Another robot has the name.
    #[error(
        "{holder} runs on this machine as {node} in domain {domain} already, and two nodes of one name disturb each other; \
         stop that one, or give this one another name (--ros-args -r __node:=NAME), namespace (ROS_NAMESPACE) or domain"
    )]
    Taken {
        /// The name.
        node: String,
        /// The domain.
        domain: u16,
        /// Name and process id of the robot that has the name.
        holder: String,
    },
    /// The directory with the locks cannot be used.
    #[error(transparent)]
    Directory(#[from] DirectoryError),
}
