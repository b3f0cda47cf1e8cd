//! What can be wrong with a module when it joins a core.

use std::fmt::Display;

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
    /// A reason of the module's own.
    #[error("module \"{module}\": {reason}")]
    Refused {
        /// The module.
        module: String,
        /// What it said.
        reason: String,
    },
    /// The core has begun to run.
    #[error("module \"{0}\": modules are added before the core starts")]
    AlreadyRunning(String),
}

fn list(names: &[impl Display]) -> String {
    if names.is_empty() {
        return "none".into();
    }
    names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>().join(", ")
}
