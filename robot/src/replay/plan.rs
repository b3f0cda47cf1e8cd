//! The plan of a replay: which modules run, what they receive and what can be compared.

use std::collections::{BTreeMap, BTreeSet};

use downbeat_bags::{Reader, TopicId};
use downbeat_bridge::diagnostics::ProcessDiagnostics;
use downbeat_bridge::middleware::Direction;
use downbeat_edge::{KnownService, KnownType};
use downbeat_executor::{Core, Graph, GraphEdge, Synchrony, TopicInfo};

use super::coverage::{self, NotCompared};
use super::{LeftOut, ReplayError, ReplayOptions, Simulators};
use crate::journal;
use crate::journal::events::{UnrecordedService, unrecorded_services};
use crate::playback::account::{Cycles, Extract, was_in_simulated_time};
use crate::playback::events::WiredServices;
use crate::{ModuleEntry, ReplayedTime, RobotFile};

pub(super) struct Plan {
    /// Modules inside the cycle, which are replayed together.
    pub(super) attached: Vec<String>,
    /// Detached modules, each replayed separately.
    pub(super) detached: Vec<String>,
    pub(super) left_out: Vec<LeftOut>,
    /// The topics that replayed modules publish and the bag contains, without the leading slash.
    pub(super) outputs: BTreeMap<String, Output>,
    /// The topics that the modules inside the cycle receive from the bag.
    pub(super) inputs: BTreeSet<String>,
    /// The topics that they receive from other publishers and that are not in the bag; also the journals of
    /// settings and events if the robot was recorded without them.
    pub(super) missing_inputs: BTreeSet<String>,
    pub(super) not_compared: Vec<NotCompared>,
    /// The module that serves each service.
    pub(super) servers: BTreeMap<String, String>,
    /// The type of each service.
    pub(super) service_types: BTreeMap<String, KnownService>,
    pub(super) cycles: Cycles,
    pub(super) simulators: Simulators,
    /// Decides which versions of modules are in force.
    pub(super) reached: ReplayedTime,
}

/// A topic that replayed modules publish.
pub(super) struct Output {
    /// The replayed modules that publish it.
    pub(super) modules: Vec<String>,
    /// `None` for a Rust type that is not registered.
    pub(super) message_type: Option<KnownType>,
    /// True if its messages in the bag do not all come from one of these modules in order.
    pub(super) is_shared: bool,
}

