//! The chains of `[[latency]]`, measured while the robot runs.

use std::collections::VecDeque;
use std::fmt::Write;
use std::sync::Arc;
use std::time::Duration;

use downbeat_executor::{
    Context, Core, CycleRuns, DetachedStep, Module, ModuleEvent, ModuleOptions, Received, Role, Setup,
    SetupError, Time,
};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticStatus, KeyValue};
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

use crate::causes::{Ages, Latency, Sample};
use crate::file::LatencyEntry;

/// The name of the module that measures.
pub(crate) const MODULE_NAME: &str = "latency_watch";

/// How many of the newest ages the distribution has.
const RECENT: usize = 1024;

/// The interval of warnings about one chain.
const PATIENCE: Duration = Duration::from_secs(1);

/// What was measured of a chain.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChainReport {
    /// The name in the robot file.
    pub name: String,
    /// The topic at which the chain begins.
    pub from: String,
    /// The topic at which it ends.
    pub to: String,
    /// The limit of the robot file.
    pub limit_ns: Option<u64>,
    /// How many messages of `to` depend on one of `from`.
    pub messages: u64,
    /// How many messages of `to` depend on none.
    pub without_origin: u64,
    /// How many messages of `to` were older than the limit.
    pub exceeded: u64,
    /// The ages of the newest messages: 50 %, 90 % and 99 % are not above.
    pub p50_ns: u64,
    /// As `p50_ns`.
    pub p90_ns: u64,
    /// As `p50_ns`.
    pub p99_ns: u64,
    /// The largest age so far.
    pub max_ns: u64,
    /// Where the oldest message spent its time.
    pub oldest: String,
}

/// The measured chains of a robot; clones share them.
#[derive(Clone, Default)]
pub struct Latencies(Arc<Mutex<Vec<Chain>>>);

struct Chain {
    entry: LatencyEntry,
    recent: VecDeque<Duration>,
    report: ChainReport,
    /// When the last warning was logged, and how many messages were too old since.
    warned: Option<Time>,
    silent: u64,
}

fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

impl Latencies {
    /// Adds an observer that measures the chains; does nothing without chains.
    pub(crate) fn add(core: &mut Core, entries: &[LatencyEntry]) -> Result<Self, SetupError> {
        let chain = |entry: &LatencyEntry| Chain {
            entry: entry.clone(),
            recent: VecDeque::with_capacity(RECENT),
            report: ChainReport {
                name: entry.name.clone(),
                from: entry.from.value.clone(),
                to: entry.to.value.clone(),
                limit_ns: entry.limit.map(nanoseconds),
                ..ChainReport::default()
            },
            warned: None,
            silent: 0,
        };
        let latencies = Self(Arc::new(Mutex::new(entries.iter().map(chain).collect())));
        if !entries.is_empty() {
            let measured =
                entries.iter().map(|entry| Latency::new(&entry.from.value, &entry.to.value)).collect();
            let watch = LatencyWatch { measured, latencies: latencies.clone() };
            let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
            core.add_with(MODULE_NAME, watch, options)?;
        }
        Ok(latencies)
    }

    /// What was measured so far, in the order of the robot file.
    #[must_use]
    pub fn reports(&self) -> Vec<ChainReport> {
        self.0.lock().iter().map(Chain::report).collect()
    }

    /// One status for each chain: a warning if messages were too old since the last call of the closure.
    pub(crate) fn diagnostics(&self, node: &str) -> impl FnMut() -> Vec<DiagnosticStatus> + Send + 'static {
        let (latencies, node, mut exceeded) = (self.clone(), node.to_owned(), Vec::new());
        move || {
            let reports = latencies.reports();
            exceeded.resize(reports.len(), 0);
            let status = |(report, before): (&ChainReport, &mut u64)| {
                let new = report.exceeded.saturating_sub(std::mem::replace(before, report.exceeded));
                status(&node, report, new)
            };
            reports.iter().zip(&mut exceeded).map(status).collect()
        }
    }
}

