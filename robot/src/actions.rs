//! Converts the exposed actions of a robot file to exposures of the bridge.

use downbeat_bridge::expose::{ActionExposure, Exposure, ServiceExposure};
use downbeat_bridge::middleware::Direction;
use downbeat_executor::ServiceInfo;

use super::Robot;
use super::catalog::unregistered;
use super::expose::canonical;
use super::file::{ActionEntry, RobotFile, RobotFileError, suggestion};
use super::services::server_of_the_robot;
use super::survey::Survey;

type Result<T> = std::result::Result<T, RobotFileError>;

/// Suffix of the service that identifies an action.
pub(super) const SEND_GOAL: &str = "/_action/send_goal";

/// Everything that the bridge exposes of a robot: topics, services and actions.
pub struct Exposures {
    /// Topics, including those of actions.
    pub topics: Vec<Exposure>,
    /// Services of modules, including those of actions.
    pub services: Vec<ServiceExposure>,
    /// Services of ROS 2 that modules call, including those of actions.
    pub calls: Vec<ServiceExposure>,
}

impl Robot {
    /// Returns the actions of modules that are exposed to ROS 2.
    ///
    /// # Errors
    /// Returns an error with path and line if no module serves an action, or it has another type.
    pub fn action_exposures(&self) -> Result<Vec<ActionExposure>> {
        self.file.actions_of(&self.survey())
    }

    /// Returns the actions of ROS 2 that modules use.
    ///
    /// # Errors
    /// Returns an error with path and line if a module serves an action itself, or its type is unknown or
    /// differs from the one that modules use.
    pub fn action_call_exposures(&self) -> Result<Vec<ActionExposure>> {
        self.file.action_calls_of(&self.survey())
    }

    /// Returns all topics, services and actions that the file exposes.
    ///
    /// # Errors
    /// Returns the errors of its parts.
    pub fn exposed(&self) -> Result<Exposures> {
        self.file.all_exposures(&self.survey())
    }
}

impl RobotFile {
    /// See [`Robot::action_exposures`].
    fn actions_of(&self, survey: &Survey) -> Result<Vec<ActionExposure>> {
        survey.each(&self.expose.actions, |entry: &ActionEntry| {
            let is_served = |(_, info): &(&str, &ServiceInfo)| server_of_the_robot(info).is_some();
            let Some((action, info)) = action(survey, entry).filter(is_served) else {
                let served = actions(survey).filter(is_served).map(|(name, _)| name);
                let hint = suggestion(&entry.action, served);
                let problem = format!("no module serves an action \"{}\"{hint}", entry.action);
                return Err(self.source.error(entry.line, problem));
            };
            self.action_exposure(entry, action, Some(info))
        })
    }

    /// See [`Robot::action_call_exposures`].
    fn action_calls_of(&self, survey: &Survey) -> Result<Vec<ActionExposure>> {
        let calls = &self.expose.action_calls;
        let names = || calls.iter().map(|call| (call.action.as_str(), call.network.as_deref()));
        survey.each(calls, |entry: &ActionEntry| {
            let name = (entry.action.as_str(), entry.network.as_deref());
            self.refuse_a_second_network(entry.line, name, names())?;
            let found = action(survey, entry);
            if let Some(server) = found.and_then(|(_, info)| server_of_the_robot(info)) {
                let problem = format!("\"{}\" is served by module \"{server}\" already", entry.action);
                return Err(self.source.error(entry.line, problem));
            }
            let action = canonical(&entry.action);
            self.action_exposure(entry, action, found.map(|(_, info)| info))
        })
    }

    /// See [`Robot::exposed`].
    pub(crate) fn all_exposures(&self, survey: &Survey) -> Result<Exposures> {
        let (served, used) = (self.actions_of(survey)?, self.action_calls_of(survey)?);
        let mut all = Exposures {
            topics: self.exposures_among(&self.expose.topics, survey, &[])?,
            services: self.services_of(survey)?,
            calls: self.calls_of(survey)?,
        };
        for action in &served {
            all.topics.extend(action.topics(Direction::Out));
            all.services.extend(action.services());
        }
        for action in &used {
            all.topics.extend(action.topics(Direction::In));
            all.calls.extend(action.services());
        }
        Ok(all)
    }

