//! The looking side of the socket.

use std::io::{self, BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use downbeat_executor::{Graph, Snapshot};
use serde::de::DeserializeOwned;

use super::{Answer, Request, RunningRobot};
use crate::robot::EndpointReport;

/// How long an answer may take. A trace waits for its cycles, and the robot gives up on them earlier.
const PATIENCE: Duration = Duration::from_secs(60);

/// A connection to a running robot.
pub struct Client {
    robot: RunningRobot,
    stream: BufReader<UnixStream>,
}

/// Why a running robot tells nothing.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// It cannot be reached.
    #[error("cannot reach robot {robot}: {source}; it may have ended")]
    Connection {
        /// Its name and process.
        robot: String,
        /// What the system said.
        source: io::Error,
    },
    /// It refused.
    #[error("robot {robot} says: {refusal}")]
    Refused {
        /// Its name and process.
        robot: String,
        /// Why.
        refusal: String,
    },
    /// What it said is not understood.
    #[error("robot {robot} gave an answer that is not understood; is it of another version? {source}")]
    Answer {
        /// Its name and process.
        robot: String,
        /// What is wrong with it.
        source: serde_json::Error,
    },
}

impl Client {
    /// Connects to a robot.
    ///
    /// # Errors
    /// If it is gone.
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

    /// The robot's counters now.
    ///
    /// # Errors
    /// If the robot is gone or refuses.
    pub fn snapshot(&mut self) -> Result<Snapshot, ClientError> {
        self.value_of(Request::Snapshot)
    }

    /// Who is connected to what.
    ///
    /// # Errors
    /// If the robot is gone or refuses.
    pub fn graph(&mut self) -> Result<Graph, ClientError> {
        self.value_of(Request::Graph)
    }

    /// A trace of the next cycles, in the Trace Event Format of Chrome.
    ///
    /// # Errors
    /// If the robot is gone or refuses.
    pub fn trace(&mut self, cycles: u32) -> Result<String, ClientError> {
        self.ask(Request::Trace { cycles })
    }

    /// Holds the robot.
    ///
    /// # Errors
    /// If the robot is gone or refuses.
    pub fn pause(&mut self) -> Result<(), ClientError> {
        self.value_of(Request::Pause)
    }

    /// Lets a held robot go on.
    ///
    /// # Errors
    /// If the robot is gone or refuses.
    pub fn resume(&mut self) -> Result<(), ClientError> {
        self.value_of(Request::Resume)
    }

    /// Has a held robot run one cycle.
    ///
    /// # Errors
    /// If the robot is gone or refuses.
    pub fn step(&mut self) -> Result<(), ClientError> {
        self.value_of(Request::Step)
    }

    /// What ROS 2 sees of the robot.
    ///
    /// # Errors
    /// If the robot is gone or refuses.
    pub fn exposed(&mut self) -> Result<Vec<EndpointReport>, ClientError> {
        self.value_of(Request::Exposed)
    }

    /// Exposes more, as the keys `out` and `in` of `[expose]` in a robot file say it. Returns what was added.
    ///
    /// # Errors
    /// If the robot is gone or refuses.
    pub fn expose(&mut self, entries: String) -> Result<Vec<EndpointReport>, ClientError> {
        self.value_of(Request::Expose { entries })
    }

    /// Takes back what is exposed under these names or patterns. Returns what it was.
    ///
    /// # Errors
    /// If the robot is gone or refuses.
    pub fn take_back(&mut self, topics: Vec<String>) -> Result<Vec<EndpointReport>, ClientError> {
        self.value_of(Request::TakeBack { topics })
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
        // A robot that turns a client away says why before it hangs up, and hears nothing.
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
