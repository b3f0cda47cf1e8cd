//! Prints what this run of tests skipped. Cargo runs the test programs of packages in the order of their
//! names, so that this one comes last in a plain `cargo test`.
#![allow(missing_docs)]

use std::process::ExitCode;

use test_machine::Skips;

fn main() -> ExitCode {
    // nextest asks which tests there are, and hides what passing tests print.
    if std::env::args().any(|argument| argument == "--list") {
        return ExitCode::SUCCESS;
    }
    match Skips::of_this_run() {
        Ok(skips) => {
            println!("\n{skips}\n");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("cannot read the list of skipped tests: {error}");
            ExitCode::FAILURE
        }
    }
}
