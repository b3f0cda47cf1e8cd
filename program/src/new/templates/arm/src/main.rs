//! The program of the arm my_robot: its module `poses`, and everything of downbeat.

mod poses;

use std::process::ExitCode;

use downbeat::App;
use poses::Poses;

fn app() -> App {
    App::with_built_in_kinds().kind("poses", "moves the arm to poses by name", Poses::default)
}

fn main() -> ExitCode {
    app().main()
}

#[cfg(test)]
mod tests {
    #[test]
    fn field_run_repeats() -> downbeat::TestResult {
        super::app().replay("robot.toml", "tests/field_run")?.assert_same()
    }
}
