//! The status block of a running robot.

use std::time::{Duration, Instant};

use downbeat::bags::Recording;
use downbeat::bridge::expose::{BridgeStatus, EndpointReport};
use downbeat::bridge::middleware::Direction;
use downbeat::executor::TopicInfo;

use super::faults::Faults;
use super::statistics::Statistics;

/// What the status block shows.
pub(crate) struct Sources<'a> {
    pub(crate) title: String,
    pub(crate) topics: Vec<TopicInfo>,
    pub(crate) statistics: &'a Statistics,
    pub(crate) bridge: Option<&'a BridgeStatus>,
    pub(crate) recording: Option<&'a Recording>,
    pub(crate) faults: &'a Faults,
}

/// Draws the block; rates are those since the last time.
pub(crate) struct StatusBlock<'a> {
    sources: Sources<'a>,
    started: Instant,
    last: Instant,
    last_counts: Vec<u64>,
    last_cycles: u64,
}

/// Lines of faults: one cause may make each of twenty servos stale.
const MOST_FAULTS: usize = 4;

impl<'a> StatusBlock<'a> {
    pub(crate) fn new(sources: Sources<'a>) -> Self {
        let (now, last_counts) = (Instant::now(), vec![0; sources.topics.len()]);
        Self { sources, started: now, last: now, last_counts, last_cycles: 0 }
    }

    pub(crate) fn lines(&mut self) -> Vec<String> {
        let now = Instant::now();
        let elapsed = (now - self.last).max(Duration::from_millis(1)).as_secs_f64();
        self.last = now;
        let running = (now - self.started).as_secs();
        let mut lines = vec![format!("{}   {running} s", self.sources.title)];
        lines.extend(self.cycles(elapsed));
        lines.extend(self.topics(elapsed));
        lines.extend(self.bridge());
        lines.extend(self.sources.recording.map(bag));
        lines.extend(self.faults());
        lines
    }

    fn cycles(&mut self, elapsed: f64) -> Vec<String> {
        let collected = self.sources.statistics.collected();
        let rate = (collected.cycles - self.last_cycles) as f64 / elapsed;
        self.last_cycles = collected.cycles;
        let mut lines = vec![labelled("cycle", &format!("{}   {rate:.0}/s", collected.cycle))];
        for (module, times) in &collected.detached {
            lines.push(labelled(module, &format!("period {}", times.period)));
            lines.push(labelled("", &format!("busy   {}", times.busy)));
        }
        lines
    }

    fn topics(&mut self, elapsed: f64) -> Vec<String> {
        let mut rates = Vec::new();
        for (topic, last) in self.sources.topics.iter().zip(&mut self.last_counts) {
            let count = topic.counter.messages();
            let rate = (count - *last) as f64 / elapsed;
            *last = count;
            if topic.is_published {
                rates.push(format!("{} {rate:.0}/s", topic.name));
            }
        }
        rates
            .chunks(4)
            .enumerate()
            .map(|(row, rates)| labelled(if row == 0 { "topics" } else { "" }, &rates.join("  ")))
            .collect()
    }

    fn faults(&self) -> Vec<String> {
        let faults = self.sources.faults.worst_first();
        let mut lines: Vec<_> =
            faults.iter().take(MOST_FAULTS).map(|fault| labelled("fault", fault)).collect();
        if faults.len() > MOST_FAULTS {
            let more = faults.len() - MOST_FAULTS;
            lines.push(labelled("", &format!("and {more} more, see the topic diagnostics")));
        }
        lines
    }

    fn bridge(&self) -> Vec<String> {
        let endpoints = self.sources.bridge.map(BridgeStatus::endpoints).unwrap_or_default();
        let line = |(row, report)| labelled(if row == 0 { "exposed" } else { "" }, &endpoint(report));
        endpoints.iter().enumerate().map(line).collect()
    }
}

fn endpoint(report: &EndpointReport) -> String {
    let (arrow, peers) = match report.direction {
        Direction::Out => ("->", "subscriptions"),
        Direction::In => ("<-", "publishers"),
    };
    let problems = match (report.errors, &report.last_error) {
        (0, _) | (_, None) => String::new(),
        (errors, Some(last)) => format!("   {errors} failed: {last}"),
    };
    let EndpointReport { ros_topic, matched, messages, .. } = report;
    format!("{arrow} {ros_topic}   {matched} {peers}   {messages} messages{problems}")
}

fn bag(recording: &Recording) -> String {
    let statistics = recording.statistics();
    let summary = &statistics.summary;
    let mebibytes = summary.bytes as f64 / (1024.0 * 1024.0);
    let (messages, lost) = (summary.message_count(), summary.lost_count());
    let failure = statistics.failure.map(|failure| format!("   stopped: {failure}")).unwrap_or_default();
    let path = summary.path.display();
    labelled("bag", &format!("{path}   {mebibytes:.1} MiB   {messages} messages   {lost} lost{failure}"))
}

fn labelled(label: &str, text: &str) -> String {
    format!("  {label:<10} {text}")
}
