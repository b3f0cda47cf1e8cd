//! `downbeat topic hz`, `bw` and `delay`

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::{Duration, Instant};

use anyhow::bail;
use bytes::Bytes;
use clap::Args;
use downbeat_bridge::middleware::Sample;
use downbeat_bridge::ros::{MessageType, Subscription};
use downbeat_msgs::dynamic::{DynamicType, DynamicView};
use downbeat_msgs::qos::QosProfile;

use super::clock::{ClockFollower, LookClock};
use super::definitions::Types;
use super::network::{Environment, Look, LookArguments};
use super::topic_type::{Absent, type_on_network};

#[derive(Args)]
pub(crate) struct HzArguments {
    #[command(flatten)]
    rate: RateArguments,
    /// Use the time of the machine, regardless of --use-sim-time.
    #[arg(long)]
    wall_time: bool,
}

#[derive(Args)]
pub(crate) struct RateArguments {
    /// The topic.
    topic: String,
    /// The number of messages in the statistics; default 100 for bw, 10000 for hz and delay.
    #[arg(short, long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    window: Option<u32>,
    /// Search definitions here first: an ament prefix, a folder of packages, or a package.
    #[arg(long, value_name = "PATH")]
    from: Vec<PathBuf>,
    #[command(flatten)]
    look: LookArguments,
}

/// How soon Ctrl-C is noticed.
const POLL: Duration = Duration::from_millis(50);
const SECOND: Duration = Duration::from_secs(1);

/// The maximum number of queued messages.
const MOST_WAITING: usize = 1024;

struct Arrived {
    /// Nanoseconds since the epoch; 0 if the time is unknown.
    time: i64,
    cdr: Bytes,
}

/// Messages of a topic with the time at which they arrived.
struct Arrivals {
    look: Look,
    type_name: String,
    clock: LookClock,
    arrived: Receiver<Arrived>,
    _subscription: Subscription,
    _follower: ClockFollower,
}

impl Arrivals {
    /// Returns `None` if the command is stopped before the topic exists.
    fn of(
        arguments: &RateArguments,
        use_sim_time: bool,
        environment: &Environment<'_>,
    ) -> anyhow::Result<Option<Self>> {
        let look = Look::join("topic", &arguments.look, environment)?;
        let Some(type_name) = type_on_network(&look, &arguments.topic, Absent::Wait)? else {
            return Ok(None);
        };
        let (clock, follower) = LookClock::new(&look, use_sim_time)?;
        let (sender, arrived) = sync_channel(MOST_WAITING);
        let of_samples = clock.clone();
        let on_sample = move |sample: Sample| {
            let _ = sender.try_send(Arrived { time: of_samples.now(), cdr: sample.cdr });
        };
        let message_type = MessageType::new(&type_name)?;
        let qos = QosProfile::SENSOR_DATA;
        let subscription = look.node.subscribe(&arguments.topic, &message_type, qos, Box::new(on_sample))?;
        Ok(Some(Self { look, type_name, clock, arrived, _subscription: subscription, _follower: follower }))
    }

    /// Calls `take` with each message and `tick` once a second, until the command is stopped.
    fn follow<S>(
        &self,
        state: &mut S,
        mut take: impl FnMut(&mut S, &Arrived) -> anyhow::Result<()>,
        mut tick: impl FnMut(&mut S),
    ) -> anyhow::Result<()> {
        let mut next = Instant::now() + SECOND;
        while !self.look.stop.is_due() {
            if let Ok(arrived) =
                self.arrived.recv_timeout(next.saturating_duration_since(Instant::now()).min(POLL))
            {
                take(state, &arrived)?;
            }
            if Instant::now() >= next {
                next += SECOND;
                tick(state);
            }
        }
        Ok(())
    }
}

/// The latest values of a window.
struct Window {
    values: VecDeque<i64>,
    most: usize,
}

impl Window {
    fn new(most: u32) -> Self {
        Self { values: VecDeque::new(), most: most as usize }
    }

    fn push(&mut self, value: i64) {
        self.values.push_back(value);
        if self.values.len() > self.most {
            self.values.pop_front();
        }
    }

    fn mean(&self) -> f64 {
        self.values.iter().map(|value| *value as f64).sum::<f64>() / self.values.len() as f64
    }

    fn least(&self) -> f64 {
        self.values.iter().min().map_or(0.0, |value| *value as f64)
    }

