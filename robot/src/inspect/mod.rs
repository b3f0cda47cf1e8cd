//! Inspection of a running robot from another process through a local socket.
//!
//! A running robot opens a Unix socket in a directory that only its user can access: see
//! [`InspectionServer`]. Each received line is a [`Request`] in JSON; each sent line is an answer, `{"ok":
//! …}` or `{"error": "…"}`. `downbeat top`, `downbeat trace` and `downbeat expose` are clients. So is this
//! command:
//!
//! ```text
//! $ echo '{"request":"snapshot"}' | nc -U $XDG_RUNTIME_DIR/downbeat/darwin_op-1234.sock
//! ```
//!
//! ```
//! use std::sync::Arc;
//! use downbeat_executor::{CycleTrace, Graph, Snapshot};
//! use downbeat_robot::inspect::{Client, Inspected, InspectionServer, SocketDirectory, Unavailable};
//!
//! struct Robot;
//!
//! impl Inspected for Robot {
//!     fn snapshot(&self) -> Result<Snapshot, Unavailable> {
//!         Ok(Snapshot { cycle: 42, ..Snapshot::default() })
//!     }
//!     # fn trace(&self, _: u32) -> Result<CycleTrace, Unavailable> { Err(Unavailable::NoAnswer) }
//!     # fn graph(&self) -> Result<Graph, Unavailable> { Err(Unavailable::NoAnswer) }
//!     # fn pause(&self) {}
//!     # fn resume(&self) {}
//!     # fn step(&self) {}
//!     // and so on
//! }
//!
//! # let folder = tempfile::tempdir()?;
//! # let directory = SocketDirectory::open_at(folder.path().join("downbeat"))?;
//! // `SocketDirectory::open()?` is where the program looks.
//! let _server = InspectionServer::start(&directory, "darwin_op", Arc::new(Robot))?;
//! let robots = directory.running()?;
//! assert_eq!(Client::connect(&robots[0])?.snapshot()?.cycle, 42);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod client;
mod directory;
mod error;
mod server;
#[cfg_attr(not(unix), path = "sockets_elsewhere.rs")]
mod sockets;
mod watch;

use std::time::Duration;

use downbeat_executor::{CoreHandle, CycleTrace, Graph, Snapshot};
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use crate::{ChainReport, EndpointReport};
pub use client::{Client, ClientError};
pub use directory::{NodeClaim, RunningRobot, SocketDirectory};
pub use error::{ClaimError, DirectoryError};
pub use server::{InspectionServer, ServerError};
pub use watch::{FieldValues, TopicValues, Watch};

/// A request of a client, for example `{"request":"snapshot"}` or `{"request":"trace","cycles":10}`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "request", rename_all = "snake_case")]
pub enum Request {
    /// Requests the counters. Answered with a [`Snapshot`].
    Snapshot,
    /// Requests a trace of the next cycles. Answered in Chrome's Trace Event Format.
    Trace {
        /// Number of cycles, from 1 to [`Request::MOST_CYCLES`].
        cycles: u32,
    },
    /// Requests the connections. Answered with a [`Graph`].
    Graph,
    /// Requests what was measured of the chains of `[[latency]]`. Answered with a list of [`ChainReport`]s.
    Latencies,
    /// Pauses the robot. Answered with `null`, like the next two requests.
    Pause,
    /// Resumes the robot.
    Resume,
    /// Lets a paused robot run one cycle.
    Step,
    /// Opens the page of the robot. Answered with its URL, which holds the token.
    View,
    /// Requests the exposed endpoints. Answered with a list of
    /// [`EndpointReport`]s, like the next two requests.
    Exposed,
    /// Exposes more topics. Answered with the added endpoints.
    Expose {
        /// The keys `out` and `in` in the form of `[expose]` in a robot file.
        entries: String,
    },
    /// Removes endpoints. Answered with the removed endpoints.
    TakeBack {
        /// Names of topics in ROS 2 or in the robot, or patterns.
        topics: Vec<String>,
    },
    /// Watches fields of a topic, and no others of it, until the client disconnects. Answered with `null`.
    /// The robot reads its messages only while they are watched.
    Watch {
        /// The topic in the robot.
        topic: String,
        /// Paths of numbers, such as `position[3]`, or `position[head_tilt]` by the name of the element; see
        /// [`Watch::watch`].
        fields: Vec<String>,
    },
    /// Ends watching a topic. Answered with `null`.
    Unwatch {
        /// The topic.
        topic: String,
    },
    /// Requests which numbers the latest message of a watched topic has. Answered with a list of
    /// [`NumberField`](crate::table::NumberField)s, or `null` if there was no message since it is watched.
    Numbers {
        /// The topic.
        topic: String,
    },
    /// Requests the values of the watched fields since the last such request. Answered with a list of
    /// [`TopicValues`].
    Values,
}

impl Request {
    /// The most cycles of one trace.
    pub const MOST_CYCLES: u32 = 100_000;
}

/// The longest request in bytes. Real requests are much shorter.
const LONGEST_REQUEST: u64 = 4096;

/// The answer to a request: `{"ok": …}` or `{"error": "…"}`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Answer {
    Ok(Box<RawValue>),
    Error(String),
}

