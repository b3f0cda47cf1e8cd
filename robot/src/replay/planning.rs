//! How a plan is made: from the robot file, the options and what the bag contains.

use std::collections::{BTreeMap, BTreeSet};

use downbeat_bags::{Reader, TopicId};
use downbeat_executor::Synchrony;

use super::coverage;
use super::plan::{Output, Plan};
use super::report::LeftOut;
use super::wiring::Wiring;
use super::{ReplayError, ReplayOptions, Simulators};
use crate::journal;
use crate::playback::journals::{Cycles, Extract, was_in_simulated_time};
use crate::{ModuleEntry, ReplayedTime, RobotFile, recorded_modules};

impl Plan {
    /// Creates the plan and reads what is needed from the bag before anything runs.
    pub(super) fn make(
        file: &RobotFile,
        reader: &Reader,
        options: &ReplayOptions,
        reached: ReplayedTime,
        extract: &mut Extract,
    ) -> Result<Self, ReplayError> {
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
            other_modules: other_modules(&graph, reader),
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
            extract.read_journals(reader)?;
            Cycles::read(reader, extract)?.begin().is_some()
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
        extract.read(reader, plan.read_before(file, reader, &graph))?;
        plan.cycles = Cycles::read(reader, extract)?;
        Ok(plan)
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

/// Compares the modules of the robot file with those of the recorded robot.
fn other_modules(graph: &Wiring, reader: &Reader) -> Vec<String> {
    let Some(recorded) = reader.metadata().and_then(recorded_modules) else {
        let unknown =
            "the bag does not say with which settings its robot ran: those of the robot file are used";
        return if graph.with_settings.is_empty() { Vec::new() } else { vec![unknown.to_owned()] };
    };
    let gone = recorded.difference(&graph.modules).map(|module| {
        format!("the recorded robot had a module \"{module}\", which the robot file lacks; its messages come from the bag")
    });
    let new = graph.with_settings.difference(&recorded).map(|module| {
        format!("the recorded robot had no module \"{module}\"; what it publishes cannot be compared")
    });
    gone.chain(new).collect()
}

fn check_names(file: &RobotFile, options: &ReplayOptions) -> Result<(), ReplayError> {
    let known = || file.modules.iter().map(|module| module.name.clone()).collect();
    match options.modules.iter().find(|name| !file.modules.iter().any(|module| module.name == **name)) {
        Some(unknown) => Err(ReplayError::NoSuchModule { module: unknown.clone(), known: known() }),
        None => Ok(()),
    }
}
