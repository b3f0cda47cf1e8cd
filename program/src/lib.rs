//! The command line: one file for each command.

#[macro_use]
mod output;

mod bag;
#[cfg(feature = "state_machine")]
mod chart;
mod check;
mod choose;
mod cli;
#[cfg(feature = "view")]
mod compose;
mod describe;
mod description;
mod doctor;
mod emulate;
mod expose;
#[cfg(feature = "football")]
mod football;
mod graph;
mod input;
mod interface;
mod logging;
mod look;
mod network;
mod new;
mod new_output;
mod own_command;
mod parameters;
mod robots;
#[cfg(feature = "zenoh")]
mod router;
mod run;
mod screen;
#[cfg(feature = "security")]
mod security;
mod service;
mod servo;
mod statistics;
mod status;
mod stop;
#[cfg_attr(not(unix), path = "system_elsewhere.rs")]
mod system;
mod top;
#[cfg(any(feature = "plots", feature = "top"))]
mod topic_field;
mod trace;
mod unfinished;
#[cfg(feature = "view")]
mod view;
#[cfg(feature = "football")]
mod vision;

use std::backtrace::{Backtrace, BacktraceStatus};
use std::ffi::OsString;
use std::fs;
use std::path::Path;
use std::process::ExitCode;

use anyhow::Context;
use clap::CommandFactory;

use cli::{BagCommand, Cli, Command, DescriptionCommand, EmulateCommand};
use downbeat_robot::in_one_line;
use downbeat_robot::{Catalog, CatalogError};
use logging::Log;
use look::Environment;
use screen::Screen;