fn status(node: &str, report: &ChainReport, new: u64) -> DiagnosticStatus {
    let milliseconds = |time_ns: u64| format!("{:.3}", time_ns as f64 / 1e6);
    let mut values = vec![
        ("from", report.from.clone()),
        ("to", report.to.clone()),
        ("p50, ms", milliseconds(report.p50_ns)),
        ("p90, ms", milliseconds(report.p90_ns)),
        ("p99, ms", milliseconds(report.p99_ns)),
        ("max, ms", milliseconds(report.max_ns)),
        ("messages", report.messages.to_string()),
        ("messages without origin", report.without_origin.to_string()),
        ("messages over the limit", report.exceeded.to_string()),
        ("oldest", report.oldest.clone()),
    ];
    values.extend(report.limit_ns.map(|limit| ("limit, ms", milliseconds(limit))));
    let (level, message) = match new {
        0 => (DiagnosticStatus::OK, format!("p99 {} ms", milliseconds(report.p99_ns))),
        _ => (DiagnosticStatus::WARN, format!("{new} messages older than the limit")),
    };
    DiagnosticStatus {
        level,
        name: format!("{node}: latency {}", report.name),
        message,
        hardware_id: String::new(),
        values: values.into_iter().map(|(key, value)| KeyValue { key: key.to_owned(), value }).collect(),
    }
}

impl Chain {
    fn report(&self) -> ChainReport {
        let ages = Ages::new(self.recent.iter().map(|&age| (age, 1)));
        let quantile = |share| ages.quantile(share).map(nanoseconds).unwrap_or_default();
        ChainReport {
            p50_ns: quantile(0.5),
            p90_ns: quantile(0.9),
            p99_ns: quantile(0.99),
            ..self.report.clone()
        }
    }

    fn take(&mut self, sample: &Sample, now: Time) {
        self.report.messages += u64::from(sample.count);
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back(sample.age);
        if nanoseconds(sample.age) > self.report.max_ns {
            self.report.max_ns = nanoseconds(sample.age);
            self.report.oldest = way(sample);
        }
        if self.entry.limit.is_some_and(|limit| sample.age > limit) {
            self.report.exceeded += u64::from(sample.count);
            self.silent += u64::from(sample.count);
            self.warn(sample, now);
        }
    }

    fn warn(&mut self, sample: &Sample, now: Time) {
        if self.warned.is_some_and(|warned| now.saturating_since(warned) < PATIENCE) {
            return;
        }
        self.warned = Some(now);
        let ChainReport { name, from, to, .. } = &self.report;
        let (limit, messages) = (self.entry.limit.unwrap_or_default(), std::mem::take(&mut self.silent));
        let (age, way) = (sample.age, way(sample));
        tracing::warn!(
            "latency \"{name}\": {to} came {age:?} after the {from} that it depends on, the limit is {limit:?}; {way}; \
             {messages} such messages since the last warning"
        );
    }
}

/// Where a message spent its time.
fn way(sample: &Sample) -> String {
    let mut way = String::new();
    for hop in sample.hops() {
        let (waited, held) =
            (hop.received.saturating_since(hop.sent), hop.published.saturating_since(hop.received));
        let separator = if way.is_empty() { "" } else { ", then " };
        let _ =
            write!(way, "{separator}{} waited {waited:?} for {}, which kept it {held:?}", hop.by, hop.module);
    }
    way
}

/// Propagates origins through the runs of the robot.
struct LatencyWatch {
    measured: Vec<Latency>,
    latencies: Latencies,
}

impl LatencyWatch {
    fn on_account(&mut self, account: &CycleRuns, ctx: &Context<'_>) {
        for (number, latency) in self.measured.iter_mut().enumerate() {
            latency.account(account);
            let mut samples = latency.take_samples().peekable();
            if samples.peek().is_some()
                && let Some(chain) = self.latencies.0.lock().get_mut(number)
            {
                samples.for_each(|sample| chain.take(&sample, ctx.now()));
            }
        }
        for (latency, chain) in self.measured.iter().zip(&mut *self.latencies.0.lock()) {
            chain.report.without_origin = latency.without_origin();
        }
    }
}

