//! Measures the cost of viewers to a robot: processor time and cycles, without viewers and with viewers that
//! subscribe to every topic, in turns.
//!
//! The viewers run in another process and read everything, so that only the robot's side is counted.

use std::io::{BufRead as _, BufReader};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context as _, ensure};
use clap::Parser;
use downbeat::App;
use downbeat::executor::TimeStatistics;
use serde_json::{Value, json};
use tungstenite::{ClientRequestBuilder, Message, WebSocket};

/// Measures the robot without viewers and with some.
#[derive(Parser)]
struct Arguments {
    /// The robot file
    #[arg(default_value = "robots/darwin_op.toml")]
    robot: PathBuf,
    /// The number of viewers
    #[arg(long, value_name = "NUMBER", default_value_t = 10)]
    viewers: usize,
    /// The duration of each turn
    #[arg(long, value_name = "SECONDS", default_value_t = 10)]
    seconds: u64,
    /// The number of turns
    #[arg(long, value_name = "NUMBER", default_value_t = 3)]
    rounds: u32,
    /// Run the viewers of a robot at this URL instead
    #[arg(long, hide = true)]
    watch: Option<String>,
}

struct Turn {
    /// The processor time of the robot's process, divided by the elapsed time.
    load: f64,
    cycle: TimeStatistics,
    /// The intervals between cycles of the hardware; they show how late cycles begin.
    period: TimeStatistics,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    if let Some(url) = &arguments.watch {
        return watch(url, arguments.viewers);
    }
    println!("{:<14} {:>10} {:>12} {:>12} {:>14}", "viewers", "load", "p50, ns", "p99, ns", "period p99, ns");
    let (mut alone, mut watched) = (Vec::new(), Vec::new());
    for _ in 0..arguments.rounds {
        for (viewers, turns) in [(0, &mut alone), (arguments.viewers, &mut watched)] {
            let turn = run(&arguments, viewers)?;
            let Turn { load, cycle, period } = &turn;
            println!(
                "{viewers:<14} {:>9.2}% {:>12} {:>12} {:>14}",
                100.0 * load,
                cycle.p50_ns,
                cycle.p99_ns,
                period.p99_ns
            );
            turns.push(turn);
        }
    }
    let least = |turns: &[Turn]| turns.iter().map(|turn| turn.load).fold(f64::INFINITY, f64::min);
    let added = 100.0 * (least(&watched) - least(&alone));
    println!("{} viewers add {added:.2} % of a core, to be below 15", arguments.viewers);
    Ok(())
}

fn run(arguments: &Arguments, viewers: usize) -> anyhow::Result<Turn> {
    let mut file = App::with_built_in_kinds().robot_file(&arguments.robot)?;
    file.view.foxglove = Some(0);
    let mut robot = downbeat::running::PreparedRobot::new(file)?;
    robot.view(None)?;
    let robot = robot.start()?;
    let url = robot.view().and_then(|view| view.foxglove_url()).context("the robot shows nothing")?;
    let child = (viewers > 0).then(|| spawn(&url, viewers)).transpose()?;
    let (start, used) = (Instant::now(), processor_time()?);
    std::thread::sleep(Duration::from_secs(arguments.seconds));
    let load = (processor_time()? - used).as_secs_f64() / start.elapsed().as_secs_f64();
    let timing = robot.core().timing();
    if let Some(mut child) = child {
        ensure!(child.try_wait()?.is_none(), "the viewers have ended");
        child.kill()?;
        child.wait()?;
    }
    robot.stop()?;
    let period = timing.loops.iter().map(|known| known.period).max_by_key(|period| period.count);
    Ok(Turn { load, cycle: timing.cycle, period: period.unwrap_or_default() })
}

/// Starts the process of the viewers, and returns when all have subscribed.
fn spawn(url: &str, viewers: usize) -> anyhow::Result<Child> {
    let mut command = Command::new(std::env::current_exe()?);
    command.args(["--watch", url, "--viewers", &viewers.to_string()]).stdout(Stdio::piped());
    let mut child = command.spawn()?;
    let mut line = String::new();
    BufReader::new(child.stdout.take().context("no output")?).read_line(&mut line)?;
    ensure!(line == "ready\n", "the viewers could not subscribe");
    Ok(child)
}

fn watch(url: &str, viewers: usize) -> anyhow::Result<()> {
    let address = url.trim_start_matches("ws://").split('/').next().context("no address")?;
    let mut threads = Vec::new();
    for _ in 0..viewers {
        let request = ClientRequestBuilder::new(url.parse()?).with_sub_protocol("foxglove.sdk.v1");
        let (mut socket, _) = tungstenite::client(request, TcpStream::connect(address)?)?;
        subscribe_to_all(&mut socket)?;
        threads.push(std::thread::spawn(move || while socket.read().is_ok() {}));
    }
    println!("ready");
    threads.into_iter().for_each(|thread| drop(thread.join()));
    Ok(())
}

fn subscribe_to_all(socket: &mut WebSocket<TcpStream>) -> anyhow::Result<()> {
    loop {
        let Message::Text(text) = socket.read()? else { continue };
        let message: Value = serde_json::from_str(&text)?;
        if message["op"] != "advertise" {
            continue;
        }
        let channels = message["channels"].as_array().context("no channels")?;
        let subscription = |(id, channel): (usize, &Value)| json!({ "id": id, "channelId": channel["id"] });
        let subscriptions: Vec<_> = channels.iter().enumerate().map(subscription).collect();
        let request = json!({ "op": "subscribe", "subscriptions": subscriptions });
        socket.send(Message::text(request.to_string()))?;
        return Ok(());
    }
}

/// The processor time of this process, which the kernel counts in hundredths of a second.
fn processor_time() -> anyhow::Result<Duration> {
    let stat = std::fs::read_to_string("/proc/self/stat")?;
    let fields = stat.rsplit_once(')').context("/proc/self/stat")?.1;
    let ticks = fields.split_whitespace().skip(11).take(2).map(str::parse::<u32>).sum::<Result<u32, _>>()?;
    Ok(Duration::from_millis(10) * ticks)
}
