//! The client side of the inspection socket.

use std::io::{self, BufRead, BufReader, Write};
use std::time::Duration;

use downbeat_executor::{Graph, Snapshot};
use serde::de::DeserializeOwned;

use super::sockets::UnixStream;
use super::{Answer, Request, RunningRobot, TopicValues};
use crate::table::NumberField;
use crate::{ChainReport, EndpointReport};

/// How long an answer may take. Longer than the robot itself waits for the cycles of a trace.
const PATIENCE: Duration = Duration::from_secs(60);

/// A connection to a running robot.
pub struct Client {
    robot: RunningRobot,
    stream: BufReader<UnixStream>,
}

/// Error of a request to a running robot.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The robot cannot be reached.
    #[error("cannot reach robot {robot}: {source}; it may have ended")]
    Connection {
        /// Name and process id of the robot.
        robot: String,
        /// The error of the operating system.
        source: io::Error,
    },
    /// The robot refused the request.
    #[error("robot {robot} says: {refusal}")]
    Refused {
        /// Name and process id of the robot.
        robot: String,
        /// The reason that the robot gave.
        refusal: String,
    },
    /// The answer of the robot cannot be parsed.
    #[error("robot {robot} gave an answer that cannot be parsed; does it run another version? {source}")]
    Answer {
        /// Name and process id of the robot.
        robot: String,
        /// The parse error.
        source: serde_json::Error,
    },
}

impl Client {
    /// Connects to a robot.
    ///
    /// # Errors
    /// Returns an error if the robot has ended.
    pub fn connect(robot: &RunningRobot) -> Result<Self, ClientError> {
        let connect = || {
            let stream = UnixStream::connect(&robot.socket)?;
            stream.set_read_timeout(Some(PATIENCE))?;
            stream.set_write_timeout(Some(PATIENCE))?;
            Ok(stream)
        };
        let stream =
            connect().map_err(|source| ClientError::Connection { robot: robot.to_string(), source })?;
        Ok(Self { robot: robot.clone(), stream: BufReader::new(stream) })
    }

    /// The robot.
    #[must_use]
    pub fn robot(&self) -> &RunningRobot {
        &self.robot
    }

    /// Returns the current counters of the robot.
    ///
    /// # Errors
    /// Returns an error if the robot has ended or refuses the request.
    pub fn snapshot(&mut self) -> Result<Snapshot, ClientError> {
        self.value_of(Request::Snapshot)
    }

    /// Returns how modules, topics and services are connected.
    ///
    /// # Errors
    /// Returns an error if the robot has ended or refuses the request.
    pub fn graph(&mut self) -> Result<Graph, ClientError> {
        self.value_of(Request::Graph)
    }

    /// Returns a trace of the next cycles in Chrome's Trace Event Format.
    ///
    /// # Errors
    /// Returns an error if the robot has ended or refuses the request.
    pub fn trace(&mut self, cycles: u32) -> Result<String, ClientError> {
        self.ask(Request::Trace { cycles })
    }

    /// Returns what was measured of the chains of `[[latency]]`.
    ///
    /// # Errors
    /// Returns an error if the robot has ended or does not know the request, as earlier versions.
    pub fn latencies(&mut self) -> Result<Vec<ChainReport>, ClientError> {
        self.value_of(Request::Latencies)
    }

    /// Pauses the robot.
    ///
    /// # Errors
    /// Returns an error if the robot has ended or refuses the request.
    pub fn pause(&mut self) -> Result<(), ClientError> {
        self.value_of(Request::Pause)
    }

    /// Resumes a paused robot.
    ///
    /// # Errors
    /// Returns an error if the robot has ended or refuses the request.
    pub fn resume(&mut self) -> Result<(), ClientError> {
        self.value_of(Request::Resume)
    }

    /// Lets a paused robot run one cycle.
    ///
    /// # Errors
    /// Returns an error if the robot has ended or refuses the request.
    pub fn step(&mut self) -> Result<(), ClientError> {
        self.value_of(Request::Step)
    }

    /// Opens the page of the robot and returns its URL, which holds the token.
    ///
    /// # Errors
    /// Returns an error if the robot has ended or has no page.
    pub fn view(&mut self) -> Result<String, ClientError> {
        self.value_of(Request::View)
    }

