//! An emulated receiver. No value was measured.
//!
//! It begins at midnight of 2026-01-01, has a fix from the second second on, and moves at 1 m/s on a circle
//! of 10 m near Munich. Once a second it sends RMC, VTG, GGA, GSA and GST at the pace of 9600 bit/s.

use std::f64::consts::FRAC_PI_2;
use std::time::Duration;

use downbeat_executor::{Context, Module, Setup, SetupError, TransitionError};
use downbeat_servos::servo_emulator::Random;

use super::sentence::line;
use crate::serial::{EmulatedDevice, EmulatedPorts, Served};

/// The middle of the circle, in degrees.
const MIDDLE: [f64; 2] = [48.1173, 11.516_666_7];
const RADIUS: f64 = 10.0;
const SPEED: f64 = 1.0;
/// A degree of latitude, and of longitude at that latitude, in m.
const DEGREE: [f64; 2] = [111_200.0, 74_300.0];
/// The standard deviation of a position, in m.
const NOISE: f64 = 0.5;
/// When it has its first fix, in s.
const FIRST_FIX: u64 = 2;
/// A byte on the line: 10 bits.
const BYTE: Duration = Duration::from_nanos(10 * 1_000_000_000 / 9600);

/// An emulated receiver, for a port.
#[must_use]
pub fn emulated(seed: u64) -> Box<dyn EmulatedDevice> {
    Box::new(Receiver { random: Random::new(seed, 8), second: 0, sentences: Vec::new() })
}

struct Receiver {
    random: Random,
    /// The next one.
    second: u64,
    /// What is sent yet, and when.
    sentences: Vec<(Duration, Vec<u8>)>,
}

impl Receiver {
    fn bodies(&mut self) -> [String; 5] {
        let second = self.second % 86_400;
        let time = format!("{:02}{:02}{:02}.00", second / 3600, second / 60 % 60, second % 60);
        let date = format!("{:02}0126", 1 + self.second / 86_400 % 28);
        if self.second < FIRST_FIX {
            return [
                format!("GNRMC,{time},V,,,,,,,{date},,,N"),
                "GNVTG,,,,,,,,,N".to_owned(),
                format!("GNGGA,{time},,,,,0,00,99.99,,,,,,"),
                "GNGSA,A,1,,,,,,,,,,,,,99.99,99.99,99.99".to_owned(),
                format!("GNGST,{time},,,,,,,"),
            ];
        }
        let (east, north) = libm::sincos(self.second as f64 * SPEED / RADIUS);
        let latitude = MIDDLE[0] + (RADIUS * north + self.random.normal(NOISE)) / DEGREE[0];
        let longitude = MIDDLE[1] + (RADIUS * east + self.random.normal(NOISE)) / DEGREE[1];
        let altitude = 520.0 + self.random.normal(2.0 * NOISE);
        let course = (self.second as f64 * SPEED / RADIUS + FRAC_PI_2).to_degrees() % 360.0;
        let knots = SPEED * 3600.0 / 1852.0;
        let angle = |degrees: f64, width: usize| {
            format!("{:0width$}{:08.5}", degrees.floor(), degrees.fract() * 60.0)
        };
        let position = format!("{},N,{},E", angle(latitude, 2), angle(longitude, 3));
        [
            format!("GNRMC,{time},A,{position},{knots:.3},{course:.2},{date},,,A"),
            format!("GNVTG,{course:.2},T,,M,{knots:.3},N,{:.3},K,A", SPEED * 3.6),
            format!("GNGGA,{time},{position},1,09,0.92,{altitude:.1},M,46.9,M,,"),
            "GNGSA,A,3,04,05,09,12,17,19,24,25,29,,,,1.72,0.92,1.45".to_owned(),
            format!("GNGST,{time},1.8,,,,{NOISE},{NOISE},{}", 2.0 * NOISE),
        ]
    }
}

impl EmulatedDevice for Receiver {
    fn advance_to(&mut self, now: Duration, send: &mut dyn FnMut(Vec<u8>)) {
        while Duration::from_secs(self.second) <= now {
            let mut at = Duration::from_secs(self.second);
            for body in self.bodies() {
                let line = line(&body);
                at += BYTE * u32::try_from(line.len()).unwrap_or(u32::MAX);
                self.sentences.push((at, line));
            }
            self.second += 1;
        }
        let count = self.sentences.iter().take_while(|(at, _)| *at <= now).count();
        self.sentences.drain(..count).for_each(|(_, line)| send(line));
    }
}

/// Runs an emulated receiver as long as the robot runs, so that [`Gps`](super::Gps) finds a port.
///
/// Settings: `link`, the path of the port, or `memory:NAME` for a port in memory; `seed`; `faults`. It has no
/// topics: everything goes through the port. Leave it out of replays.
#[derive(Default)]
pub struct GpsEmulator {
    served: Served,
}

impl GpsEmulator {
    /// An emulator that can be among these ports in memory.
    #[must_use]
    pub fn new(ports: EmulatedPorts) -> Self {
        Self { served: Served::new(ports) }
    }
}

impl Module for GpsEmulator {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        self.served.declare(setup, "memory:gps", emulated)
    }

    fn activate(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        Ok(self.served.open(emulated)?)
    }

    fn deactivate(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        self.served.close();
        Ok(())
    }

    fn shutdown(&mut self, _ctx: &mut Context<'_>) {
        self.served.close();
    }
}
