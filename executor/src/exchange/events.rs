//! What takes effect in a cycle besides messages and settings, published for those who repeat a run.

use std::sync::Arc;

use crate::topics::Report;
use crate::{CallError, ModuleId, SyncPhase, Time, Transition};

/// Something besides messages and settings that took effect, as published on [`ModuleEvent::TOPIC`] when somebody subscribes to
/// it: with it a replay makes it take effect again in the same cycle.
#[derive(Clone, Debug, PartialEq)]
pub struct ModuleEvent {
    /// The time of the cycle in whose sync phase it took effect.
    pub time: Time,
    /// The number of that cycle.
    pub cycle: u64,
    /// What it was.
    pub kind: ModuleEventKind,
}

/// What took effect.
#[derive(Clone, Debug, PartialEq)]
pub enum ModuleEventKind {
    /// A request went to its server.
    Request {
        /// The service.
        service: Arc<str>,
        /// Who called.
        origin: CallOrigin,
        /// The request; `None` unless the service has an encoder, see [`Core::encode_service`](crate::Core::encode_service).
        body: Option<Vec<u8>>,
    },
    /// An answer went to its client. Calls that time out follow from the clock alone, and are not reported.
    Answer {
        /// The service.
        service: Arc<str>,
        /// The call that it ends.
        origin: CallOrigin,
        /// The answer; `None` unless the service has an encoder.
        result: Result<Option<Vec<u8>>, CallError>,
    },
    /// A module was asked to make a transition, or held, or removed, or started again.
    Command {
        /// The module.
        module: Arc<str>,
        /// What it was asked for.
        command: ModuleCommand,
        /// The module that asked; `None` for another thread.
        by: Option<Arc<str>>,
    },
    /// The result of a job went to its module.
    JobResult {
        /// The module.
        module: Arc<str>,
        /// The position of the job among those that the module declared.
        job: u32,
        /// Counts what the module asked of that job, from 0.
        number: u64,
    },
    /// A module was made while the core ran, from what its setup [described](crate::Setup::made_from). Its setup may have failed.
    Made {
        /// The module.
        module: Arc<str>,
        /// What it was made from, in a form of its own.
        description: Vec<u8>,
    },
    /// A run of a detached module took over the next `count` of the events that concern the module: requests to it, answers,
    /// commands and results.
    Taken {
        /// The module.
        module: Arc<str>,
        /// The number of the run.
        step: u64,
        /// How many.
        count: u32,
    },
}

/// Who made a call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CallOrigin {
    /// The module; `None` for a [`Caller`](crate::Caller).
    pub client: Option<Arc<str>>,
    /// The position of the client among those that the module declared; 0 for a caller.
    pub port: u32,
    /// Counts the calls of that client, or of all callers, from 0.
    pub number: u64,
}

/// What a module can be asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModuleCommand {
    /// To make this transition.
    Transition(Transition),
    /// To be held.
    Pause,
    /// To go on.
    Resume,
    /// To run once.
    Step,
    /// To be made again after it stopped.
    Restart,
    /// To leave.
    Remove,
}

impl ModuleEvent {
    /// The topic on which events are published.
    pub const TOPIC: &'static str = "executor/events";
}

impl Report for ModuleEvent {
    const TOPIC: &'static str = Self::TOPIC;
    const NUMBER: usize = 2;
}

/// True if somebody receives events.
pub(crate) fn hears_events(phase: &mut SyncPhase<'_>) -> bool {
    phase.topics().hears::<ModuleEvent>()
}

pub(crate) fn note_event(phase: &mut SyncPhase<'_>, kind: ModuleEventKind) {
    let (time, cycle) = (phase.now(), phase.cycle());
    phase.report(ModuleEvent { time, cycle, kind });
}

/// Publishes an event of a module, if the module is a part and somebody receives events: an observer is not replayed.
pub(crate) fn note_event_of(
    phase: &mut SyncPhase<'_>,
    module: ModuleId,
    kind: impl FnOnce(Arc<str>) -> ModuleEventKind,
) {
    if !hears_events(phase) || !phase.is_part(module) {
        return;
    }
    if let Some(member) = phase.state.members.get(module.order) {
        let kind = kind(Arc::clone(&member.name));
        note_event(phase, kind);
    }
}
