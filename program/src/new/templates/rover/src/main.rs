//! The program of the rover my_robot: its module `patrol`, and everything of downbeat.

mod patrol;

use std::process::ExitCode;

use downbeat::App;
use patrol::Patrol;

fn app() -> App {
    App::with_built_in_kinds().kind("patrol", "drives along a square", Patrol::default)
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
