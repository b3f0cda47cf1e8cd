//! Measures how long `downbeat bag debug` takes to go to a cycle, with its checkpoints: random cycles of a
//! recorded run, and steps back from there.
//!
//! The run is shorter than an hour, so its checkpoints are nearer to each other. The time to a cycle of an
//! hour is extrapolated by their distance in the first pass; a step back starts at a checkpoint that is a few
//! cycles away in any run. What else runs on the machine lengthens all of these times.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};
use clap::Parser;

/// Measures ways to cycles of a recorded run.
#[derive(Parser)]
struct Arguments {
    /// The program, built for release
    #[arg(default_value = "target/release/downbeat")]
    program: PathBuf,
    #[arg(long, default_value = "robots/darwin_op.toml")]
    robot: PathBuf,
    /// The folder that gets the bag, which is used again if it is there
    #[arg(long, default_value = "target/travel")]
    folder: PathBuf,
    /// The length of the run in simulated time
    #[arg(long, value_name = "MINUTES", default_value_t = 6, value_parser = clap::value_parser!(u32).range(1..))]
    minutes: u32,
    /// How many random cycles are gone to; five steps back are made from each
    #[arg(long, value_name = "NUMBER", default_value_t = 40)]
    goals: u64,
}

/// The most that the way to any cycle of an hour may take, and a step back.
const GOAL: Duration = Duration::from_secs(2);
const STEP_GOAL: Duration = Duration::from_millis(200);
/// The most memory of all checkpoints, in MB.
const MEMORY_GOAL: u64 = 500;

/// The distance of checkpoints in the first pass, which doubles when there are too many of them: as in
/// `program/src/bag/debug`.
const FIRST_INTERVAL: Duration = Duration::from_millis(50);
const MOST_CHECKPOINTS: f64 = 64.0;

const STEPS: usize = 5;

fn main() -> anyhow::Result<()> {
    let Arguments { program, robot, folder, minutes, goals } = Arguments::parse();
    ensure!(
        program.is_file(),
        "there is no program {}; `cargo build --release -p downbeat --features state_machine` builds one",
        program.display()
    );
    std::fs::create_dir_all(&folder)?;
    let bag = folder.join(format!("{minutes}_minutes"));
    if !bag.exists() {
        let mut run = Command::new(&program);
        run.arg("run").arg(&robot).args(["--fast", "--duration", &format!("{minutes}min"), "--record"]);
        let status = run.arg(&bag).env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST").status()?;
        ensure!(status.success(), "the robot was not recorded: {status}");
    }
    let begin = Instant::now();
    let mut debugger = Debugger::start(&program, &robot, &bag)?;
    let cycles = debugger.await_cycles()?;
    let pass = begin.elapsed();
    println!("first pass of {cycles} cycles, {minutes} minutes: {:.1} s", pass.as_secs_f64());
    let (mut ways, mut steps) = (Vec::new(), Vec::new());
    // As random as the places must be, and the same in each run.
    let places = (1..=goals).map(|number| number.wrapping_mul(0x9E37_79B9_7F4A_7C15) % (cycles - 100) + 50);
    for place in places {
        ways.push(debugger.go(&format!("go #{place}"))?);
        for _ in 0..STEPS {
            steps.push(debugger.go("back")?);
        }
    }
    let memory = debugger.memory_of_checkpoints() >> 20;
    debugger.end()?;
    let further = interval(pass.mul_f64(60.0 / f64::from(minutes))).saturating_sub(interval(pass));
    // Each at its place between two checkpoints.
    ways.sort();
    let places = (1..).map(|place| f64::from(place) / ways.len() as f64);
    let extrapolated: Vec<_> =
        ways.iter().zip(places).map(|(way, place)| *way + further.mul_f64(place)).collect();
    println!("{:<44} {:>10} {:>10} {:>10}", "", "median", "longest", "goal");
    let mut is_met = memory <= MEMORY_GOAL;
    for (what, mut times, goal) in [
        ("to a random cycle", ways, None),
        ("to a random cycle of an hour, extrapolated", extrapolated, Some(GOAL)),
        ("a step back", steps, Some(STEP_GOAL)),
    ] {
        times.sort();
        let (median, longest) = (times[times.len() / 2], times[times.len() - 1]);
        is_met &= goal.is_none_or(|goal| longest <= goal);
        let goal = goal.map(|goal| format!("{} ms", goal.as_millis())).unwrap_or_default();
        println!("{what:<44} {:>7} ms {:>7} ms {goal:>10}", median.as_millis(), longest.as_millis());
    }
    println!("{:<44} {:>10} {memory:>7} MB {:>7} MB", "memory of the checkpoints", "", MEMORY_GOAL);
    ensure!(is_met, "a goal is missed");
    Ok(())
}

