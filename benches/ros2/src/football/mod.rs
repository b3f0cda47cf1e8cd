//! Measures what it costs a football robot to expose its topics: its core alone, the robot with all topics
//! exposed and no subscriber, and with a subscriber of its joint states on rclpy and on Cyclone DDS.

mod robot;

use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use serde::Deserialize;

pub use robot::{RobotOptions, run as run_robot};

use crate::contestant::{Contestant, Kind, Task, on_processor};
use crate::role::Role;
use robot::Outcome;

#[derive(clap::Args)]
pub struct Options {
    /// For how many seconds each contestant is measured in a round.
    #[arg(long, default_value_t = 5.0)]
    seconds: f64,
    /// Number of rounds, in which the contestants take turns; the median of the rounds counts.
    #[arg(long, default_value_t = 5)]
    rounds: usize,
    /// Periods of the robot in microseconds.
    #[arg(long, value_delimiter = ',', default_values_t = [8000, 1000])]
    periods_us: Vec<u64>,
    /// The ROS domain.
    #[arg(long, default_value_t = 100)]
    domain: u16,
}

/// A robot, and who subscribes.
#[derive(Clone, Copy)]
struct Setting {
    name: &'static str,
    is_exposed: bool,
    subscriber: Option<Kind>,
    /// Another thread keeps a processor busy.
    is_busy: bool,
    /// For the threads of the robot; `None` leaves the system's.
    timer_slack_ns: Option<u64>,
}

const CORE: Setting =
    Setting { name: "core alone", is_exposed: false, subscriber: None, is_busy: false, timer_slack_ns: None };
const SETTINGS: [Setting; 6] = [
    CORE,
    Setting { name: "exposed, nobody", is_exposed: true, ..CORE },
    Setting { name: "exposed, rclpy", is_exposed: true, subscriber: Some(Kind::Rclpy), ..CORE },
    Setting { name: "exposed, Cyclone", is_exposed: true, subscriber: Some(Kind::Cyclone), ..CORE },
    Setting { name: "core, a busy processor", is_busy: true, ..CORE },
    Setting { name: "the same, timer slack 1 ns", is_busy: true, timer_slack_ns: Some(1), ..CORE },
];

/// What a subscriber prints.
#[derive(Clone, Copy, Default, Deserialize)]
struct Received {
    messages: u64,
    p50_us: f64,
    p99_us: f64,
}

/// The results of one turn.
struct Turn {
    robot: Outcome,
    received: Received,
    /// Of the subscriber, in milliseconds per second.
    processor: f64,
}

pub fn run(options: &Options) -> anyhow::Result<()> {
    anyhow::ensure!(options.rounds > 0, "--rounds must be at least 1");
    for &period_us in &options.periods_us {
        let mut turns: [Vec<Turn>; SETTINGS.len()] = Default::default();
        for _ in 0..options.rounds {
            for (setting, turns) in SETTINGS.iter().zip(&mut turns) {
                turns.push(turn(setting, period_us, options).with_context(|| setting.name)?);
            }
        }
        print(period_us, &turns);
    }
    Ok(())
}

fn turn(setting: &Setting, period_us: u64, options: &Options) -> anyhow::Result<Turn> {
    let _busy = setting.is_busy.then(Busy::start).transpose()?;
    let task = Task { size: 0, window: 1, seconds: options.seconds, domain_id: options.domain };
    let start = |kind| Contestant::start(kind, Role::JointStates, &task);
    let mut subscriber = setting.subscriber.map(start).transpose()?;
    let mut command = Command::new(std::env::current_exe()?);
    command.arg("football-robot").args(["--period-us", &period_us.to_string()]);
    command.args(["--seconds", &options.seconds.to_string()]);
    if setting.is_exposed {
        command.args(["--domain", &options.domain.to_string()]);
    }
    if setting.subscriber.is_some() {
        command.arg("--is-subscribed");
    }
    if let Some(slack) = setting.timer_slack_ns {
        command.args(["--timer-slack-ns", &slack.to_string()]);
    }
    let mut robot = Contestant::spawn(command, "the robot")?;
    robot.wait_for_go()?;
    let time =
        |subscriber: &Option<Contestant>| subscriber.as_ref().map_or(Ok(0.0), Contestant::on_processor);
    let before = time(&subscriber)?;
    let outcome: Outcome = robot.outcome()?;
    let processor = (time(&subscriber)? - before) * 1e3 / options.seconds;
    robot.end()?;
    let received = subscriber.as_mut().map_or(Ok(Received::default()), Contestant::result)?;
    subscriber.map_or(Ok(()), Contestant::end)?;
    Ok(Turn { robot: outcome, received, processor })
}

/// Keeps a processor busy until it is dropped.
struct Busy(Arc<AtomicBool>);

impl Busy {
    fn start() -> anyhow::Result<Self> {
        let ends = Arc::<AtomicBool>::default();
        let ended = Arc::clone(&ends);
        let spin = move || while !ended.load(Ordering::Relaxed) {};
        std::thread::Builder::new().name("busy".into()).spawn(spin)?;
        Ok(Self(ends))
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

fn print(period_us: u64, turns: &[Vec<Turn>]) {
    println!("\nPeriod {} ms:\n", period_us as f64 / 1e3);
    println!(
        "| | chain p50 | p99 | times the core's | processor of the robot, ms/s | times the core's | timer p99 | \
         joint states p50 | p99 | processor of the subscriber, ms/s | datagrams/s from it |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    let of = |turns: &[Turn], figure: fn(&Turn) -> f64| median(turns.iter().map(figure));
    let core = turns.first().map_or(&[][..], Vec::as_slice);
    let (chain, processor) =
        (of(core, |turn| turn.robot.chain_p50_us), of(core, |turn| turn.robot.processor_ms_per_s));
    for (setting, turns) in SETTINGS.iter().zip(turns) {
        let figure = |figure| of(turns, figure);
        let (p50, own) =
            (figure(|turn| turn.robot.chain_p50_us), figure(|turn| turn.robot.processor_ms_per_s));
        let mut row = format!(
            "| {} | {p50:.1} µs | {:.0} µs | {:.2} | {own:.1} | {:.2} | {:.0} µs |",
            setting.name,
            figure(|turn| turn.robot.chain_p99_us),
            p50 / chain,
            own / processor,
            figure(|turn| turn.robot.timer_p99_us),
        );
        if setting.subscriber.is_some() {
            let lost =
                turns.iter().map(|turn| turn.robot.sent.saturating_sub(turn.received.messages)).sum::<u64>();
            row += &format!(
                " {:.0} µs | {:.0} µs | {:.1} | {:.0} |",
                figure(|turn| turn.received.p50_us),
                figure(|turn| turn.received.p99_us),
                figure(|turn| turn.processor),
                figure(|turn| turn.robot.datagrams_per_s),
            );
            if lost > 0 {
                row += &format!(" {lost} not received");
            }
        } else {
            row += " | | | |";
        }
        println!("{row}");
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

/// The processor time of this process in seconds.
fn own_processor_time() -> anyhow::Result<f64> {
    on_processor(std::process::id())
}
