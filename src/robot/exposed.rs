//! What is exposed, for people and for other programs to read.

use std::fmt;
use std::time::Duration;

use downbeat_bridge::expose::{BridgeStatus, EndpointReport, Exposure, Limits, OfACycle};
use downbeat_bridge::middleware;
use downbeat_bridge::ros::{NodeName, Policy, QosRequest, TopicName};
use downbeat_executor::CoreHandle;
use downbeat_msgs::qos::{Durability, History, Liveliness, Reliability};
use serde::{Deserialize, Serialize};

use super::file::{ExposeEntry, RobotFile, RobotFileError};

type Result<T> = std::result::Result<T, RobotFileError>;

/// How long a running core may take to tell its topics.
const PATIENCE: Duration = Duration::from_secs(5);

/// An endpoint of ROS 2 for a topic of the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExposedEndpoint {
    /// The topic in the robot.
    pub topic: String,
    /// The topic in ROS 2, absolute, after remapping.
    pub ros_topic: String,
    /// The node that has the endpoint, absolute, after remapping.
    pub node: String,
    /// `out` or `in`, seen from the robot.
    pub direction: String,
    /// As in `sensor_msgs/msg/Imu`.
    #[serde(rename = "type")]
    pub type_name: String,
    /// What it offers or requests.
    pub qos: ExposedQos,
    /// At most so many messages per second pass.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_hz: Option<f64>,
    /// One of so many messages passes.
    pub every: u32,
    /// True if of one cycle only the last message passes.
    pub latest_only: bool,
    /// What went through so far, where the robot runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub traffic: Option<ExposedTraffic>,
}

/// Quality of service in the words of robot files; what is left open is `best_available`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExposedQos {
    /// `reliable` or `best_effort`.
    pub reliability: String,
    /// `volatile` or `transient_local`.
    pub durability: String,
    /// `keep_last` or `keep_all`.
    pub history: String,
    /// Of `keep_last`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<u32>,
    /// A time such as `100ms`, or `infinite`.
    pub deadline: String,
    /// A time such as `100ms`, or `infinite`.
    pub lifespan: String,
    /// `automatic` or `manual_by_topic`.
    pub liveliness: String,
    /// A time such as `100ms`, or `infinite`.
    pub liveliness_lease_duration: String,
}

/// What went through an endpoint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExposedTraffic {
    /// Endpoints of others that are matched.
    pub matched: usize,
    /// Messages that went through.
    pub messages: u64,
    /// Messages that nobody was there for.
    pub skipped: u64,
    /// Messages that the limits held back.
    pub limited: u64,
    /// Messages that should have gone through and did not.
    pub errors: u64,
}

impl RobotFile {
    /// What ROS 2 will see of these exposures, with all names as remapping rules have them.
    ///
    /// # Errors
    /// If ROS 2 does not accept a name.
    pub fn exposed(&self, exposures: &[Exposure]) -> Result<Vec<ExposedEndpoint>> {
        exposures.iter().map(|exposure| self.exposed_endpoint(exposure)).collect()
    }

    /// What more is to be exposed of a running robot, as the keys `out` and `in` of `[expose]` say it. Patterns leave
    /// alone what is exposed already.
    ///
    /// # Errors
    /// If the text says something that cannot be, or the core does not answer.
    pub fn exposures_while_running(
        &self,
        text: &str,
        core: &CoreHandle,
        status: &BridgeStatus,
    ) -> Result<Vec<Exposure>> {
        let entries: Vec<ExposeEntry> = Self::parse_entries(text, &self.catalog.interfaces)?;
        let topics = core.topics().wait(PATIENCE).ok_or_else(|| {
            self.source
                .error(1, "the core does not answer: it has stopped or is held, or a module does not return")
        })?;
        let taken: Vec<_> = status.endpoints().into_iter().map(|endpoint| endpoint.topic).collect();
        // The lines are those of this text, not of the robot file.
        self.exposures_of(&entries, &topics, &taken).map_err(|error| match error {
            RobotFileError::Line { line, problem, .. } => {
                RobotFileError::Line { path: "expose".into(), line, problem }
            }
            other => other,
        })
    }

