//! Why an emulator could not be started.

use std::io;
use std::path::PathBuf;

/// Why the emulator could not be started.
#[derive(Debug, thiserror::Error)]
pub enum EmulatorError {
    /// No pseudo terminal is available.
    #[error("the emulator cannot open a pseudo terminal: {source}; is /dev/pts mounted?")]
    PseudoTerminal {
        /// The error of the operating system.
        source: io::Error,
    },
    /// This system has no pseudo terminals.
    #[error(
        "emulated devices behind pseudo terminals work on Linux and macOS only; here name a port in memory, such as \
         memory:robot, in the emulator and in the module that opens it"
    )]
    Unsupported,
    /// The link cannot be created.
    #[error("linking {} to the emulator's port: {source}; choose an unused path", link.display())]
    Link {
        /// The path of the link.
        link: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// An existing link was not created by an emulator.
    #[error("{} is a link to {} that was not created by an emulator; choose an unused path", link.display(), target.display())]
    OtherLink {
        /// The path of the link.
        link: PathBuf,
        /// Its target.
        target: PathBuf,
    },
    /// Another emulator uses the link.
    #[error(
        "{} links to {}, which is in use by another emulator; stop it, choose another link, or remove this one",
        link.display(),
        target.display()
    )]
    LinkInUse {
        /// The path of the link.
        link: PathBuf,
        /// The port of the other one.
        target: PathBuf,
    },
    /// The thread cannot be started.
    #[error("the emulator cannot start a thread: {source}")]
    Thread {
        /// The error of the operating system.
        source: io::Error,
    },
}
