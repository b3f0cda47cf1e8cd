//! The lines on the socket.

use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

/// What a client can ask for: `{"request":"snapshot"}`, `{"request":"trace","cycles":10}`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "request", rename_all = "snake_case")]
pub enum Request {
    /// The counters: answered with a [`Snapshot`](downbeat_executor::Snapshot).
    Snapshot,
    /// What runs in the next cycles: answered with a trace in the Trace Event Format of Chrome.
    Trace {
        /// How many cycles, 1 to [`Request::MOST_CYCLES`].
        cycles: u32,
    },
    /// Who is connected to what: answered with a [`Graph`](downbeat_executor::Graph).
    Graph,
    /// Hold the robot. Answered with `null`, as are the next two.
    Pause,
    /// Let it go on.
    Resume,
    /// Have a held robot run one cycle.
    Step,
    /// What ROS 2 sees: answered with a list of [`EndpointReport`](crate::robot::EndpointReport)s, as are the next two.
    Exposed,
    /// Expose more: answered with what was added.
    Expose {
        /// The keys `out` and `in` as under `[expose]` of a robot file.
        entries: String,
    },
    /// Take back what is exposed: answered with what it was.
    TakeBack {
        /// Names of topics in ROS 2 or in the robot, or patterns.
        topics: Vec<String>,
    },
}

impl Request {
    /// The most cycles of one trace.
    pub const MOST_CYCLES: u32 = 100_000;
}

/// The longest request: none comes near it.
pub(super) const LONGEST_REQUEST: u64 = 4096;

/// The answer to a request: `{"ok": …}` or `{"error": "…"}`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Answer {
    Ok(Box<RawValue>),
    Error(String),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_what_the_documentation_shows() {
        let of = |text| serde_json::from_str::<Request>(text).ok();
        assert_eq!(of(r#"{"request":"snapshot"}"#), Some(Request::Snapshot));
        assert_eq!(of(r#"{"request":"trace","cycles":10}"#), Some(Request::Trace { cycles: 10 }));
        assert_eq!(of(r#"{"request":"trace"}"#), None);
        assert_eq!(of(r#"{"request":"explode"}"#), None);
    }

    #[test]
    fn answers_are_what_the_documentation_shows() {
        let ok =
            RawValue::from_string("[1]".into()).map(Answer::Ok).and_then(|ok| serde_json::to_string(&ok));
        assert_eq!(ok.ok().as_deref(), Some(r#"{"ok":[1]}"#));
        let error = serde_json::to_string(&Answer::Error("why".into()));
        assert_eq!(error.ok().as_deref(), Some(r#"{"error":"why"}"#));
    }
}