/// Runs a command line, the name of the program first, with what robot files can name. Errors are printed on
/// standard error and exit with code 1.
pub fn main(catalog: Result<&Catalog, &CatalogError>, line: impl IntoIterator<Item = OsString>) -> ExitCode {
    let cli = Cli::parse_with_ros_args(line);
    let screen = Screen::of_process().clone();
    let Cli { command, ros } = cli;
    if matches!(command, Command::LibraryChild) {
        // Before anything can print: its standard output is a pipe to the robot.
        return downbeat_library_host::child();
    }
    report_panics();
    let log = match Log::start(&screen, &ros.log) {
        Ok(log) => log,
        Err(error) => return fail(&error),
    };
    let catalog = match catalog {
        Ok(catalog) => catalog,
        Err(problem) => return fail(&anyhow::anyhow!("this program registers something invalid: {problem}")),
    };
    if ends_when_done(&command)
        && let Err(error) = unfinished::end_on_signals()
    {
        return fail(&error);
    }
    let environment = Environment { catalog, ros: &ros };
    let result = match command {
        Command::Run(arguments) => run::run(&arguments, catalog, &ros, &screen, &log),
        #[cfg(feature = "football")]
        Command::Match(arguments) => football::play(&arguments, catalog, &ros, &screen, &log),
        #[cfg(feature = "football")]
        Command::MatchRobot(arguments) => football::robot::run(&arguments, catalog, &ros, &screen, &log),
        #[cfg(not(feature = "football"))]
        Command::Match(_) | Command::Vision(_) => not_built("football", ""),
        Command::Check(arguments) => check::check(&arguments, catalog, &ros, &log),
        Command::Robots(command) => robots::run(&command, catalog),
        Command::Doctor(arguments) => doctor::doctor(&arguments, catalog, &ros),
        Command::Describe(arguments) => describe::describe(&arguments, catalog, &ros),
        #[cfg(feature = "view")]
        Command::Compose(arguments) => compose::compose(&arguments, catalog),
        #[cfg(not(feature = "view"))]
        Command::Compose(_) | Command::View(_) | Command::Bag(BagCommand::View(_)) => not_built("view", ""),
        Command::Top(arguments) => top::top(&arguments),
        Command::Expose(arguments) => expose::expose(&arguments),
        Command::Trace(arguments) => trace::trace(&arguments),
        #[cfg(feature = "view")]
        Command::View(arguments) => view::view(&arguments, catalog, &ros),
        #[cfg(feature = "state_machine")]
        Command::Chart(arguments) => chart::chart(&arguments, catalog),
        #[cfg(not(feature = "state_machine"))]
        Command::Chart(_) => not_built("state_machine", ""),
        #[cfg(feature = "zenoh")]
        Command::Router => router::router(),
        #[cfg(not(feature = "zenoh"))]
        Command::Router(_) => not_built("zenoh", ""),
        #[cfg(feature = "security")]
        Command::Security(command) => security::security(&command, catalog, &ros, &log),
        #[cfg(not(feature = "security"))]
        Command::Security(_) => not_built("security", "`ros2 security` makes keystores too"),
        Command::Graph(arguments) => graph::graph(&arguments, catalog, &ros),
        Command::Bag(BagCommand::Info(arguments)) => bag::info::info(&arguments),
        Command::Bag(BagCommand::Record(arguments)) => {
            bag::record::record(&arguments, catalog, &ros, &screen, &log)
        }
        Command::Bag(BagCommand::Play(arguments)) => {
            bag::play::play(&arguments, catalog, &ros, &screen, &log)
        }
        Command::Bag(BagCommand::Replay(arguments)) => bag::replay::replay(&arguments, catalog, &ros, &log),
        #[cfg(unix)]
        Command::Bag(BagCommand::Debug(arguments)) => bag::debug::debug(&arguments, catalog, &ros, &log),
        #[cfg(not(unix))]
        Command::Bag(BagCommand::Debug(_)) => Err(anyhow::anyhow!(
            "`bag debug` makes checkpoints by `fork`, which this system does not have: use it on Linux or macOS, or here \
             `downbeat bag replay`, which finds the first difference, and `downbeat bag why`"
        )),
        Command::Bag(BagCommand::Bisect(arguments)) => bag::bisect::bisect(&arguments),
        Command::Bag(BagCommand::Check(arguments)) => bag::check::check(&arguments, catalog),
        Command::Bag(BagCommand::Repair(arguments)) => bag::repair::repair(&arguments),
        Command::Bag(BagCommand::Reindex(arguments)) => bag::reindex::reindex(&arguments),
        Command::Bag(BagCommand::Convert(arguments)) => bag::convert::convert(&arguments),
        Command::Bag(BagCommand::Cut(arguments)) => bag::cut::cut(&arguments),
        Command::Bag(BagCommand::Diff(arguments)) => bag::diff::diff(&arguments),
        Command::Bag(BagCommand::Export(arguments)) => bag::export::export(&arguments, catalog),
        #[cfg(feature = "tables")]
        Command::Bag(BagCommand::Import(arguments)) => bag::import::import(&arguments),
        #[cfg(not(feature = "tables"))]
        Command::Bag(BagCommand::Import(_)) => not_built("tables", ""),
        Command::Bag(BagCommand::Why(arguments)) => bag::why::why(&arguments, catalog),
        Command::Bag(BagCommand::Latency(arguments)) => bag::latency::latency(&arguments, catalog),
        #[cfg(feature = "plots")]
        Command::Bag(BagCommand::Plot(arguments)) => bag::plot::plot(&arguments, catalog),
        #[cfg(not(feature = "plots"))]
        Command::Bag(BagCommand::Plot(_)) => not_built("plots", "`bag export` writes tables"),
        #[cfg(feature = "view")]
        Command::Bag(BagCommand::View(arguments)) => bag::view::view(&arguments, catalog),
        Command::Interface(command) => interface::interface(&command, catalog),
        Command::Topic(command) => look::topic(&command, &environment),
        Command::Node(command) => look::node(&command, &environment),
        Command::Service(command) => look::service(&command, &environment),
        Command::Param(command) => look::param(&command, &environment),
        Command::Action(command) => look::action(&command, &environment),
        Command::Lifecycle(command) => look::lifecycle(&command, &environment),
        Command::New(arguments) => new::new(&arguments),
        Command::Description(DescriptionCommand::Mjcf { urdf, fixed }) => description::mjcf(&urdf, fixed),
        Command::Servo(command) => servo::run(command),
        #[cfg(feature = "football")]
        Command::Vision(command) => vision::run(&command),
        Command::Emulate(EmulateCommand::Servos { description, bus, link, seed, fault, by_hand }) => {
            emulate::servos(&description, &bus, link, seed, &fault, by_hand)
        }
        Command::Emulate(EmulateCommand::DarwinOp { link, seed, fault }) => {
            emulate::darwin_op(link, seed, &fault)
        }
        Command::Completions { shell } => {
            print_completions(shell);
            Ok(())
        }
        Command::Man { folder } => write_man_pages(&folder),
        Command::LibraryChild => Ok(()),
    };
    screen.show(Vec::new());
    screen.flush();
    log.close();
    match result {
        Ok(()) if output::has_failed() => ExitCode::FAILURE,
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fail(&error),
    }
}

