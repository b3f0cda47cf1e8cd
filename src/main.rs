//! The program `downbeat`: runs robots, looks at bags, emulates devices.

use std::process::ExitCode;

fn main() -> ExitCode {
    downbeat::program::main()
}
