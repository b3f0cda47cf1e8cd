//! The program `downbeat`: runs robots, inspects bags, emulates devices.

use std::process::ExitCode;

fn main() -> ExitCode {
    downbeat::App::with_built_in_kinds().main()
}
