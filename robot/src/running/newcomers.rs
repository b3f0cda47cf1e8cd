//! Exposes and records what modules bring while the robot runs: one that could not be made at the start, or a
//! newer version.

use std::collections::BTreeSet;
use std::fmt;
use std::sync::Arc;

use downbeat_bridge::expose::{Bridge, EndpointReport, ExposedServices, Exposure, ServiceExposure};
use downbeat_edge::CoreAccess;
use downbeat_edge::foreign::Declarations;
use downbeat_executor::{CoreHandle, ModuleOptions};
use parking_lot::Mutex;

use super::node::RobotNode;
use super::recording::Growing;
#[cfg(feature = "view")]
use super::view::RobotView;
use crate::{Direction, Exposures, Robot, RobotFile, Survey};

/// Takes in what the robot file names in `[expose]` and `[record]` and modules bring later.
pub(super) struct Newcomers {
    core: CoreHandle,
    /// Bridge and services of the node, if there is one.
    node: Option<(Bridge, ExposedServices)>,
    recording: Option<Growing>,
    #[cfg(feature = "view")]
    view: Option<Arc<RobotView>>,
    known: Mutex<Known>,
}

/// What was taken in before, or could not be, by its names: it is tried once.
#[derive(Default)]
struct Known {
    topics: BTreeSet<(Option<String>, Direction, String, String)>,
    /// Networks, and names in the core and in ROS 2.
    offered: BTreeSet<(Option<String>, String, String)>,
    called: BTreeSet<(Option<String>, String, String)>,
    /// Services whose requests and answers are recorded.
    encoded: BTreeSet<Arc<str>>,
    /// The modules that could not be made so far.
    late: Vec<String>,
    /// Sentences that were logged.
    told: BTreeSet<String>,
}

impl Known {
    /// Returns what is new, and remembers it.
    fn note(&mut self, all: Exposures) -> Exposures {
        let Exposures { mut topics, mut services, mut calls } = all;
        topics.retain(|exposure| self.topics.insert(key(exposure)));
        let key = |exposure: &ServiceExposure| {
            (exposure.network.clone(), exposure.service.clone(), exposure.ros_service().to_owned())
        };
        services.retain(|exposure| self.offered.insert(key(exposure)));
        calls.retain(|exposure| self.called.insert(key(exposure)));
        Exposures { topics, services, calls }
    }
}

fn key(exposure: &Exposure) -> (Option<String>, Direction, String, String) {
    let Exposure { network, direction, topic, .. } = exposure;
    (network.clone(), *direction, topic.clone(), exposure.ros_topic().to_owned())
}

impl Newcomers {
    /// Of a robot that has not started, with what is exposed and recorded of it.
    pub(super) fn of(
        robot: &Robot,
        node: Option<&RobotNode>,
        recording: Option<Growing>,
        #[cfg(feature = "view")] view: Option<Arc<RobotView>>,
    ) -> Self {
        let mut known = Known { late: robot.late_modules(), ..Known::default() };
        if let Ok(exposed) = robot.exposed() {
            known.note(exposed);
        }
        known.encoded = robot.core.services().map(|service| Arc::clone(&service.name)).collect();
        Self {
            core: robot.core.handle(),
            node: node.map(|node| (node.bridge().clone(), node.services().clone())),
            recording,
            #[cfg(feature = "view")]
            view,
            known: Mutex::new(known),
        }
    }

    /// Takes in what a module declares that is about to join, so that its first messages are recorded and
    /// reach ROS 2.
    pub(super) fn expect(&self, file: &RobotFile, declared: &Declarations, options: &ModuleOptions) {
        if let Some(survey) = self.survey() {
            self.take_in(file, survey.with(declared, options));
        }
    }

    /// Takes in what modules have that were made since.
    pub(super) fn look(&self, file: &RobotFile) {
        let Some(survey) = self.survey() else { return };
        let survey = self.take_in(file, survey);
        let mut known = self.known.lock();
        known.late.retain(|module| survey.has_stopped(module));
        // Otherwise it may still come.
        if known.late.is_empty() {
            for problem in survey.problems() {
                if known.told.insert(problem.clone()) {
                    tracing::error!("{problem}");
                }
            }
        }
    }

    fn survey(&self) -> Option<Survey> {
        let survey = Survey::of_running(&self.core);
        if survey.is_none() && !self.core.stop_is_requested() {
            tracing::warn!("what modules bring is not exposed and recorded: the core does not answer");
        }
        survey
    }

    fn take_in(&self, file: &RobotFile, survey: Survey) -> Survey {
        let survey = survey.lenient();
        let exposed = file.all_exposures(&survey);
        let recorded = file.recorded_of(&file.record, &survey);
        let (Ok(exposed), Ok(recorded)) = (exposed, recorded) else { return survey };
        self.encode(file, &survey);
        if let Some(recording) = &self.recording {
            let extended = recording.extend(&self.core, &recorded, &exposed.topics);
            self.tell("not recorded", extended);
        }
        #[cfg(feature = "view")]
        if let Some(view) = &self.view {
            self.tell("not recorded", view.extend_recordings(&recorded, &exposed.topics));
        }
        let new = self.known.lock().note(exposed);
        if let Some((bridge, services)) = &self.node {
            self.expose(bridge, services, new);
        }
        survey
    }

    /// Has the requests and answers of new services recorded.
    fn encode(&self, file: &RobotFile, survey: &Survey) {
        let interfaces = &file.catalog.interfaces;
        let find = |name: &str| survey.services().iter().find(|service| *service.name == *name);
        for service in survey.services() {
            let is_new = self.known.lock().encoded.insert(Arc::clone(&service.name));
            if is_new && let Some(known) = interfaces.service_found(&service.name, find) {
                let encoded = known.encode_in(&mut CoreAccess::Running(&self.core), &service.name);
                self.tell("its calls are not recorded", encoded);
            }
        }
    }

    fn expose(&self, bridge: &Bridge, services: &ExposedServices, new: Exposures) {
        for exposure in new.topics {
            // By hand, with `downbeat expose`.
            let is_exposed = bridge.status().endpoints().iter().any(|EndpointReport { endpoint, .. }| {
                endpoint.direction == exposure.direction
                    && endpoint.topic == exposure.topic
                    && endpoint.network == exposure.network
            });
            if is_exposed {
                continue;
            }
            match bridge.add(std::slice::from_ref(&exposure)) {
                Ok(added) => {
                    for EndpointReport { endpoint, .. } in added {
                        tracing::info!("exposed: {} [{}]", endpoint.ros_topic, endpoint.type_name);
                    }
                }
                Err(error) => self.tell("not exposed", Err(error)),
            }
        }
        for exposure in &new.services {
            let added = services.add(&self.core, std::slice::from_ref(exposure), &[]);
            if added.is_ok() {
                let network = exposure.network.iter().map(|name| format!(" on {name}")).collect::<String>();
                tracing::info!("exposed service{network}: {}", exposure.ros_service());
            }
            self.tell("not exposed", added);
        }
        for exposure in &new.calls {
            self.tell("not exposed", services.add(&self.core, &[], std::slice::from_ref(exposure)));
        }
    }

    /// Logs an error, once.
    fn tell<E: fmt::Display>(&self, what: &str, result: Result<(), E>) {
        let Err(error) = result else { return };
        let is_new = self.known.lock().told.insert(error.to_string());
        if is_new && !self.core.stop_is_requested() {
            tracing::error!("{what}: {error}");
        }
    }
}
