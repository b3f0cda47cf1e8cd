//! What can be wrong with a module when it joins a core.

use std::fmt::{self, Display};

/// Why a module could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// Two modules of one name.
    #[error("module \"{0}\": there is a module of that name already; give each module a name of its own")]
    DuplicateModule(String),
    /// A topic name that ROS would refuse.
    #[error(
        "module \"{module}\": \"{topic}\" is not a topic name; use words of letters, digits and _, \
         joined by /, each beginning with a letter or _"
    )]
    InvalidTopicName {
        /// The module that asked for the topic.
        module: String,
        /// The name it gave.
        topic: String,
    },
    /// Two message types on one topic.
    #[error(
        "module \"{module}\": topic \"{topic}\" carries {known}, not {asked}; rename the topic in one of the \
         modules, or remap it"
    )]
    TopicType {
        /// The module that came second.
        module: String,
        /// The topic.
        topic: String,
        /// The Rust path of the type it asked for.
        asked: &'static str,
        /// The Rust path of the type the topic has.
        known: &'static str,
    },
    /// A remap for a topic the module does not have.
    #[error("module \"{module}\" has no topic \"{topic}\" to remap; it has {}", list(.known))]
    UnknownTopic {
        /// The module.
        module: String,
        /// The name that was to be remapped.
        topic: String,
        /// The topics of the module, by the names it gives them.
        known: Vec<String>,
    },
    /// A timer that would fire without end.
    #[error("module \"{0}\": a timer needs a period longer than zero")]
    ZeroPeriod(String),
    /// Two settings of one name in one module.
    #[error("module \"{module}\" declares setting \"{setting}\" twice")]
    DuplicateSetting {
        /// The module.
        module: String,
        /// The setting.
        setting: String,
    },
    /// A value for a setting that the module does not have.
    #[error("module \"{module}\" has no setting \"{setting}\"; it has {}", list(.known))]
    UnknownSetting {
        /// The module.
        module: String,
        /// The name that was given a value.
        setting: String,
        /// The settings of the module.
        known: Vec<String>,
    },
    /// A value that a setting refuses.
    #[error("module \"{module}\", setting \"{setting}\": {refusal}")]
    SettingValue {
        /// The module.
        module: String,
        /// The setting.
        setting: String,
        /// What is wrong with the value.
        refusal: String,
    },
    /// A service name that ROS would refuse.
    #[error(
        "module \"{module}\": \"{service}\" is not a service name; use words of letters, digits and _, \
         joined by /, each beginning with a letter or _"
    )]
    InvalidServiceName {
        /// The module that asked for the service.
        module: String,
        /// The name it gave.
        service: String,
    },
    /// One service with two types.
    #[error(
        "module \"{module}\": service \"{service}\" is {known}, not {asked}; rename the service in one of the \
         modules, or remap it"
    )]
    ServiceType {
        /// The module that came second.
        module: String,
        /// The service.
        service: String,
        /// The Rust paths of the types it asked for.
        asked: String,
        /// The Rust paths of the types the service has.
        known: String,
    },
    /// Two servers for one service.
    #[error(
        "module \"{module}\": service \"{service}\" is served by module \"{known}\" already; remap it in one of \
         them"
    )]
    DuplicateServer {
        /// The module that came second.
        module: String,
        /// The service.
        service: String,
        /// The module that serves it.
        known: String,
    },
    /// A mechanism that the core does not offer.
    #[error(
        "module \"{module}\" needs the mechanism \"{mechanism}\" at version {asked}; this core offers {}",
        match .offered { Some(version) => format!("version {version}"), None => format!("only {}", .known.join(", ")) }
    )]
    Mechanism {
        /// The module.
        module: String,
        /// The mechanism.
        mechanism: String,
        /// The version it asked for.
        asked: Version,
        /// The version there is, if any.
        offered: Option<Version>,
        /// All mechanisms there are, with their versions.
        known: Vec<String>,
    },
    /// The module's setup panicked.
    #[error("module \"{module}\" panicked in its setup: {reason}")]
    Panicked {
        /// The module.
        module: String,
        /// What the panic said.
        reason: String,
    },
    /// A restart policy for a module that cannot be made again.
    #[error("module \"{0}\" cannot be restarted: add it with Core::add_restartable")]
    NotRestartable(String),
    /// A module that no longer can be added.
    #[error("module \"{0}\": the core has stopped")]
    Stopped(String),
    /// The system gave the module no thread.
    #[error("module \"{module}\": cannot start its thread: {reason}")]
    Thread {
        /// The module.
        module: String,
        /// What the system said.
        reason: String,
    },
    /// A reason of the module's own.
    #[error("module \"{module}\": {reason}")]
    Refused {
        /// The module.
        module: String,
        /// What it said.
        reason: String,
    },
}

fn list(names: &[impl Display]) -> String {
    if names.is_empty() {
        return "none".into();
    }
    names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ")
}

/// The version of a mechanism: what is built for `1.2` works with `1.3`, not with `1.1` nor `2.0`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Version {
    /// Changes when something is taken away.
    pub major: u16,
    /// Changes when something is added.
    pub minor: u16,
}

impl Version {
    /// Version `major.minor`.
    #[must_use]
    pub const fn new(major: u16, minor: u16) -> Self {
        Self { major, minor }
    }

    /// True if what asks for version `asked` can work with this one.
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
