//! Measures the engine alone: engine to engine in two processes, without cores or bridge, compared with bare
//! UDP, rustdds and Cyclone DDS in C.
//!
//! A contestant answers on the thread that receives, as `ddsperf` does with its listeners.

mod bare;
mod ddsperf;
mod engine;

use std::io::{BufRead, BufReader, Lines};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Duration;

use anyhow::{Context, bail};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

#[derive(clap::Args)]
pub struct Options {
    /// How long each contestant sends.
    #[arg(long, default_value_t = 3.0)]
    seconds: f64,
    /// Number of rounds; the median of the rounds counts.
    #[arg(long, default_value_t = 5)]
    rounds: usize,
    /// The ROS domain.
    #[arg(long, default_value_t = 101)]
    domain: u16,
}

/// The software that sends and receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Stack {
    /// UDP sockets alone: the upper limit.
    Bare,
    /// downbeat-rtps.
    Rtps,
    /// The crate rustdds.
    #[cfg(feature = "rustdds")]
    Rustdds,
}

/// The role of one end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum End {
    /// Sends 100 bytes and waits for the answer.
    Ping,
    /// Sends back what it receives.
    Echo,
    /// Sends as fast as it can.
    Flood,
    /// Counts what it receives.
    Count,
}

#[derive(clap::Args)]
pub struct PeerOptions {
    #[arg(long)]
    stack: Stack,
    #[arg(long)]
    end: End,
    #[arg(long)]
    size: usize,
    #[arg(long)]
    seconds: f64,
    #[arg(long)]
    domain: u16,
    /// The UDP port on which the other end receives; used by bare UDP only.
    #[arg(long, default_value_t = 0)]
    port: u16,
}

/// Round trips of one turn.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Trips {
    p50_us: f64,
    p99_us: f64,
}

/// What the other end received in one turn of a stream.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Stream {
    bytes: u64,
    samples: u64,
    /// From the first to the last received sample.
    seconds: f64,
}

pub fn run(options: &Options) -> anyhow::Result<()> {
    anyhow::ensure!(options.rounds > 0, "--rounds must be at least 1");
    round_trips(options)?;
    streams(options, 100, "100 B, one way, reliable", |stream| {
        format!("{:.0} samples/s", stream.samples as f64 / stream.seconds)
    })?;
    streams(options, 1_000_000, "1 MB, one way, reliable", |stream| {
        format!("{:.0} MB/s", stream.bytes as f64 / stream.seconds / 1e6)
    })
}

const STACKS: &[Stack] = &[
    Stack::Bare,
    Stack::Rtps,
    #[cfg(feature = "rustdds")]
    Stack::Rustdds,
];

fn round_trips(options: &Options) -> anyhow::Result<()> {
    println!("| 100 B, there and back | p50 | p99 |\n| --- | --- | --- |");
    let print = |name: &str, turns: Vec<Trips>| {
        let figure = |of: fn(&Trips) -> f64| median(turns.iter().map(of));
        println!(
            "| {name} | {:.1} µs | {:.1} µs |",
            figure(|trips| trips.p50_us),
            figure(|trips| trips.p99_us)
        );
    };
    for &stack in STACKS {
        let turns = (0..options.rounds).map(|_| {
            let (echo, port) = Peer::start(stack, End::Echo, 100, 0, options)?;
            let (mut ping, _) = Peer::start(stack, End::Ping, 100, port, options)?;
            let trips = ping.outcome()?;
            echo.end()?;
            ping.end()?;
            Ok(trips)
        });
        print(&format!("{stack:?}"), turns.collect::<anyhow::Result<_>>()?);
    }
    match ddsperf::round_trips(options) {
        Ok(turns) => print("Cyclone DDS in C", turns),
        Err(error) => println!("\nCyclone DDS is left out: {error:#}"),
    }
    Ok(())
}