    fn most(&self) -> f64 {
        self.values.iter().max().map_or(0.0, |value| *value as f64)
    }

    /// Formats minimum, maximum and deviation of times in nanoseconds, printed after their mean.
    fn spread(&self) -> String {
        let mean = self.mean();
        let squares: f64 = self.values.iter().map(|value| (*value as f64 - mean).powi(2)).sum();
        let deviation = (squares / self.values.len() as f64).sqrt();
        format!(
            "\tmin: {:.3}s max: {:.3}s std dev: {:.5}s window: {}",
            self.least() * 1e-9,
            self.most() * 1e-9,
            deviation * 1e-9,
            self.values.len()
        )
    }
}

/// The times between messages.
struct Periods {
    periods: Window,
    first: i64,
    last: i64,
    printed: i64,
}

impl Periods {
    fn new(window: u32) -> Self {
        Self { periods: Window::new(window), first: -1, last: 0, printed: 0 }
    }

    /// Returns the text to print.
    fn take(&mut self, time: i64) -> Option<String> {
        if time == 0 {
            let had_some = !self.periods.values.is_empty();
            self.periods.values.clear();
            return had_some.then(|| "time has reset, resetting counters".to_owned());
        }
        if self.first < 0 || self.first > time {
            self.first = time;
            self.periods.values.clear();
        } else {
            self.periods.push(time - self.last);
        }
        self.last = time;
        if self.periods.values.is_empty() {
            return None;
        }
        if self.printed == 0 {
            self.printed = time;
            return None;
        }
        if time < self.printed + 1_000_000_000 {
            return None;
        }
        self.printed = time;
        let mean = self.periods.mean();
        let rate = if mean > 0.0 { 1e9 / mean } else { 0.0 };
        Some(format!("average rate: {rate:.3}\n{}", self.periods.spread()))
    }
}

pub(super) fn hz(arguments: &HzArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let HzArguments { rate, wall_time } = arguments;
    let use_sim_time = rate.look.use_sim_time && !wall_time;
    let Some(arrivals) = Arrivals::of(rate, use_sim_time, environment)? else { return Ok(()) };
    let mut periods = Periods::new(rate.window.unwrap_or(10_000));
    let take = |periods: &mut Periods, arrived: &Arrived| {
        if let Some(text) = periods.take(arrived.time) {
            println!("{text}");
        }
        Ok(())
    };
    arrivals.follow(&mut periods, take, |_| ())
}

/// The sizes of messages, each with the time at which it arrived.
struct Sizes {
    sizes: Window,
    times: Window,
}

impl Sizes {
    fn new(window: u32) -> Self {
        Self { sizes: Window::new(window), times: Window::new(window) }
    }

    /// Returns the text to print at that time.
    fn bandwidth(&mut self, now: i64) -> Option<String> {
        let first = *self.times.values.front()?;
        let count = self.times.values.len();
        if count < 2 {
            return None;
        }
        if now <= first {
            self.sizes.values.clear();
            self.times.values.clear();
            return Some("WARNING: time is reset!".to_owned());
        }
        let mean = self.sizes.mean();
        let rate = mean * count as f64 / ((now - first) as f64 * 1e-9);
        let show = |bytes: f64| match rate {
            ..1e3 => format!("{bytes:.0} B"),
            ..1e6 => format!("{:.2} KB", bytes / 1e3),
            _ => format!("{:.2} MB", bytes / 1e6),
        };
        Some(format!(
            "{}/s from {count} messages\n\tMessage size mean: {} min: {} max: {}",
            show(rate),
            show(mean),
            show(self.sizes.least()),
            show(self.sizes.most())
        ))
    }
}

pub(super) fn bandwidth(arguments: &RateArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let Some(arrivals) = Arrivals::of(arguments, arguments.look.use_sim_time, environment)? else {
        return Ok(());
    };
    println!("Subscribed to [{}]", arguments.topic);
    let mut sizes = Sizes::new(arguments.window.unwrap_or(100));
    let take = |sizes: &mut Sizes, arrived: &Arrived| {
        sizes.times.push(arrived.time);
        sizes.sizes.push(i64::try_from(arrived.cdr.len()).unwrap_or(i64::MAX));
        Ok(())
    };
    let print = |sizes: &mut Sizes| {
        if let Some(text) = sizes.bandwidth(arrivals.clock.now()) {
            println!("{text}");
        }
    };
    arrivals.follow(&mut sizes, take, print)
}

