//! `~/expose`: `downbeat expose` for ROS 2.
//!
//! The service has the type `rcl_interfaces/srv/SetParametersAtomically`, so that it can be called without a
//! package of ours. A request is one entry of `[expose]` in a robot file, a parameter for each key:
//!
//! ```sh
//! ros2 service call /darwin_op/expose rcl_interfaces/srv/SetParametersAtomically "{parameters: [
//!   {name: out, value: {type: 4, string_value: 'imu/*'}}, {name: as, value: {type: 4, string_value: '/sensors/*'}},
//!   {name: rate_hz, value: {type: 3, double_value: 10.0}}]}"
//! ```
//!
//! `out` or `in` has the name of the topic, a pattern, or a list of them; the other keys are those of robot
//! files, with a dot where a key is of a table, as in `qos.reliability`. `remove` alone takes back what is
//! exposed under its names or patterns.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use crate::inspect::Inspected;
use crate::{EndpointReport, toml_string};
use downbeat_bridge::ros::{Node, Reply, Service};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::msg::{Parameter, ParameterType, ParameterValue, SetParametersResult};
use downbeat_msgs::rcl_interfaces::srv::{
    SetParametersAtomically, SetParametersAtomicallyRequest, SetParametersAtomicallyResponse,
};

use super::StartError;
use super::inspected::InspectedRobot;

const NAME: &str = "~/expose";

/// How many requests wait; more are not answered.
const QUEUE: usize = 16;

/// The longest entry, in bytes; one of a robot file has some dozen.
const LONGEST_ENTRY: usize = 4096;

/// The service, until it is dropped.
pub(crate) struct ExposeService {
    // Dropped before the thread ends, so that no request comes after it.
    _service: Service,
    jobs: SyncSender<Option<Job>>,
    thread: Option<JoinHandle<()>>,
}

type Job = (SetParametersAtomicallyRequest, Reply<SetParametersAtomically>);

impl ExposeService {
    /// Offers the service on a node. Requests are answered on a thread of their own, since each waits for the
    /// end of a cycle.
    pub(crate) fn start(node: &Node, robot: Arc<InspectedRobot>) -> Result<Self, StartError> {
        let (jobs, received) = sync_channel(QUEUE);
        let thread = std::thread::Builder::new()
            .name("expose".into())
            .spawn(move || run(&robot, &received))
            .map_err(|source| StartError::Thread { what: "the expose service", source })?;
        let sender = jobs.clone();
        let on_request = move |request, reply| {
            if sender.try_send(Some((request, reply))).is_err() {
                tracing::warn!("a request to expose is not answered: too many others wait");
            }
        };
        let qos = QosProfile::SERVICES;
        let service = node.serve_later::<SetParametersAtomically>(NAME, qos, on_request)?;
        tracing::info!("exposed service: {}", service.name());
        Ok(Self { _service: service, jobs, thread: Some(thread) })
    }
}

/// Offers the service without answering, on a node that no client finds.
pub(super) fn placeholder(node: &Node) -> Result<Service, StartError> {
    Ok(node.serve_later::<SetParametersAtomically>(NAME, QosProfile::SERVICES, |_, _| {})?)
}

impl Drop for ExposeService {
    fn drop(&mut self) {
        // Fails only when the thread has ended.
        let _ = self.jobs.send(None);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of the expose service panicked");
        }
    }
}

fn run(robot: &InspectedRobot, jobs: &Receiver<Option<Job>>) {
    while let Ok(Some((request, reply))) = jobs.recv() {
        let result = result(change(robot, &request.parameters));
        if let Err(error) = reply.send(&SetParametersAtomicallyResponse { result }) {
            tracing::warn!("a request to expose is not answered: {error}");
        }
    }
}

fn change(robot: &impl Inspected, parameters: &[Parameter]) -> Result<Vec<EndpointReport>, String> {
    match parameters {
        [Parameter { name, value }] if name == "remove" => robot.take_back(&topics(name, value)?),
        parameters => robot.expose(&entries(parameters)?),
    }
}

/// The entries as a robot file has them, so that one reader understands both.
fn entries(parameters: &[Parameter]) -> Result<String, String> {
    let is_direction = |parameter: &&Parameter| ["out", "in"].contains(&&*parameter.name);
    let (directions, keys): (Vec<_>, Vec<_>) = parameters.iter().partition(is_direction);
    let [direction] = directions[..] else {
        return Err("expected \"out\" or \"in\" with the keys of an entry, or \"remove\" alone".to_owned());
    };
    let keys = keys
        .into_iter()
        .map(|Parameter { name, value }| Ok(format!(", {} = {}", key(name), toml(name, value)?)));
    let keys = keys.collect::<Result<String, String>>()?;
    let topics = topics(&direction.name, &direction.value)?;
    let entries = topics.iter().map(|topic| format!("{{ topic = {}{keys} }}", toml_string(topic)));
    let text = format!("{} = [{}]", direction.name, entries.collect::<Vec<_>>().join(", "));
    if text.len() > LONGEST_ENTRY {
        return Err(format!("expected an entry of at most {LONGEST_ENTRY} bytes"));
    }
    Ok(text)
}

