//! Counts the instructions of a cycle, which are reproducible although times are not.
//!
//! Each scenario runs in Valgrind's Callgrind with two numbers of trials. The difference is the cost of the
//! trials alone, without setup.

use std::num::NonZeroU64;
use std::process::Command;

use anyhow::{Context as _, ensure};
use benches::contestants::{Contestant, Downbeat, Limit};
use benches::launchers::LAUNCHERS;
use benches::{Calls, Football, Load, Relay};

/// The name, the description of a trial, its number of cycles, and the constructor.
type Scenario = (&'static str, &'static str, u64, fn() -> anyhow::Result<Box<dyn Contestant>>);

const TEN_BY_HUNDRED: Load = Load { modules: 10, messages: 100, batch: NonZeroU64::new(1000).unwrap() };

const SCENARIOS: &[Scenario] = &[
    ("hop", "a module receives and publishes one message", 1, || {
        Ok(Box::new(Relay::new(|core| Ok(core.without_times()))?))
    }),
    ("measured_hop", "the same, with times", 1, || Ok(Box::new(Relay::new(Ok)?))),
    ("fan_out", "10 modules receive 100 messages", 2, || {
        Ok(Box::new(Downbeat::new(TEN_BY_HUNDRED, &LAUNCHERS[0])?))
    }),
    ("limit", "the same as a plain loop", 1, || Ok(Box::new(Limit::new(TEN_BY_HUNDRED)))),
    ("football", "a football robot: 8 modules, 14 topics", 1, || {
        Ok(Box::new(Football::new(|core| Ok(core.without_times()))?))
    }),
    ("call", "a service call and its answer", 2, || Ok(Box::new(Calls::new()?))),
];

const TRIALS: u64 = 2000;

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    if let (Some(name), Some(trials)) = (arguments.next(), arguments.next()) {
        return run(&name, trials.parse()?);
    }
    println!("{:<14} {:>12} {:>12}  a trial", "", "per trial", "per cycle");
    for &(name, meaning, cycles, _) in SCENARIOS {
        let count = (instructions(name, 2 * TRIALS)? - instructions(name, TRIALS)?) as f64 / TRIALS as f64;
        println!("{name:<14} {count:>12.1} {:>12.1}  {meaning}", count / cycles as f64);
    }
    Ok(())
}

fn run(name: &str, trials: u64) -> anyhow::Result<()> {
    let scenario = SCENARIOS.iter().find(|(known, ..)| *known == name).context("no such scenario")?;
    let mut contestant = (scenario.3)()?;
    (0..trials).for_each(|_| contestant.trial());
    ensure!(contestant.finish() > 0, "{name}: messages were lost");
    Ok(())
}

/// The instructions that Callgrind counts in this program with this scenario.
fn instructions(name: &str, trials: u64) -> anyhow::Result<u64> {
    let program = std::env::current_exe()?;
    let output = Command::new("valgrind")
        .args(["--tool=callgrind", "--callgrind-out-file=/dev/null"])
        .arg(program)
        .args([name, &trials.to_string()])
        .output()
        .context("cannot run valgrind; install the package of that name")?;
    let text = String::from_utf8_lossy(&output.stderr);
    let count =
        text.lines().find_map(|line| line.split_once("Collected : ")).context("Callgrind counted nothing")?;
    Ok(count.1.trim().parse()?)
}
