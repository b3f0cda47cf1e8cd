//! The robot of `downbeat new`, with a second module, whose device is a sonar.

mod level_head;
mod simulated_imu;
mod sonar;

use std::process::ExitCode;

use downbeat::App;
use downbeat::robot::Kind;
use level_head::LevelHead;
use simulated_imu::SimulatedImu;
use sonar::{Line, Sonar};

fn app() -> App {
    App::new()
        .interfaces(level_head::INTERFACES)
        .interfaces(sonar::INTERFACES)
        .kind("level_head", "holds the head level", LevelHead::default)
        .add_kind(Kind::new("simulated_imu", "an IMU that sways to and fro", SimulatedImu::default).emulated())
        .add_kind(Kind::device("sonar", "measures the way ahead", Line::open, Sonar::new).emulated())
}

fn main() -> ExitCode {
    app().main()
}
