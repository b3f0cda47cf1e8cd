//! Measures what the account of runs costs while somebody listens to it: the same cycles with and without a
//! subscriber of `executor/runs`, in turns.
//!
//! A third core, also without a subscriber, takes its turns too: what the two differ by is noise.

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use benches::contestants::Contestant;
use benches::{Football, Relay};
use clap::Parser;
use downbeat_executor::{Core, CycleRuns, Module, ModuleOptions, Received, Role, Setup, SetupError};

/// Measures cycles with and without a subscriber of the account of runs.
#[derive(Parser)]
struct Arguments {
    /// The robot file, which is measured with the feature `robot`
    #[arg(default_value = "robots/darwin_op.toml")]
    robot: PathBuf,
    /// The number of turns of each core
    #[arg(long, value_name = "NUMBER", default_value_t = 3000)]
    rounds: usize,
}

/// The cycles of a turn of a small core. Turns are short, so that few are disturbed by other processes, and
/// a slow phase of the machine affects all cores alike.
const CYCLES: u32 = 500;

fn main() -> anyhow::Result<()> {
    let Arguments { robot, rounds } = Arguments::parse();
    println!(
        "{:<36} {:>10} {:>10} {:>10} {:>9} {:>9}",
        "ns per cycle, median", "without", "with", "without", "cost", "noise"
    );
    small("two modules, one message", rounds, |prepare| Ok(Box::new(Relay::new(prepare)?)))?;
    small("eight modules, 14 messages", rounds, |prepare| Ok(Box::new(Football::new(prepare)?)))?;
    measure_robot(&robot, rounds)
}

type Prepare = fn(Core) -> anyhow::Result<Core>;

/// Compares cores of `make`, each trial of which is a cycle.
fn small(
    name: &str,
    rounds: usize,
    make: fn(Prepare) -> anyhow::Result<Box<dyn Contestant>>,
) -> anyhow::Result<()> {
    let cores = [make(Ok)?, make(listening)?, make(Ok)?];
    compare(name, rounds, cores, |core| {
        (0..CYCLES).for_each(|_| core.trial());
        Ok(CYCLES)
    })
}

/// Adds an observer that receives the account.
fn listening(mut core: Core) -> anyhow::Result<Core> {
    let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
    core.add_with("listener", Listener::default(), options)?;
    Ok(core)
}

/// Receives the account, and adds up its sizes.
#[derive(Default)]
struct Listener {
    runs: usize,
}

impl Module for Listener {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe(CycleRuns::TOPIC, |listener: &mut Self, account: Received<'_, Arc<CycleRuns>>, _| {
            listener.runs = black_box(listener.runs + account.runs.len());
        })
    }
}

/// Measures three cores, of which the second has the account, in turns, and prints the median times of a
/// cycle, and the median of how much longer it is than in the same round without. `turn` returns the number
/// of its cycles.
fn compare<C>(
    name: &str,
    rounds: usize,
    mut cores: [C; 3],
    mut turn: impl FnMut(&mut C) -> anyhow::Result<u32>,
) -> anyhow::Result<()> {
    let (mut times, mut costs, mut noises) = ([const { Vec::new() }; 3], Vec::new(), Vec::new());
    // The first round fills caches and memory that later ones reuse.
    for round in 0..=rounds {
        let (mut cycles, mut times_now) = ([0; 3], [0.0; 3]);
        // Each core begins a third of the rounds.
        for number in (0..3).map(|number| (number + round) % 3) {
            let begin = Instant::now();
            cycles[number] = turn(&mut cores[number])?;
            times_now[number] = begin.elapsed().as_secs_f64() * 1e9 / f64::from(cycles[number]);
        }
        anyhow::ensure!(
            cycles.iter().all(|&count| count == cycles[0] && count > 0),
            "{name}: {cycles:?} cycles are not the same work"
        );
        if round == 0 {
            continue;
        }
        let [without, with, again] = times_now;
        // A single turn each: a mean of two would be longer wherever either is disturbed.
        costs.push(100.0 * (with / without - 1.0));
        noises.push(100.0 * (again / without - 1.0));
        times.iter_mut().zip(times_now).for_each(|(times, time)| times.push(time));
    }
    let [without, with, again] = times.map(median);
    let (cost, noise) = (median(costs), median(noises));
    println!("{name:<36} {without:>10.1} {with:>10.1} {again:>10.1} {cost:>+7.1} % {noise:>+7.1} %");
    Ok(())
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = |index: usize| values.get(index).copied().unwrap_or(f64::NAN);
    middle(values.len().saturating_sub(1) / 2).midpoint(middle(values.len() / 2))
}