/// The distance of checkpoints after a first pass of this length.
fn interval(pass: Duration) -> Duration {
    let mut interval = FIRST_INTERVAL;
    while pass.as_secs_f64() / interval.as_secs_f64() > MOST_CHECKPOINTS {
        interval *= 2;
    }
    interval
}

/// A debugger that is given lines.
struct Debugger {
    process: Child,
    output: BufReader<ChildStdout>,
}

impl Debugger {
    fn start(program: &Path, robot: &Path, bag: &Path) -> anyhow::Result<Self> {
        let mut command = Command::new(program);
        command.args(["bag", "debug"]).arg(robot).arg(bag).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut process = command.spawn().with_context(|| format!("cannot start {}", program.display()))?;
        let output = process.stdout.take().context("the debugger has no output")?;
        Ok(Self { process, output: BufReader::new(output) })
    }

    /// The next line that begins so.
    fn await_line(&mut self, begin: &str) -> anyhow::Result<String> {
        self.await_any(|line| line.starts_with(begin))
    }

    fn await_any(&mut self, is_meant: impl Fn(&str) -> bool) -> anyhow::Result<String> {
        loop {
            let mut line = String::new();
            ensure!(self.output.read_line(&mut line)? > 0, "the debugger has ended");
            if is_meant(&line) {
                return Ok(line);
            }
        }
    }

    /// Waits for the first pass; returns the number of cycles.
    fn await_cycles(&mut self) -> anyhow::Result<u64> {
        let line = self.await_any(|line| line.contains(" cycles of "))?;
        let cycles = line.split(' ').next().unwrap_or_default().parse()?;
        self.await_line("cycle #")?;
        ensure!(cycles > 200, "the run has only {cycles} cycles");
        Ok(cycles)
    }

    /// How long a command takes that goes somewhere.
    fn go(&mut self, command: &str) -> anyhow::Result<Duration> {
        let begin = Instant::now();
        let input = self.process.stdin.as_mut().context("the debugger has no input")?;
        writeln!(input, "{command}")?;
        self.await_line("cycle #")?;
        Ok(begin.elapsed())
    }

    /// The memory in bytes that engines share with no other: they are a group of processes that the debugger
    /// started. 0 where the system does not tell.
    fn memory_of_checkpoints(&self) -> u64 {
        let own = self.process.id().to_string();
        let numbers = std::fs::read_dir("/proc").into_iter().flatten().flatten().filter_map(|entry| {
            let stat = std::fs::read_to_string(entry.path().join("stat")).ok()?;
            // After the name, which may contain anything: state, parent, group.
            let mut fields = stat.rsplit_once(") ")?.1.split(' ').skip(1).map(str::to_owned);
            Some((entry.path(), fields.next()?, fields.next()?))
        });
        let processes: Vec<_> = numbers.collect();
        let Some((_, _, group)) = processes.iter().find(|(_, parent, _)| *parent == own) else { return 0 };
        let engines = processes.iter().filter(|(_, _, of)| of == group);
        let private = |process: &Path| {
            let text = std::fs::read_to_string(process.join("smaps_rollup")).unwrap_or_default();
            let lines = text.lines().filter(|line| line.starts_with("Private_"));
            lines.filter_map(|line| line.split_whitespace().nth(1)?.parse::<u64>().ok()).sum::<u64>()
        };
        engines.map(|(process, ..)| private(process)).sum::<u64>() * 1024
    }

    fn end(mut self) -> anyhow::Result<()> {
        drop(self.process.stdin.take());
        ensure!(self.process.wait()?.success(), "the debugger failed");
        Ok(())
    }
}
