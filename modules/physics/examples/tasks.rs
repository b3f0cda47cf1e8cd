//! How often a simulated Darwin OP does its tasks in worlds that differ from the description:
//! `cargo xtask physics`.
#![allow(missing_docs)]

use clap::Parser;
use downbeat_executor::SettingValue;
use downbeat_physics::Engine;
use downbeat_physics::tasks::{Conditions, Failure, Success, Task, push_limit};
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Runs the tasks of a simulated Darwin OP in perturbed worlds and prints how many succeed.
#[derive(Parser)]
#[command(name = "physics")]
struct Arguments {
    /// The number of worlds
    #[arg(long, default_value_t = 20)]
    seeds: u64,
    /// A task; may be repeated [default: all]
    #[arg(long, value_parser = task)]
    task: Vec<Task>,
    /// The engine: rapier, or mujoco
    #[arg(long, default_value = "rapier")]
    physics: Engine,
    /// A file of motions in place of the built-in one
    #[arg(long, default_value = "")]
    motions: String,
    /// A setting of the gait other than its default, as in `--gait period=0.5`; may be repeated
    #[arg(long, value_parser = setting)]
    gait: Vec<(String, SettingValue)>,
    /// The seed of the first world
    #[arg(long, default_value_t = 1)]
    first_seed: u64,
    /// Measures the largest push in each world, of a robot that stands and of one that walks
    #[arg(long)]
    push_limits: bool,
    /// The number of threads [default: one for each core]
    #[arg(long)]
    threads: Option<usize>,
}

/// The share of worlds in which a task has to succeed.
const GOAL: f64 = 0.9;

struct Run {
    task: Task,
    seed: u64,
    result: Result<Success, Failure>,
}

fn task(name: &str) -> Result<Task, String> {
    let names = || Task::ALL.map(Task::name).join(", ");
    let found = Task::ALL.into_iter().find(|task| task.name() == name);
    found.ok_or_else(|| format!("the tasks are {}", names()))
}

fn setting(text: &str) -> Result<(String, SettingValue), String> {
    let (name, value) = text.split_once('=').ok_or("expected setting=value")?;
    let value: f64 = value.parse().map_err(|_| format!("\"{value}\" is not a number"))?;
    Ok((name.to_owned(), value.into()))
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let arranged = |mut conditions: Conditions| {
        conditions.simulation.engine = arguments.physics;
        conditions.motions.clone_from(&arguments.motions);
        conditions.gait.extend(arguments.gait.iter().cloned());
        conditions
    };
    let seeds = arguments.first_seed..arguments.first_seed + arguments.seeds;
    let tasks = match &arguments.task[..] {
        [] if arguments.push_limits => &[],
        [] => &Task::ALL[..],
        tasks => tasks,
    };
    let jobs: Vec<_> = tasks.iter().flat_map(|&task| seeds.clone().map(move |seed| (task, seed))).collect();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let started = Instant::now();
    let threads = arguments.threads.unwrap_or(cores);
    let runs = in_parallel(&jobs, threads, |&(task, seed)| Run {
        task,
        seed,
        result: task.run(arranged(Conditions::perturbed(seed))),
    });
    println!("{}, {} worlds, {:.0} s", arguments.physics, arguments.seeds, started.elapsed().as_secs_f64());
    println!("task          done    at the first try  smallest  median  largest");
    let good: Vec<bool> = tasks.iter().map(|task| report(*task, &runs)).collect();
    let is_good = good.iter().all(|is_good| *is_good);
    if arguments.push_limits {
        push_limits(&seeds.collect::<Vec<_>>(), threads, arranged);
    }
    if is_good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Prints the largest push in all worlds, and the one that the robot survives in [`GOAL`] of them.
fn push_limits(seeds: &[u64], threads: usize, arranged: impl Fn(Conditions) -> Conditions + Sync) {
    let sides = [("front", [1.0, 0.0]), ("back", [-1.0, 0.0]), ("left", [0.0, 1.0]), ("right", [0.0, -1.0])];
    for (what, velocity) in [("stands", 0.0), ("walks", 0.1)] {
        for (side, direction) in sides {
            let limits = in_parallel(seeds, threads, |&seed| {
                push_limit(&arranged(Conditions::perturbed(seed)), direction, velocity)
            });
            match limits.into_iter().collect::<Result<Vec<f64>, _>>() {
                Ok(mut limits) => {
                    limits.sort_by(f64::total_cmp);
                    let spared = ((1.0 - GOAL) * limits.len() as f64).round() as usize;
                    println!(
                        "{what}, pushed to the {side}: {:.2} N s in {} of {} worlds, median {:.2}",
                        limits[spared],
                        limits.len() - spared,
                        limits.len(),
                        limits[limits.len() / 2]
                    );
                }
                Err(error) => println!("{what}, pushed to the {side}: {error}"),
            }
        }
    }
}

/// Results in the order of the jobs.
fn in_parallel<J: Sync, R: Send>(jobs: &[J], threads: usize, work: impl Fn(&J) -> R + Sync) -> Vec<R> {
    let next = AtomicUsize::new(0);
    let worker = || {
        let take = || Some(next.fetch_add(1, Ordering::Relaxed)).filter(|index| *index < jobs.len());
        std::iter::from_fn(take).map(|index| (index, work(&jobs[index]))).collect::<Vec<_>>()
    };
    let mut done: Vec<_> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads.max(1)).map(|_| scope.spawn(worker)).collect();
        workers.into_iter().flat_map(|worker| worker.join().unwrap_or_default()).collect()
    });
    done.sort_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}

/// Prints the line of a task and the seeds that failed; returns whether the goal is reached.
fn report(task: Task, runs: &[Run]) -> bool {
    let runs: Vec<&Run> = runs.iter().filter(|run| run.task == task).collect();
    let done: Vec<&Success> = runs.iter().filter_map(|run| run.result.as_ref().ok()).collect();
    let at_once = done.iter().filter(|success| success.attempts <= 1).count();
    let mut figures: Vec<f64> = done.iter().map(|success| success.figure).collect();
    figures.sort_by(f64::total_cmp);
    let figure = |index: usize| figures.get(index).map_or("-".to_owned(), |figure| format!("{figure:.2}"));
    println!(
        "{task:<13} {:>2}/{:<2} {:>19} {:>9} {:>7} {:>8}  {}",
        done.len(),
        runs.len(),
        if matches!(task, Task::GetUpFront | Task::GetUpBack) { at_once.to_string() } else { String::new() },
        figure(0),
        figure(figures.len() / 2),
        figure(figures.len().saturating_sub(1)),
        task.unit(),
    );
    for run in &runs {
        if let Err(failure) = &run.result {
            println!("    seed {}: {failure}", run.seed);
        }
    }
    done.len() as f64 >= GOAL * runs.len() as f64
}
