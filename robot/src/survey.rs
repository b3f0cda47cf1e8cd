//! What a core has, for the names in a robot file.

use std::cell::RefCell;
use std::time::Duration;

use downbeat_edge::foreign::Declarations;
use downbeat_executor::{
    Core, CoreHandle, Graph, GraphEdge, ModuleInfo, ModuleOptions, ServiceInfo, TopicInfo,
};

use super::file::RobotFileError;

/// How long a running core may take for each answer.
const PATIENCE: Duration = Duration::from_secs(5);

/// The topics, services, modules and settings of a core, and those that a module is about to bring.
#[derive(Default)]
pub(crate) struct Survey {
    pub(super) topics: Vec<TopicInfo>,
    pub(super) services: Vec<ServiceInfo>,
    pub(super) modules: Vec<String>,
    /// The modules that have stopped, or could not be made.
    stopped: Vec<String>,
    /// As in `motion.gain`.
    pub(super) settings: Vec<String>,
    /// The modules that publish, each with a topic.
    publishers: Vec<(String, String)>,
    /// The topics that modules receive.
    received: Vec<String>,
    /// Why names of the file mean nothing here; `None` where that is an error.
    problems: Option<RefCell<Vec<String>>>,
}

impl Survey {
    /// Of topics alone.
    pub(super) fn of_topics(topics: &[TopicInfo]) -> Self {
        Self { topics: topics.to_vec(), ..Self::default() }
    }

    pub(crate) fn of(core: &Core) -> Self {
        let modules = core.modules();
        let settings = modules.iter().flat_map(|module| {
            let settings = core.settings(&module.name).unwrap_or_default();
            settings.into_iter().map(move |setting| format!("{}.{}", module.name, setting.name))
        });
        Self {
            topics: core.topics().cloned().collect(),
            services: core.services().cloned().collect(),
            settings: settings.collect(),
            ..Self::of_graph(&core.graph(), &modules)
        }
    }

    /// The same of a core that runs, without its settings; `None` if it does not answer.
    pub(crate) fn of_running(core: &CoreHandle) -> Option<Self> {
        let (topics, services, graph, modules) =
            (core.topics(), core.services(), core.graph(), core.modules());
        Some(Self {
            topics: topics.wait(PATIENCE)?,
            services: services.wait(PATIENCE)?,
            ..Self::of_graph(&graph.wait(PATIENCE)?, &modules.wait(PATIENCE)?)
        })
    }

    fn of_graph(graph: &Graph, modules: &[ModuleInfo]) -> Self {
        let published = graph.edges.iter().filter_map(|edge| match *edge {
            GraphEdge::Publishes { module, topic } => {
                Some((graph.modules.get(module)?.name.clone(), graph.topics.get(topic)?.name.clone()))
            }
            _ => None,
        });
        let received = graph.edges.iter().filter_map(|edge| match *edge {
            GraphEdge::Subscribes { topic, .. } => Some(graph.topics.get(topic)?.name.clone()),
            _ => None,
        });
        let stopped = modules.iter().filter(|module| module.panic.is_some());
        Self {
            modules: graph.modules.iter().map(|module| module.name.clone()).collect(),
            stopped: stopped.map(|module| module.name.to_string()).collect(),
            publishers: published.collect(),
            received: received.collect(),
            ..Self::default()
        }
    }

    /// Adds what a module that is about to join declares.
    #[must_use]
    pub(crate) fn with(mut self, declared: &Declarations, options: &ModuleOptions) -> Self {
        let module = declared.module_name();
        for topic in declared.topics(options) {
            if topic.is_published {
                self.publishers.push((module.to_owned(), topic.name.to_string()));
            }
            match self.topics.iter_mut().find(|known| known.name == topic.name) {
                Some(known) => known.is_published |= topic.is_published,
                None => self.topics.push(topic),
            }
        }
        for service in declared.services(options) {
            match self.services.iter_mut().find(|known| known.name == service.name) {
                Some(known) if known.server.is_none() => known.server = service.server,
                Some(_) => {}
                None => self.services.push(service),
            }
        }
        self
    }

    /// The same for a file whose names need not all mean something: [`problems`](Self::problems) has those
    /// that do not.
    #[must_use]
    pub(crate) fn lenient(self) -> Self {
        Self { problems: Some(RefCell::default()), ..self }
    }

    /// The names of the file that mean nothing here, once each: sentences with path and line.
    pub(crate) fn problems(&self) -> Vec<String> {
        self.problems.as_ref().map(|problems| problems.borrow().clone()).unwrap_or_default()
    }

    /// Whether the module has stopped, or could not be made.
    pub(crate) fn has_stopped(&self, module: &str) -> bool {
        self.stopped.iter().any(|stopped| stopped == module)
    }

    pub(crate) fn services(&self) -> &[ServiceInfo] {
        &self.services
    }

    pub(super) fn topics_published_by(&self, module: &str) -> impl Iterator<Item = String> {
        let of_module = self.publishers.iter().filter(move |(publisher, _)| publisher == module);
        of_module.map(|(_, topic)| topic.clone())
    }

    /// Whether modules receive the topic and none publishes it, but something outside of the core does: the
    /// bridge, once the topic is exposed.
    pub(super) fn comes_from_outside(&self, topic: &TopicInfo) -> bool {
        let is_published = self.publishers.iter().any(|(_, published)| *published == *topic.name);
        topic.is_published && !is_published && self.received.iter().any(|received| *received == *topic.name)
    }

    /// Notes an error where that is none here.
    pub(super) fn admit<T>(&self, result: Result<T, RobotFileError>) -> Result<Option<T>, RobotFileError> {
        match (result, &self.problems) {
            (Err(problem), Some(problems)) => {
                let (problem, mut problems) = (problem.to_string(), problems.borrow_mut());
                if !problems.contains(&problem) {
                    problems.push(problem);
                }
                Ok(None)
            }
            (result, _) => result.map(Some),
        }
    }

    /// What the entries of a file mean.
    pub(super) fn each<E, T>(
        &self,
        entries: &[E],
        meaning: impl Fn(&E) -> Result<T, RobotFileError>,
    ) -> Result<Vec<T>, RobotFileError> {
        let found = entries.iter().map(|entry| self.admit(meaning(entry)));
        found.filter_map(Result::transpose).collect()
    }
}
