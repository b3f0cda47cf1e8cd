//! Emulated lidars in an emulated room. No value was measured.
//!
//! The lidar stands in a room of 4 m by 3 m with a column, 1 m in front of the middle of its rear wall, and
//! turns clockwise: the LD06 and LD19 ten times per second with packets of 12 measurements as soon as they
//! have power, the RPLIDAR A1 5.5 times per second with nodes of single measurements while a scan is
//! requested. Distances have noise of 5 mm; one measurement of a hundred has no echo.
//!
//! Not emulated: the time that a motor takes to reach its speed, the line DTR that switches it, and health
//! other than good.

use std::collections::VecDeque;
use std::time::Duration;

use downbeat_executor::{Context, Module, Setup, SetupError, TransitionError};
use downbeat_servos::servo_emulator::Random;

use super::ldrobot::{MEASUREMENTS, Packet};
use super::rplidar::{Command, Node};
use super::{Model, ldrobot};
use crate::serial::{EmulatedDevice, EmulatedPorts, Served};

/// The walls, seen from the lidar: ahead, left, behind, right, in m.
const WALLS: [f64; 4] = [3.0, 1.5, 1.0, 1.5];
/// The column: forward, left, radius, in m.
const COLUMN: [f64; 3] = [1.5, 0.8, 0.2];
/// The standard deviation of a distance, in m.
const NOISE: f64 = 0.005;

/// An emulated lidar of this model, for a port.
#[must_use]
pub fn emulated(model: Model, seed: u64) -> Box<dyn EmulatedDevice> {
    let room = Room { random: Random::new(seed, 7) };
    match model {
        Model::Ld06 | Model::Ld19 => Box::new(LdRobot { room, packets: 0 }),
        Model::RplidarA1 => Box::new(Rplidar {
            room,
            now: Duration::ZERO,
            scan: None,
            requests: Vec::new(),
            answers: VecDeque::new(),
        }),
    }
}

struct Room {
    random: Random,
}

impl Room {
    /// The distance in this direction, clockwise, in m; `None` without echo.
    fn measure(&mut self, clockwise_deg: f64) -> Option<f64> {
        let (left, forward) = libm::sincos(-clockwise_deg.to_radians());
        let [ahead, to_left, behind, to_right] = WALLS;
        let to_wall = |component: f64, positive: f64, negative: f64| {
            let wall = if component > 0.0 { positive } else { negative };
            if component.abs() < 1e-9 { f64::INFINITY } else { wall / component.abs() }
        };
        let wall = to_wall(forward, ahead, behind).min(to_wall(left, to_left, to_right));
        let [x, y, radius] = COLUMN;
        let along = x * forward + y * left;
        let aside = x * left - y * forward;
        let column =
            (along > 0.0 && aside.abs() < radius).then(|| along - (radius * radius - aside * aside).sqrt());
        let distance = column.map_or(wall, |column| column.min(wall)) + self.random.normal(NOISE);
        (self.random.unit() >= 0.01).then_some(distance)
    }
}

/// Sends packets all the time.
struct LdRobot {
    room: Room,
    packets: u64,
}

impl LdRobot {
    const SPEED_DPS: u16 = 3600;
    const RATE: u64 = 4500;

    /// The direction of a measurement, clockwise, in 0.01°.
    fn direction_cdeg(number: u64) -> u16 {
        // 3600°/s and 4500/s: 0.8° each.
        (number % 450 * 80) as u16
    }
}

impl EmulatedDevice for LdRobot {
    fn advance_to(&mut self, now: Duration, send: &mut dyn FnMut(Vec<u8>)) {
        loop {
            let first = self.packets * MEASUREMENTS as u64;
            let last = first + MEASUREMENTS as u64 - 1;
            let sent_at = Duration::from_nanos((last + 1) * 1_000_000_000 / Self::RATE);
            if sent_at > now {
                return;
            }
            let measurements = std::array::from_fn(|index| {
                let direction = Self::direction_cdeg(first + index as u64);
                match self.room.measure(f64::from(direction) / 100.0) {
                    Some(metres) => ((metres * 1000.0).round() as u16, 200),
                    None => (0, 0),
                }
            });
            let packet = Packet {
                speed_dps: Self::SPEED_DPS,
                start_cdeg: Self::direction_cdeg(first),
                measurements,
                end_cdeg: Self::direction_cdeg(last),
                timestamp_ms: (sent_at.as_millis() % 30_000) as u16,
            };
            send(packet.to_bytes());
            self.packets += 1;
        }
    }
}