    fn exposed_endpoint(&self, exposure: &Exposure) -> Result<ExposedEndpoint> {
        let refuse = |error: &dyn fmt::Display| self.source.error(1, error.to_string());
        let given: NodeName = exposure.node.clone().map_or_else(|| self.given_node_name(), Ok)?;
        let node = self.remaps.node(&given).map_err(|error| refuse(&error))?;
        let topic = TopicName::expand(exposure.ros_topic(), &node).map_err(|error| refuse(&error))?;
        let topic = self.remaps.topic(topic, &node).map_err(|error| refuse(&error))?;
        let Limits { period, every, of_a_cycle } = exposure.limits;
        Ok(ExposedEndpoint {
            topic: exposure.topic.clone(),
            ros_topic: topic.to_string(),
            node: node.to_string(),
            direction: direction(exposure.direction).to_owned(),
            type_name: exposure.message_type.name().to_owned(),
            qos: ExposedQos::of(&exposure.qos),
            rate_hz: period.map(rate),
            every: every.max(1),
            latest_only: of_a_cycle == OfACycle::Latest,
            traffic: None,
        })
    }
}

impl ExposedEndpoint {
    /// An endpoint of a running robot.
    #[must_use]
    pub fn of_report(report: &EndpointReport) -> Self {
        let EndpointReport { matched, messages, skipped, limited, errors, limits, .. } = *report;
        Self {
            topic: report.topic.clone(),
            ros_topic: report.ros_topic.clone(),
            node: report.node.clone(),
            direction: direction(report.direction).to_owned(),
            type_name: report.type_name.to_owned(),
            qos: ExposedQos::of(&report.qos.into()),
            rate_hz: limits.period.map(rate),
            every: limits.every.max(1),
            latest_only: limits.of_a_cycle == OfACycle::Latest,
            traffic: Some(ExposedTraffic { matched, messages, skipped, limited, errors }),
        }
    }
}

impl fmt::Display for ExposedEndpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let arrow = if self.direction == "out" { "->" } else { "<-" };
        let Self { topic, ros_topic, type_name, qos, .. } = self;
        write!(f, "{topic:<24} {arrow} {ros_topic:<28} {type_name:<32} {qos}")?;
        if let Some(rate) = self.rate_hz {
            write!(f, ", at most {rate} Hz")?;
        }
        if self.every > 1 {
            write!(f, ", one of {}", self.every)?;
        }
        if self.latest_only {
            f.write_str(", latest only")?;
        }
        let Some(traffic) = self.traffic else { return Ok(()) };
        write!(f, ", {} matched, {} messages", traffic.matched, traffic.messages)?;
        for (count, what) in [(traffic.limited, "held back"), (traffic.errors, "failed")] {
            if count > 0 {
                write!(f, ", {count} {what}")?;
            }
        }
        Ok(())
    }
}

impl ExposedQos {
    fn of(request: &QosRequest) -> Self {
        let (history, depth) = match request.history {
            History::KeepLast(depth) => ("keep_last", Some(depth)),
            History::KeepAll => ("keep_all", None),
        };
        Self {
            reliability: word(request.reliability, |policy| match policy {
                Reliability::Reliable => "reliable".into(),
                Reliability::BestEffort => "best_effort".into(),
            }),
            durability: word(request.durability, |policy| match policy {
                Durability::Volatile => "volatile".into(),
                Durability::TransientLocal => "transient_local".into(),
            }),
            history: history.to_owned(),
            depth,
            deadline: word(request.deadline, time),
            lifespan: time(request.lifespan),
            liveliness: word(request.liveliness, |policy| match policy {
                Liveliness::Automatic => "automatic".into(),
                Liveliness::ManualByTopic => "manual_by_topic".into(),
            }),
            liveliness_lease_duration: word(request.liveliness_lease_duration, time),
        }
    }
}

/// What differs from case to case in words; the rest where it is not as usual.
impl fmt::Display for ExposedQos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} {}", self.reliability, self.durability, self.history)?;
        if let Some(depth) = self.depth {
            write!(f, " {depth}")?;
        }
        for (policy, name, usual) in [
            (&self.deadline, "deadline", "infinite"),
            (&self.lifespan, "lifespan", "infinite"),
            (&self.liveliness, "liveliness", "automatic"),
            (&self.liveliness_lease_duration, "lease", "infinite"),
        ] {
            if policy != usual {
                write!(f, " {name} {policy}")?;
            }
        }
        Ok(())
    }
}

fn word<T: Copy>(policy: Policy<T>, given: impl Fn(T) -> String) -> String {
    match policy {
        Policy::Given(policy) => given(policy),
        Policy::BestAvailable => "best_available".into(),
    }
}

fn time(duration: Option<Duration>) -> String {
    duration.map_or_else(|| "infinite".into(), |duration| format!("{duration:?}"))
}

fn direction(direction: middleware::Direction) -> &'static str {
    match direction {
        middleware::Direction::Out => "out",
        middleware::Direction::In => "in",
    }
}

/// In messages per second, without the noise of binary fractions.
fn rate(period: Duration) -> f64 {
    (1e6 / period.as_secs_f64()).round() / 1e6
}
