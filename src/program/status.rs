//! The status block of a running robot.

use std::time::{Duration, Instant};

use crate::bags::{Recording, RecordingStatistics};
use crate::bridge::expose::{BridgeStatus, EndpointReport};
use crate::bridge::middleware::Direction;
use crate::executor::TopicInfo;

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

/// Makes the lines of the block.
pub(crate) struct StatusBlock<'a> {
    sources: Sources<'a>,
    started: Instant,
    cycles: Rates,
    topics: Rates,
}

/// Lines of faults: one cause may make each of twenty servos stale.
const MOST_FAULTS: usize = 4;

impl<'a> StatusBlock<'a> {
    pub(crate) fn new(sources: Sources<'a>) -> Self {
        let now = Instant::now();
        Self { sources, started: now, cycles: Rates::new(now), topics: Rates::new(now) }
    }

    pub(crate) fn lines(&mut self) -> Vec<String> {
        let now = Instant::now();
        let running = (now - self.started).as_secs();
        let mut lines = vec![format!("{}   {running} s", self.sources.title)];
        lines.extend(self.cycles(now));
        lines.extend(self.topics(now));
        lines.extend(self.bridge());
        let recording = self.sources.recording.map(Recording::statistics);
        lines.extend(recording.map(|statistics| labelled("bag", &bag(&statistics))));
        lines.extend(self.faults());
        lines
    }

    /// The most important of it in one line, for a log.
    pub(crate) fn line(&mut self) -> String {
        let now = Instant::now();
        let mut parts = vec![format!("{} s", (now - self.started).as_secs())];
        let endpoints = self.sources.bridge.map(BridgeStatus::endpoints).unwrap_or_default();
        let rates = self.topic_rates(now);
        let is_exposed = |name: &str| endpoints.iter().any(|endpoint| endpoint.topic == name);
        let exposed = rates.iter().filter(|(name, _)| endpoints.is_empty() || is_exposed(name));
        parts.push(exposed.map(|(name, rate)| format!("{name} {rate:.0}/s")).collect::<Vec<_>>().join("  "));
        if !endpoints.is_empty() {
            let peers: usize = endpoints.iter().map(|endpoint| endpoint.matched).sum();
            parts.push(format!("{peers} endpoints of others matched"));
        }
        parts.extend(self.sources.recording.map(|recording| bag(&recording.statistics())));
        parts.extend(self.sources.faults.worst_first().into_iter().next());
        parts.join(";  ")
    }

    fn cycles(&mut self, now: Instant) -> Vec<String> {
        let collected = self.sources.statistics.collected();
        let rate = self.cycles.update(now, vec![collected.cycles])[0];
        let mut lines = vec![labelled("cycle", &format!("{}   {rate:.0}/s", collected.cycle))];
        for (module, times) in &collected.detached {
            lines.push(labelled(module, &format!("period {}", times.period)));
            lines.push(labelled("", &format!("busy   {}", times.busy)));
        }
        lines
    }

    fn topics(&mut self, now: Instant) -> Vec<String> {
        let rates = self.topic_rates(now);
        let rates: Vec<_> = rates.iter().map(|(name, rate)| format!("{name} {rate:.0}/s")).collect();
        let label = |row| if row == 0 { "topics" } else { "" };
        rates.chunks(4).enumerate().map(|(row, rates)| labelled(label(row), &rates.join("  "))).collect()
    }

    /// The published topics, with messages per second.
    fn topic_rates(&mut self, now: Instant) -> Vec<(String, f64)> {
        let topics = &self.sources.topics;
        let rates = self.topics.update(now, topics.iter().map(|topic| topic.counter.messages()).collect());
        let published = topics.iter().zip(rates).filter(|(topic, _)| topic.is_published);
        published.map(|(topic, rate)| (topic.name.to_string(), *rate)).collect()
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

/// How a recording is doing, in a line.
pub(crate) fn bag(statistics: &RecordingStatistics) -> String {
    let summary = &statistics.summary;
    let mebibytes = summary.bytes as f64 / (1024.0 * 1024.0);
    let (messages, lost) = (summary.message_count(), summary.lost_count());
    let path = summary.path.display();
    let mut line = format!("{path}   {mebibytes:.1} MiB   {messages} messages   {lost} lost");
    let mut add = |text: &str| {
        line.push_str("   ");
        line.push_str(text);
    };
    if summary.files > 1 {
        add(&format!("{} files", summary.files));
    }
    // The worst alone: it is a line.
    let worst = summary.topics.iter().filter(|topic| topic.lost > 0).max_by_key(|topic| topic.lost);
    if let Some(topic) = worst {
        add(&format!("most of {} ({})", topic.name, topic.lost));
    }
    if statistics.is_paused {
        add("paused");
    }
    if statistics.is_disk_full {
        add("the disk is full");
    }
    if let Some(failure) = &statistics.failure {
        add(&format!("stopped: {failure}"));
    }
    line
}

/// What some counters gain per second, over at least a second.
struct Rates {
    since: Instant,
    counts: Vec<u64>,
    rates: Vec<f64>,
}

impl Rates {
    fn new(now: Instant) -> Self {
        Self { since: now, counts: Vec::new(), rates: Vec::new() }
    }

    fn update(&mut self, now: Instant, counts: Vec<u64>) -> &[f64] {
        self.counts.resize(counts.len(), 0);
        self.rates.resize(counts.len(), 0.0);
        let elapsed = now - self.since;
        if elapsed >= Duration::from_secs(1) {
            let gains = counts.iter().zip(&self.counts).map(|(count, last)| count.saturating_sub(*last));
            self.rates = gains.map(|gain| gain as f64 / elapsed.as_secs_f64()).collect();
            (self.since, self.counts) = (now, counts);
        }
        &self.rates
    }
}

fn labelled(label: &str, text: &str) -> String {
    format!("  {label:<10} {text}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_of_the_last_second_or_more() {
        let start = Instant::now();
        let mut rates = Rates::new(start);
        let at = |milliseconds| start + Duration::from_millis(milliseconds);
        assert_eq!(rates.update(at(500), vec![60]), [0.0]);
        assert_eq!(rates.update(at(1000), vec![125]), [125.0]);
        assert_eq!(rates.update(at(1900), vec![999]), [125.0]);
        assert_eq!(rates.update(at(3000), vec![325]), [100.0]);
    }
}
