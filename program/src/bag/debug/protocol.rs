//! What the debugger and its engines say to each other: lines of JSON on sockets.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;

use anyhow::Context;
use downbeat_executor::{Graph, Snapshot};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// What the debugger asks of an engine. Positions count the cycles that have run.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Order {
    /// Run to the end, tell of each cycle, and leave checkpoints on the way.
    Pass,
    /// Run to this position, and leave checkpoints at these on the way.
    Go { to: u64, checkpoints: Vec<u64> },
    /// Run to this position at most: while the condition becomes true nowhere, or to know where it did last.
    Search { condition: String, to: u64, stops: bool },
    /// Go on in a process of its own, which names this number.
    Fork { number: u64 },
    /// Tell what happened in the last cycle.
    Show,
    /// Tell the last message of a topic.
    Print { topic: String },
    /// Tell of a module.
    Module { name: String },
    /// Tell of all modules and topics, and how they are connected.
    Graph,
    /// Tell what was counted of them.
    Snapshot,
}

/// What an engine tells the debugger.
#[derive(Debug, Serialize, Deserialize)]
pub(super) enum Report {
    /// The first report on each connection.
    Here {
        process: u32,
        position: u64,
        role: Role,
    },
    /// What is known before the first cycle.
    About(Box<About>),
    Passed(Passed),
    /// The order was carried out.
    Done {
        position: u64,
        is_at_end: bool,
    },
    /// Where the condition became true.
    Found {
        position: Option<u64>,
        last: u64,
    },
    Cycle(Box<Cycle>),
    Message(Option<Message>),
    Module(Module),
    Graph(Box<Graph>),
    Snapshot(Box<Snapshot>),
    Failed {
        problem: String,
    },
}

/// What an engine is there for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Role {
    /// It was started by the debugger.
    First,
    /// A checkpoint of the first pass.
    Spread,
    /// A checkpoint on the way to a goal.
    Near,
    /// It was ordered, by this number.
    Copy(u64),
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct About {
    pub(super) robot: String,
    pub(super) modules: Vec<String>,
    pub(super) detached: Vec<String>,
    /// The topics of messages that can be read, with their types.
    pub(super) topics: BTreeMap<String, String>,
    /// The topics that each module receives.
    pub(super) subscriptions: BTreeMap<String, Vec<String>>,
    /// Sentences about what differs from the recorded run.
    pub(super) notes: Vec<String>,
    pub(super) cycles: Option<u64>,
    pub(super) first_cycle: u64,
    pub(super) start_ns: i64,
    /// Why there are no checkpoints.
    pub(super) no_checkpoints: Option<String>,
}

/// Some cycles of the first pass.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Passed {
    pub(super) times: Vec<i64>,
    /// The modules and topics that were not named before, in the order of their numbers.
    pub(super) new_modules: Vec<String>,
    pub(super) new_topics: Vec<String>,
    /// For each cycle the numbers of the modules that ran.
    pub(super) runs: Vec<Vec<u32>>,
    /// For each cycle the numbers of topics and how many messages they had.
    pub(super) messages: Vec<Vec<(u32, u32)>>,
    /// The first difference from the bag, if it came up in the last of these cycles.
    pub(super) difference: Option<String>,
}

/// What happened in a cycle.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Cycle {
    pub(super) position: u64,
    pub(super) cycle: u64,
    pub(super) time_ns: i64,
    pub(super) runs: Vec<Run>,
    /// The messages that came from the bag.
    pub(super) given: Vec<Messages>,
    /// Requests, answers and commands that come from no module, in sentences.
    pub(super) events: Vec<String>,
    /// The first difference from the bag so far.
    pub(super) difference: Option<String>,
}

/// A run of a module.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Run {
    pub(super) module: String,
    pub(super) causes: Vec<String>,
    /// The number of the run of a detached module.
    pub(super) step: Option<u64>,
    pub(super) received: Vec<Messages>,
    pub(super) published: Vec<Messages>,
    /// Requests, answers, commands and results of jobs that it was given and that it gave, in sentences.
    pub(super) got: Vec<Got>,
    pub(super) gave: Vec<String>,
}

/// What a run was given besides messages.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Got {
    /// In words.
    pub(super) event: String,
    /// The module that made the request or gave the answer in the cycle before; `None` if it came from
    /// outside, or is something else.
    pub(super) from: Option<String>,
}

/// Messages of a topic.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Messages {
    pub(super) topic: String,
    /// The number of the first.
    pub(super) first: u64,
    pub(super) count: u64,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Message {
    pub(super) topic: String,
    pub(super) type_name: String,
    pub(super) number: u64,
    pub(super) time_ns: i64,
    pub(super) yaml: String,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Module {
    pub(super) name: String,
    /// `None` if it does not run.
    pub(super) settings: Option<Vec<(String, String)>>,
    /// What the module shows of itself.
    pub(super) state: Option<String>,
}

impl Messages {
    pub(super) fn name(&self) -> String {
        let Self { topic, first, count } = self;
        match count {
            1 => format!("{topic} #{first}"),
            _ => format!("{topic} #{first} to #{}", first + count - 1),
        }
    }
}

/// One end of a connection.
pub(super) struct Link {
    reader: BufReader<UnixStream>,
}

impl Link {
    pub(super) fn new(stream: UnixStream) -> Self {
        Self { reader: BufReader::with_capacity(1 << 16, stream) }
    }

    pub(super) fn send(&mut self, what: &impl Serialize) -> anyhow::Result<()> {
        let mut line = serde_json::to_vec(what)?;
        line.push(b'\n');
        self.reader.get_mut().write_all(&line).context("the other side of the debugger has ended")
    }

    /// Ends the connection: the other side receives nothing more.
    pub(super) fn close(&self) {
        // It may have ended.
        let _ = self.reader.get_ref().shutdown(Shutdown::Both);
    }

    /// `None` at the end of the other side.
    pub(super) fn receive<T: DeserializeOwned>(&mut self) -> anyhow::Result<Option<T>> {
        let mut line = Vec::new();
        match self.reader.read_until(b'\n', &mut line) {
            Ok(0) => Ok(None),
            Ok(_) => Ok(Some(serde_json::from_slice(&line)?)),
            // Ended by force.
            Err(error) if error.kind() == std::io::ErrorKind::ConnectionReset => Ok(None),
            Err(error) => Err(error.into()),
        }
    }
}
