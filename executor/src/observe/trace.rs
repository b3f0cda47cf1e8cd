//! Traces of a few cycles: which module ran when and on which thread.

use std::cmp::Reverse;
use std::fmt;
use std::io::{self, Write};
use std::sync::Arc;
use std::thread::ThreadId;
use std::time::Instant;

use super::Span;
use super::histogram::nanoseconds;
use super::markup::json_string;

/// The limit of events, beyond which viewers become unusable.
const MOST_EVENTS: usize = 250_000;

/// The runs and phases of a few cycles, with their threads and times.
///
/// [`write_chrome_json`](Self::write_chrome_json) writes it in a format for <https://ui.perfetto.dev> or
/// `chrome://tracing`.
pub struct CycleTrace {
    origin: Instant,
    threads: Vec<(ThreadId, String)>,
    events: Vec<TraceEvent>,
}

/// A run or a phase of a cycle.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct TraceEvent {
    /// The kind of the event.
    pub kind: TraceEventKind,
    /// The module that ran; `None` for a phase of the cycle.
    #[cfg_attr(feature = "serde", serde(serialize_with = "optional_text"))]
    pub module: Option<Arc<str>>,
    /// The thread, as an index of [`CycleTrace::threads`].
    pub thread: usize,
    /// The cycle of the run, or, for a step, the cycle in which its messages were sent.
    pub cycle: u64,
    /// The begin in nanoseconds since the core's start.
    pub begin_ns: u64,
    /// The end in nanoseconds since the core's start.
    pub end_ns: u64,
    /// The reasons of the run; empty for a phase of the cycle.
    pub causes: Vec<TraceCause>,
}

/// The reason of a module's run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TraceCause {
    /// The first run of the module.
    Start,
    /// Messages of this topic.
    Messages(Arc<str>),
    /// A timer or a task was due.
    Time,
    /// A request to one of its services.
    Request,
    /// A response to a call of the module.
    Response,
    /// A setting changed.
    Setting,
    /// The result of a job.
    Result,
    /// A run in every cycle, a transition, or the end of a pause.
    Woken,
}

impl fmt::Display for TraceCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Start => "start",
            Self::Messages(topic) => return write!(f, "message on {topic}"),
            Self::Time => "timer",
            Self::Request => "request",
            Self::Response => "response",
            Self::Setting => "setting",
            Self::Result => "result of a job",
            Self::Woken => "woken",
        })
    }
}

#[cfg(feature = "serde")]
fn optional_text<S: serde::Serializer>(text: &Option<Arc<str>>, serializer: S) -> Result<S::Ok, S::Error> {
    serde::Serialize::serialize(&text.as_deref(), serializer)
}

#[cfg(feature = "serde")]
impl serde::Serialize for TraceCause {
    /// Serialises the cause as its text.
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// The kind of an event in a trace.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize), serde(rename_all = "snake_case"))]
pub enum TraceEventKind {
    /// A module's run inside a cycle.
    Run,
    /// A run of a detached module.
    Step,
    /// The process phase of a cycle.
    Process,
    /// The sync phase of a cycle.
    Sync,
}

impl TraceEventKind {
    fn name(self) -> &'static str {
        match self {
            Self::Run => "run",
            Self::Step => "step",
            Self::Process => "process",
            Self::Sync => "sync",
        }
    }
}

impl CycleTrace {
    pub(crate) fn new(origin: Instant) -> Self {
        Self { origin, threads: Vec::new(), events: Vec::new() }
    }

    pub(crate) fn add(
        &mut self,
        kind: TraceEventKind,
        module: Option<&Arc<str>>,
        cycle: u64,
        span: &Span,
        causes: Vec<TraceCause>,
    ) {
        // The thread of a step that began before the trace was requested is not known.
        let Some(thread) = &span.thread else { return };
        if self.is_full() {
            return;
        }
        let known = self.threads.iter().position(|(id, _)| *id == thread.id());
        let thread = known.unwrap_or_else(|| {
            let name = thread.name().map_or_else(|| format!("{:?}", thread.id()), str::to_owned);
            self.threads.push((thread.id(), name));
            self.threads.len() - 1
        });
        let since_origin = |time: Instant| nanoseconds(time.saturating_duration_since(self.origin));
        let (begin_ns, end_ns) = (since_origin(span.begin), since_origin(span.end));
        self.events.push(TraceEvent {
            kind,
            module: module.cloned(),
            thread,
            cycle,
            begin_ns,
            end_ns,
            causes,
        });
    }

    pub(crate) fn is_full(&self) -> bool {
        self.events.len() >= MOST_EVENTS
    }

    /// Sorts the events by time, with enclosing events before the enclosed ones.
    pub(crate) fn finish(mut self) -> Self {
        let is_part = |event: &TraceEvent| event.module.is_some();
        self.events.sort_by_key(|event| (event.begin_ns, Reverse(event.end_ns), is_part(event)));
        self
    }

    /// The events, sorted by their begin.
    #[must_use]
    pub fn events(&self) -> &[TraceEvent] {
        &self.events
    }

    /// The names of the threads.
    pub fn threads(&self) -> impl ExactSizeIterator<Item = &str> {
        self.threads.iter().map(|(_, name)| name.as_str())
    }

