//! The tables of modules, topics and outlets: from two snapshots to rows of text.

use std::cmp::Ordering;
use std::collections::HashMap;
use std::time::Duration;

use downbeat_executor::{ModuleStatistics, OutletStatistics, Snapshot, TimeStatistics, TopicStatistics};

use downbeat_robot::ChainReport;

use crate::screen::{length, wrap};
use crate::statistics::short;
use downbeat_msgs::printable;

/// Headings and rows. The first column is text, the others are numbers unless [`Grid::LEFT`] names them.
#[derive(Debug, PartialEq)]
pub(crate) struct Grid {
    pub(crate) headings: Vec<&'static str>,
    pub(crate) rows: Vec<Vec<String>>,
}

/// How rows are sorted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Sort {
    /// In the order of registration or declaration.
    #[default]
    Order,
    /// The busiest module, or the topic with the most messages, first.
    Busiest,
    /// By name.
    Name,
}

impl Sort {
    pub(crate) fn next(self) -> Self {
        match self {
            Self::Order => Self::Busiest,
            Self::Busiest => Self::Name,
            Self::Name => Self::Order,
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Order => "order",
            Self::Busiest => "busiest",
            Self::Name => "name",
        }
    }
}

impl Grid {
    /// Columns of words.
    const LEFT: [&'static str; 7] = ["MODULE", "TOPIC", "OUTLET", "STATE", "LATENCY", "FROM", "TO"];

    /// The modules, with rates over the time from `earlier` to `later`.
    pub(crate) fn of_modules(earlier: &Snapshot, later: &Snapshot, sort: Sort) -> Self {
        let before: HashMap<_, _> = earlier.modules.iter().map(|module| (&module.name, module)).collect();
        let (new, seconds) = (ModuleStatistics::default(), seconds_between(earlier, later));
        let mut rows: Vec<_> = later
            .modules
            .iter()
            .map(|module| (module, before.get(&module.name).copied().unwrap_or(&new)))
            .map(|(module, before)| (module, before, Shares::of(before, module, seconds)))
            .collect();
        match sort {
            Sort::Order => {}
            Sort::Busiest => rows.sort_by(|(.., a), (.., b)| descending(a.processor, b.processor)),
            Sort::Name => rows.sort_by(|(a, ..), (b, ..)| a.name.cmp(&b.name)),
        }
        let cells = |(module, before, shares): (&ModuleStatistics, &ModuleStatistics, Shares)| {
            let rate = |now: u64, then: u64| rate(now.saturating_sub(then) as f64 / seconds);
            let detached = if module.is_detached { " detached" } else { "" };
            let mut cells = vec![
                printable(&module.name).into_owned(),
                format!("{}{detached}", module.state),
                rate(module.runs, before.runs),
            ];
            cells.extend(times(&module.run_time));
            let percent = |share: f64| match module.run_time.count {
                0 => "-".into(),
                _ => format!("{:.1} %", share * 100.0),
            };
            cells.push(percent(shares.processor));
            cells.push(shares.waiting.map_or_else(|| "-".into(), percent));
            cells.extend([rate(module.received, before.received), rate(module.published, before.published)]);
            let counts =
                [module.inbox, module.dropped, module.overruns, module.panics].map(|count| count.to_string());
            cells.extend(counts);
            cells
        };
        let headings = vec![
            "MODULE", "STATE", "RUNS/S", "P50", "P99", "MAX", "CPU", "WAIT", "IN/S", "OUT/S", "INBOX",
            "DROPS", "OVERRUNS", "PANICS",
        ];
        Self { headings, rows: rows.into_iter().map(cells).collect() }
    }

    /// The topics, with rates over the time from `earlier` to `later`.
    pub(crate) fn of_topics(earlier: &Snapshot, later: &Snapshot, sort: Sort) -> Self {
        let before: HashMap<_, _> =
            earlier.topics.iter().map(|topic| (&topic.name, topic.messages)).collect();
        let seconds = seconds_between(earlier, later);
        let gain = |topic: &TopicStatistics| {
            topic.messages.saturating_sub(before.get(&topic.name).copied().unwrap_or(0)) as f64 / seconds
        };
        let mut rows: Vec<_> = later.topics.iter().map(|topic| (topic, gain(topic))).collect();
        match sort {
            Sort::Order => {}
            Sort::Busiest => rows.sort_by(|(_, a), (_, b)| descending(*a, *b)),
            Sort::Name => rows.sort_by(|(a, _), (b, _)| a.name.cmp(&b.name)),
        }
        let cells = |(topic, messages_per_second): (&TopicStatistics, f64)| {
            let TopicStatistics { messages, subscribers, dropped, last_batch, largest_batch, .. } = topic;
            let age = topic.last_time_ns.map_or_else(
                || "never".into(),
                |last| short(later.time.saturating_since(downbeat_executor::Time::from_nanos(last))),
            );
            let counts = [messages, subscribers, dropped, last_batch, largest_batch];
            let mut cells = vec![printable(&topic.name).into_owned(), rate(messages_per_second)];
            cells.extend(counts.map(u64::to_string));
            cells.push(age);
            cells
        };
        let headings =
            vec!["TOPIC", "MESSAGES/S", "MESSAGES", "SUBSCRIBERS", "DROPS", "LAST BATCH", "LARGEST", "AGE"];
        Self { headings, rows: rows.into_iter().map(cells).collect() }
    }

    /// The inboxes of outlets, with rates over the time from `earlier` to `later`.
    pub(crate) fn of_outlets(earlier: &Snapshot, later: &Snapshot, sort: Sort) -> Self {
        let before: HashMap<_, _> =
            earlier.outlets.iter().map(|outlet| (&outlet.name, outlet.received)).collect();
        let seconds = seconds_between(earlier, later);
        let gain = |outlet: &OutletStatistics| {
            outlet.received.saturating_sub(before.get(&outlet.name).copied().unwrap_or(0)) as f64 / seconds
        };
        let mut rows: Vec<_> = later.outlets.iter().map(|outlet| (outlet, gain(outlet))).collect();
        match sort {
            Sort::Order => {}
            Sort::Busiest => rows.sort_by(|(_, a), (_, b)| descending(*a, *b)),
            Sort::Name => rows.sort_by(|(a, _), (b, _)| a.name.cmp(&b.name)),
        }
        let cells = |(outlet, messages_per_second): (&OutletStatistics, f64)| {
            let OutletStatistics { received, topics, inbox, dropped, failed, .. } = outlet;
            let mut cells = vec![printable(&outlet.name).into_owned(), rate(messages_per_second)];
            cells.extend([received, topics, inbox, dropped, failed].map(u64::to_string));
            cells
        };
        let headings = vec!["OUTLET", "MESSAGES/S", "MESSAGES", "TOPICS", "INBOX", "DROPS", "PANICS"];
        Self { headings, rows: rows.into_iter().map(cells).collect() }
    }

    /// The measured chains: the distribution is of the newest messages, the rest since the robot's start.
    pub(crate) fn of_latencies(chains: &[ChainReport]) -> Self {
        let cells = |chain: &ChainReport| {
            let time = |time_ns| short(Duration::from_nanos(time_ns));
            let mut cells: Vec<_> =
                [&chain.name, &chain.from, &chain.to].map(|name| printable(name).into_owned()).into();
            let times = [chain.p50_ns, chain.p90_ns, chain.p99_ns, chain.max_ns];
            match chain.messages {
                0 => cells.extend(times.map(|_| "-".to_owned())),
                _ => cells.extend(times.map(time)),
            }
            cells.push(chain.limit_ns.map_or_else(|| "-".into(), time));
            cells.extend(
                [chain.exceeded, chain.messages, chain.without_origin].map(|count| count.to_string()),
            );
            cells
        };
        let headings =
            vec!["LATENCY", "FROM", "TO", "P50", "P90", "P99", "MAX", "LIMIT", "OVER", "MESSAGES", "WITHOUT"];
        Self { headings, rows: chains.iter().map(cells).collect() }
    }

    /// Columns of numbers in the order in which they are omitted on a narrow terminal. The others are always
    /// shown: the busiest module and losses matter most.
    const DISPENSABLE: [&'static str; 17] = [
        "INBOX",
        "WITHOUT",
        "P90",
        "MAX",
        "LARGEST",
        "LAST BATCH",
        "P50",
        "IN/S",
        "OUT/S",
        "SUBSCRIBERS",
        "WAIT",
        "OVERRUNS",
        "MESSAGES",
        "PANICS",
        "STATE",
        "P99",
        "AGE",
    ];

    /// The same rows with the columns that fit into `width` characters: numbers are never truncated.
    pub(crate) fn fitting(mut self, width: usize) -> Self {
        let mut dispensable = Self::DISPENSABLE.into_iter();
        while self.width() > width
            && let Some(heading) = dispensable.next()
        {
            let Some(column) = self.headings.iter().position(|other| *other == heading) else { continue };
            self.headings.remove(column);
            self.rows.iter_mut().for_each(|row| drop(row.remove(column)));
        }
        while self.width() > width && self.headings.len() > 1 {
            self.headings.pop();
            self.rows.iter_mut().for_each(|row| drop(row.pop()));
        }
        self
    }

    /// Characters between columns.
    pub(crate) const SPACING: usize = 2;

    fn width(&self) -> usize {
        self.widths().iter().map(|width| width + Self::SPACING).sum::<usize>().saturating_sub(Self::SPACING)
    }

    /// The width of each column.
    pub(crate) fn widths(&self) -> Vec<usize> {
        let width = |column: usize| {
            let cells = self.rows.iter().map(|row| length(&row[column]));
            cells.chain([self.headings[column].len()]).max().unwrap_or(0)
        };
        (0..self.headings.len()).map(width).collect()
    }

    /// Returns whether a column is left-aligned.
    pub(crate) fn is_left(&self, column: usize) -> bool {
        Self::LEFT.contains(&self.headings[column])
    }

    /// The whole table as lines.
    pub(crate) fn lines(&self) -> impl Iterator<Item = String> {
        let widths = self.widths();
        let headings = self.headings.iter().map(ToString::to_string).collect();
        std::iter::once(headings).chain(self.rows.iter().cloned()).map(move |row: Vec<String>| {
            let cells = row.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| {
                if self.is_left(column) { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
            });
            cells.collect::<Vec<_>>().join(&" ".repeat(Self::SPACING)).trim_end().to_owned()
        })
    }
}

/// The summary of cycles: three lines, or more if they would exceed `width` characters.
pub(crate) fn summary(robot: &str, earlier: &Snapshot, later: &Snapshot, width: usize) -> Vec<String> {
    let seconds = seconds_between(earlier, later);
    let cycles_per_second = rate(later.cycle.saturating_sub(earlier.cycle) as f64 / seconds);
    let state = if later.is_paused { "paused" } else { "running" };
    let up = later.uptime_ns / 1_000_000_000;
    let cycles = &later.cycles;
    let [total, process, sync, lateness] =
        [&cycles.total, &cycles.process, &cycles.sync, &cycles.lateness].map(distribution);
    let first = [
        robot.to_owned(),
        state.to_owned(),
        format!("up {up} s"),
        format!("{cycles_per_second} cycles/s"),
        measured(later),
    ];
    let mut lines = wrap(first, "   ", width);
    lines.extend(wrap([format!("cycle    {total}"), format!("late {lateness}")], "   ", width));
    lines.extend(wrap([format!("process  {process}"), format!("sync {sync}")], "   ", width));
    lines.into_iter().map(|line| line.text).collect()
}

/// The share of measured cycles, and the cost of measuring.
fn measured(snapshot: &Snapshot) -> String {
    let cycles = &snapshot.cycles;
    if cycles.total.count == 0 {
        return "times are not measured".into();
    }
    let share = cycles.total.count as f64 / snapshot.cycle.max(1) as f64;
    let busy_ns = cycles.total.mean_ns() * snapshot.cycle as f64;
    let cost = cycles.measuring_ns as f64 / busy_ns.max(1.0);
    format!("{:.1} % of cycles measured, for {:.1} % of the time", share.min(1.0) * 100.0, cost * 100.0)
}

fn distribution(times: &TimeStatistics) -> String {
    let [p50, p99, max] = self::times(times);
    format!("p50 {p50}  p99 {p99}  max {max}")
}

/// Median, 99th percentile and maximum.
fn times(times: &TimeStatistics) -> [String; 3] {
    let text = |time_ns| {
        if times.count == 0 { "-".into() } else { short(Duration::from_nanos(time_ns)) }
    };
    [text(times.p50_ns), text(times.p99_ns), short_maximum(times)]
}

/// The maximum may be known even if the distribution is not.
fn short_maximum(times: &TimeStatistics) -> String {
    if times.max_ns == 0 { "-".into() } else { short(Duration::from_nanos(times.max_ns)) }
}

/// What a module did with the time between two snapshots.
#[derive(Clone, Copy)]
struct Shares {
    /// The share of one processor that it used. A module that is not detached is taken to compute all the
    /// time of its runs.
    processor: f64,
    /// The share of the time that it waited in its runs, where that is known.
    waiting: Option<f64>,
}

impl Shares {
    fn of(before: &ModuleStatistics, module: &ModuleStatistics, seconds: f64) -> Self {
        let running = running_share(before, module, seconds);
        match module.processor_ns {
            None => Self { processor: running, waiting: None },
            Some(now_ns) => {
                let used_ns = now_ns.saturating_sub(before.processor_ns.unwrap_or(0));
                let processor = used_ns as f64 / (seconds * 1e9);
                Self { processor, waiting: Some((running - processor).max(0.0)) }
            }
        }
    }
}

/// The share of the time between two snapshots in which a module ran, extrapolated from its measured runs.
fn running_share(before: &ModuleStatistics, module: &ModuleStatistics, seconds: f64) -> f64 {
    let (now, then) = (&module.run_time, &before.run_time);
    let count = now.count.saturating_sub(then.count);
    let mean_ns = match count {
        0 => now.mean_ns(),
        _ => now.sum_ns.saturating_sub(then.sum_ns) as f64 / count as f64,
    };
    mean_ns * module.runs.saturating_sub(before.runs) as f64 / (seconds * 1e9)
}

fn seconds_between(earlier: &Snapshot, later: &Snapshot) -> f64 {
    // Two simultaneous snapshots would give infinite rates.
    (later.uptime_ns.saturating_sub(earlier.uptime_ns).max(1_000_000)) as f64 / 1e9
}

fn descending(a: f64, b: f64) -> Ordering {
    b.total_cmp(&a)
}

/// Events per second, with about three digits.
fn rate(rate: f64) -> String {
    match rate {
        0.0 => "0".into(),
        ..99.95 => format!("{rate:.1}"),
        ..99_999.5 => format!("{rate:.0}"),
        ..9_999_500.0 => format!("{:.0}k", rate / 1e3),
        _ => format!("{:.0}M", rate / 1e6),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use downbeat_executor::{CycleStatistics, ModuleState, Time};

    use super::*;

    /// A robot after `seconds` of 100 cycles each.
    pub(crate) fn snapshot(seconds: u64) -> Snapshot {
        let times = |count, mean_ns| TimeStatistics {
            count,
            sum_ns: count * mean_ns,
            p50_ns: mean_ns,
            p99_ns: 2 * mean_ns,
            max_ns: 3 * mean_ns,
        };
        let module = |name: &str, is_detached, runs, mean_ns| ModuleStatistics {
            name: name.into(),
            is_detached,
            runs,
            received: 2 * runs,
            published: runs,
            run_time: times(runs / 10, mean_ns),
            ..ModuleStatistics::default()
        };
        let cycle = 100 * seconds;
        let mut vision = module("vision", true, 10 * seconds, 50_000_000);
        (vision.inbox, vision.dropped) = (3, 17);
        vision.processor_ns = Some(seconds * 50_000_000);
        let mut planner = module("planner", false, 0, 0);
        planner.state = ModuleState::Failed;
        planner.panics = 1;
        Snapshot {
            time: Time::from_nanos(seconds as i64 * 1_000_000_000),
            uptime_ns: seconds * 1_000_000_000,
            cycle,
            is_paused: false,
            cycles: CycleStatistics {
                process: times(cycle / 10, 20_000),
                sync: times(cycle / 10, 1_000),
                total: times(cycle / 10, 21_000),
                lateness: times(cycle / 10, 60_000),
                measuring_ns: cycle * 105,
            },
            modules: vec![module("motion", false, cycle, 20_000), vision, planner],
            topics: vec![
                TopicStatistics {
                    name: "joint_states".into(),
                    subscribers: 2,
                    messages: cycle,
                    last_batch: 1,
                    largest_batch: 4,
                    last_time_ns: Some(seconds as i64 * 1_000_000_000 - 8_000_000),
                    ..TopicStatistics::default()
                },
                TopicStatistics {
                    name: "image".into(),
                    messages: 200 * seconds,
                    ..TopicStatistics::default()
                },
            ],
            outlets: vec![OutletStatistics {
                name: "recorder".into(),
                topics: 2,
                received: 300 * seconds,
                inbox: 1,
                ..OutletStatistics::default()
            }],
        }
    }

    #[test]
    fn rates_and_shares_cover_the_time_between_two_snapshots() {
        let grid = Grid::of_modules(&snapshot(10), &snapshot(12), Sort::Order);
        let expected = [
            "MODULE   STATE            RUNS/S      P50      P99      MAX    CPU    WAIT  IN/S  OUT/S  INBOX  DROPS  OVERRUNS  PANICS",
            "motion   active              100  20.0 µs  40.0 µs  60.0 µs  0.2 %       -   200    100      0      0         0       0",
            "vision   active detached    10.0  50.0 ms   100 ms   150 ms  5.0 %  45.0 %  20.0   10.0      3     17         0       0",
            "planner  failed                0        -        -        -      -       -     0      0      0      0         0       1",
        ];
        assert_eq!(grid.lines().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn topics_show_their_rate_and_the_age_of_their_last_message() {
        let grid = Grid::of_topics(&snapshot(10), &snapshot(12), Sort::Order);
        let expected = [
            "TOPIC         MESSAGES/S  MESSAGES  SUBSCRIBERS  DROPS  LAST BATCH  LARGEST      AGE",
            "joint_states         100      1200            2      0           1        4  8.00 ms",
            "image                200      2400            0      0           0        0    never",
        ];
        assert_eq!(grid.lines().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn outlets_show_their_rate_and_queue() {
        let grid = Grid::of_outlets(&snapshot(10), &snapshot(12), Sort::Busiest);
        let expected = [
            "OUTLET    MESSAGES/S  MESSAGES  TOPICS  INBOX  DROPS  PANICS",
            "recorder         300      3600       2      1      0       0",
        ];
        assert_eq!(grid.lines().collect::<Vec<_>>(), expected);
    }

    #[test]
    fn chains_show_their_ages_and_limit() {
        let chain = ChainReport {
            name: "reaction".into(),
            from: "image".into(),
            to: "goals".into(),
            limit_ns: Some(30_000_000),
            messages: 10,
            exceeded: 1,
            p50_ns: 12_000_000,
            max_ns: 35_000_000,
            ..ChainReport::default()
        };
        let lines: Vec<_> =
            Grid::of_latencies(&[chain.clone(), ChainReport { limit_ns: None, messages: 0, ..chain }])
                .lines()
                .collect();
        assert_eq!(
            lines,
            [
                "LATENCY   FROM   TO         P50      P90      P99      MAX    LIMIT  OVER  MESSAGES  WITHOUT",
                "reaction  image  goals  12.0 ms  0.00 ns  0.00 ns  35.0 ms  30.0 ms     1        10        0",
                "reaction  image  goals        -        -        -        -        -     1         0        0",
            ]
        );
    }

    #[test]
    fn rows_are_sorted_as_requested() {
        let names = |sort| {
            let modules = Grid::of_modules(&snapshot(1), &snapshot(2), sort);
            let topics = Grid::of_topics(&snapshot(1), &snapshot(2), sort);
            let rows = modules.rows.into_iter().chain(topics.rows);
            rows.map(|row| row[0].clone()).collect::<Vec<_>>()
        };
        assert_eq!(names(Sort::Order), ["motion", "vision", "planner", "joint_states", "image"]);
        assert_eq!(names(Sort::Busiest), ["vision", "motion", "planner", "image", "joint_states"]);
        assert_eq!(names(Sort::Name), ["motion", "planner", "vision", "image", "joint_states"]);
    }

    #[test]
    fn a_module_added_between_two_snapshots_is_counted_from_zero() {
        let mut earlier = snapshot(1);
        earlier.modules.remove(0);
        let grid = Grid::of_modules(&earlier, &snapshot(2), Sort::Order);
        assert_eq!(grid.rows[0][2], "200");
    }

    #[test]
    fn the_summary_shows_the_share_of_measured_cycles() {
        let lines = summary("darwin_op (process 7)", &snapshot(10), &snapshot(12), usize::MAX);
        assert_eq!(
            lines,
            [
                "darwin_op (process 7)   running   up 12 s   100 cycles/s   10.0 % of cycles measured, for 0.5 % of the time",
                "cycle    p50 21.0 µs  p99 42.0 µs  max 63.0 µs   late p50 60.0 µs  p99 120 µs  max 180 µs",
                "process  p50 20.0 µs  p99 40.0 µs  max 60.0 µs   sync p50 1.00 µs  p99 2.00 µs  max 3.00 µs",
            ]
        );
        let off = summary("a", &Snapshot::default(), &Snapshot::default(), usize::MAX);
        assert!(off[0].ends_with("times are not measured"), "{off:?}");
    }

    #[test]
    fn rates_are_short() {
        let rates = [0.0, 0.25, 99.9, 100.0, 99_999.0, 123_456.0, 12_345_678.0].map(rate);
        assert_eq!(rates, ["0", "0.2", "99.9", "100", "99999", "123k", "12M"]);
    }
}