    fn action_exposure(
        &self,
        entry: &ActionEntry,
        action: &str,
        info: Option<&ServiceInfo>,
    ) -> Result<ActionExposure> {
        let name = &entry.action;
        let refuse = |problem| Err(self.source.error(entry.line, problem));
        let action_type =
            match (info.map(|info| (info, self.catalog.interfaces.action_of(info))), entry.action_type) {
                (Some((info, None)), _) => {
                    let request = info.request_type;
                    return refuse(format!(
                        "\"{name}\" takes {request}, {}",
                        unregistered(request, "goal of ROS 2")
                    ));
                }
                (Some((_, Some(found))), Some(said)) if found != said => {
                    return refuse(format!("\"{name}\" is of type \"{found}\", not \"{said}\""));
                }
                (Some((_, Some(found))), _) => found,
                (None, Some(said)) => said,
                (None, None) => {
                    let such = "tf2_msgs/action/LookupTransform";
                    return refuse(format!(
                        "no module uses \"{name}\"; add its type, such as type = \"{such}\""
                    ));
                }
            };
        Ok(ActionExposure {
            action: action.to_owned(),
            ros_action: Some(entry.ros_action.clone().unwrap_or_else(|| name.clone())),
            action_type,
            timeout: entry.timeout,
            network: entry.network.clone(),
        })
    }
}

/// The actions that modules serve or use, with their names.
fn actions(survey: &Survey) -> impl Iterator<Item = (&str, &ServiceInfo)> {
    survey.services.iter().filter_map(|info| Some((info.name.strip_suffix(SEND_GOAL)?, info)))
}

