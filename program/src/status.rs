//! The status block of a running robot.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::Mutex;

use super::screen::{Line, shorten, wrap};
use super::statistics::{Statistics, Times};
use downbeat_bags::{Recording, RecordingStatistics};
use downbeat_bridge::expose::{BridgeStatus, EndpointReport, EndpointTraffic, ExposedEndpoint};
use downbeat_bridge::middleware::Direction;
use downbeat_executor::{Core, Inbox, OutletInbox, Received, SetupError, TopicInfo};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};

/// The data of the status block.
pub(crate) struct Sources<'a> {
    pub(crate) title: String,
    pub(crate) topics: Vec<TopicInfo>,
    pub(crate) statistics: &'a Statistics,
    pub(crate) bridge: Option<&'a BridgeStatus>,
    pub(crate) recording: Option<&'a Recording>,
    pub(crate) faults: &'a Faults,
}

/// Creates the lines of the block.
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

    /// The block in at most this many lines and characters. Entries are not truncated: those that do not fit
    /// are counted.
    pub(crate) fn lines(&mut self, (height, width): (usize, usize)) -> Vec<String> {
        let now = Instant::now();
        let running = (now - self.started).as_secs();
        let title = self.sources.title.split(SEPARATOR).map(str::to_owned);
        let title = wrap(title.chain([format!("{running} s")]), SEPARATOR, width);
        let mut head: Vec<_> = title.into_iter().map(|line| line.text).collect();
        head.extend(self.cycles(now));
        let text_width = width.saturating_sub(INDENT);
        let [topics, endpoints] = [self.topics(now, text_width), self.bridge(text_width)];
        let mut tail = Vec::new();
        if let Some(recording) = self.sources.recording {
            let entries = bag(&recording.statistics());
            tail.extend(labelled_lines("bag", shorten(wrap(entries, SEPARATOR, text_width), usize::MAX)));
        }
        tail.extend(self.faults(text_width));
        // On a small terminal, faults are shown rather than times: they come last.
        tail.drain(..tail.len().saturating_sub(height.saturating_sub(1)));
        head.truncate(height.saturating_sub(tail.len()));
        let room = height.saturating_sub(head.len() + tail.len());
        // Without room, not even their number is shown.
        let shorten = |lines, most| if most == 0 { Vec::new() } else { shorten(lines, most) };
        let topics = shorten(topics, room.saturating_sub(endpoints.len()).max(room / 2));
        let endpoints = shorten(endpoints, room.saturating_sub(topics.len()));
        head.extend(labelled_lines("topics", topics));
        head.extend(labelled_lines("exposed", endpoints));
        head.extend(tail);
        head
    }

    /// The most important data in one line, for the log.
    pub(crate) fn line(&mut self) -> String {
        let now = Instant::now();
        let mut parts = vec![format!("{} s", (now - self.started).as_secs())];
        let endpoints = self.sources.bridge.map(BridgeStatus::endpoints).unwrap_or_default();
        let rates = self.topic_rates(now);
        let is_exposed = |name: &str| endpoints.iter().any(|report| report.endpoint.topic == name);
        let exposed = rates.iter().filter(|(name, _)| endpoints.is_empty() || is_exposed(name));
        parts.push(exposed.map(|(name, rate)| format!("{name} {rate:.0}/s")).collect::<Vec<_>>().join("  "));
        if !endpoints.is_empty() {
            let peers: usize = endpoints.iter().map(|report| report.traffic.matched).sum();
            parts.push(format!("{peers} remote endpoints matched"));
        }
        parts.extend(self.sources.recording.map(|recording| bag(&recording.statistics()).join(SEPARATOR)));
        parts.extend(self.sources.faults.worst_first().into_iter().next());
        parts.join(";  ")
    }

    fn cycles(&mut self, now: Instant) -> Vec<String> {
        let collected = self.sources.statistics.collected();
        let rate = self.cycles.update(now, vec![collected.cycles])[0];
        let mut lines = vec![labelled("cycle", &format!("{}   {rate:.0}/s", Times(collected.cycle)))];
        for known in &collected.loops {
            lines.push(labelled(&known.module, &format!("period {}", Times(known.period))));
            lines.push(labelled("", &format!("busy   {}", Times(known.busy))));
        }
        lines
    }

    fn topics(&mut self, now: Instant, width: usize) -> Vec<Line> {
        let rates = self.topic_rates(now);
        wrap(rates.iter().map(|(name, rate)| format!("{name} {rate:.0}/s")), "  ", width)
    }

    /// The published topics, with messages per second.
    fn topic_rates(&mut self, now: Instant) -> Vec<(String, f64)> {
        let topics = &self.sources.topics;
        let rates = self.topics.update(now, topics.iter().map(|topic| topic.counter.messages()).collect());
        let published = topics.iter().zip(rates).filter(|(topic, _)| topic.is_published);
        published.map(|(topic, rate)| (topic.name.to_string(), *rate)).collect()
    }

    fn faults(&self, width: usize) -> Vec<String> {
        let faults = self.sources.faults.worst_first();
        let mut lines = Vec::new();
        for fault in faults.iter().take(MOST_FAULTS) {
            let words = wrap(fault.split(' '), " ", width);
            lines.extend(labelled_lines("fault", shorten(words, usize::MAX)));
        }
        if faults.len() > MOST_FAULTS {
            let more = faults.len() - MOST_FAULTS;
            lines.push(labelled("", &format!("and {more} more, see the topic diagnostics")));
        }
        lines
    }

    fn bridge(&self, width: usize) -> Vec<Line> {
        let endpoints = self.sources.bridge.map(BridgeStatus::endpoints).unwrap_or_default();
        let lines = endpoints.iter().flat_map(|report| {
            let lines = wrap(endpoint(report), SEPARATOR, width);
            let last = lines.len().saturating_sub(1);
            // An entry of the block is a whole endpoint.
            lines
                .into_iter()
                .enumerate()
                .map(move |(row, line)| Line { entries: usize::from(row == last), ..line })
        });
        lines.collect()
    }
}

