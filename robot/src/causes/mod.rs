//! Why a robot did something: from a message back to what caused it.
//!
//! A [`History`] holds which modules ran in which cycle, why, and what they published, as the executor
//! reports it and bags hold it ([`Recorded`]). [`History::explain`] follows a message back through the runs
//! that led to it, across modules, threads and services, to what came from outside. [`Latency`] follows
//! messages forward instead, and measures how old the newest message of a topic is on which those of another
//! one depend; it works while a robot runs. [`Guess`] does what is possible with bags of ROS, which know of
//! no runs.
//!
//! All of this is pure: whoever uses it reads bags and subscribes to topics.

mod explain;
mod guess;
mod history;
mod latency;
mod recorded;
#[cfg(test)]
mod tests;

pub use explain::{Call, Explained, From, Limits, Remembered, RunExplained};
pub use guess::{Guess, Guessed, GuessedWay, Rule, Stamped};
pub use history::{History, MessageId, RunId, Unplaced};
pub use latency::{Ages, Hop, Latency, Sample};
pub use recorded::Recorded;
