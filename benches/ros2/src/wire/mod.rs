//! Measures the engines alone: engine to engine in two processes, without cores or bridge. Each network has a
//! limit, the first contestant: bare UDP on DDS, the bare crate `zenoh` on Zenoh.
//!
//! A contestant answers on the thread that receives, as `ddsperf` does with its listeners. Round trips and
//! pictures have the default quality of service of ROS 2; streams keep all samples, so that the sender waits
//! for a slow receiver.

mod bare;
mod ddsperf;
mod engine;
#[cfg(feature = "security")]
mod secured;
#[cfg(feature = "zenoh")]
mod zenoh_crate;

use std::io::{BufRead, BufReader, Lines};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use crate::contestant::CYCLONE_ON_THIS_MACHINE;
use anyhow::{Context, bail};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

#[derive(clap::Args)]
pub struct Options {
    /// How long each contestant sends.
    #[arg(long, default_value_t = 3.0)]
    seconds: f64,
    /// Number of rounds, in which the contestants take turns; the median of the rounds counts.
    #[arg(long, default_value_t = 5)]
    rounds: usize,
    /// The ROS domain.
    #[arg(long, default_value_t = 101)]
    domain: u16,
    /// Measure this network only.
    #[arg(long)]
    only: Option<Network>,
    /// What is measured.
    #[arg(long, value_delimiter = ',', default_values = ["trips", "samples", "streams", "pictures"])]
    parts: Vec<Part>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Part {
    /// 100 bytes there and back.
    Trips,
    /// Samples of 100 bytes as fast as they go.
    Samples,
    /// Samples of 1 MB as fast as they go.
    Streams,
    /// Pictures at 30 Hz.
    Pictures,
}

/// Contestants that are compared with one another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Network {
    Dds,
    /// With the keystore of `ros2 security`, compared with the same engine without security.
    #[cfg(feature = "security")]
    Secured,
    #[cfg(feature = "zenoh")]
    Zenoh,
}

impl Network {
    /// The first is the limit.
    fn stacks(self) -> &'static [Stack] {
        match self {
            Self::Dds => &[
                Stack::Bare,
                Stack::Rtps,
                #[cfg(feature = "rustdds")]
                Stack::Rustdds,
            ],
            #[cfg(feature = "security")]
            Self::Secured => &[Stack::Rtps, Stack::Secured],
            #[cfg(feature = "zenoh")]
            Self::Zenoh => &[Stack::ZenohCrate, Stack::Zenoh],
        }
    }
}

/// The software that sends and receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Stack {
    /// UDP sockets alone.
    Bare,
    /// downbeat-rtps.
    Rtps,
    /// downbeat-rtps with DDS Security.
    #[cfg(feature = "security")]
    Secured,
    /// The crate rustdds.
    #[cfg(feature = "rustdds")]
    Rustdds,
    /// The crate zenoh alone.
    #[cfg(feature = "zenoh")]
    ZenohCrate,
    /// The engine on it.
    #[cfg(feature = "zenoh")]
    Zenoh,
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
    /// Sends pictures at the rate of a camera.
    Camera,
    /// Counts what it receives.
    Count,
}

/// How long the ends may take to discover each other.
const PATIENCE: Duration = Duration::from_secs(20);

/// Bytes of a picture: 640 x 480, RGB.
const PICTURE: usize = 921_600;
const PICTURES: u64 = 150;
const PICTURE_PERIOD: Duration = Duration::from_micros(33_333);

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
    /// Where the router of Zenoh listens.
    #[cfg(feature = "zenoh")]
    #[arg(long)]
    router: Option<String>,
    /// The keystore of a secured end.
    #[cfg(feature = "security")]
    #[arg(long)]
    keystore: Option<String>,
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

/// One way, once.
#[derive(Clone, Copy)]
struct Turn {
    received: Stream,
    sent: Stream,
    /// Processor time of both ends.
    processor_s: f64,
}

