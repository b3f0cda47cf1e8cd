//! Compares the cycles of a robot under `downbeat run` with those of its modules in a core without a node.
//!
//! Both have the same pace and sleep between cycles. They run in turns, and the times are measured by the
//! core's inspector.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context as _, ensure};
use benches::measure::ratio;
use clap::Parser;
use downbeat::App;
use downbeat::executor::{Core, TimeStatistics};

/// Measures the robot with its node in ROS 2, and its modules alone.
#[derive(Parser)]
struct Arguments {
    /// The robot file
    #[arg(default_value = "robots/darwin_op.toml")]
    robot: PathBuf,
    /// The duration of each turn
    #[arg(long, value_name = "SECONDS", default_value_t = 5)]
    seconds: u64,
    /// The number of turns
    #[arg(long, value_name = "NUMBER", default_value_t = 3)]
    rounds: u32,
}

fn main() -> anyhow::Result<()> {
    let Arguments { robot, seconds, rounds } = Arguments::parse();
    let (app, turn) = (App::with_built_in_kinds(), Duration::from_secs(seconds));
    let (mut running, mut bare) = (Vec::new(), Vec::new());
    for _ in 0..rounds {
        running.push(run(&app, &robot, turn).context("the robot")?);
        bare.push(run_bare(&app, &robot, turn).context("its modules")?);
    }
    println!("{:<22} {:>10} {:>10} {:>10}", "", "p50, ns", "p99, ns", "measured");
    let mut best = Vec::new();
    for (name, turns) in [("as `downbeat run`", running), ("a core alone", bare)] {
        let turn = turns.iter().min_by_key(|times| times.p50_ns).context("no turn")?;
        println!("{name:<22} {:>10} {:>10} {:>10}", turn.p50_ns, turn.p99_ns, turn.count);
        best.push(Duration::from_nanos(turn.p50_ns));
    }
    println!("ratio {:.2}, to be at most 1.3", ratio(best[0], best[1]));
    Ok(())
}

fn run(app: &App, robot: &PathBuf, turn: Duration) -> anyhow::Result<TimeStatistics> {
    let robot = app.start(robot)?;
    std::thread::sleep(turn);
    let times = robot.core().timing().cycle;
    robot.stop()?;
    ensure!(times.count > 0, "no cycle was measured");
    Ok(times)
}

fn run_bare(app: &App, robot: &PathBuf, turn: Duration) -> anyhow::Result<TimeStatistics> {
    let mut core = app.robot_file(robot)?.build(Core::new())?.core;
    let handle = core.handle();
    let thread = std::thread::spawn(move || core.run());
    std::thread::sleep(turn);
    let times = handle.timing().cycle;
    handle.stop();
    thread.join().map_err(|_| anyhow::anyhow!("the core's thread panicked"))??;
    ensure!(times.count > 0, "no cycle was measured");
    Ok(times)
}