/// How old messages were when they arrived.
struct Delays {
    delays: Window,
    first: i64,
    last: i64,
    printed: i64,
}

impl Delays {
    fn new(window: u32) -> Self {
        Self { delays: Window::new(window), first: -1, last: 0, printed: 0 }
    }

    /// Adds a message that was stamped at `stamp`. Returns the text to print.
    fn take(&mut self, time: i64, stamp: i64) -> Option<String> {
        if time == 0 {
            let had_some = !self.delays.values.is_empty();
            self.delays.values.clear();
            return had_some.then(|| "time has reset, resetting counters".to_owned());
        }
        if self.first < 0 || self.first > time {
            self.first = time;
            self.delays.values.clear();
        } else {
            self.delays.push(time.saturating_sub(stamp));
        }
        self.last = time;
        None
    }

    fn shown(&mut self) -> Option<String> {
        if self.delays.values.is_empty() {
            return None;
        }
        if self.printed == self.last {
            return Some("no new messages".to_owned());
        }
        self.printed = self.last;
        Some(format!("average delay: {:.3}\n{}", self.delays.mean() * 1e-9, self.delays.spread()))
    }
}

pub(super) fn delay(arguments: &RateArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let Some(arrivals) = Arrivals::of(arguments, arguments.look.use_sim_time, environment)? else {
        return Ok(());
    };
    let types = Types::load(&arrivals.look, &arguments.from)?;
    let of = types.message(&arrivals.look, &arguments.topic, &arrivals.type_name)?;
    if !of.fields().any(|field| field.name == "header") {
        bail!("msg does not have header");
    }
    let mut delays = Delays::new(arguments.window.unwrap_or(10_000));
    let take = |delays: &mut Delays, arrived: &Arrived| {
        if let Some(text) = delays.take(arrived.time, stamp(&of, &arrived.cdr)?) {
            println!("{text}");
        }
        Ok(())
    };
    let print = |delays: &mut Delays| {
        if let Some(text) = delays.shown() {
            println!("{text}");
        }
    };
    arrivals.follow(&mut delays, take, print)
}

/// The time in the header of a message, in nanoseconds.
fn stamp(of: &DynamicType, cdr: &[u8]) -> anyhow::Result<i64> {
    let view = DynamicView::new(of, cdr)?;
    let get = |path: &str| anyhow::Ok(view.get(path)?.as_i64().unwrap_or_default());
    Ok(get("header.stamp.sec")? * 1_000_000_000 + get("header.stamp.nanosec")?)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn a_rate_is_printed_once_a_second() {
        let mut periods = Periods::new(4);
        let printed: Vec<_> =
            (0..=12).filter_map(|step| periods.take(1_000 * MS + step * 125 * MS)).collect();
        assert_eq!(printed, ["average rate: 8.000\n\tmin: 0.125s max: 0.125s std dev: 0.00000s window: 4"]);
        assert_eq!(periods.take(0).as_deref(), Some("time has reset, resetting counters"));
        assert_eq!(periods.take(0), None);
    }

    #[test]
    fn bandwidth_is_computed_over_the_window() {
        let mut sizes = Sizes::new(2);
        assert_eq!(sizes.bandwidth(0), None);
        for (time, size) in [(1, 100), (1_000 * MS, 1_000), (1_500 * MS, 3_000)] {
            sizes.times.push(time);
            sizes.sizes.push(size);
        }
        assert_eq!(
            sizes.bandwidth(2_000 * MS).as_deref(),
            Some("4.00 KB/s from 2 messages\n\tMessage size mean: 2.00 KB min: 1.00 KB max: 3.00 KB")
        );
        assert_eq!(sizes.bandwidth(1).as_deref(), Some("WARNING: time is reset!"));
    }

    #[test]
    fn a_delay_is_relative_to_the_stamp() {
        let mut delays = Delays::new(10);
        assert_eq!(delays.take(1_000 * MS, 0), None);
        assert_eq!(delays.shown(), None, "the first message only starts the clock");
        delays.take(1_100 * MS, 1_090 * MS);
        delays.take(1_200 * MS, 1_170 * MS);
        assert_eq!(
            delays.shown().as_deref(),
            Some("average delay: 0.020\n\tmin: 0.010s max: 0.030s std dev: 0.01000s window: 2")
        );
        assert_eq!(delays.shown().as_deref(), Some("no new messages"));
    }
}