impl Stream {
    /// What a camera sends.
    fn of_a_camera(size: usize) -> Self {
        let seconds = PICTURE_PERIOD.as_secs_f64() * PICTURES as f64;
        Self { bytes: PICTURES * size as u64, samples: PICTURES, seconds }
    }
}

pub fn run(options: &Options) -> anyhow::Result<()> {
    anyhow::ensure!(options.rounds > 0, "--rounds must be at least 1");
    let all = <Network as clap::ValueEnum>::value_variants();
    for &network in all.iter().filter(|network| options.only.is_none_or(|only| only == **network)) {
        let contest = Contest::new(network, options)?;
        println!("\nOn {network:?}:");
        for part in &options.parts {
            match part {
                Part::Trips => contest.round_trips()?,
                Part::Samples => contest.streams(100, "100 B, one way, all kept", "samples/s", |stream| {
                    stream.samples as f64 / stream.seconds
                })?,
                Part::Streams => contest.streams(1_000_000, "1 MB, one way, all kept", "MB/s", |stream| {
                    stream.bytes as f64 / stream.seconds / 1e6
                })?,
                Part::Pictures => contest.pictures()?,
            }
        }
    }
    Ok(())
}

/// The contestants of a network, and what they need.
struct Contest<'a> {
    network: Network,
    options: &'a Options,
    #[cfg(feature = "zenoh")]
    router: Option<crate::router::LocalRouter>,
    #[cfg(feature = "security")]
    keystore: Option<crate::keystore::LocalKeystore>,
}

impl<'a> Contest<'a> {
    fn new(network: Network, options: &'a Options) -> anyhow::Result<Self> {
        Ok(Self {
            network,
            options,
            #[cfg(feature = "zenoh")]
            router: (network == Network::Zenoh).then(crate::router::LocalRouter::start).transpose()?,
            #[cfg(feature = "security")]
            keystore: (network == Network::Secured)
                .then(|| crate::keystore::LocalKeystore::create(options.domain))
                .transpose()?,
        })
    }

    fn router(&self) -> Option<&str> {
        #[cfg(feature = "zenoh")]
        return self.router.as_ref().map(|router| router.endpoint.as_str());
        #[cfg(not(feature = "zenoh"))]
        None
    }

    /// The options that only some stacks need.
    fn keystore(&self, stack: Stack) -> Option<&str> {
        #[cfg(feature = "security")]
        if stack == Stack::Secured {
            return self.keystore.as_ref().and_then(|keystore| keystore.path().to_str());
        }
        let _ = stack;
        None
    }

    /// The configurations of the two ends of Cyclone DDS, each with its name; none if it does not take part.
    fn cyclones(&self) -> Vec<(&'static str, [String; 2])> {
        let plain = || [CYCLONE_ON_THIS_MACHINE; 2].map(str::to_owned);
        #[cfg(feature = "security")]
        if let Some(keystore) = &self.keystore {
            let secured = |end| secured::cyclone(CYCLONE_ON_THIS_MACHINE, keystore.path(), end);
            let ends = [End::Ping, End::Echo].map(secured);
            return vec![("Cyclone DDS in C", plain()), ("Cyclone DDS in C, secured", ends)];
        }
        if self.network == Network::Dds { vec![("Cyclone DDS in C", plain())] } else { Vec::new() }
    }

