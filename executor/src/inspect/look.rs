//! What a core shows of itself between two cycles.

use std::collections::HashMap;
use std::sync::Arc;

use super::histogram::nanoseconds;
use super::{
    Graph, GraphEdge, GraphModule, GraphOutlet, GraphService, GraphTopic, ModuleMeter, ModuleState, Snapshot,
};
use crate::core::{Pause, World};
use crate::management::{Member, Place};
use crate::{LifecycleState, Stage};

impl Graph {
    pub(crate) fn of(stage: &Stage, world: &World) -> Self {
        let topics = &stage.shared.topics;
        let topic_infos: Vec<_> = topics.infos().collect();
        let topic_places = places(topic_infos.iter().map(|info| &info.name));
        let service_infos: Vec<_> = world.services.infos().collect();
        let service_places = places(service_infos.iter().map(|info| &info.name));

        let mut edges = Vec::new();
        for (module, member) in world.members.iter().enumerate() {
            let topic = |index: &usize| topic_places.get(topics.name(*index)).copied();
            let published = member.uses.published.iter().filter_map(topic);
            edges.extend(published.map(|topic| GraphEdge::Publishes { module, topic }));
            let subscribed = member.uses.subscribed.iter().filter_map(topic);
            edges.extend(subscribed.map(|topic| GraphEdge::Subscribes { module, topic }));
            for &index in &member.uses.services {
                let Some(&service) = service_places.get(world.services.name(index)) else { continue };
                let is_server = service_infos[service].server.as_ref() == Some(&member.name);
                // One that calls a service of its own uses it twice.
                let uses = member.uses.services.iter().filter(|&&other| other == index).count();
                if is_server {
                    edges.push(GraphEdge::Serves { module, service });
                }
                if !is_server || uses > 1 {
                    edges.push(GraphEdge::Calls { module, service });
                }
            }
        }
        for (outlet, (_, taken)) in world.outlets.connections().enumerate() {
            let taken = taken.filter_map(|index| topic_places.get(topics.name(index)).copied());
            edges.extend(taken.map(|topic| GraphEdge::Leaves { topic, outlet }));
        }
        edges.sort_unstable();
        edges.dedup();

        Self {
            modules: world.members.iter().map(GraphModule::of).collect(),
            outlets: world
                .outlets
                .connections()
                .map(|(name, _)| GraphOutlet { name: name.to_string() })
                .collect(),
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
    pub(crate) fn of(stage: &mut Stage, world: &mut World) -> Self {
        let restarting: Vec<_> = world.restarts.iter().map(|&(_, order)| order).collect();
        let modules = world.members.iter().filter_map(|member| {
            let is_restarting = restarting.contains(&member.id.order);
            match member.id.place {
                Place::Attached(slot) => {
                    let cell = stage.cell(slot)?;
                    let state = state(cell.state(), cell.is_paused(), &cell.meter, is_restarting);
                    Some(cell.meter.statistics(&member.name, state, false))
                }
                Place::Detached(slot) => {
                    let module = world.detached[slot].as_mut()?;
                    module.meter.inbox(module.waiting());
                    let state = state(module.state, module.is_paused, &module.meter, is_restarting);
                    Some(module.meter.statistics(&member.name, state, true))
                }
            }
        });
        let modules = modules.collect();
        let topics = &stage.shared.topics;
        let topic_statistics = |topic| {
            let info = topics.info(topic);
            let subscribers = topics.subscribers(topic).len();
            topics.meter(topic).statistics(&info.name, info.message_type, subscribers)
        };
        Self {
            time: stage.now,
            uptime_ns: nanoseconds(world.inspector.uptime()),
            cycle: world.cycle,
            is_paused: world.pause != Pause::Running,
            cycles: world.inspector.statistics(),
            modules,
            topics: topics.indices().map(topic_statistics).collect(),
            outlets: world.outlets.statistics(),
        }
    }
}

fn state(state: LifecycleState, is_paused: bool, meter: &ModuleMeter, is_restarting: bool) -> ModuleState {
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
