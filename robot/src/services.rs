//! Converts the exposed services and parameters of a robot file to exposures of the bridge.

use downbeat_bridge::expose::{
    CALLS_MODULE_NAME, ParameterExposure, SERVICES_MODULE_NAME, ServiceExposure, ServiceIntrospection,
};
use downbeat_edge::KnownService;
use downbeat_executor::ServiceInfo;

use super::Robot;
use super::catalog::unregistered;
use super::expose::{canonical, network_name};
use super::file::{RobotFile, RobotFileError, ServiceEntry, suggestion};
use super::survey::Survey;

type Result<T> = std::result::Result<T, RobotFileError>;

/// Matches all settings, even if there are none.
const ALL: &str = "*";

/// The module of the robot that serves a service; the bridge may serve it too, for modules that call others.
pub(super) fn server_of_the_robot(info: &ServiceInfo) -> Option<&str> {
    info.server.as_deref().filter(|server| !server.starts_with(CALLS_MODULE_NAME))
}

impl Robot {
    /// Returns the services of modules that are exposed to ROS 2.
    ///
    /// # Errors
    /// Returns an error with path and line if no module serves a service, or its types are not those of a ROS
    /// 2 service.
    pub fn service_exposures(&self) -> Result<Vec<ServiceExposure>> {
        self.file.services_of(&self.survey())
    }

    /// Returns the services of ROS 2 that modules call.
    ///
    /// # Errors
    /// Returns an error with path and line if a module serves a service itself, or its type is unknown or
    /// differs from the one that modules call.
    pub fn call_exposures(&self) -> Result<Vec<ServiceExposure>> {
        self.file.calls_of(&self.survey())
    }

    /// Returns the settings that are exposed as parameters of the node.
    ///
    /// # Errors
    /// Returns an error with path and line if a name or pattern matches no setting of the modules.
    pub fn parameter_exposure(&self) -> Result<ParameterExposure> {
        self.file.parameters_of(&self.survey())
    }
}

impl RobotFile {
    /// See [`Robot::service_exposures`].
    pub(super) fn services_of(&self, survey: &Survey) -> Result<Vec<ServiceExposure>> {
        survey.each(&self.expose.services, |entry: &ServiceEntry| {
            let served = survey.services.iter().filter(|info| server_of_the_robot(info).is_some());
            let served: Vec<_> = served.collect();
            let Some(info) = served.iter().find(|info| is_named(info, &entry.service)) else {
                let hint = suggestion(&entry.service, served.iter().map(|info| &*info.name));
                return Err(self.refuse(entry, format!("no module serves \"{}\"{hint}", entry.service)));
            };
            Ok(ServiceExposure {
                service: info.name.to_string(),
                ros_service: entry.ros_service.clone(),
                service_type: self.service_type(entry, Some(info))?,
                timeout: entry.timeout,
                network: entry.network.clone(),
            })
        })
    }

    /// See [`Robot::call_exposures`].
    pub(super) fn calls_of(&self, survey: &Survey) -> Result<Vec<ServiceExposure>> {
        let names = || self.expose.calls.iter().map(|call| (call.service.as_str(), call.network.as_deref()));
        survey.each(&self.expose.calls, |entry: &ServiceEntry| {
            let name = (entry.service.as_str(), entry.network.as_deref());
            self.refuse_a_second_network(entry.line, name, names())?;
            let info = survey.services.iter().find(|info| is_named(info, &entry.service));
            if let Some(server) = info.and_then(server_of_the_robot) {
                let problem = format!("\"{}\" is served by module \"{server}\" already", entry.service);
                return Err(self.refuse(entry, problem));
            }
            Ok(ServiceExposure {
                service: entry.service.clone(),
                ros_service: entry.ros_service.clone(),
                service_type: self.service_type(entry, info)?,
                timeout: entry.timeout,
                network: entry.network.clone(),
            })
        })
    }