/// Sends nodes after it was asked for a scan.
struct Rplidar {
    room: Room,
    now: Duration,
    /// When the scan began, and the number of measurements since.
    scan: Option<(Duration, u64)>,
    /// Bytes of a request that is not whole.
    requests: Vec<u8>,
    answers: VecDeque<Vec<u8>>,
}

impl Rplidar {
    const SAMPLE: Duration = Duration::from_micros(504);
    /// Measurements of a revolution: 5.5 per second.
    const REVOLUTION: u64 = 361;

    fn answer(&mut self, command: Command) {
        let data: &[u8] = match command {
            Command::GetInfo => &[0x18, 29, 1, 7, 0xD0, 0xE1, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14],
            Command::GetHealth => &[0, 0, 0],
            Command::GetSampleRate => &[0xF8, 0x01, 0xFC, 0x00],
            Command::Stop | Command::Reset | Command::Scan => &[],
        };
        match command {
            Command::Stop | Command::Reset => self.scan = None,
            Command::Scan => self.scan = Some((self.now, 0)),
            _ => {}
        }
        if let Some(descriptor) = command.descriptor() {
            self.answers.push_back([&descriptor[..], data].concat());
        }
    }
}

impl EmulatedDevice for Rplidar {
    fn receive(&mut self, bytes: &[u8]) {
        self.requests.extend(bytes);
        while let Some(request) = self.requests.first_chunk::<2>() {
            match Command::ALL.into_iter().find(|command| command.to_bytes() == *request) {
                Some(command) => {
                    self.requests.drain(..2);
                    self.answer(command);
                }
                None => drop(self.requests.drain(..1)),
            }
        }
    }

    fn advance_to(&mut self, now: Duration, send: &mut dyn FnMut(Vec<u8>)) {
        self.now = now;
        self.answers.drain(..).for_each(&mut *send);
        let Some((began, count)) = &mut self.scan else { return };
        while *began + Self::SAMPLE * u32::try_from(*count + 1).unwrap_or(u32::MAX) <= now {
            let number = *count % Self::REVOLUTION;
            let angle_q6 = (number * 360 * 64 / Self::REVOLUTION) as u16;
            let distance = self.room.measure(f64::from(angle_q6) / 64.0);
            let node = Node {
                is_first: number == 0,
                quality: if distance.is_some() { 15 } else { 0 },
                angle_q6,
                distance_q2: (distance.unwrap_or(0.0) * 4000.0).round() as u16,
            };
            send(node.to_bytes().to_vec());
            *count += 1;
        }
    }
}

/// Runs an emulated lidar as long as the robot runs, so that [`Lidar`](super::Lidar) finds a port.
///
/// Settings: `model`; `link`, the path of the port, or `memory:NAME` for a port in memory; `seed`; `faults`.
/// It has no topics: everything goes through the port. Leave it out of replays.
#[derive(Default)]
pub struct LidarEmulator {
    served: Served,
    model: Model,
}

impl LidarEmulator {
    /// An emulator that can be among these ports in memory.
    #[must_use]
    pub fn new(ports: EmulatedPorts) -> Self {
        Self { served: Served::new(ports), model: Model::default() }
    }
}

impl Module for LidarEmulator {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let model = setup.read_only_choice("model", "ld19", &Model::NAMES, "which lidar is emulated")?;
        self.model = setup.value(model).and_then(|name| Model::named(name)).unwrap_or_default();
        let model = self.model;
        self.served.declare(setup, "memory:lidar", |seed| emulated(model, seed))
    }

    fn activate(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        let model = self.model;
        Ok(self.served.open(|seed| emulated(model, seed))?)
    }

    fn deactivate(&mut self, _ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        self.served.close();
        Ok(())
    }

    fn shutdown(&mut self, _ctx: &mut Context<'_>) {
        self.served.close();
    }
}

/// The length of a packet is that of its description.
const _: () = assert!(ldrobot::LENGTH == 6 + 3 * MEASUREMENTS + 5);