impl Module for LatencyWatch {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        // In this order: in a run, steps and earlier events come before the account of their cycle.
        setup.subscribe(DetachedStep::TOPIC, |watch, step: Received<'_, DetachedStep>, _| {
            watch.measured.iter_mut().for_each(|latency| latency.step(&step));
        })?;
        setup.subscribe(ModuleEvent::TOPIC, |watch, event: Received<'_, ModuleEvent>, _| {
            watch.measured.iter_mut().for_each(|latency| latency.event(&event));
        })?;
        setup.subscribe(CycleRuns::TOPIC, |watch, account: Received<'_, Arc<CycleRuns>>, ctx| {
            watch.on_account(&account, ctx);
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::path::Path;

    use downbeat_executor::{ManualClock, Publication};
    use downbeat_msgs::std_msgs;

    use super::*;
    use crate::{Catalog, Kind, RobotFile, Source};

    /// Passes numbers on after a delay.
    struct Delay;

    impl Module for Delay {
        type Ports = Publication<std_msgs::msg::Int32>;

        fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Self::Ports, SetupError> {
            let later = setup.task(|_, ctx: &mut Context<'_, Self::Ports>| {
                ctx.publish(*ctx.ports, std_msgs::msg::Int32::default());
            });
            setup.subscribe("numbers", move |_, _: Received<'_, std_msgs::msg::Int32>, ctx| {
                ctx.schedule_after(later, Duration::from_millis(20));
            })?;
            setup.publish("delayed")
        }
    }

    fn robot(latency: &str, clock: &ManualClock) -> Result<crate::Robot, String> {
        let mut catalog = Catalog::built_in();
        catalog.add_kind(Kind::new("delay", "passes on", || Delay)).unwrap();
        let text = format!("[robot]\nname = \"r\"\n[[module]]\nkind = \"delay\"\n{latency}");
        let file = RobotFile::parse(Source::new(Path::new("robot.toml"), text), &catalog);
        let built = file.and_then(|(file, _)| file.build(Core::new().with_clock(clock.clone())));
        built.map_err(|error| error.to_string())
    }

    fn refusal(latency: &str) -> String {
        robot(latency, &ManualClock::new(Time::ZERO)).err().unwrap()
    }

    #[test]
    fn a_chain_is_measured_while_the_robot_runs_and_its_limit_watched() {
        let text = "[[latency]]\nname = \"way\"\nfrom = \"numbers\"\nto = \"/delayed\"\nlimit = \"15ms\"";
        let clock = ManualClock::new(Time::ZERO);
        let mut robot = robot(text, &clock).unwrap();
        let numbers = robot.core.inlet::<std_msgs::msg::Int32>("numbers").unwrap();
        let mut diagnostics = robot.latencies.diagnostics("robot");
        assert_eq!(diagnostics()[0].level, DiagnosticStatus::OK);
        for cycle in 0..40 {
            if cycle % 6 == 0 {
                numbers.publish(std_msgs::msg::Int32::default()).unwrap();
            }
            robot.core.cycle().unwrap();
            clock.advance(Duration::from_millis(5));
        }
        robot.core.stop();
        let report = robot.latencies.reports().remove(0);
        assert!(report.messages >= 5 && report.exceeded == report.messages, "{report:?}");
        // A message joins in one cycle, is received in the next, and passed on 20 ms after that.
        assert_eq!([report.p50_ns, report.max_ns], [25_000_000; 2]);
        assert_eq!(report.oldest, "numbers waited 5ms for delay, which kept it 20ms");
        let [status] = &diagnostics()[..] else { panic!("one chain") };
        assert_eq!((status.level, &*status.name), (DiagnosticStatus::WARN, "robot: latency way"));
        assert_eq!(diagnostics()[0].level, DiagnosticStatus::OK, "nothing new");
    }

    #[test]
    fn mistakes_are_told_with_their_line_and_the_nearest_name() {
        let unknown = refusal("[[latency]]\nname = \"way\"\nfrom = \"number\"\nto = \"delayed\"");
        assert!(
            unknown.contains("robot.toml:7") && unknown.contains("did you mean \"numbers\""),
            "{unknown}"
        );
        let same = refusal("[[latency]]\nname = \"way\"\nfrom = \"numbers\"\nto = \"/numbers\"");
        assert!(same.contains("robot.toml:5") && same.contains("same topic"), "{same}");
        let twice = "[[latency]]\nname = \"way\"\nfrom = \"numbers\"\nto = \"delayed\"\n";
        assert!(refusal(&twice.repeat(2)).contains("another [[latency]] of this name"));
    }
}
