//! Errors of a module that joins a core.

use std::fmt::{self, Display};

/// The reason why a module could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// Another module has this name.
    #[error("module \"{0}\": a module with this name exists already; give each module another name")]
    DuplicateModule(String),
    /// ROS would refuse the topic name.
    #[error(
        "module \"{module}\": \"{topic}\" is not a topic name; use words of letters, digits and _, \
         joined by /, each beginning with a letter or _"
    )]
    InvalidTopicName {
        /// The module that uses the topic.
        module: String,
        /// The name as given by the module.
        topic: String,
    },
    /// The topic exists with another message type.
    #[error(
        "module \"{module}\": topic \"{topic}\" carries {known}, not {asked}; rename the topic in one of the \
         modules, or remap it"
    )]
    TopicType {
        /// The module that was added later.
        module: String,
        /// The topic.
        topic: String,
        /// The Rust path of the requested type.
        asked: &'static str,
        /// The Rust path of the type the topic has.
        known: &'static str,
    },
    /// The module has no topic of the name that is to be remapped.
    #[error("module \"{module}\" has no topic \"{topic}\" to remap; it has {}", list(.known))]
    UnknownTopic {
        /// The module.
        module: String,
        /// The name in the remap.
        topic: String,
        /// The topics of the module, under the module's own names for them.
        known: Vec<String>,
    },
    /// A timer has a period of zero.
    #[error("module \"{0}\": a timer needs a period longer than zero")]
    ZeroPeriod(String),
    /// A module declares two settings with the same name.
    #[error("module \"{module}\" declares setting \"{setting}\" twice")]
    DuplicateSetting {
        /// The module.
        module: String,
        /// The setting.
        setting: String,
    },
    /// The module has no setting of this name.
    #[error("module \"{module}\" has no setting \"{setting}\"; it has {}", list(.known))]
    UnknownSetting {
        /// The module.
        module: String,
        /// The name that was given a value.
        setting: String,
        /// The settings of the module.
        known: Vec<String>,
    },
    /// The setting refuses the value.
    #[error("module \"{module}\", setting \"{setting}\": {refusal}")]
    SettingValue {
        /// The module.
        module: String,
        /// The setting.
        setting: String,
        /// The reason of the refusal.
        refusal: String,
    },
    /// ROS would refuse the service name.
    #[error(
        "module \"{module}\": \"{service}\" is not a service name; use words of letters, digits and _, \
         joined by /, each beginning with a letter or _"
    )]
    InvalidServiceName {
        /// The module that uses the service.
        module: String,
        /// The name as given by the module.
        service: String,
    },
    /// The service exists with other types.
    #[error(
        "module \"{module}\": service \"{service}\" is {known}, not {asked}; rename the service in one of the \
         modules, or remap it"
    )]
    ServiceType {
        /// The module that was added later.
        module: String,
        /// The service.
        service: String,
        /// The Rust paths of the requested types.
        asked: String,
        /// The Rust paths of the types the service has.
        known: String,
    },
    /// Another module serves the service.
    #[error(
        "module \"{module}\": service \"{service}\" is served by module \"{known}\" already; remap it in one of \
         them"
    )]
    DuplicateServer {
        /// The module that was added later.
        module: String,
        /// The service.
        service: String,
        /// The module that serves it.
        known: String,
    },
    /// The core does not offer the mechanism, or only another version of it.
    #[error(
        "module \"{module}\" needs the mechanism \"{mechanism}\" at version {asked}; this core offers {}",
        match .offered { Some(version) => format!("version {version}"), None => format!("only {}", .known.join(", ")) }
    )]
    Mechanism {
        /// The module.
        module: String,
        /// The mechanism.
        mechanism: String,
        /// The requested version.
        asked: Version,
        /// The version that the core offers, if any.
        offered: Option<Version>,
        /// All mechanisms of the core, with their versions.
        known: Vec<String>,
    },
    /// The module's setup panicked.
    #[error("module \"{module}\" panicked in its setup: {reason}")]
    Panicked {
        /// The module.
        module: String,
        /// The message of the panic.
        reason: String,
    },
    /// A restart policy was given to a module that cannot be constructed again.
    #[error("module \"{0}\" cannot be restarted: add it with Core::add_restartable")]
    NotRestartable(String),
    /// The core has stopped, and accepts no more modules.
    #[error("module \"{0}\": the core has stopped")]
    Stopped(String),
    /// The system refused a thread for the module.
    #[error("module \"{module}\": cannot start its thread: {reason}")]
    Thread {
        /// The module.
        module: String,
        /// The error of the system.
        reason: String,
    },
    /// The setup of the module returned an error.
    #[error("module \"{module}\": {reason}")]
    Refused {
        /// The module.
        module: String,
        /// The message of that error.
        reason: String,
    },
}

fn list(names: &[impl Display]) -> String {
    if names.is_empty() {
        return "none".into();
    }
    names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ")
}

/// The version of a mechanism. A module built for `1.2` works with `1.3`, but with neither `1.1` nor `2.0`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Version {
    /// Incremented when something is removed.
    pub major: u16,
    /// Incremented when something is added.
    pub minor: u16,
}

impl Version {
    /// Version `major.minor`.
    #[must_use]
    pub const fn new(major: u16, minor: u16) -> Self {
        Self { major, minor }
    }

    /// True if a user that requires version `asked` works with this version.
    #[must_use]
    pub const fn offers(self, asked: Self) -> bool {
        self.major == asked.major && self.minor >= asked.minor
    }
}

impl fmt::Display for Version {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.major, self.minor)
    }
}
