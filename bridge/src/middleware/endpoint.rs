//! Endpoints, their samples and their identities.

use bytes::Bytes;
use downbeat_msgs::qos::{Durability, Liveliness, QosProfile, Reliability};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::time::Duration;

/// The identity of a participant or an endpoint: on DDS its GUID, 12 bytes of participant and 4 of endpoint;
/// of an endpoint on Zenoh a hash, which has no such parts.
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Default)]
pub struct Gid(pub [u8; 16]);

impl Gid {
    /// The part that all endpoints of a participant share with it.
    #[must_use]
    pub fn participant(self) -> [u8; 12] {
        let mut prefix = [0; 12];
        prefix.copy_from_slice(&self.0[..12]);
        prefix
    }

    /// The two bytes with which the identities of all participants of one DDS implementation begin (RTPS 2.5,
    /// 9.3.1.5).
    #[must_use]
    pub fn vendor(self) -> [u8; 2] {
        [self.0[0], self.0[1]]
    }
}

impl fmt::Debug for Gid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Display for Gid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self, f)
    }
}

/// The namespace and name of a node.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct NodeIdentity {
    /// It begins with a slash; `/` is the root.
    pub namespace: String,
    /// Its name.
    pub name: String,
}

/// The description of an endpoint: names as ROS 2 writes them on DDS, and quality of service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// The topic on DDS, such as `rt/joint_states`.
    pub topic_name: String,
    /// The type on DDS, such as `sensor_msgs::msg::dds_::JointState_`.
    pub type_name: String,
    /// What is offered or requested.
    pub qos: QosProfile,
    /// How many samples a writer may hold for readers that have not acknowledged them, beyond those of its
    /// history depth. A transient local writer holds no more than the greater of 64 and its history depth.
    pub send_window: u32,
    /// How many bytes of samples it may hold for them, beyond those of its history depth: few large samples,
    /// whatever their type. Bounds the memory that a dead or best-effort reader can cost.
    pub send_window_bytes: u64,
    /// How its samples go over a link.
    pub send: SendOptions,
    /// The hash of the type, `RIHS01_` and 64 hex digits, for engines that can announce it.
    pub type_hash: Option<String>,
    /// The node that has it, for engines that announce it with the endpoint.
    pub node: Option<NodeIdentity>,
}

impl Endpoint {
    /// A window that at 125 Hz outlasts the 20 s that Fast DDS takes to notice a killed process; at 1 kB it
    /// holds 4 MB.
    pub const SEND_WINDOW: u32 = 4096;
    /// Holds 64 images of 1 MB.
    pub const SEND_WINDOW_BYTES: u64 = 64 << 20;

    /// An endpoint with these windows.
    #[must_use]
    pub fn new(topic_name: impl Into<String>, type_name: impl Into<String>, qos: QosProfile) -> Self {
        Self {
            topic_name: topic_name.into(),
            type_name: type_name.into(),
            qos,
            send_window: Self::SEND_WINDOW,
            send_window_bytes: Self::SEND_WINDOW_BYTES,
            send: SendOptions::default(),
            type_hash: None,
            node: None,
        }
    }
}

/// How the samples of a writer share a link with others. Zenoh follows it; DDS has no such thing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(default)]
pub struct SendOptions {
    /// Which samples wait for which.
    #[serde(skip_serializing_if = "Priority::is_default")]
    pub priority: Priority,
    /// Whether a sample goes at once, without waiting for others that fit into the same packet.
    #[serde(rename = "express", skip_serializing_if = "std::ops::Not::not")]
    pub is_express: bool,
}

/// A sample overtakes those of lower priorities that wait for a link. From the highest, in Zenoh's words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[expect(missing_docs, reason = "there is no more to say")]
pub enum Priority {
    RealTime,
    InteractiveHigh,
    InteractiveLow,
    DataHigh,
    #[default]
    Data,
    DataLow,
    Background,
}

impl Priority {
    /// All, with the names in robot files.
    pub const ALL: [(&str, Self); 7] = [
        ("real_time", Self::RealTime),
        ("interactive_high", Self::InteractiveHigh),
        ("interactive_low", Self::InteractiveLow),
        ("data_high", Self::DataHigh),
        ("data", Self::Data),
        ("data_low", Self::DataLow),
        ("background", Self::Background),
    ];

    /// The name in robot files.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }

    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// One received message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sample {
    /// The encapsulation header and the body, as they were received.
    pub cdr: Bytes,
    /// When the writer wrote it, in nanoseconds since the Unix epoch; `None` if it sent no time.
    pub source_time_ns: Option<i64>,
    /// Its writer.
    pub writer: Gid,
    /// Its number among the samples of its writer, from 1.
    pub sequence_number: i64,
    /// The sample it belongs to, if its writer named one: of a reply, the request.
    pub related: Option<SampleIdentity>,
}

/// Names one sample: who wrote it, and its number there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SampleIdentity {
    /// The writer; in requests of ROS 2 the reader that waits for the reply.
    pub endpoint: Gid,
    /// The number, or [`UNKNOWN_NUMBER`](Self::UNKNOWN_NUMBER).
    pub number: i64,
}

impl SampleIdentity {
    /// Stands where no number is known (`SEQUENCENUMBER_UNKNOWN`, RTPS 2.5, 9.3.2).
    pub const UNKNOWN_NUMBER: i64 = -(1 << 32);
}

/// Options of one write.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WriteOptions {
    /// The sample it belongs to.
    pub related: Option<SampleIdentity>,
    /// The only reader that is to receive it; nothing for all that are matched.
    pub only_to: Option<Gid>,
}

/// Which way samples go through an endpoint, seen from its owner.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// It writes.
    Out,
    /// It reads.
    In,
}

impl Direction {
    /// The key in robot files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Out => "out",
            Self::In => "in",
        }
    }
}

/// A node of another participant.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct RemoteNodeIdentity {
    /// The participant.
    pub participant: Gid,
    /// Namespace and name, `/robot/talker`, without control characters.
    pub name: String,
}

/// An endpoint of another participant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RemoteEndpoint {
    /// Its identity.
    pub gid: Gid,
    /// Whether it writes or reads.
    pub direction: Direction,
    /// The topic on the wire.
    pub topic_name: String,
    /// The type on the wire.
    pub type_name: String,
    /// Offered or requested reliability.
    pub reliability: Reliability,
    /// Offered or requested durability.
    pub durability: Durability,
    /// The longest time between two samples that it offers or accepts.
    pub deadline: Option<Duration>,
    /// How long a sample of a writer is worth delivering.
    pub lifespan: Option<Duration>,
    /// Offered or requested liveliness.
    pub liveliness: Liveliness,
    /// How long a publisher may be silent before it counts as not alive.
    pub liveliness_lease_duration: Option<Duration>,
    /// The hash of the type, `RIHS01_` and 64 hex digits, if the peer announces it.
    pub type_hash: Option<String>,
    /// Its node, where the engine learns it with the endpoint.
    pub node: Option<RemoteNodeIdentity>,
}

impl RemoteEndpoint {
    /// Its policies as a profile. Discovery does not reveal the history.
    #[must_use]
    pub fn qos(&self) -> QosProfile {
        QosProfile {
            history: QosProfile::DEFAULT.history,
            reliability: self.reliability,
            durability: self.durability,
            deadline: self.deadline,
            lifespan: self.lifespan,
            liveliness: self.liveliness,
            liveliness_lease_duration: self.liveliness_lease_duration,
        }
    }
}