/// Whether a command runs for long, but has nothing to stop in order.
fn ends_when_done(command: &Command) -> bool {
    let Command::Bag(command) = command else { return false };
    match command {
        BagCommand::Info(_) | BagCommand::Check(_) | BagCommand::Repair(_) | BagCommand::Reindex(_) => true,
        BagCommand::Convert(_) | BagCommand::Cut(_) | BagCommand::Diff(_) | BagCommand::Export(_) => true,
        BagCommand::Why(_) | BagCommand::Latency(_) => true,
        #[cfg(feature = "tables")]
        BagCommand::Import(_) => true,
        #[cfg(feature = "plots")]
        BagCommand::Plot(_) => true,
        _ => false,
    }
}

/// The error of a command that needs a feature of the package.
#[cfg_attr(
    all(
        feature = "football",
        feature = "plots",
        feature = "security",
        feature = "tables",
        feature = "top",
        feature = "view",
        feature = "zenoh"
    ),
    allow(dead_code)
)]
fn not_built<T>(feature: &str, instead: &str) -> anyhow::Result<T> {
    anyhow::bail!(
        "this program is {}{}{instead}",
        downbeat_robot::features::built_without(feature),
        if instead.is_empty() { "" } else { "; " }
    )
}

/// Reports panics like the standard library, but through the screen: a halted terminal must not halt the
/// module that panics.
fn report_panics() {
    std::panic::set_hook(Box::new(|panic| {
        let thread = std::thread::current();
        let name = thread.name().unwrap_or("<unnamed>");
        let mut text = format!("thread '{name}' {panic}\n");
        let backtrace = Backtrace::capture();
        if backtrace.status() == BacktraceStatus::Captured {
            text.push_str(&format!("stack backtrace:\n{backtrace}"));
        }
        if name == "main" {
            // The process is about to end.
            eprintln!("{}", text.trim_end());
        } else {
            Screen::of_process().log(logging::Stream::Error, output::escaped(format_args!("{text}")));
        }
    }));
}

fn print_completions(shell: clap_complete::Shell) {
    let mut command = Cli::command();
    let name = command.get_name().to_owned();
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut command, name, &mut script);
    print!("{}", String::from_utf8_lossy(&script));
}

fn write_man_pages(folder: &Path) -> anyhow::Result<()> {
    let write = || {
        fs::create_dir_all(folder)?;
        clap_mangen::generate_to(Cli::command(), folder)
    };
    write().with_context(|| format!("cannot write the man pages into {}", folder.display()))
}

fn fail(error: &anyhow::Error) -> ExitCode {
    eprintln!("downbeat: {}", in_one_line(error.chain().map(ToString::to_string)));
    ExitCode::FAILURE
}
