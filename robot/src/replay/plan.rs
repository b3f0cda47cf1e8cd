//! The plan of a replay: which modules run, what they receive and what is compared.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use downbeat_edge::{KnownService, KnownType};

use super::Simulators;
use super::report::{LeftOut, NotCompared};
use super::wiring::Wiring;
use crate::playback::events::WiredServices;
use crate::playback::journals::Cycles;
use crate::{ModuleEntry, ReplayedTime};

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
    /// Sentences about modules that only the recorded robot has, or only the robot file.
    pub(super) other_modules: Vec<String>,
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
    pub(super) fn replays(&self, module: &str) -> bool {
        self.attached.iter().chain(&self.detached).any(|name| name == module)
    }

    pub(super) fn services(&self) -> WiredServices<'_> {
        WiredServices { types: &self.service_types, servers: &self.servers }
    }

    /// The topics that are compared and that these modules publish, with their types.
    pub(super) fn published_by(&self, is_one: impl Fn(&str) -> bool) -> Vec<(Arc<str>, KnownType)> {
        let outputs = self.outputs.iter();
        let outputs = outputs.filter(|(_, output)| output.modules.iter().any(|name| is_one(name)));
        outputs.filter_map(|(topic, output)| Some((topic.as_str().into(), output.message_type?))).collect()
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
}