/// The parts of a name, which may be any text.
fn key(name: &str) -> String {
    name.split('.').map(toml_string).collect::<Vec<_>>().join(".")
}

fn topics(name: &str, value: &ParameterValue) -> Result<Vec<String>, String> {
    match value.r#type {
        ParameterType::PARAMETER_STRING => Ok(vec![value.string_value.clone()]),
        ParameterType::PARAMETER_STRING_ARRAY => Ok(value.string_array_value.clone()),
        other => {
            Err(format!("\"{name}\" has a value of type {other}; expected text (4) or a list of texts (9)"))
        }
    }
}

fn toml(name: &str, value: &ParameterValue) -> Result<String, String> {
    Ok(match value.r#type {
        ParameterType::PARAMETER_BOOL => value.bool_value.to_string(),
        ParameterType::PARAMETER_INTEGER => value.integer_value.to_string(),
        ParameterType::PARAMETER_DOUBLE => format!("{:?}", value.double_value).to_lowercase(),
        ParameterType::PARAMETER_STRING => toml_string(&value.string_value),
        ParameterType::PARAMETER_STRING_ARRAY => {
            let texts = value.string_array_value.iter().map(|text| toml_string(text));
            format!("[{}]", texts.collect::<Vec<_>>().join(", "))
        }
        other => return Err(format!("\"{name}\" has a value of type {other}, which no key of an entry has")),
    })
}

/// The endpoints, or why the request failed.
fn result(outcome: Result<Vec<EndpointReport>, String>) -> SetParametersResult {
    let names = |endpoints: Vec<EndpointReport>| {
        let names = endpoints.iter().map(|EndpointReport { endpoint, .. }| {
            format!("{} [{}]", endpoint.ros_topic, endpoint.type_name)
        });
        names.collect::<Vec<_>>().join(", ")
    };
    let successful = outcome.is_ok();
    SetParametersResult { successful, reason: outcome.map_or_else(|problem| problem, names) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use downbeat_bridge::expose::parameter_value;
    use downbeat_executor::SettingValue;

    fn parameter(name: &str, value: impl Into<SettingValue>) -> Parameter {
        Parameter { name: name.to_owned(), value: parameter_value(&value.into()) }
    }

    #[test]
    fn a_request_becomes_what_a_robot_file_says() {
        let text = |text: &str| SettingValue::Text(text.to_owned());
        let imu = || parameter("out", text("imu/*"));
        let both = SettingValue::Texts(vec!["a".to_owned(), "b".to_owned()]);
        for (parameters, expected) in [
            (vec![imu()], "out = [{ topic = \"imu/*\" }]"),
            (vec![parameter("in", both)], "in = [{ topic = \"a\" }, { topic = \"b\" }]"),
            (
                vec![
                    parameter("as", text("/x/*")),
                    imu(),
                    parameter("every", 2_i64),
                    parameter("rate_hz", 10.0),
                ],
                "out = [{ topic = \"imu/*\", \"as\" = \"/x/*\", \"every\" = 2, \"rate_hz\" = 10.0 }]",
            ),
            (
                vec![imu(), parameter("qos.reliability", text("best_effort"))],
                "out = [{ topic = \"imu/*\", \"qos\".\"reliability\" = \"best_effort\" }]",
            ),
            (
                vec![imu(), parameter("as = 1 }]\n", text("}"))],
                "out = [{ topic = \"imu/*\", \"as = 1 }]\\u000a\" = \"}\" }]",
            ),
        ] {
            assert_eq!(entries(&parameters).as_deref(), Ok(expected));
        }
        for (parameters, problem) in [
            (vec![parameter("up", text("a"))], "expected \"out\" or \"in\""),
            (vec![imu(), parameter("in", text("a"))], "expected \"out\" or \"in\""),
            (vec![parameter("out", 1.0)], "value of type 3"),
            (vec![imu(), parameter("as", text(&" ".repeat(5000)))], "at most"),
        ] {
            let refused = entries(&parameters);
            assert!(refused.as_ref().is_err_and(|refusal| refusal.contains(problem)), "{refused:?}");
        }
    }
}
