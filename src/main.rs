//! The program `downbeat`: runs robots, looks at bags, emulates devices.

mod program;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    program::main(program::cli::Cli::parse())
}