#[cfg(not(feature = "robot"))]
fn measure_robot(_: &Path, _: usize) -> anyhow::Result<()> {
    println!("with --features robot, the cycles of a robot are measured too");
    Ok(())
}

/// Compares the robot without its journal `module_runs` with the robot as it is, and with a bare subscriber
/// in the journal's place.
#[cfg(feature = "robot")]
fn measure_robot(path: &Path, rounds: usize) -> anyhow::Result<()> {
    use robot::Simulated;
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let without = |prepare| Simulated::new(path, prepare)?.without_journal();
    let measure = |what: &str, with: Simulated| {
        let mut cores = [without(Ok)?, with, without(Ok)?];
        for (core, is_accounted) in cores.iter_mut().zip([false, true, false]) {
            let before = core.accounts();
            core.turn()?;
            anyhow::ensure!((core.accounts() > before) == is_accounted, "{what}: another module listens");
        }
        compare(&format!("{name}, {what}"), rounds, cores, Simulated::turn)
    };
    measure("bare subscriber", without(listening)?)?;
    let mut journaled = Simulated::new(path, Ok)?;
    // The others took a turn to lose the journal.
    journaled.turn()?;
    measure("journal module_runs", journaled)
}

#[cfg(feature = "robot")]
mod robot {
    use std::path::Path;
    use std::time::Duration;

    use anyhow::Context as _;
    use downbeat::App;
    use downbeat_executor::{Core, CycleRuns, ManualClock, Time};

    use super::Prepare;

    /// The simulated time of a turn: ten periods of the Darwin OP.
    const TURN: Duration = Duration::from_millis(80);

    /// The journal that every robot has.
    const JOURNAL: &str = "run_journal";

    /// A robot in simulated time that does not wait, so that a turn is the work of its cycles alone.
    pub(super) struct Simulated {
        core: Core,
        clock: ManualClock,
        end: Time,
    }

    impl Simulated {
        /// Runs the first turn, in which the robot starts.
        pub(super) fn new(robot: &Path, prepare: Prepare) -> anyhow::Result<Self> {
            // Each has its own names of emulators in memory.
            let app = App::with_built_in_kinds();
            let clock = ManualClock::new(Time::ZERO);
            let core = app.robot_file(robot)?.build(Core::new().with_clock(clock.clone()))?.core;
            let mut robot = Self { core: prepare(core)?, clock, end: Time::ZERO };
            robot.turn()?;
            Ok(robot)
        }

        pub(super) fn without_journal(mut self) -> anyhow::Result<Self> {
            let removed = self.core.handle().remove(JOURNAL);
            self.turn()?;
            removed.wait(Duration::ZERO).context("the journal was not removed in a turn")??;
            Ok(self)
        }

        /// How many accounts were published.
        pub(super) fn accounts(&self) -> u64 {
            let mut topics = self.core.topics();
            topics.find(|topic| &*topic.name == CycleRuns::TOPIC).map_or(0, |topic| topic.counter.messages())
        }

        /// Runs until the end of the turn, and returns the number of cycles.
        pub(super) fn turn(&mut self) -> anyhow::Result<u32> {
            self.end = self.end + TURN;
            let mut cycles = 0;
            while let Some(at) = self.core.next_event().filter(|at| *at < self.end) {
                self.clock.set(at);
                self.core.cycle()?;
                cycles += 1;
            }
            Ok(cycles)
        }
    }
}
