//! What a core can be asked for by modules and by other threads.

use std::sync::Arc;

use crate::core::World;
use crate::management::{Candidate, Source};
use crate::receipt::ReceiptSender;
use crate::{
    LifecycleState, Module, ModuleOptions, SettingValue, SetupError, Stage, Transition, TransitionRefused,
};

/// There is no such module.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no module \"{module}\"; there is {known}")]
pub struct UnknownModule {
    /// The name that was given.
    pub module: Arc<str>,
    /// The names there are.
    pub known: String,
}

/// Why a setting keeps its value.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SettingRefused {
    /// There is no such module.
    #[error(transparent)]
    UnknownModule(#[from] UnknownModule),
    /// The setting or its module refuses the value.
    #[error("module \"{module}\", setting \"{setting}\": {reason}")]
    Refused {
        /// The module.
        module: String,
        /// The setting.
        setting: String,
        /// What is wrong with the value.
        reason: String,
    },
}

type Receipt<T> = Option<ReceiptSender<T>>;

pub(crate) type Look = Box<dyn FnOnce(&mut Stage, &mut World) + Send>;

/// Takes effect in the next sync phase.
pub(crate) enum Command {
    Add {
        candidate: Box<Candidate>,
        receipt: Receipt<Result<(), SetupError>>,
    },
    Remove {
        module: String,
        receipt: Receipt<Result<(), UnknownModule>>,
    },
    Pause {
        module: String,
        receipt: Receipt<Result<(), UnknownModule>>,
    },
    Resume {
        module: String,
        receipt: Receipt<Result<(), UnknownModule>>,
    },
    Step {
        module: String,
        receipt: Receipt<Result<(), UnknownModule>>,
    },
    Transition {
        module: String,
        transition: Transition,
        receipt: Receipt<Result<LifecycleState, TransitionRefused>>,
    },
    Set {
        module: String,
        setting: String,
        value: SettingValue,
        receipt: Receipt<Result<(), SettingRefused>>,
    },
    Transfer {
        from: String,
        to: String,
        receipt: Receipt<Result<(), SettingRefused>>,
    },
    /// Looks at the core between two cycles.
    Look(Look),
}

impl Command {
    /// The module that it makes something of, unless that is to join or to leave.
    pub(crate) fn target(&self) -> Option<&str> {
        match self {
            Self::Pause { module, .. }
            | Self::Resume { module, .. }
            | Self::Step { module, .. }
            | Self::Transition { module, .. }
            | Self::Set { module, .. }
            | Self::Transfer { to: module, .. } => Some(module),
            Self::Add { .. } | Self::Remove { .. } | Self::Look(_) => None,
        }
    }
}

impl Command {
    pub(crate) fn add<M: Module>(name: &str, module: M, options: ModuleOptions) -> Self {
        let candidate = Candidate { name: name.to_owned(), source: Source::once(module), options };
        Self::Add { candidate: Box::new(candidate), receipt: None }
    }
}
