//! Requests that only the thread that records can answer: services of rosbag2's recorder.
//!
//! Names, types and responses are those of `rosbag2_transport/src/rosbag2_transport/recorder.cpp`, release
//! 0.26.10 for Jazzy.

use std::sync::mpsc::{Receiver, Sender, channel};

use downbeat_bridge::ros::{Node, NodeError, Reply, Service};
use downbeat_msgs::Service as ServiceType;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rosbag2_interfaces::srv::{
    IsDiscoveryRunning, IsDiscoveryRunningResponse, Record, RecordResponse, StartDiscovery,
    StartDiscoveryResponse, Stop, StopDiscovery, StopDiscoveryResponse, StopResponse,
};

/// A request, with the handle for its response.
pub(super) enum Control {
    /// Begin a recording in the directory of that URI; an empty one leaves the choice.
    Record(String, Reply<Record>),
    Stop(Reply<Stop>),
    StartDiscovery(Reply<StartDiscovery>),
    StopDiscovery(Reply<StopDiscovery>),
    IsDiscoveryRunning(Reply<IsDiscoveryRunning>),
}

/// The services, which exist until it is dropped.
pub(super) struct Controls {
    requests: Receiver<Control>,
    _services: Vec<Service>,
}

impl Controls {
    pub(super) fn offer(node: &Node) -> Result<Self, NodeError> {
        let (sender, requests) = channel();
        let services = vec![
            serve::<Record>(node, "~/record", &sender, |request, reply| Control::Record(request.uri, reply))?,
            serve::<Stop>(node, "~/stop", &sender, |_, reply| Control::Stop(reply))?,
            serve::<StartDiscovery>(node, "~/start_discovery", &sender, |_, reply| {
                Control::StartDiscovery(reply)
            })?,
            serve::<StopDiscovery>(node, "~/stop_discovery", &sender, |_, reply| {
                Control::StopDiscovery(reply)
            })?,
            serve::<IsDiscoveryRunning>(node, "~/is_discovery_running", &sender, |_, reply| {
                Control::IsDiscoveryRunning(reply)
            })?,
        ];
        Ok(Self { requests, _services: services })
    }

    /// Returns a request that has arrived.
    pub(super) fn next(&self) -> Option<Control> {
        self.requests.try_recv().ok()
    }
}

fn serve<S: ServiceType>(
    node: &Node,
    name: &str,
    sender: &Sender<Control>,
    control: fn(S::Request, Reply<S>) -> Control,
) -> Result<Service, NodeError> {
    let sender = sender.clone();
    node.serve_later::<S>(name, QosProfile::SERVICES, move |request, reply| {
        // If the recorder has ended, the service is about to be removed.
        let _ = sender.send(control(request, reply));
    })
}

/// What a caller is told of the outcome of its request.
pub(super) trait Outcome {
    fn answer(self, outcome: Result<(), String>);
}

impl Outcome for Reply<Record> {
    fn answer(self, outcome: Result<(), String>) {
        let (return_code, error_string) = returned(outcome);
        send(self, &RecordResponse { return_code, error_string });
    }
}

impl Outcome for Reply<StartDiscovery> {
    fn answer(self, outcome: Result<(), String>) {
        let (return_code, error_string) = returned(outcome);
        send(self, &StartDiscoveryResponse { return_code, error_string });
    }
}

impl Outcome for Reply<StopDiscovery> {
    fn answer(self, outcome: Result<(), String>) {
        let (return_code, error_string) = returned(outcome);
        send(self, &StopDiscoveryResponse { return_code, error_string });
    }
}

/// Answers a request of `~/stop`.
pub(super) fn stopped(reply: Reply<Stop>) {
    send(reply, &StopResponse::default());
}

/// Answers a request of `~/is_discovery_running`.
pub(super) fn is_running(reply: Reply<IsDiscoveryRunning>, running: bool) {
    send(reply, &IsDiscoveryRunningResponse { running });
}

/// The return code and the error string.
fn returned(outcome: Result<(), String>) -> (i32, String) {
    outcome.map_or_else(|problem| (1, problem), |()| (0, String::new()))
}

/// Errors are ignored, since the client may have disappeared.
fn send<S: ServiceType>(reply: Reply<S>, response: &S::Response) {
    if let Err(error) = reply.send(response) {
        tracing::debug!("an answer was not sent: {error}");
    }
}