    /// Returns the endpoints that are exposed to ROS 2.
    ///
    /// # Errors
    /// Returns an error if the robot has ended or refuses the request.
    pub fn exposed(&mut self) -> Result<Vec<EndpointReport>, ClientError> {
        self.value_of(Request::Exposed)
    }

    /// Exposes more topics; `entries` has the form of the keys `out` and `in` of `[expose]` in a robot file.
    /// Returns the endpoints that were added.
    ///
    /// # Errors
    /// Returns an error if the robot has ended or refuses the request.
    pub fn expose(&mut self, entries: String) -> Result<Vec<EndpointReport>, ClientError> {
        self.value_of(Request::Expose { entries })
    }

    /// Removes the endpoints with these names or patterns. Returns the removed endpoints.
    ///
    /// # Errors
    /// Returns an error if the robot has ended or refuses the request.
    pub fn take_back(&mut self, topics: Vec<String>) -> Result<Vec<EndpointReport>, ClientError> {
        self.value_of(Request::TakeBack { topics })
    }

    /// Watches fields of a topic, and no others of it, until this client is dropped: paths of numbers such as
    /// `position[3]`, or `position[head_tilt]` by the name of the element. Without fields, only
    /// [`numbers`](Self::numbers) are known of the topic.
    ///
    /// # Errors
    /// Returns an error if the robot has ended or has no such topic or field.
    pub fn watch(&mut self, topic: &str, fields: &[String]) -> Result<(), ClientError> {
        self.value_of(Request::Watch { topic: topic.to_owned(), fields: fields.to_vec() })
    }

    /// Ends watching a topic.
    ///
    /// # Errors
    /// Returns an error if the robot has ended.
    pub fn unwatch(&mut self, topic: &str) -> Result<(), ClientError> {
        self.value_of(Request::Unwatch { topic: topic.to_owned() })
    }

    /// Returns which numbers the latest message of a watched topic has; `None` if there was no message since
    /// it is watched.
    ///
    /// # Errors
    /// Returns an error if the robot has ended or the topic is not watched.
    pub fn numbers(&mut self, topic: &str) -> Result<Option<Vec<NumberField>>, ClientError> {
        self.value_of(Request::Numbers { topic: topic.to_owned() })
    }

    /// Returns the values of all watched fields since the last call. The robot keeps
    /// [`Watch::MOST_VALUES`](super::Watch::MOST_VALUES) of each.
    ///
    /// # Errors
    /// Returns an error if the robot has ended.
    pub fn values(&mut self) -> Result<Vec<TopicValues>, ClientError> {
        self.value_of(Request::Values)
    }

    fn value_of<T: DeserializeOwned>(&mut self, request: Request) -> Result<T, ClientError> {
        let json = self.ask(request)?;
        serde_json::from_str(&json).map_err(|source| self.not_understood(source))
    }

    fn ask(&mut self, request: Request) -> Result<String, ClientError> {
        let line = self.exchange(request).map_err(|source| {
            let robot = self.robot.to_string();
            ClientError::Connection { robot, source }
        })?;
        match serde_json::from_str(&line).map_err(|source| self.not_understood(source))? {
            Answer::Ok(json) => Ok(Box::<str>::from(json).into()),
            Answer::Error(refusal) => Err(ClientError::Refused { robot: self.robot.to_string(), refusal }),
        }
    }

    fn exchange(&mut self, request: Request) -> io::Result<String> {
        let mut line = serde_json::to_string(&request)?;
        line.push('\n');
        let written = self.stream.get_mut().write_all(line.as_bytes());
        line.clear();
        // A robot that rejects a client sends the reason and closes the connection without reading the
        // request.
        match (self.stream.read_line(&mut line), written) {
            (Ok(1..), _) => Ok(line),
            (_, Err(error)) | (Err(error), _) => Err(error),
            (Ok(0), Ok(())) => Err(io::ErrorKind::UnexpectedEof.into()),
        }
    }

    fn not_understood(&self, source: serde_json::Error) -> ClientError {
        ClientError::Answer { robot: self.robot.to_string(), source }
    }
}