    fn round_trips(&self) -> anyhow::Result<()> {
        let stacks = self.network.stacks();
        let mut turns = vec![Vec::new(); stacks.len()];
        let cyclones = self.cyclones();
        let mut of_cyclone: Vec<_> = cyclones.iter().map(|_| Ok(Vec::new())).collect();
        for _ in 0..self.options.rounds {
            for (&stack, turns) in stacks.iter().zip(&mut turns) {
                let (echo, port) = self.start(stack, End::Echo, 100, 0)?;
                let (mut ping, _) = self.start(stack, End::Ping, 100, port)?;
                turns.push(ping.outcome::<Trips>()?);
                echo.end()?;
                ping.end()?;
            }
            for ((_, ends), turns) in cyclones.iter().zip(&mut of_cyclone) {
                let Ok(known) = turns else { continue };
                match ddsperf::round_trips(self.options.seconds, self.options.domain, ends) {
                    Ok(trips) => known.push(trips),
                    Err(error) => *turns = Err(error),
                }
            }
        }
        println!(
            "| 100 B, there and back | p50 | p99 | p50 divided by the first |\n| --- | --- | --- | --- |"
        );
        let p50 = |turns: &[Trips]| median(turns.iter().map(|trips| trips.p50_us));
        let first = p50(&turns[0]);
        let print = |name: &str, turns: &[Trips]| {
            let (p50, p99) = (p50(turns), median(turns.iter().map(|trips| trips.p99_us)));
            println!("| {name} | {p50:.1} µs | {p99:.1} µs | {:.2} |", p50 / first);
        };
        for (stack, turns) in stacks.iter().zip(&turns) {
            print(&format!("{stack:?}"), turns);
        }
        for ((name, _), turns) in cyclones.iter().zip(of_cyclone) {
            match turns {
                Ok(turns) => print(name, &turns),
                Err(error) => println!("\n{name} is left out: {error:#}"),
            }
        }
        Ok(())
    }

    fn streams(
        &self,
        size: usize,
        title: &str,
        unit: &str,
        figure: impl Fn(&Stream) -> f64,
    ) -> anyhow::Result<()> {
        println!("\n| {title} | received | of what was sent | the first divided by it |");
        println!("| --- | --- | --- | --- |");
        let turns = self.one_way(End::Flood, size)?;
        let middle = |turns: &[Turn]| {
            let mut turns = turns.to_vec();
            turns.sort_by(|a, b| figure(&a.received).total_cmp(&figure(&b.received)));
            turns[turns.len() / 2]
        };
        let first = figure(&middle(&turns[0]).received);
        for (stack, turns) in self.network.stacks().iter().zip(&turns) {
            let Turn { received, sent, .. } = middle(turns);
            let share = received.bytes as f64 / sent.bytes.max(1) as f64 * 100.0;
            let figure = figure(&received);
            println!("| {stack:?} | {figure:.0} {unit} | {share:.1} % | {:.2} |", first / figure);
        }
        Ok(())
    }

    fn pictures(&self) -> anyhow::Result<()> {
        println!("\n| {PICTURE} B at 30 Hz | received in the worst round | processor time of both ends |");
        println!("| --- | --- | --- |");
        let turns = self.one_way(End::Camera, PICTURE)?;
        for (stack, turns) in self.network.stacks().iter().zip(&turns) {
            let received = turns.iter().map(|turn| turn.received.samples).min().unwrap_or_default();
            let processor = median(turns.iter().map(|turn| turn.processor_s));
            println!("| {stack:?} | {received} of {PICTURES} | {processor:.2} s |");
        }
        #[cfg(feature = "security")]
        if self.network == Network::Secured {
            let time = secured::cipher_time(PICTURE, PICTURES)?;
            println!("| the ciphers of Secured alone | | {time:.2} s |");
        }
        Ok(())
    }

    /// The turns of each contestant.
    fn one_way(&self, sender: End, size: usize) -> anyhow::Result<Vec<Vec<Turn>>> {
        let stacks = self.network.stacks();
        let mut turns = vec![Vec::new(); stacks.len()];
        for _ in 0..self.options.rounds {
            for (&stack, turns) in stacks.iter().zip(&mut turns) {
                let (mut count, port) = self.start(stack, End::Count, size, 0)?;
                let (mut sending, _) = self.start(stack, sender, size, port)?;
                let sent = sending.outcome()?;
                let processor_s = sending.processor_time()? + count.processor_time()?;
                sending.end()?;
                count.close_input();
                turns.push(Turn { received: count.outcome()?, sent, processor_s });
                count.end()?;
            }
        }
        Ok(turns)
    }