/// Between entries of a line.
pub(crate) const SEPARATOR: &str = "   ";

fn endpoint(report: &EndpointReport) -> Vec<String> {
    let (arrow, peers) = match report.endpoint.direction {
        Direction::Out => ("->", "subscriptions"),
        Direction::In => ("<-", "publishers"),
    };
    let EndpointReport { endpoint: ExposedEndpoint { ros_topic, .. }, traffic } = report;
    let EndpointTraffic { matched, messages, .. } = traffic;
    let mut entries =
        vec![format!("{arrow} {ros_topic}"), format!("{matched} {peers}"), format!("{messages} messages")];
    if let (1.., Some(last)) = (traffic.errors, &traffic.last_error) {
        entries.push(format!("{} failed: {last}", traffic.errors));
    }
    entries
}

/// The state of a recording, as entries of a line.
pub(crate) fn bag(statistics: &RecordingStatistics) -> Vec<String> {
    let summary = &statistics.summary;
    let mebibytes = summary.bytes as f64 / (1024.0 * 1024.0);
    let (messages, lost) = (summary.message_count(), summary.lost_count());
    let mut entries = vec![
        summary.path.display().to_string(),
        format!("{mebibytes:.1} MiB"),
        format!("{messages} messages"),
        format!("{lost} lost"),
    ];
    if summary.files > 1 {
        entries.push(format!("{} files", summary.files));
    }
    // Only the worst topic, since it is a single line.
    let worst = summary.topics.iter().filter(|topic| topic.lost > 0).max_by_key(|topic| topic.lost);
    if let Some(topic) = worst {
        entries.push(format!("most of {} ({})", topic.name, topic.lost));
    }
    if statistics.is_paused {
        entries.push("paused".to_owned());
    }
    if statistics.is_disk_full {
        entries.push("the disk is full".to_owned());
    }
    if let Some(failure) = &statistics.failure {
        entries.push(format!("stopped: {failure}"));
    }
    entries
}

/// The rates of counters, over at least a second.
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

/// The width of the label before a line.
const INDENT: usize = 13;

fn labelled(label: &str, text: &str) -> String {
    format!("  {label:<10} {text}")
}

/// Adds the label to the first line.
fn labelled_lines(label: &str, lines: Vec<String>) -> impl Iterator<Item = String> {
    lines.into_iter().enumerate().map(move |(row, line)| labelled(if row == 0 { label } else { "" }, &line))
}

/// The topic of REP-107.
const TOPIC: &str = "diagnostics";

/// Components with faults, by name.
#[derive(Clone, Default)]
pub(crate) struct Faults {
    by_component: Arc<Mutex<BTreeMap<String, Fault>>>,
}

struct Fault {
    level: u8,
    message: String,
}

