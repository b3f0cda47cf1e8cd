//! Views of a core between two cycles: modules, graph, snapshot.

use std::collections::HashMap;
use std::sync::Arc;

use crate::cycle::{CoreState, Mechanisms, Member, Pause};
use crate::exchange::{Messages, Services};
use crate::module::{Direction, MESSAGES, Place, SERVICES};
use crate::observe::{ModuleMeter, nanoseconds};
use crate::{
    Graph, GraphEdge, GraphModule, GraphOutlet, GraphService, GraphTopic, LifecycleState, ModuleState,
    Snapshot, Stage, SyncPhase,
};

impl Graph {
    pub(crate) fn of(stage: &Stage, state: &CoreState, mechanisms: &Mechanisms) -> Self {
        let topics = &stage.views.topics;
        let (Some(services), Some(messages)) =
            (mechanisms.get::<Services>(SERVICES), mechanisms.get::<Messages>(MESSAGES))
        else {
            return Self::default();
        };
        let topic_infos: Vec<_> = topics.infos().collect();
        let topic_places = places(topic_infos.iter().map(|info| &info.name));
        let service_infos: Vec<_> = services.infos().collect();
        let service_places = places(service_infos.iter().map(|info| &info.name));

        let mut edges = Vec::new();
        for (module, member) in state.members.iter().enumerate() {
            for used in &member.uses {
                let (topic, service) = match used.of {
                    MESSAGES => (topic_places.get(topics.name(used.index)), None),
                    SERVICES => (None, service_places.get(services.name(used.index))),
                    _ => continue,
                };
                edges.extend(match (topic, service, used.direction) {
                    (Some(&topic), _, Direction::In) => Some(GraphEdge::Subscribes { module, topic }),
                    (Some(&topic), _, Direction::Out) => Some(GraphEdge::Publishes { module, topic }),
                    (_, Some(&service), Direction::In) => Some(GraphEdge::Serves { module, service }),
                    (_, Some(&service), Direction::Out) => Some(GraphEdge::Calls { module, service }),
                    (None, None, _) => None,
                });
            }
        }
        for (outlet, (_, taken)) in messages.connections().enumerate() {
            let taken = taken.filter_map(|index| topic_places.get(topics.name(index)).copied());
            edges.extend(taken.map(|topic| GraphEdge::Leaves { topic, outlet }));
        }
        edges.sort_unstable();
        edges.dedup();

        Self {
            modules: state.members.iter().map(GraphModule::of).collect(),
            outlets: messages.connections().map(|(name, _)| GraphOutlet { name: name.to_string() }).collect(),
            topics: topic_infos
                .iter()
                .map(|info| GraphTopic {
                    name: info.name.to_string(),
                    message_type: info.message_type.to_owned(),
                })
                .collect(),
            services: service_infos
                .iter()
                .map(|info| GraphService {
                    name: info.name.to_string(),
                    request_type: info.request_type.to_owned(),
                    response_type: info.response_type.to_owned(),
                })
                .collect(),
            edges,
        }
    }
}

impl GraphModule {
    fn of(member: &Member) -> Self {
        let is_detached = matches!(member.id.place, Place::Detached(_));
        Self { name: member.name.to_string(), is_detached }
    }
}

impl Snapshot {
    pub(crate) fn of(phase: &mut SyncPhase<'_>) -> Self {
        let SyncPhase { stage, state, mechanisms, .. } = phase;
        let CoreState { members, detached, restarts, .. } = &mut **state;
        let modules = members.iter().filter_map(|member| {
            let is_restarting = restarts.iter().any(|&(_, order)| order == member.id.order);
            match member.id.place {
                Place::Attached(slot) => {
                    let cell = stage.cells.get(slot)?;
                    let state = module_state(cell.state(), cell.is_paused(), &cell.meter, is_restarting);
                    Some(cell.meter.statistics(&member.name, state, false))
                }
                Place::Detached(slot) => {
                    let module = detached[slot].as_mut()?;
                    module.meter.inbox(module.waiting());
                    let state = module_state(module.state, module.is_paused, &module.meter, is_restarting);
                    Some(module.meter.statistics(&member.name, state, true))
                }
            }
        });
        let modules = modules.collect();
        let outlets = mechanisms.get::<Messages>(MESSAGES).map(Messages::outlet_statistics);
        Self {
            time: stage.now,
            uptime_ns: nanoseconds(state.inspector.uptime()),
            cycle: state.cycle,
            is_paused: state.pause != Pause::Running,
            cycles: state.inspector.statistics(),
            modules,
            topics: stage.views.topics.statistics().collect(),
            outlets: outlets.unwrap_or_default(),
        }
    }
}

fn module_state(
    state: LifecycleState,
    is_paused: bool,
    meter: &ModuleMeter,
    is_restarting: bool,
) -> ModuleState {
    match state {
        LifecycleState::Finalized if is_restarting => ModuleState::Restarting,
        LifecycleState::Finalized if meter.has_failed() => ModuleState::Failed,
        LifecycleState::Finalized => ModuleState::Finalized,
        _ if is_paused => ModuleState::Paused,
        LifecycleState::Unconfigured => ModuleState::Unconfigured,
        LifecycleState::Inactive => ModuleState::Inactive,
        LifecycleState::Active => ModuleState::Active,
    }
}

fn places<'a>(names: impl Iterator<Item = &'a Arc<str>>) -> HashMap<Arc<str>, usize> {
    names.enumerate().map(|(place, name)| (Arc::clone(name), place)).collect()
}
