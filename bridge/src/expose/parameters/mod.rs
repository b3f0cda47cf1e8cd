//! Settings of modules as parameters of a node: `<module>.<setting>`, with the six services that parameter clients call and
//! the events they listen to.
//!
//! Answers are those of rclcpp (`rclcpp/src/rclcpp/parameter_service.cpp` and `node_interfaces/node_parameters.cpp`, branch
//! jazzy), but for three things: a whole number is accepted for a double, atomic changes of several modules are taken back
//! when one is refused rather than made at once, and a value that changes otherwise than through these services is told within a second.

mod store;
mod thread;
mod value;

use super::TopicPattern;
use crate::ros::{Node, NodeError, Service};
use downbeat_executor::Core;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::srv::{
    DescribeParameters, GetParameterTypes, GetParameters, ListParameters, SetParameters,
    SetParametersAtomically,
};
use store::Parameters;
use thiserror::Error;
use thread::{Jobs, ParameterThread};

/// Which settings are parameters.
#[derive(Clone, Debug, Default)]
pub struct ParameterExposure {
    /// Names `<module>.<setting>`, or patterns for them in which `*` stands for any characters.
    pub settings: Vec<TopicPattern>,
    /// The value of `use_sim_time`: whether the robot follows `/clock`.
    pub follows_clock: bool,
}

/// The parameters of a node could not be exposed.
#[derive(Debug, Error)]
pub enum ParametersError {
    /// A service or the topic of the events could not be created.
    #[error("exposing parameters: {0}")]
    Node(#[from] NodeError),
    /// The thread that answers could not start.
    #[error("starting the thread of the parameters failed: {0}")]
    Thread(#[from] std::io::Error),
}

/// The parameter services of a node. Dropping it removes them.
pub struct ParameterServices {
    // Fields drop in this order: nothing is asked any more when the thread ends.
    _services: [Service; 6],
    _thread: ParameterThread,
}

/// Shows settings of the modules of `core` as parameters of `node`, also of modules that are added later.
///
/// Requests are answered on a thread of their own, since the core takes until its next sync phase to say whether a value
/// is accepted. While it does not answer, the values last known are given.
///
/// # Errors
/// [`ParametersError`] when a service cannot be created.
pub fn expose_parameters(
    core: &Core,
    node: &Node,
    exposure: ParameterExposure,
) -> Result<ParameterServices, ParametersError> {
    let thread = ParameterThread::start(Parameters::new(core, node, exposure)?)?;
    let jobs = thread.jobs();
    Ok(ParameterServices {
        _services: [
            serve::<GetParameters>(node, "~/get_parameters", &jobs, Parameters::get)?,
            serve::<GetParameterTypes>(node, "~/get_parameter_types", &jobs, Parameters::types)?,
            serve::<SetParameters>(node, "~/set_parameters", &jobs, Parameters::set)?,
            serve::<SetParametersAtomically>(
                node,
                "~/set_parameters_atomically",
                &jobs,
                Parameters::set_atomically,
            )?,
            serve::<DescribeParameters>(node, "~/describe_parameters", &jobs, Parameters::describe)?,
            serve::<ListParameters>(node, "~/list_parameters", &jobs, Parameters::list)?,
        ],
        _thread: thread,
    })
}

fn serve<S: downbeat_msgs::Service>(
    node: &Node,
    service: &'static str,
    jobs: &Jobs,
    answer: fn(&mut Parameters, S::Request) -> S::Response,
) -> Result<Service, NodeError> {
    let jobs = jobs.clone();
    node.serve_later::<S>(service, QosProfile::PARAMETERS, move |request, reply| {
        let job = move |parameters: &mut Parameters| {
            if let Err(error) = reply.send(&answer(parameters, request)) {
                tracing::warn!(service, "a request is not answered: {error}");
            }
        };
        if !jobs.push(Box::new(job)) {
            tracing::warn!(service, "a request is not answered: too many others wait");
        }
    })
}