    /// Writes the trace in the Trace Event Format of Chrome, which Perfetto and `chrome://tracing` open: one
    /// complete event ("ph": "X") for each of [`events`](Self::events), with times in microseconds, and the
    /// names of the threads as metadata events ("ph": "M"). The output contains no line break.
    ///
    /// # Errors
    /// Errors of `out`.
    ///
    /// # References
    /// "Trace Event Format", the document of the Catapult project.
    pub fn write_chrome_json(&self, mut out: impl Write) -> io::Result<()> {
        let process = std::process::id();
        write!(out, r#"{{"displayTimeUnit":"ns","traceEvents":["#)?;
        write!(
            out,
            r#"{{"name":"process_name","ph":"M","pid":{process},"tid":0,"args":{{"name":"downbeat"}}}}"#
        )?;
        for (number, name) in self.threads().enumerate() {
            let (tid, name) = (number + 1, json_string(name));
            write!(
                out,
                r#",{{"name":"thread_name","ph":"M","pid":{process},"tid":{tid},"args":{{"name":{name}}}}}"#
            )?;
        }
        for event in &self.events {
            let kind = event.kind.name();
            let name = json_string(event.module.as_deref().unwrap_or(kind));
            let (ts, dur) = (Microseconds(event.begin_ns), Microseconds(event.end_ns - event.begin_ns));
            let (tid, cycle) = (event.thread + 1, event.cycle);
            let causes: Vec<_> = event.causes.iter().map(TraceCause::to_string).collect();
            let causes = json_string(&causes.join(", "));
            write!(
                out,
                r#",{{"name":{name},"cat":"{kind}","ph":"X","ts":{ts},"dur":{dur},"pid":{process},"tid":{tid},"args":{{"cycle":{cycle},"causes":{causes}}}}}"#
            )?;
        }
        write!(out, "]}}")?;
        out.flush()
    }
}

/// Prints nanoseconds as microseconds, exactly.
struct Microseconds(u64);

impl std::fmt::Display for Microseconds {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{:03}", self.0 / 1000, self.0 % 1000)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::thread::Thread;
    use std::time::Duration;

    use serde_json::Value;

    use super::*;

    fn example() -> CycleTrace {
        let origin = Instant::now();
        let span = |begin_ns, end_ns, thread: &Thread| Span {
            begin: origin + Duration::from_nanos(begin_ns),
            end: origin + Duration::from_nanos(end_ns),
            thread: Some(thread.clone()),
            processor: None,
        };
        let here = std::thread::current();
        let there = std::thread::Builder::new().name("eye \"left\"\n".into()).spawn(std::thread::current);
        let there = there.unwrap().join().unwrap();
        let mut trace = CycleTrace::new(origin);
        let (motion, vision): (Arc<str>, Arc<str>) = (Arc::from("motion"), Arc::from("vision\\1"));
        let causes = vec![TraceCause::Messages("joint_states".into()), TraceCause::Time];
        trace.add(TraceEventKind::Run, Some(&motion), 7, &span(1_000, 2_500, &here), causes);
        trace.add(TraceEventKind::Step, Some(&vision), 7, &span(5, 5_000_005, &there), Vec::new());
        trace.add(TraceEventKind::Process, None, 7, &span(1_000, 2_500, &here), Vec::new());
        trace.add(TraceEventKind::Sync, None, 7, &span(2_500, 2_501, &here), Vec::new());
        trace.finish()
    }

    #[test]
    fn events_come_in_the_order_of_time_and_a_phase_before_what_ran_in_it() {
        let kinds: Vec<_> = example().events().iter().map(|event| event.kind).collect();
        use TraceEventKind::{Process, Run, Step, Sync};
        assert_eq!(kinds, [Step, Process, Run, Sync]);
    }

    #[test]
    fn the_json_is_what_the_trace_event_format_asks_for() {
        let mut json = Vec::new();
        example().write_chrome_json(&mut json).unwrap();
        assert!(!json.contains(&b'\n'));
        let json: Value = serde_json::from_slice(&json).unwrap();
        let events = json["traceEvents"].as_array().unwrap();
        let (metadata, complete): (Vec<_>, Vec<_>) = events.iter().partition(|event| event["ph"] == "M");
        let pid = u64::from(std::process::id());
        assert!(events.iter().all(|event| event["pid"] == pid && event["tid"].is_u64()));
        assert_eq!(metadata[0]["name"], "process_name");
        let threads: Vec<_> = metadata[1..].iter().map(|event| &event["args"]["name"]).collect();
        assert!(metadata[1..].iter().all(|event| event["name"] == "thread_name"));
        assert_eq!(threads[1], "eye \"left\"\n");
        let run = complete.iter().find(|event| event["name"] == "motion").unwrap();
        assert_eq!((run["cat"].as_str(), run["ts"].as_f64()), (Some("run"), Some(1.0)));
        assert_eq!((run["dur"].as_f64(), run["args"]["cycle"].as_u64()), (Some(1.5), Some(7)));
        assert_eq!(run["args"]["causes"], "message on joint_states, timer");
        let step = complete.iter().find(|event| event["name"] == "vision\\1").unwrap();
        assert_eq!((step["ts"].as_f64(), step["dur"].as_f64()), (Some(0.005), Some(5_000.0)));
        assert_ne!(step["tid"], run["tid"]);
        for event in complete {
            assert_eq!(event["ph"], "X");
            let tid = &event["tid"];
            assert!(metadata.iter().any(|named| named["name"] == "thread_name" && named["tid"] == *tid));
        }
    }

    #[test]
    fn a_trace_without_events_is_valid_json() {
        let mut json = Vec::new();
        CycleTrace::new(Instant::now()).finish().write_chrome_json(&mut json).unwrap();
        let json: Value = serde_json::from_slice(&json).unwrap();
        assert_eq!(json["traceEvents"].as_array().map(Vec::len), Some(1));
    }
}
