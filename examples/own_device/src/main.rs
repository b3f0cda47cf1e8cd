//! A custom device: a range finder that answers lines of text.

mod emulator;
mod range_finder;

use std::process::ExitCode;

use downbeat::App;
use downbeat::robot::Kind;

use emulator::Emulator;
use range_finder::{Exchange, Line, RangeFinder};

fn app() -> App {
    let about = "a range finder that answers lines of text over UDP";
    let emulator = Kind::new("range_finder_emulator", "an emulated range finder", Emulator::default);
    App::new()
        .interfaces(Exchange::INTERFACES)
        .add_kind(Kind::device("range_finder", about, Line::default, RangeFinder::new))
        .add_kind(emulator.emulated().drives_device())
}

fn main() -> ExitCode {
    app().main()
}

#[cfg(test)]
mod tests {
    use super::app;

    #[test]
    fn the_recorded_run_repeats_byte_for_byte() -> downbeat::TestResult {
        app().replay("robot.toml", "tests/recorded_run")?.assert_same()
    }
}