    /// See [`Robot::parameter_exposure`].
    pub(super) fn parameters_of(&self, survey: &Survey) -> Result<ParameterExposure> {
        let entries = &self.expose.parameters;
        // Settings of a module that is added when services are exposed.
        let introspection = [ServiceIntrospection::OF_SERVICES, ServiceIntrospection::OF_CLIENTS];
        let introspection = introspection.map(|setting| format!("{SERVICES_MODULE_NAME}.{setting}"));
        let names = || survey.settings.iter().chain(&introspection);
        for entry in entries {
            if entry.value.to_string() != ALL && !names().any(|name| entry.value.matches(name)) {
                let hint = suggestion(&entry.value.to_string(), names().map(String::as_str));
                let problem = format!("no module has a setting \"{}\"{hint}", entry.value);
                survey.admit(Err::<(), _>(self.source.error(entry.line, problem)))?;
            }
        }
        let settings = entries.iter().map(|entry| entry.value.clone()).collect();
        Ok(ParameterExposure { settings, of_module: None })
    }

    /// Modules call the server of one network. `calls` are all that the file has, each with its network.
    pub(super) fn refuse_a_second_network<'a>(
        &self,
        line: usize,
        (name, network): (&str, Option<&str>),
        mut calls: impl Iterator<Item = (&'a str, Option<&'a str>)>,
    ) -> Result<()> {
        let first = calls.find(|(other, _)| canonical(other) == canonical(name));
        let Some((_, other)) = first.filter(|(_, other)| *other != network) else { return Ok(()) };
        let other = network_name(other);
        Err(self
            .source
            .error(line, format!("\"{name}\" is called in {other} already, and can be only in one")))
    }

    fn service_type(&self, entry: &ServiceEntry, info: Option<&ServiceInfo>) -> Result<KnownService> {
        let found = info.map(|info| {
            self.catalog.interfaces.service_of(info).ok_or_else(|| {
                let (request, response) = (info.request_type, info.response_type);
                let name = &entry.service;
                let problem = unregistered(request, "ROS service");
                self.refuse(entry, format!("\"{name}\" is {request} -> {response}, {problem}"))
            })
        });
        match (found.transpose()?, entry.service_type) {
            (Some(found), Some(said)) if found != said => {
                let name = &entry.service;
                Err(self.refuse(entry, format!("\"{name}\" is of type \"{found}\", not \"{said}\"")))
            }
            (Some(found), _) => Ok(found),
            (None, Some(said)) => Ok(said),
            (None, None) => {
                let problem = format!(
                    "no module calls \"{}\"; add its type, such as type = \"std_srvs/srv/Trigger\"",
                    entry.service
                );
                Err(self.refuse(entry, problem))
            }
        }
    }

    fn refuse(&self, entry: &ServiceEntry, problem: String) -> RobotFileError {
        self.source.error(entry.line, problem)
    }
}

