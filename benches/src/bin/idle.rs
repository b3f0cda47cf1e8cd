//! Measures processor time and memory of a robot to which nobody subscribes: its modules alone, its node on
//! DDS, and its node on Zenoh with a router, in turns.
//!
//! Each turn is a process. The router is in this one.

use std::path::PathBuf;
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context as _, ensure};
use clap::{Parser, ValueEnum};
use downbeat::App;
use downbeat::running::PreparedRobot;
use downbeat_zenoh::{Router, Settings};
use serde::{Deserialize, Serialize};

/// Measures a robot without subscribers, with each engine.
#[derive(Parser)]
struct Arguments {
    /// The robot file
    #[arg(default_value = "robots/darwin_op.toml")]
    robot: PathBuf,
    /// How long each turn is measured
    #[arg(long, value_name = "SECONDS", default_value_t = 10)]
    seconds: u64,
    /// The number of turns
    #[arg(long, value_name = "NUMBER", default_value_t = 3)]
    rounds: usize,
    /// The ROS domain
    #[arg(long, default_value_t = 103)]
    domain: u16,
    /// Run the robot for one turn
    #[arg(long, hide = true)]
    turn: Option<Setting>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Setting {
    Modules,
    Dds,
    Zenoh,
}

/// The measurements of a turn.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct Turn {
    /// Percent of a core.
    load: f64,
    /// Resident memory.
    megabytes: f64,
    threads: usize,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    if let Some(setting) = arguments.turn {
        println!("{}", serde_json::to_string(&turn(setting, &arguments)?)?);
        return Ok(());
    }
    ensure!(arguments.rounds > 0, "--rounds must be at least 1");
    let overrides = Some(r#"listen/endpoints=["tcp/127.0.0.1:0"]"#.to_owned());
    let router = Router::start(&Settings { overrides, ..Settings::default() })?;
    let router = router.locators().into_iter().next().context("the router listens nowhere")?;
    let mut turns = vec![Vec::new(); Setting::value_variants().len()];
    for _ in 0..arguments.rounds {
        for (setting, turns) in Setting::value_variants().iter().zip(&mut turns) {
            turns.push(start(*setting, &router, &arguments).with_context(|| format!("{setting:?}"))?);
        }
    }
    println!("| robot | processor, % of a core | memory, MB | more than DDS | threads |");
    println!("| --- | --- | --- | --- | --- |");
    let of = |turns: &[Turn], figure: fn(&Turn) -> f64| median(turns.iter().map(figure));
    let dds = &turns[Setting::Dds as usize];
    let (load_of_dds, megabytes_of_dds) = (of(dds, |turn| turn.load), of(dds, |turn| turn.megabytes));
    for (setting, turns) in Setting::value_variants().iter().zip(&turns) {
        let (load, megabytes) = (of(turns, |turn| turn.load), of(turns, |turn| turn.megabytes));
        let threads = of(turns, |turn| turn.threads as f64);
        println!(
            "| {setting:?} | {load:.2} | {megabytes:.1} | {:+.2} %, {:+.1} MB | {threads} |",
            load - load_of_dds,
            megabytes - megabytes_of_dds
        );
    }
    Ok(())
}

fn start(setting: Setting, router: &str, arguments: &Arguments) -> anyhow::Result<Turn> {
    let mut command = Command::new(std::env::current_exe()?);
    command.arg(&arguments.robot).args(["--seconds", &arguments.seconds.to_string()]);
    let name = setting.to_possible_value().context("a setting has a name")?;
    command.args(["--turn", name.get_name()]);
    let rmw = match setting {
        Setting::Zenoh => "rmw_zenoh_cpp",
        Setting::Modules | Setting::Dds => "rmw_fastrtps_cpp",
    };
    command.env("RMW_IMPLEMENTATION", rmw);
    command.env("ROS_DOMAIN_ID", arguments.domain.to_string());
    command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
    command.env("ZENOH_CONFIG_OVERRIDE", format!("connect/endpoints=[{router:?}]"));
    let output = command.stderr(std::process::Stdio::inherit()).output()?;
    ensure!(output.status.success(), "the robot ended with {}", output.status);
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// Runs the robot in this process; the environment chooses the engine.
fn turn(setting: Setting, arguments: &Arguments) -> anyhow::Result<Turn> {
    let app = App::with_built_in_kinds();
    let robot = match setting {
        Setting::Modules => PreparedRobot::new(app.robot_file(&arguments.robot)?)?.start()?,
        Setting::Dds | Setting::Zenoh => app.start(&arguments.robot)?,
    };
    let measured = measure(arguments)?;
    robot.stop()?;
    Ok(measured)
}

fn measure(arguments: &Arguments) -> anyhow::Result<Turn> {
    // It has started, and met the router.
    std::thread::sleep(Duration::from_secs(3));
    let (start, used) = (Instant::now(), on_processor()?);
    std::thread::sleep(Duration::from_secs(arguments.seconds));
    let load = 100.0 * (on_processor()? - used) / start.elapsed().as_secs_f64();
    let rollup = std::fs::read_to_string("/proc/self/smaps_rollup")?;
    let line = rollup.lines().find_map(|line| line.strip_prefix("Rss:")).context("Rss in smaps_rollup")?;
    let kibibytes: u64 = line.trim().trim_end_matches("kB").trim().parse()?;
    let threads = std::fs::read_dir("/proc/self/task")?.count();
    Ok(Turn { load, megabytes: kibibytes as f64 * 1024.0 / 1e6, threads })
}

/// The seconds that the present threads of this process have run.
fn on_processor() -> anyhow::Result<f64> {
    let mut nanoseconds = 0;
    for task in std::fs::read_dir("/proc/self/task")? {
        // A thread may have ended.
        let Ok(text) = std::fs::read_to_string(task?.path().join("schedstat")) else { continue };
        nanoseconds += text.split(' ').next().context("schedstat")?.parse::<u64>()?;
    }
    Ok(nanoseconds as f64 / 1e9)
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}
