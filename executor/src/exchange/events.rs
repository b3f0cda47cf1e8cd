//! Events that take effect in a cycle, other than messages and settings; published for recording and replay.

use std::sync::Arc;

use crate::topics::Report;
use crate::{CallError, Core, ModuleId, SyncPhase, Time, Transition};

/// An event, other than a message or a setting, that took effect. Published on [`ModuleEvent::TOPIC`] if the
/// topic has subscribers. A replay uses it to repeat the event in the same cycle.
#[derive(Clone, Debug, PartialEq)]
pub struct ModuleEvent {
    /// The time of the cycle whose sync phase applied the event.
    pub time: Time,
    /// The number of that cycle.
    pub cycle: u64,
    /// The kind of the event.
    pub kind: ModuleEventKind,
}

/// The kinds of events.
#[derive(Clone, Debug, PartialEq)]
pub enum ModuleEventKind {
    /// A request was delivered to its server.
    Request {
        /// The service.
        service: Arc<str>,
        /// The caller.
        origin: CallOrigin,
        /// The request; `None` unless the service has an encoder, see
        /// [`Core::encode_service`](crate::Core::encode_service).
        body: Option<Vec<u8>>,
    },
    /// An answer was delivered to its client. Time-outs of calls follow from the clock alone, and are not
    /// reported.
    Answer {
        /// The service.
        service: Arc<str>,
        /// The call that the answer ends.
        origin: CallOrigin,
        /// The answer; `None` unless the service has an encoder.
        result: Result<Option<Vec<u8>>, CallError>,
    },
    /// A module was asked to make a transition, or was paused, resumed, stepped, removed or restarted.
    Command {
        /// The module.
        module: Arc<str>,
        /// The command.
        command: ModuleCommand,
        /// The module that sent the command; `None` for another thread.
        by: Option<Arc<str>>,
    },
    /// The result of a job was delivered to its module.
    JobResult {
        /// The module.
        module: Arc<str>,
        /// The index of the job in the order of declaration by the module.
        job: u32,
        /// The number of the result among those of the job, from 0.
        number: u64,
    },
    /// A module was constructed while the core ran, from the description that its setup
    /// [gave](crate::Setup::made_from). Its setup may have failed.
    Made {
        /// The module.
        module: Arc<str>,
        /// The description, in a format defined by the module.
        description: Vec<u8>,
    },
    /// A run of a detached module took the next `count` events that concern the module: requests to it,
    /// answers, commands and results.
    Taken {
        /// The module.
        module: Arc<str>,
        /// The number of the run.
        step: u64,
        /// The number of events.
        count: u32,
    },
}

/// The origin of a call.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CallOrigin {
    /// The calling module; `None` for a [`Caller`](crate::Caller).
    pub client: Option<Arc<str>>,
    /// The index of the client in the order of declaration by the module; 0 for a caller.
    pub port: u32,
    /// The number of the call among those of the client, or of all callers, from 0.
    pub number: u64,
}

/// A command to a module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModuleCommand {
    /// Make this transition.
    Transition(Transition),
    /// Pause.
    Pause,
    /// Resume.
    Resume,
    /// Run once.
    Step,
    /// Construct the module again after it has stopped.
    Restart,
    /// Remove the module.
    Remove,
}

impl ModuleEvent {
    /// The topic on which events are published.
    pub const TOPIC: &'static str = "executor/events";
}

impl Report for ModuleEvent {
    const TOPIC: &'static str = Self::TOPIC;
    const NUMBER: usize = 3;
}

impl Core {
    /// The events of the last cycle that took effect after its messages were published. They are published in
    /// the next cycle: this is for programs that look at a core between cycles.
    #[must_use]
    pub fn waiting_events(&self) -> &[ModuleEvent] {
        self.stage.views.topics.waiting_reports()
    }
}

/// True if the topic of events has subscribers.
pub(crate) fn hears_events(phase: &mut SyncPhase<'_>) -> bool {
    phase.topics().hears::<ModuleEvent>()
}

pub(crate) fn note_event(phase: &mut SyncPhase<'_>, kind: ModuleEventKind) {
    let (time, cycle) = (phase.now(), phase.cycle());
    phase.report(ModuleEvent { time, cycle, kind });
}

/// Publishes an event of a module if the module is a part and the topic has subscribers. Observers are not
/// replayed, so their events are left out.
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
