//! Who publishes, receives and serves what in a robot.

use std::collections::{BTreeMap, BTreeSet};

use downbeat_bridge::diagnostics::ProcessDiagnostics;
use downbeat_bridge::middleware::Direction;
use downbeat_edge::KnownService;
use downbeat_executor::{Core, Graph, GraphEdge, TopicInfo};

use super::ReplayError;
use crate::journal;
use crate::journal::events::{UnrecordedService, unrecorded_services};
use crate::{ModuleEntry, ReplayedTime, RobotFile};

/// The publishers and receivers of each topic.
pub(super) struct Wiring {
    pub(super) publishers: BTreeMap<String, BTreeSet<String>>,
    pub(super) subscribers: BTreeMap<String, BTreeSet<String>>,
    /// The modules of the robot file.
    pub(super) modules: BTreeSet<String>,
    /// Those of them that have settings: older bags name no others.
    pub(super) with_settings: BTreeSet<String>,
    pub(super) servers: BTreeMap<String, String>,
    pub(super) service_types: BTreeMap<String, KnownService>,
    pub(super) unrecorded_services: Vec<UnrecordedService>,
    /// The topics of the core.
    pub(super) types: BTreeMap<String, TopicInfo>,
}

/// Placeholder for publishers outside the robot.
const ROS: &str = "ROS 2";

impl Wiring {
    /// With all that modules have at the start or at the end.
    pub(super) fn of(file: &RobotFile, reached: &ReplayedTime) -> Result<Self, ReplayError> {
        reached.reset();
        let mut wiring = Self::in_force(file)?;
        let has_several = |module: &ModuleEntry| module.versions.are_several();
        if file.modules.iter().any(has_several) {
            reached.finish();
            wiring.extend(Self::in_force(file)?);
            reached.reset();
        }
        let known: Vec<_> = wiring.types.values().cloned().collect();
        for exposure in file.exposures_of(&file.expose.topics, &known, &[])? {
            if exposure.direction == Direction::In {
                let topic = exposure.topic.trim_start_matches('/').to_owned();
                wiring.publishers.entry(topic).or_default().insert(ROS.to_owned());
            }
        }
        Ok(wiring)
    }

    fn extend(&mut self, later: Self) {
        for (mine, others) in
            [(&mut self.publishers, later.publishers), (&mut self.subscribers, later.subscribers)]
        {
            for (topic, modules) in others {
                mine.entry(topic).or_default().extend(modules);
            }
        }
        self.servers.extend(later.servers);
        self.service_types.extend(later.service_types);
        for (name, topic) in later.types {
            let known = self.types.entry(name).or_insert_with(|| topic.clone());
            known.is_published |= topic.is_published;
        }
        let is_known = |service: &UnrecordedService| {
            self.unrecorded_services.iter().any(|known| known.service == service.service)
        };
        let new = later.unrecorded_services.into_iter().filter(|service| !is_known(service));
        let new: Vec<_> = new.collect();
        self.unrecorded_services.extend(new);
    }

    /// With what modules have in the versions in force.
    fn in_force(file: &RobotFile) -> Result<Self, ReplayError> {
        let mut core = Core::new();
        if file.expose.features.diagnostics {
            ProcessDiagnostics::add(&mut core, &file.name)?;
        }
        let mut core = file.build_modules(core, |_, _| None)?;
        let interfaces = &file.catalog.interfaces;
        journal::add(&mut core, interfaces, file.launcher.idle)?;
        let unrecorded_services = unrecorded_services(&core, interfaces);
        let services = || core.services().map(|info| info.name.to_string());
        let servers = core
            .services()
            .filter_map(|info| Some((info.name.to_string(), info.server.as_ref()?.to_string())));
        let known = services().filter_map(|name| Some((name.clone(), interfaces.service_in(&core, &name)?)));
        let Graph { modules, topics, edges, .. } = core.graph();
        let mut wiring = Self {
            publishers: BTreeMap::new(),
            subscribers: BTreeMap::new(),
            modules: file.modules.iter().map(|module| module.name.clone()).collect(),
            with_settings: file
                .modules
                .iter()
                .filter(|module| core.settings(&module.name).is_some_and(|settings| !settings.is_empty()))
                .map(|module| module.name.clone())
                .collect(),
            servers: servers.collect(),
            service_types: known.collect(),
            unrecorded_services,
            types: core.topics().map(|topic| (topic.name.to_string(), topic.clone())).collect(),
        };
        let names = |module: usize, topic: usize| {
            Some((modules.get(module)?.name.clone(), topics.get(topic)?.name.clone()))
        };
        for edge in edges {
            match edge {
                GraphEdge::Publishes { module, topic } => {
                    if let Some((module, topic)) = names(module, topic) {
                        wiring.publishers.entry(topic).or_default().insert(module);
                    }
                }
                GraphEdge::Subscribes { module, topic } => {
                    if let Some((module, topic)) = names(module, topic) {
                        wiring.subscribers.entry(topic).or_default().insert(module);
                    }
                }
                _ => {}
            }
        }
        Ok(wiring)
    }

    /// Returns whether a part of the process publishes the topic, and not ROS 2.
    pub(super) fn is_published_by_process(&self, topic: &str) -> bool {
        self.publishers.get(topic).is_some_and(|names| names.iter().any(|name| name != ROS))
    }
}