fn streams(
    options: &Options,
    size: usize,
    title: &str,
    figure: impl Fn(&Stream) -> String,
) -> anyhow::Result<()> {
    println!("\n| {title} | received | of what was sent |\n| --- | --- | --- |");
    for &stack in STACKS {
        let mut turns = Vec::new();
        for _ in 0..options.rounds {
            let (mut count, port) = Peer::start(stack, End::Count, size, 0, options)?;
            let (mut flood, _) = Peer::start(stack, End::Flood, size, port, options)?;
            let sent: Stream = flood.outcome()?;
            flood.end()?;
            count.close_input();
            turns.push((count.outcome::<Stream>()?, sent));
            count.end()?;
        }
        turns.sort_by(|(a, _), (b, _)| (a.bytes as f64 / a.seconds).total_cmp(&(b.bytes as f64 / b.seconds)));
        let (received, sent) = &turns[turns.len() / 2];
        let share = received.bytes as f64 / sent.bytes.max(1) as f64 * 100.0;
        println!("| {stack:?} | {} | {share:.1} % |", figure(received));
    }
    Ok(())
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

/// One end of a pair in a separate process; killed when dropped.
struct Peer {
    process: Child,
    input: Option<ChildStdin>,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Peer {
    /// Starts the process and returns it with the UDP port on which it receives.
    fn start(
        stack: Stack,
        end: End,
        size: usize,
        port: u16,
        options: &Options,
    ) -> anyhow::Result<(Self, u16)> {
        let name = |value: &dyn Fn() -> Option<clap::builder::PossibleValue>| {
            value().map(|value| value.get_name().to_owned()).unwrap_or_default()
        };
        let mut process = Command::new(std::env::current_exe()?)
            .args(["wire-peer", "--stack", &name(&|| clap::ValueEnum::to_possible_value(&stack))])
            .args(["--end", &name(&|| clap::ValueEnum::to_possible_value(&end)), "--size", &size.to_string()])
            .args(["--seconds", &options.seconds.to_string(), "--domain", &options.domain.to_string()])
            .args(["--port", &port.to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
        let input = process.stdin.take();
        let lines = BufReader::new(process.stdout.take().context("its output is piped")?).lines();
        let mut peer = Self { process, input, lines };
        let port = peer.line()?.parse().context("a port")?;
        Ok((peer, port))
    }

    fn line(&mut self) -> anyhow::Result<String> {
        Ok(self.lines.next().context("a contestant ended before it printed anything")??)
    }

    fn outcome<T: DeserializeOwned>(&mut self) -> anyhow::Result<T> {
        let line = self.line()?;
        serde_json::from_str(&line).with_context(|| line)
    }

    fn close_input(&mut self) {
        drop(self.input.take());
    }

    /// Closes the input of the process, which ends it.
    fn end(mut self) -> anyhow::Result<()> {
        self.close_input();
        let status = self.process.wait()?;
        anyhow::ensure!(status.success(), "a contestant ended with {status}");
        Ok(())
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // Both fail if the process has already ended.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Runs one end of a pair: prints the port on which it receives, then its measurements.
pub fn peer(options: &PeerOptions) -> anyhow::Result<()> {
    match options.stack {
        Stack::Bare => bare::run(options),
        Stack::Rtps => engine::run(options, downbeat_bridge::middleware::Engine::Rtps),
        #[cfg(feature = "rustdds")]
        Stack::Rustdds => engine::run(options, downbeat_bridge::middleware::Engine::Rustdds),
    }
}

/// Waits until the input is closed, which happens when the other end is done.
fn wait_for_the_end() -> anyhow::Result<()> {
    std::io::copy(&mut std::io::stdin(), &mut std::io::sink())?;
    Ok(())
}

/// The statistics of round trips.
fn trips(mut times: Vec<Duration>) -> anyhow::Result<Trips> {
    times.sort_unstable();
    let at = |share: f64| {
        let index = ((times.len() as f64 * share) as usize).min(times.len().saturating_sub(1));
        times.get(index).map(|time| time.as_secs_f64() * 1e6)
    };
    match (at(0.5), at(0.99)) {
        (Some(p50_us), Some(p99_us)) => Ok(Trips { p50_us, p99_us }),
        _ => bail!("nothing came back"),
    }
}
