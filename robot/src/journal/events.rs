//! Events of a cycle besides messages and settings: requests, answers, commands to modules and results of
//! jobs.

use std::collections::{BTreeSet, HashMap};

use downbeat_edge::Interfaces;
use downbeat_executor::{
    CallError, CallOrigin, Core, Graph, GraphEdge, GraphModule, ModuleCommand, ModuleEvent as Event,
    ModuleEventKind as Kind, SetupError,
};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::downbeat_interfaces::msg::ModuleEvent;

/// The command to a module that has stopped to start again.
pub(crate) const RESTART: &str = "restart";

/// Makes the executor report the content of requests and answers of all services whose types are registered.
pub(crate) fn encode_services(core: &mut Core, interfaces: &Interfaces) -> Result<(), SetupError> {
    let names: Vec<_> = core.services().map(|service| service.name.clone()).collect();
    for name in names {
        if let Some(known) = interfaces.service_in(core, &name) {
            known.encode(core, &name)?;
        }
    }
    Ok(())
}

/// A service whose calls no bag holds though a replay needs them: of plain Rust types, between modules of
/// which one is detached.
pub(crate) struct UnrecordedService {
    pub(crate) service: String,
    /// The Rust types of request and answer.
    pub(crate) types: String,
    /// The modules that serve and call it.
    pub(crate) modules: BTreeSet<String>,
}

/// The unrecorded services of a core.
pub(crate) fn unrecorded_services(core: &Core, interfaces: &Interfaces) -> Vec<UnrecordedService> {
    let Graph { modules, services, edges, .. } = core.graph();
    let mut users: HashMap<&str, Vec<&GraphModule>> = HashMap::new();
    for edge in &edges {
        if let GraphEdge::Calls { module, service } | GraphEdge::Serves { module, service } = edge
            && let (Some(module), Some(service)) = (modules.get(*module), services.get(*service))
        {
            users.entry(&service.name).or_default().push(module);
        }
    }
    let infos = core.services().filter(|info| interfaces.service_in(core, &info.name).is_none());
    let unrecorded = infos.filter_map(|info| {
        let of_it = users.get(&*info.name).map(Vec::as_slice).unwrap_or_default();
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
            let mut by = String::new();
            let (outcome, reason) = match result {
                Ok(_) => (ModuleEvent::ANSWERED, String::new()),
                Err(CallError::Refused { reason, .. }) => (ModuleEvent::REFUSED, reason.clone()),
                Err(CallError::NoServer { .. }) => (ModuleEvent::NO_SERVER, String::new()),
                Err(CallError::ServerGone { module, .. }) => (ModuleEvent::SERVER_GONE, module.to_string()),
                Err(CallError::ServerFailed { module, reason, .. }) => {
                    by = module.to_string();
                    (ModuleEvent::SERVER_FAILED, reason.to_string())
                }
                Err(error) => (ModuleEvent::REFUSED, error.to_string()),
            };
            let data = result.as_ref().ok().cloned().flatten().unwrap_or_default();
            ModuleEvent { kind: ModuleEvent::ANSWER, by, outcome, reason, data, ..of_call(service, origin) }
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
                ModuleCommand::Restart => RESTART.to_owned(),
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
        Kind::Made { module, description } => ModuleEvent {
            kind: ModuleEvent::MADE,
            module: module.to_string(),
            data: description.clone(),
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::time::Duration;

    use downbeat_executor::{Inbox, Module, ModuleOptions, Setup, Synchrony};

    use super::*;

    struct Doubler;

    impl Module for Doubler {
        type Ports = ();

        fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
            setup.serve::<u32, u64, _>("double", |_: &mut Self, number, _| Ok(u64::from(*number) * 2))
        }
    }

    struct Asker;

    impl Module for Asker {
        type Ports = ();

        fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
            setup.client::<u32, u64, _>("double", Duration::from_secs(1), |_: &mut Self, _, _| ()).map(drop)
        }
    }

    #[test]
    fn a_service_of_plain_types_is_not_recorded_where_one_side_is_detached() {
        let unrecorded = |synchrony| {
            let mut core = Core::new();
            core.add("doubler", Doubler).unwrap();
            core.add_with("asker", Asker, ModuleOptions { synchrony, ..ModuleOptions::default() }).unwrap();
            unrecorded_services(&core, &Interfaces::carried())
        };
        assert!(unrecorded(Synchrony::default()).is_empty());
        let found = unrecorded(Synchrony::Detached(Inbox::KeepAll));
        assert_eq!(found.len(), 1);
        assert_eq!((&*found[0].service, &*found[0].types), ("double", "u32 -> u64"));
        assert!(found[0].modules.iter().eq(["asker", "doubler"]));
    }
}