impl Plan {
    /// Creates the plan and reads what is needed from the bag before anything runs.
    pub(super) fn make(
        file: &RobotFile,
        reader: &Reader,
        options: &ReplayOptions,
        reached: ReplayedTime,
    ) -> Result<(Self, Extract), ReplayError> {
        check_names(file, options)?;
        if options.simulators == Simulators::RunAgain && !was_in_simulated_time(reader) {
            return Err(ReplayError::RealTime);
        }
        let graph = Wiring::of(file, &reached)?;
        let is_in_bag = |topic: &str| reader.topic(&format!("/{topic}")).is_some();
        let mut plan = Self {
            attached: Vec::new(),
            detached: Vec::new(),
            left_out: Vec::new(),
            outputs: BTreeMap::new(),
            inputs: BTreeSet::new(),
            missing_inputs: BTreeSet::new(),
            not_compared: Vec::new(),
            servers: graph.servers.clone(),
            service_types: graph.service_types.clone(),
            cycles: Cycles::Unknown,
            simulators: options.simulators,
            reached,
        };
        let runs_detached = |module: &ModuleEntry| {
            !was_in_simulated_time(reader) && matches!(module.options().synchrony, Synchrony::Detached(_))
        };
        let begins_later = file.modules.iter().any(runs_detached) && {
            let mut extract = Extract::new(&file.catalog.interfaces);
            Cycles::read(reader, &mut extract)?.begin().is_some()
        };
        for module in &file.modules {
            let is_asked_for = options.modules.contains(&module.name);
            let replayability = match runs_detached(module) && begins_later {
                true => Err("it is detached, and the bag begins while it ran".to_owned()),
                false => plan.replayability(module, runs_detached(module), reader),
            };
            match replayability {
                _ if !options.modules.is_empty() && !is_asked_for => {}
                Ok(()) if runs_detached(module) => plan.detached.push(module.name.clone()),
                Ok(()) => plan.attached.push(module.name.clone()),
                Err(reason) if is_asked_for => {
                    return Err(ReplayError::NotReplayable(module.name.clone(), reason));
                }
                Err(reason) => plan.left_out.push(LeftOut { module: module.name.clone(), reason }),
            }
        }
        for (topic, publishers) in &graph.publishers {
            let modules = plan.publishers_of(&graph, topic);
            if !modules.is_empty() && is_in_bag(topic) {
                let is_shared = publishers.len() > modules.len()
                    || (modules.len() > 1 && modules.iter().any(|name| plan.detached.contains(name)));
                let info = graph.types.get(topic);
                let message_type = info.and_then(|info| file.catalog.interfaces.message_in(info));
                plan.outputs.insert(topic.clone(), Output { modules, message_type, is_shared });
            }
        }
        plan.find_inputs(&graph, is_in_bag)?;
        if reader.metadata().is_some_and(|metadata| metadata.custom_data.contains_key("robot")) {
            let accounts = [journal::SETTINGS, journal::EVENTS].into_iter().filter(|topic| !is_in_bag(topic));
            plan.missing_inputs.extend(accounts.map(str::to_owned));
        }
        if was_in_simulated_time(reader) && !plan.inputs.is_empty() && !is_in_bag(journal::MESSAGES) {
            plan.missing_inputs.insert(journal::MESSAGES.to_owned());
        }
        plan.check()?;
        plan.not_compared =
            coverage::not_compared(&mut plan, &graph, reader, options, &file.catalog.interfaces);
        let mut extract =
            Extract::read(reader, &plan.read_before(file, reader, &graph), &file.catalog.interfaces)?;
        plan.cycles = Cycles::read(reader, &mut extract)?;
        Ok((plan, extract))
    }

    pub(super) fn replays(&self, module: &str) -> bool {
        self.attached.iter().chain(&self.detached).any(|name| name == module)
    }

