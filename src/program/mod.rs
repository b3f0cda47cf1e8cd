//! What the program does, one file for each command.

mod bag;
mod check;
pub(crate) mod cli;
mod emulate;
mod faults;
mod logging;
mod run;
mod screen;
mod session;
mod statistics;
mod status;
mod stop;

use std::process::ExitCode;

use cli::{BagCommand, Cli, Command, EmulateCommand};
use screen::Screen;

/// Does what the command line says. An error is told on standard error and gives exit code 1.
pub(crate) fn main(cli: Cli) -> ExitCode {
    let screen = Screen::new();
    logging::start(&screen);
    let result = match cli.command {
        Command::Run(arguments) => run::run(&arguments, &screen),
        Command::Check(arguments) => check::check(&arguments),
        Command::Bag(BagCommand::Info { bag }) => bag::info(&bag),
        Command::Bag(BagCommand::Record(arguments)) => bag::record::record(&arguments, &screen),
        Command::Bag(BagCommand::Play(arguments)) => bag::play::play(&arguments),
        Command::Emulate(EmulateCommand::DarwinOp { link, seed, fault }) => {
            emulate::darwin_op(link, seed, &fault)
        }
    };
    screen.show(Vec::new());
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("downbeat: {error:#}");
            ExitCode::FAILURE
        }
    }
}
