//! Runs the swarm, with all commands of `downbeat`.

use std::process::ExitCode;

fn main() -> ExitCode {
    swarm::app().main()
}