/// How long a core may take to reach the end of a cycle.
const PATIENCE: Duration = Duration::from_secs(5);

/// How long the cycles of a trace may take. The trace contains the cycles that have run by then.
const PATIENCE_WITH_TRACE: Duration = Duration::from_secs(30);

/// A running robot as seen through the socket. The methods are called from the threads of the socket's
/// clients.
pub trait Inspected: Send + Sync + 'static {
    /// Returns the counters of the robot between two cycles.
    ///
    /// # Errors
    /// Returns an error if the core does not answer.
    fn snapshot(&self) -> Result<Snapshot, Unavailable>;

    /// Traces the next cycles.
    ///
    /// # Errors
    /// Returns an error if the core does not answer.
    fn trace(&self, cycles: u32) -> Result<CycleTrace, Unavailable>;

    /// Returns which modules publish, subscribe, serve and call what.
    ///
    /// # Errors
    /// Returns an error if the core does not answer.
    fn graph(&self) -> Result<Graph, Unavailable>;

    /// Returns what was measured of the chains of `[[latency]]`.
    fn latencies(&self) -> Vec<ChainReport> {
        Vec::new()
    }

    /// Pauses the robot: no cycle runs until it is resumed.
    fn pause(&self);

    /// Resumes the robot.
    fn resume(&self);

    /// Lets a paused robot run one cycle.
    fn step(&self);

    /// Opens the page of the robot, or finds it open, and returns its URL with the token.
    ///
    /// # Errors
    /// Returns a message if the robot has no page.
    fn view(&self) -> Result<String, String> {
        Err(format!("it has no page: it is {}", crate::features::built_without("view")))
    }

    /// Returns the endpoints that are exposed to ROS 2.
    ///
    /// # Errors
    /// Returns a message if the robot has no ROS 2 node.
    fn exposed(&self) -> Result<Vec<EndpointReport>, String> {
        Err(NO_NODE.to_owned())
    }

    /// Exposes more topics; the entries have the form of the keys `out` and `in` of `[expose]` in a robot
    /// file. Returns the endpoints that were added.
    ///
    /// # Errors
    /// Returns a message if an entry is invalid or the robot has no ROS 2 node.
    fn expose(&self, _entries: &str) -> Result<Vec<EndpointReport>, String> {
        Err(NO_NODE.to_owned())
    }

    /// Removes the endpoints with these names or patterns. Returns the removed endpoints.
    ///
    /// # Errors
    /// Returns a message if one of them is not exposed or the robot has no ROS 2 node.
    fn take_back(&self, _topics: &[String]) -> Result<Vec<EndpointReport>, String> {
        Err(NO_NODE.to_owned())
    }

    /// Returns a watch for a client, which watches nothing yet.
    ///
    /// # Errors
    /// Returns a message if the topics of the robot cannot be watched.
    fn watch(&self) -> Result<Watch, String> {
        Err("its topics cannot be watched".to_owned())
    }
}

const NO_NODE: &str = "it runs without a ROS 2 node";

/// Error of a core that does not answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unavailable {
    /// The core has stopped, or is in a cycle that does not end.
    #[error("the core does not answer: it has stopped, or a module does not return")]
    NoAnswer,
}

impl Inspected for CoreHandle {
    fn snapshot(&self) -> Result<Snapshot, Unavailable> {
        self.snapshot().wait(PATIENCE).ok_or(Unavailable::NoAnswer)
    }

    fn trace(&self, cycles: u32) -> Result<CycleTrace, Unavailable> {
        let trace = self.trace(cycles);
        let complete = trace.wait(PATIENCE_WITH_TRACE);
        let cut = || {
            self.finish_trace();
            trace.wait(PATIENCE)
        };
        complete.or_else(cut).ok_or(Unavailable::NoAnswer)
    }

    fn graph(&self) -> Result<Graph, Unavailable> {
        self.graph().wait(PATIENCE).ok_or(Unavailable::NoAnswer)
    }

    fn pause(&self) {
        self.pause();
    }

    fn resume(&self) {
        self.resume();
    }

    fn step(&self) {
        self.step();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_have_the_documented_form() {
        let of = |text| serde_json::from_str::<Request>(text).ok();
        assert_eq!(of(r#"{"request":"snapshot"}"#), Some(Request::Snapshot));
        assert_eq!(of(r#"{"request":"trace","cycles":10}"#), Some(Request::Trace { cycles: 10 }));
        assert_eq!(of(r#"{"request":"trace"}"#), None);
        assert_eq!(of(r#"{"request":"explode"}"#), None);
        let (topic, fields) = ("joint_states".to_owned(), vec!["position[3]".to_owned()]);
        let watch = r#"{"request":"watch","topic":"joint_states","fields":["position[3]"]}"#;
        assert_eq!(of(watch), Some(Request::Watch { topic, fields }));
    }

    #[test]
    fn answers_have_the_documented_form() {
        let ok =
            RawValue::from_string("[1]".into()).map(Answer::Ok).and_then(|ok| serde_json::to_string(&ok));
        assert_eq!(ok.ok().as_deref(), Some(r#"{"ok":[1]}"#));
        let error = serde_json::to_string(&Answer::Error("why".into()));
        assert_eq!(error.ok().as_deref(), Some(r#"{"error":"why"}"#));
    }
}