    pub(super) fn services(&self) -> WiredServices<'_> {
        WiredServices { types: &self.service_types, servers: &self.servers }
    }

    /// The replayed modules that publish a topic.
    pub(super) fn publishers_of(&self, graph: &Wiring, topic: &str) -> Vec<String> {
        let publishers = graph.publishers.get(topic).into_iter().flatten();
        publishers.filter(|name| self.replays(name)).cloned().collect()
    }

    pub(super) fn publishes(&self, graph: &Wiring, topic: &str) -> bool {
        graph.publishers.get(topic).into_iter().flatten().any(|name| self.replays(name))
    }

    /// True for a simulator that runs again, and for a module that drives one.
    pub(super) fn runs_live(&self, module: &ModuleEntry) -> bool {
        self.simulators == Simulators::RunAgain && module.has_simulated_device()
    }

    /// Checks whether the module can be replayed; the error is a message with the reason.
    fn replayability(
        &self,
        module: &ModuleEntry,
        runs_detached: bool,
        reader: &Reader,
    ) -> Result<(), String> {
        if module.kind.uses_device() && !self.runs_live(module) {
            let Some(replayed) = module.kind.replayed() else {
                return Err("it drives a device, whose answers are not recorded".to_owned());
            };
            let topic = replayed.topic_of(&module.options());
            if reader.topic(&topic).is_none() {
                return Err(format!(
                    "it drives a device, and the bag has no {topic} with the device's answers"
                ));
            }
        }
        let steps = format!("/{}", journal::STEPS);
        if runs_detached && reader.topic(&steps).is_none() {
            return Err(format!("it is detached, and the bag has no {steps} with its runs"));
        }
        Ok(())
    }

    /// The topics that are read in advance: times of cycles and runs, answers of devices, and messages that
    /// detached modules received.
    fn read_before(&self, file: &RobotFile, reader: &Reader, graph: &Wiring) -> BTreeSet<TopicId> {
        let devices =
            file.modules.iter().filter(|module| self.replays(&module.name) && !self.runs_live(module));
        let answers = devices.filter_map(|module| Some(module.kind.replayed()?.topic_of(&module.options())));
        let received = graph.subscribers.iter().filter(|(topic, subscribers)| {
            !topic.starts_with("executor/") && self.detached.iter().any(|name| subscribers.contains(name))
        });
        let mut topics: Vec<String> = received.map(|(topic, _)| format!("/{topic}")).collect();
        topics.extend(answers);
        topics.extend(
            [journal::CYCLES, journal::MESSAGES, journal::SETTINGS, journal::EVENTS]
                .map(|topic| format!("/{topic}")),
        );
        if !self.detached.is_empty() {
            topics.push(format!("/{}", journal::STEPS));
        }
        topics.iter().filter_map(|topic| reader.topic(topic)).collect()
    }

    fn find_inputs(&mut self, graph: &Wiring, is_in_bag: impl Fn(&str) -> bool) -> Result<(), ReplayError> {
        for (topic, subscribers) in &graph.subscribers {
            if topic.starts_with("executor/") || !subscribers.iter().any(|name| self.attached.contains(name))
            {
                continue;
            }
            let nobody = BTreeSet::new();
            let publishers = graph.publishers.get(topic).unwrap_or(&nobody);
            let (own, others): (Vec<_>, Vec<_>) =
                publishers.iter().cloned().partition(|name| self.attached.contains(name));
            match (own.is_empty(), others.is_empty()) {
                (true, _) if is_in_bag(topic) => drop(self.inputs.insert(topic.clone())),
                // If nothing publishes it, no message was received.
                (true, false) => drop(self.missing_inputs.insert(topic.clone())),
                (true, true) | (false, true) => {}
                (false, false) => {
                    return Err(ReplayError::SharedInput { topic: topic.clone(), modules: own });
                }
            }
        }
        Ok(())
    }

    fn check(&self) -> Result<(), ReplayError> {
        if self.attached.is_empty() && self.detached.is_empty() {
            let reasons = self.left_out.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
            return Err(ReplayError::Nothing(reasons));
        }
        if self.outputs.is_empty() {
            let modules = self.attached.iter().chain(&self.detached).cloned().collect::<Vec<_>>().join(", ");
            return Err(ReplayError::Nothing(format!("the bag has no topic that {modules} publish")));
        }
        Ok(())
    }
}

fn check_names(file: &RobotFile, options: &ReplayOptions) -> Result<(), ReplayError> {
    let known = || file.modules.iter().map(|module| module.name.clone()).collect();
    match options.modules.iter().find(|name| !file.modules.iter().any(|module| module.name == **name)) {
        Some(unknown) => Err(ReplayError::NoSuchModule { module: unknown.clone(), known: known() }),
        None => Ok(()),
    }
}

/// The publishers and receivers of each topic.
pub(super) struct Wiring {
    pub(super) publishers: BTreeMap<String, BTreeSet<String>>,
    subscribers: BTreeMap<String, BTreeSet<String>>,
    /// The modules of the robot file.
    pub(super) modules: BTreeSet<String>,
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
    fn of(file: &RobotFile, reached: &ReplayedTime) -> Result<Self, ReplayError> {
        reached.reset();
        let mut wiring = Self::in_force(file)?;
        let has_several = |module: &ModuleEntry| {
            module.source.recorded.as_ref().is_some_and(|versions| versions.are_several())
        };
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