fn action<'a>(survey: &'a Survey, entry: &ActionEntry) -> Option<(&'a str, &'a ServiceInfo)> {
    actions(survey).find(|(name, _)| *name == canonical(&entry.action))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::file::Source;
    use downbeat_actions::{ActionClient, ActionServer};
    use downbeat_executor::{Core, Module, Setup, SetupError};
    use downbeat_msgs::tf2_msgs::action::LookupTransform;
    use std::path::Path;

    /// Serves `lookup` and uses `far/lookup`.
    #[derive(Default)]
    struct Frames {
        server: ActionServer<LookupTransform>,
        client: ActionClient<LookupTransform>,
    }

    impl Module for Frames {
        type Ports = ();

        fn setup(&mut self, setup: &mut Setup<'_, Self>) -> std::result::Result<(), SetupError> {
            ActionServer::builder(|frames: &mut Self| &mut frames.server).declare(
                setup,
                "lookup",
                &mut self.server,
            )?;
            ActionClient::builder(|frames: &mut Self| &mut frames.client).declare(
                setup,
                "far/lookup",
                &mut self.client,
            )
        }
    }

    fn robot(expose: &str) -> Robot {
        let text =
            format!("[robot]\nname = \"r\"\n[[module]]\nkind = \"stand_nod_wave\"\n[expose]\n{expose}");
        let file = RobotFile::parse(Source::new(Path::new("robot.toml"), text), &crate::Catalog::built_in())
            .unwrap()
            .0;
        let mut core = Core::new();
        core.add("frames", Frames::default()).unwrap();
        Robot { file, core, latencies: Default::default() }
    }

    #[test]
    fn an_action_is_exposed_as_three_services_and_two_topics() {
        let robot = robot(
            "actions = [{ action = \"lookup\", as = \"~/lookup\", timeout = \"2s\" }]\naction_calls = [\"/far/lookup\"]",
        );
        let exposed = robot.exposed().unwrap();
        let services: Vec<_> =
            exposed.services.iter().map(|service| service.ros_service.as_deref().unwrap()).collect();
        assert_eq!(
            services,
            ["send_goal", "cancel_goal", "get_result"].map(|part| format!("~/lookup/_action/{part}"))
        );
        let calls: Vec<_> = exposed.calls.iter().map(|call| &*call.service).collect();
        assert_eq!(
            calls,
            ["send_goal", "cancel_goal", "get_result"].map(|part| format!("far/lookup/_action/{part}"))
        );
        let topics: Vec<_> =
            exposed.topics.iter().map(|topic| (topic.ros_topic().to_owned(), topic.direction)).collect();
        let topic = |name: &str, direction| (name.to_owned(), direction);
        assert_eq!(
            topics,
            [
                topic("~/lookup/_action/feedback", Direction::Out),
                topic("~/lookup/_action/status", Direction::Out),
                topic("/far/lookup/_action/feedback", Direction::In),
                topic("/far/lookup/_action/status", Direction::In),
            ]
        );
        assert_eq!(exposed.services[0].timeout.as_secs(), 2);
        let everything = robot.file.expose.topics.is_empty();
        assert!(everything, "only the actions");
    }

    #[test]
    fn an_action_is_offered_in_several_networks_and_used_in_one() {
        let both = robot("[networks.a]\nactions = [\"lookup\"]\n[networks.b]\nactions = [\"lookup\"]");
        let exposed = both.exposed().unwrap();
        let in_networks = |networks: &[Option<String>]| {
            let number = networks.len() / 2;
            networks.iter().filter(|network| network.as_deref() == Some("a")).count() == number
                && networks.iter().filter(|network| network.as_deref() == Some("b")).count() == number
        };
        let topics: Vec<_> = exposed.topics.into_iter().map(|topic| topic.network).collect();
        let services: Vec<_> = exposed.services.into_iter().map(|service| service.network).collect();
        assert_eq!((topics.len(), services.len()), (4, 6));
        assert!(in_networks(&topics) && in_networks(&services), "{topics:?} {services:?}");
        let both = robot(
            "[networks.a]\naction_calls = [\"far/lookup\"]\n[networks.b]\naction_calls = [\"far/lookup\"]",
        );
        assert_eq!(
            both.exposed().err().unwrap().to_string(),
            "robot.toml:9: \"far/lookup\" is called in network \"a\" already, and can be only in one"
        );
    }

    #[test]
    fn patterns_do_not_match_topics_of_actions() {
        let text = "[robot]\nname = \"r\"\n[[module]]\nkind = \"stand_nod_wave\"\n[expose]\nout = [\"**\"]";
        let file = RobotFile::parse(
            Source::new(Path::new("robot.toml"), text.to_owned()),
            &crate::Catalog::built_in(),
        )
        .unwrap()
        .0;
        let mut robot = file.build(Core::new()).unwrap();
        robot.core.add("frames", Frames::default()).unwrap();
        assert!(robot.exposed().unwrap().topics.iter().all(|topic| !topic.topic.contains("_action")));
    }

    #[test]
    fn errors_contain_the_line_and_the_nearest_name() {
        for (expose, words) in [
            ("actions = [\"lokup\"]", "no module serves an action \"lokup\", did you mean \"lookup\"?"),
            ("actions = [\"far/lookup\"]", "no module serves an action \"far/lookup\""),
            ("action_calls = [\"lookup\"]", "served by module \"frames\" already"),
            ("action_calls = [\"walk\"]", "no module uses \"walk\"; add its type"),
        ] {
            let error = robot(expose).exposed().err().unwrap().to_string();
            assert!(error.starts_with("robot.toml:6: ") && error.contains(words), "{expose}: {error}");
        }
        let wrong = "[robot]\nname = \"r\"\n[[module]]\nkind = \"stand_nod_wave\"\n[expose]\n\
            action_calls = [{ action = \"a\", type = \"tf2_msgs/LookupTransform\" }]";
        let error = RobotFile::parse(
            Source::new(Path::new("robot.toml"), wrong.to_owned()),
            &crate::Catalog::built_in(),
        )
        .err()
        .unwrap();
        assert!(error.to_string().contains("did you mean \"tf2_msgs/action/LookupTransform\"?"), "{error}");
    }
}
