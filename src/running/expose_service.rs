//! `~/expose`: `downbeat expose` for ROS 2.
//!
//! Of the service types of a ROS 2 desktop `rcl_interfaces/srv/SetParameters` says what is needed: a list of names with a
//! value each, and for each whether it was done and why not. So it is called without a package of ours:
//!
//! ```sh
//! ros2 service call /darwin_op/expose rcl_interfaces/srv/SetParameters \
//!   "{parameters: [{name: 'imu/*', value: {type: 4, string_value: 'out, as = \"/sensors/*\", rate_hz = 10.0'}}]}"
//! ```
//!
//! The name is a topic or a pattern; the text is `out` or `in` and behind it the keys of an entry of a robot file. A value of
//! type 0, which is none, takes back what is exposed under that name.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use crate::bridge::ros::{Node, Reply, Service};
use crate::inspect::Inspected;
use crate::msgs::qos::QosProfile;
use crate::msgs::rcl_interfaces::msg::{Parameter, ParameterType, SetParametersResult};
use crate::msgs::rcl_interfaces::srv::{SetParameters, SetParametersRequest, SetParametersResponse};
use crate::robot::{ExposedEndpoint, toml_string};

use super::StartError;
use super::inspected::InspectedRobot;

/// Requests that wait; what is above it is not answered.
const QUEUE: usize = 16;

/// An entry of a robot file has some dozen characters.
const LONGEST_ENTRY: usize = 4096;

/// The service, until it is dropped.
pub(crate) struct ExposeService {
    // Nothing is asked any more when the thread ends.
    _service: Service,
    jobs: SyncSender<Option<Job>>,
    thread: Option<JoinHandle<()>>,
}

type Job = (SetParametersRequest, Reply<SetParameters>);

impl ExposeService {
    /// Offers the service on a node. Requests are answered on a thread of their own, since what goes out waits for the end of
    /// a cycle.
    pub(crate) fn start(node: &Node, robot: Arc<InspectedRobot>) -> Result<Self, StartError> {
        let (jobs, received) = sync_channel(QUEUE);
        let thread = std::thread::Builder::new()
            .name("expose".into())
            .spawn(move || run(&robot, &received))
            .map_err(|source| StartError::Thread { what: "the expose service", source })?;
        let sender = jobs.clone();
        let service =
            node.serve_later::<SetParameters>("~/expose", QosProfile::SERVICES, move |request, reply| {
                if sender.try_send(Some((request, reply))).is_err() {
                    tracing::warn!("a request to expose is not answered: too many others wait");
                }
            })?;
        tracing::info!("exposed service: {}", service.name());
        Ok(Self { _service: service, jobs, thread: Some(thread) })
    }
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
        let results = request.parameters.iter().map(|parameter| answer(change(robot, parameter)));
        let response = SetParametersResponse { results: results.collect() };
        if let Err(error) = reply.send(&response) {
            tracing::warn!("a request to expose is not answered: {error}");
        }
    }
}

fn change(robot: &impl Inspected, parameter: &Parameter) -> Result<Vec<ExposedEndpoint>, String> {
    let Parameter { name, value } = parameter;
    match value.r#type {
        ParameterType::PARAMETER_STRING => robot.expose(&entry(name, &value.string_value)?),
        ParameterType::PARAMETER_NOT_SET => robot.take_back(std::slice::from_ref(name)),
        other => Err(format!(
            "\"{name}\" has a value of type {other}; expected text (4), as in 'out, qos = \"sensor_data\"', or none (0) \
             to take it back"
        )),
    }
}

/// The entry as a robot file would say it, so that one reader understands both.
fn entry(topic: &str, how: &str) -> Result<String, String> {
    let (direction, keys) = how.split_once(',').unwrap_or((how, ""));
    let direction = direction.trim();
    if !["out", "in"].contains(&direction) {
        let found: String = direction.chars().take(40).collect();
        return Err(format!("expected \"out\" or \"in\", found \"{found}\""));
    }
    if topic.len() + how.len() > LONGEST_ENTRY || how.contains(['\n', '\r']) {
        return Err(format!("expected one line of at most {LONGEST_ENTRY} bytes"));
    }
    let separator = if keys.trim().is_empty() { "" } else { "," };
    Ok(format!("{direction} = [{{ topic = {}{separator}{keys} }}]", toml_string(topic)))
}

/// What was done, or why not.
fn answer(result: Result<Vec<ExposedEndpoint>, String>) -> SetParametersResult {
    let told = |endpoints: &Vec<ExposedEndpoint>| {
        let endpoints =
            endpoints.iter().map(|endpoint| format!("{} [{}]", endpoint.ros_topic, endpoint.type_name));
        endpoints.collect::<Vec<_>>().join(", ")
    };
    SetParametersResult {
        successful: result.is_ok(),
        reason: result.as_ref().map_or_else(Clone::clone, told),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_becomes_what_a_robot_file_says() {
        for (how, expected) in [
            ("out", "out = [{ topic = \"imu/*\" }]"),
            (" in ,", "in = [{ topic = \"imu/*\" }]"),
            ("out, as = \"/x/*\", every = 2", "out = [{ topic = \"imu/*\", as = \"/x/*\", every = 2 }]"),
        ] {
            assert_eq!(entry("imu/*", how).as_deref(), Ok(expected));
        }
        for (how, problem) in [
            ("up", "found \"up\""),
            ("out\n", "one line"),
            (&*format!("out,{}", " ".repeat(5000)), "at most"),
        ] {
            let refused = entry("imu/*", how);
            assert!(refused.as_ref().is_err_and(|refusal| refusal.contains(problem)), "{refused:?}");
        }
    }
}
