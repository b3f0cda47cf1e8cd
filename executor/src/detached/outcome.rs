//! What a run of a detached module brings back.

use crate::core::Answer;
use crate::inspect::Span;
use crate::job::Work;
use crate::management::Command;
use crate::messaging::AnyOutbox;
use crate::service::AnyClient;
use crate::{LifecycleState, ModuleId, SettingInfo, SettingValue, Time};

/// What a run of a detached module brings to the next sync phase.
pub(crate) struct StepOutcome {
    pub(crate) module: ModuleId,
    pub(crate) time: Time,
    pub(crate) step: u64,
    pub(crate) is_stop: bool,
    pub(crate) inputs: Vec<Input>,
    /// Requests, answers, results and commands that the run took over.
    pub(crate) taken: u32,
    pub(crate) outboxes: Vec<Box<dyn AnyOutbox>>,
    /// When and where it ran, if that was measured.
    pub(crate) span: Option<Span>,
    /// Runs that took longer than the deadline.
    pub(crate) overruns: u64,
    /// By client port.
    pub(crate) calls: Vec<(u32, Box<dyn AnyClient>)>,
    pub(crate) answers: Vec<Answer>,
    pub(crate) commands: Vec<Command>,
    pub(crate) work: Vec<Work>,
    pub(crate) state: LifecycleState,
    pub(crate) panic: Option<String>,
    /// Where settings were changed before the run.
    pub(crate) settings: Option<Box<NewSettings>>,
}

pub(crate) struct NewSettings {
    /// All, as they are now.
    pub(crate) all: Vec<SettingInfo>,
    /// What was changed, in order.
    pub(crate) changed: Vec<(String, SettingValue)>,
}

#[derive(Clone, Copy)]
pub(crate) struct Input {
    pub(crate) topic: usize,
    pub(crate) skipped: u32,
    pub(crate) received: u32,
}