impl Faults {
    /// Tracks the messages on `diagnostics` until the core stops.
    pub(crate) fn watch(core: &mut Core) -> Result<Self, SetupError> {
        let faults = Self::default();
        let (inbox, sink) = (OutletInbox::new("faults", Inbox::KeepAll), faults.clone());
        let outlet = core.outlet(TOPIC, &inbox, move |array: Received<'_, DiagnosticArray>| {
            array.status.iter().for_each(|status| sink.update(status));
        })?;
        outlet.keep();
        Ok(faults)
    }

    /// A line for each component with a fault: errors, warnings, then stale ones.
    fn worst_first(&self) -> Vec<String> {
        let faults = self.by_component.lock();
        let lines = |wanted: u8, name: &'static str| {
            let of_level = faults.iter().filter(move |(_, fault)| fault.level == wanted);
            of_level.map(move |(component, fault)| format!("{name}: {component}: {}", fault.message))
        };
        lines(DiagnosticStatus::ERROR, "error")
            .chain(lines(DiagnosticStatus::WARN, "warning"))
            .chain(lines(DiagnosticStatus::STALE, "stale"))
            .collect()
    }

    fn update(&self, status: &DiagnosticStatus) {
        let mut faults = self.by_component.lock();
        if status.level == DiagnosticStatus::OK {
            faults.remove(&status.name);
        } else {
            let (level, message) = (status.level, status.message.clone());
            faults.insert(status.name.clone(), Fault { level, message });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use downbeat_executor::TopicCounter;

    fn topic(name: String) -> TopicInfo {
        TopicInfo {
            name: name.into(),
            message_type: "u8",
            message_type_id: std::any::TypeId::of::<u8>(),
            is_published: true,
            counter: TopicCounter::default(),
        }
    }

    #[test]
    fn the_block_truncates_no_topic_and_counts_those_without_room() {
        let faults = Faults::default();
        let statistics = Statistics::default();
        let names: Vec<_> =
            (0..30).map(|number| format!("camera_{number:02}/image_raw/compressed")).collect();
        let sources = || Sources {
            title: "/darwin_op   domain 0   emulated".into(),
            topics: names.iter().cloned().map(topic).collect(),
            statistics: &statistics,
            bridge: None,
            recording: None,
            faults: &faults,
        };
        let tall = StatusBlock::new(sources()).lines((100, 79));
        assert!(tall.iter().all(|line| line.chars().count() <= 79), "{tall:#?}");
        let whole = |block: &[String]| {
            let block = block.join(" ");
            let words: Vec<_> = block.split_whitespace().collect();
            names.iter().filter(|name| words.windows(2).any(|two| two == [name.as_str(), "0/s"])).count()
        };
        assert_eq!(whole(&tall), names.len());
        let low = StatusBlock::new(sources()).lines((12, 79));
        assert!(low.len() <= 12, "{low:#?}");
        let more =
            |line: &String| line.trim().strip_prefix('+')?.strip_suffix(" more")?.parse::<usize>().ok();
        let more_entries: usize = low.iter().filter_map(more).sum();
        assert_eq!(whole(&low) + more_entries, names.len(), "{low:#?}");
    }

    #[test]
    fn a_block_on_a_small_terminal_fits_and_shows_faults() {
        let (faults, statistics) = (Faults::default(), Statistics::default());
        let status = DiagnosticStatus {
            level: DiagnosticStatus::ERROR,
            name: "servos: elbow".into(),
            message: "no answer".into(),
            ..DiagnosticStatus::default()
        };
        faults.update(&status);
        for size in [(0, 0), (0, 79), (1, 1), (4, 19), (2, 9), (30, 5)] {
            let sources = Sources {
                title: "/darwin_op   domain 0   emulated".into(),
                topics: (0..30).map(|number| topic(format!("camera_{number}/image_raw"))).collect(),
                statistics: &statistics,
                bridge: None,
                recording: None,
                faults: &faults,
            };
            let block = StatusBlock::new(sources).lines(size);
            assert!(block.len() <= size.0, "{size:?}: {block:#?}");
            let shows_fault = block.iter().any(|line| line.contains("answer"));
            assert_eq!(shows_fault, size.0 >= 2, "{size:?}: {block:#?}");
        }
    }

    #[test]
    fn rates_cover_at_least_the_last_second() {
        let start = Instant::now();
        let mut rates = Rates::new(start);
        let at = |milliseconds| start + Duration::from_millis(milliseconds);
        assert_eq!(rates.update(at(500), vec![60]), [0.0]);
        assert_eq!(rates.update(at(1000), vec![125]), [125.0]);
        assert_eq!(rates.update(at(1900), vec![999]), [125.0]);
        assert_eq!(rates.update(at(3000), vec![325]), [100.0]);
    }

    #[test]
    fn faults_are_shown_worst_first_until_their_component_recovers() {
        let faults = Faults::default();
        let status = |name: &str, level, message: &str| DiagnosticStatus {
            level,
            name: name.into(),
            message: message.into(),
            ..DiagnosticStatus::default()
        };
        faults.update(&status("board", DiagnosticStatus::STALE, "no news"));
        faults.update(&status("servo 5", DiagnosticStatus::ERROR, "silent"));
        assert_eq!(faults.worst_first(), ["error: servo 5: silent", "stale: board: no news"]);
        faults.update(&status("servo 5", DiagnosticStatus::OK, "well"));
        assert_eq!(faults.worst_first(), ["stale: board: no news"]);
    }
}
