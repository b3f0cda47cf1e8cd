//! The program `downbeat`: runs robots, looks at bags, emulates devices.

mod program;

use std::process::ExitCode;

fn main() -> ExitCode {
    program::main(program::cli::Cli::parse_with_ros_args(std::env::args_os()))
}
