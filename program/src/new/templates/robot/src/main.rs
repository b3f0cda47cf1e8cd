//! The program of the robot my_robot: its kinds of modules, with every command of downbeat.

mod level_head;
mod simulated_imu;

use std::process::ExitCode;

use downbeat::App;
use downbeat::robot::Kind;
use level_head::LevelHead;
use simulated_imu::SimulatedImu;

fn app() -> App {
    App::new()
        .interfaces(level_head::INTERFACES)
        .kind("level_head", "holds the head level", LevelHead::default)
        .add_kind(
            Kind::new("simulated_imu", "an IMU that sways to and fro", SimulatedImu::default).emulated(),
        )
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