fn is_named(info: &ServiceInfo, name: &str) -> bool {
    *info.name == *canonical(name)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::file::Source;
    use downbeat_executor::{Core, Module, Setup, SetupError};
    use downbeat_msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse, TriggerRequest, TriggerResponse};
    use std::path::Path;
    use std::time::Duration;

    /// Serves `stand_up` and `odd`, calls `plan`, and has the settings `gain` and `side`.
    struct Legs;

    impl Module for Legs {
        type Ports = ();

        fn setup(&mut self, setup: &mut Setup<'_, Self>) -> std::result::Result<(), SetupError> {
            setup.serve::<SetBoolRequest, SetBoolResponse, _>("stand_up", |_, _, _| Err("no".into()))?;
            setup.serve::<u32, u32, _>("odd", |_, _, _| Err("no".into()))?;
            setup.client::<TriggerRequest, TriggerResponse, _>(
                "plan",
                Duration::from_secs(1),
                |_, _, _| (),
            )?;
            setup.setting("gain", 1.0, "")?;
            setup.setting("side", 1.0, "")?;
            Ok(())
        }
    }

    fn robot(expose: &str) -> Robot {
        let text =
            format!("[robot]\nname = \"r\"\n[[module]]\nkind = \"stand_nod_wave\"\n[expose]\n{expose}");
        let file = RobotFile::parse(Source::new(Path::new("robot.toml"), text), &crate::Catalog::built_in())
            .unwrap()
            .0;
        let mut core = Core::new();
        core.add("legs", Legs).unwrap();
        Robot { file, core, latencies: Default::default() }
    }

    #[test]
    fn services_calls_and_parameters_are_read_with_the_types_of_the_modules() {
        let robot = robot(
            "services = [\"stand_up\"]\n\
             calls = [{ service = \"plan\", as = \"/planner/plan\", timeout = \"2s\" }, \
             { service = \"map\", type = \"std_srvs/srv/Empty\" }]\n\
             parameters = [\"legs.g*\"]",
        );
        let offered = robot.service_exposures().unwrap();
        assert_eq!(
            (&*offered[0].service, offered[0].service_type.name()),
            ("stand_up", "std_srvs/srv/SetBool")
        );
        let called = robot.call_exposures().unwrap();
        assert_eq!(
            (called[0].ros_service.as_deref(), called[0].timeout),
            (Some("/planner/plan"), Duration::from_secs(2))
        );
        assert_eq!(called[0].service_type.name(), "std_srvs/srv/Trigger");
        assert_eq!(called[1].service_type.name(), "std_srvs/srv/Empty");
        let parameters = robot.parameter_exposure().unwrap();
        assert!(parameters.settings[0].matches("legs.gain") && !parameters.settings[0].matches("legs.side"));
    }

    #[test]
    fn a_service_is_offered_in_several_networks_and_called_in_one() {
        let both = robot("services = [\"stand_up\"]\n[networks.fleet]\nservices = [\"stand_up\"]");
        let networks: Vec<_> =
            both.service_exposures().unwrap().into_iter().map(|exposure| exposure.network).collect();
        assert_eq!(networks, [None, Some("fleet".to_owned())]);
        let fleet = robot("[networks.fleet]\ncalls = [\"plan\"]");
        assert_eq!(fleet.call_exposures().unwrap()[0].network.as_deref(), Some("fleet"));
        let both = robot("calls = [\"plan\"]\n[networks.fleet]\ncalls = [\"/plan\"]");
        assert_eq!(
            both.call_exposures().unwrap_err().to_string(),
            "robot.toml:8: \"/plan\" is called in the robot's own network already, and can be only in one"
        );
    }

    #[test]
    fn introspection_has_the_values_of_ros_and_can_be_a_parameter() {
        use downbeat_bridge::ros::Introspection;
        let robot = robot("service_introspection = \"contents\"\nparameters = [\"bridge_services.*\"]");
        let chosen = robot.file.expose.introspection;
        assert_eq!((chosen.services, chosen.clients), (Introspection::Contents, Introspection::Off));
        let parameters = robot.parameter_exposure().unwrap();
        assert!(parameters.settings[0].matches("bridge_services.service_configure_introspection"));
        let text = "[robot]\nname = \"r\"\n[[module]]\nkind = \"stand_nod_wave\"\n[expose]\nclient_introspection = \"on\"";
        let error = RobotFile::parse(
            Source::new(Path::new("robot.toml"), text.to_owned()),
            &crate::Catalog::built_in(),
        )
        .err()
        .unwrap();
        assert_eq!(
            error.to_string(),
            "robot.toml:6: \"on\" is none of \"disabled\", \"metadata\" and \"contents\""
        );
    }

    #[test]
    fn errors_contain_the_line_and_the_nearest_name() {
        for (expose, words) in [
            ("services = [\"stand_upp\"]", "no module serves \"stand_upp\", did you mean \"stand_up\"?"),
            ("services = [\"odd\"]", "u32 -> u32, which is not a ROS service"),
            (
                "services = [{ service = \"stand_up\", type = \"std_srvs/srv/Empty\" }]",
                "is of type \"std_srvs/srv/SetBool\"",
            ),
            ("calls = [\"stand_up\"]", "served by module \"legs\" already"),
            ("calls = [\"map\"]", "add its type"),
            (
                "parameters = [\"legs.gian\"]",
                "no module has a setting \"legs.gian\", did you mean \"legs.gain\"?",
            ),
        ] {
            let robot = robot(expose);
            let errors = [
                robot.service_exposures().err(),
                robot.call_exposures().err(),
                robot.parameter_exposure().err(),
            ];
            let error = errors.into_iter().flatten().next().unwrap().to_string();
            assert!(error.starts_with("robot.toml:6: ") && error.contains(words), "{expose}: {error}");
        }
    }
}