    /// Starts one end and returns it with the UDP port on which it receives.
    fn start(&self, stack: Stack, end: End, size: usize, port: u16) -> anyhow::Result<(Peer, u16)> {
        let name = |value: &dyn Fn() -> Option<clap::builder::PossibleValue>| {
            value().map(|value| value.get_name().to_owned()).unwrap_or_default()
        };
        let mut command = Command::new(std::env::current_exe()?);
        command
            .args(["wire-peer", "--stack", &name(&|| clap::ValueEnum::to_possible_value(&stack))])
            .args(["--end", &name(&|| clap::ValueEnum::to_possible_value(&end)), "--size", &size.to_string()])
            .args(["--seconds", &self.options.seconds.to_string()])
            .args(["--domain", &self.options.domain.to_string(), "--port", &port.to_string()])
            .args(self.router().into_iter().flat_map(|router| ["--router", router]))
            .args(self.keystore(stack).into_iter().flat_map(|keystore| ["--keystore", keystore]));
        let mut peer = Peer::start(command)?;
        let port = peer.line()?.parse().context("a port")?;
        Ok((peer, port))
    }
}

/// Processor time of the threads of a process since it started, in seconds (`/proc/PID/stat`, in hundredths).
fn processor_time(pid: &str) -> anyhow::Result<f64> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat"))?;
    // The name before it may contain spaces.
    let fields = stat.rsplit_once(')').context("a process in /proc")?.1;
    let ticks = fields.split_ascii_whitespace().skip(11).take(2).map(str::parse::<u32>);
    Ok(f64::from(ticks.sum::<Result<u32, _>>()?) / 100.0)
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
    fn start(mut command: Command) -> anyhow::Result<Self> {
        let mut process = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
        let input = process.stdin.take();
        let lines = BufReader::new(process.stdout.take().context("its output is piped")?).lines();
        Ok(Self { process, input, lines })
    }

    fn line(&mut self) -> anyhow::Result<String> {
        Ok(self.lines.next().context("a contestant ended before it printed anything")??)
    }

    fn outcome<T: DeserializeOwned>(&mut self) -> anyhow::Result<T> {
        let line = self.line()?;
        serde_json::from_str(&line).with_context(|| line)
    }

    fn processor_time(&self) -> anyhow::Result<f64> {
        processor_time(&self.process.id().to_string())
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
        #[cfg(feature = "security")]
        Stack::Secured => engine::run(options, downbeat_bridge::middleware::Engine::Rtps),
        #[cfg(feature = "rustdds")]
        Stack::Rustdds => engine::run(options, downbeat_bridge::middleware::Engine::Rustdds),
        #[cfg(feature = "zenoh")]
        Stack::ZenohCrate => zenoh_crate::run(options),
        #[cfg(feature = "zenoh")]
        Stack::Zenoh => engine::run(options, downbeat_bridge::middleware::Engine::Zenoh),
    }
}

/// Waits until the input is closed, which happens when the other end is done.
fn wait_for_the_end() -> anyhow::Result<()> {
    std::io::copy(&mut std::io::stdin(), &mut std::io::sink())?;
    Ok(())
}

fn wait_until(what: &str, condition: impl Fn() -> bool) -> anyhow::Result<()> {
    let start = Instant::now();
    while !condition() {
        anyhow::ensure!(start.elapsed() < PATIENCE, "gave up waiting until {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
    Ok(())
}

/// Calls `send` with the pace of a camera.
fn at_the_pace_of_a_camera(mut send: impl FnMut() -> anyhow::Result<()>) -> anyhow::Result<()> {
    let start = Instant::now();
    for number in 0..PICTURES as u32 {
        std::thread::sleep((start + number * PICTURE_PERIOD).saturating_duration_since(Instant::now()));
        send()?;
    }
    // The last picture is under way.
    std::thread::sleep(Duration::from_millis(500));
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
