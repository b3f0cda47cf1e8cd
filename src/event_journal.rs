//! What takes effect in the cycles of a running robot besides messages and settings, as a ROS message, so that a bag holds it and
//! a replay can repeat it: requests, answers, commands to modules and results of jobs.

use std::collections::BTreeSet;

use downbeat_bridge::edge::Interfaces;
use downbeat_executor::{
    CallError, CallOrigin, Context, Core, Graph, GraphEdge, Module, ModuleCommand, ModuleEvent as Event,
    ModuleEventKind as Kind, ModuleOptions, Publication, Received, Role, Setup, SetupError,
};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::downbeat_interfaces::msg::ModuleEvent;

/// The topic on which the events are published.
pub const TOPIC: &str = "module_events";

/// Publishes each event on [`TOPIC`]: an observer, so that it tells the last ones too.
pub struct EventJournal;

impl EventJournal {
    /// The name of the module.
    pub const MODULE_NAME: &'static str = "event_journal";

    /// Adds the journal to a core whose modules are all there. Requests and answers are recorded with their content where their types
    /// are registered.
    ///
    /// # Errors
    /// If another module has the name or the topic.
    pub fn add(core: &mut Core, interfaces: &Interfaces) -> Result<(), SetupError> {
        encode_services(core, interfaces)?;
        let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
        core.add_with(Self::MODULE_NAME, Self, options)
    }

    fn on_event(&mut self, event: Received<'_, Event>, ctx: &mut Context<'_, Publication<ModuleEvent>>) {
        ctx.publish(*ctx.ports, message(&event));
    }
}

impl Module for EventJournal {
    type Ports = Publication<ModuleEvent>;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Self::Ports, SetupError> {
        setup.subscribe(Event::TOPIC, Self::on_event)?;
        setup.publish(TOPIC)
    }
}

/// Has the content of requests and answers told of all services whose types are registered.
pub(crate) fn encode_services(core: &mut Core, interfaces: &Interfaces) -> Result<(), SetupError> {
    let names: Vec<_> = core.services().map(|service| service.name.clone()).collect();
    for name in names {
        if let Some(known) = interfaces.service_in(core, &name) {
            known.encode(core, &name)?;
        }
    }
    Ok(())
}

/// A service whose calls no bag holds though a replay needs them: of plain Rust types, between modules of which one is detached.
pub(crate) struct UnrecordedService {
    pub(crate) service: String,
    /// The Rust types of request and answer.
    pub(crate) types: String,
    /// The modules that serve and call it.
    pub(crate) modules: BTreeSet<String>,
}

/// Those of a core.
pub(crate) fn unrecorded_services(core: &Core, interfaces: &Interfaces) -> Vec<UnrecordedService> {
    let Graph { modules, services, edges, .. } = core.graph();
    let infos = core.services().filter(|info| interfaces.service_in(core, &info.name).is_none());
    let unrecorded = infos.filter_map(|info| {
        let is_it = |service: usize| services.get(service).is_some_and(|known| known.name == *info.name);
        let of_it = edges.iter().filter_map(|edge| match edge {
            GraphEdge::Calls { module, service } | GraphEdge::Serves { module, service }
                if is_it(*service) =>
            {
                modules.get(*module)
            }
            _ => None,
        });
        let of_it: Vec<_> = of_it.collect();
        of_it.iter().any(|module| module.is_detached).then(|| UnrecordedService {
            service: info.name.to_string(),
            types: format!("{} -> {}", info.request_type, info.response_type),
            modules: of_it.iter().map(|module| module.name.clone()).collect(),
        })
    });
    unrecorded.filter(|service| service.modules.len() > 1).collect()
}

pub(crate) fn message(event: &Event) -> ModuleEvent {
    let of_call = |service: &str, origin: &CallOrigin| ModuleEvent {
        service: service.to_owned(),
        module: origin.client.as_deref().unwrap_or_default().to_owned(),
        port: origin.port,
        number: origin.number,
        ..ModuleEvent::default()
    };
    let message = match &event.kind {
        Kind::Request { service, origin, body } => ModuleEvent {
            kind: ModuleEvent::REQUEST,
            data: body.clone().unwrap_or_default(),
            ..of_call(service, origin)
        },
        Kind::Answer { service, origin, result } => {
            let (outcome, reason) = match result {
                Ok(_) => (ModuleEvent::ANSWERED, String::new()),
                Err(CallError::Refused { reason, .. }) => (ModuleEvent::REFUSED, reason.clone()),
                Err(CallError::NoServer { .. }) => (ModuleEvent::NO_SERVER, String::new()),
                Err(CallError::ServerGone { module, .. }) => (ModuleEvent::SERVER_GONE, module.to_string()),
                Err(error) => (ModuleEvent::REFUSED, error.to_string()),
            };
            let data = result.as_ref().ok().cloned().flatten().unwrap_or_default();
            ModuleEvent { kind: ModuleEvent::ANSWER, outcome, reason, data, ..of_call(service, origin) }
        }
        Kind::Command { module, command, by } => ModuleEvent {
            kind: ModuleEvent::COMMAND,
            module: module.to_string(),
            by: by.as_deref().unwrap_or_default().to_owned(),
            command: match command {
                ModuleCommand::Transition(transition) => transition.to_string(),
                ModuleCommand::Pause => "pause".to_owned(),
                ModuleCommand::Resume => "resume".to_owned(),
                ModuleCommand::Step => "step".to_owned(),
                ModuleCommand::Remove => "remove".to_owned(),
            },
            ..ModuleEvent::default()
        },
        Kind::JobResult { module, job, number } => ModuleEvent {
            kind: ModuleEvent::RESULT,
            module: module.to_string(),
            port: *job,
            number: *number,
            ..ModuleEvent::default()
        },
        Kind::Taken { module, step, count } => ModuleEvent {
            kind: ModuleEvent::TAKEN,
            module: module.to_string(),
            number: *step,
            count: *count,
            ..ModuleEvent::default()
        },
    };
    ModuleEvent { stamp: Time::from_nanos(event.time.as_nanos()), cycle: event.cycle, ..message }
}
