//! All devices, and their answers to instructions.

use super::board::Board;
use super::foot::Foot;
use super::servo::Servo;
use super::standing::Standing;
use crate::hardware::FEET;
use crate::hardware::bus::BAUD_RATE;
use crate::hardware::protocol::{Id, Packet, Protocol, StatusError};
use crate::hardware::tables::joints::COUNT;
use crate::hardware::tables::units::CENTRE_TICKS;
use crate::hardware::tables::{Field, cm730, mx28};
use downbeat_servos::servo_emulator::{
    Answer, Body, Device, Devices, EmulatorOptions, Random, Timing, answer,
};
use std::time::Duration;

/// How often servos and board measure and drive the body.
const STEP: Duration = Duration::from_millis(1);

/// The robot.
pub(super) struct Robot {
    time: Duration,
    board: Board,
    servos: Vec<Servo>,
    /// Right, left; none if the body has no feet.
    feet: Vec<Foot>,
    dead: [bool; COUNT],
    body: Box<dyn Body>,
    noise: Random,
}

impl Robot {
    pub(super) fn of(options: &EmulatorOptions, body: Option<Box<dyn Body>>) -> Self {
        Self::new(options.seed, options.timing != Timing::Measured, body)
    }

    /// The devices of a robot with this body, or of a standing one near the middle of its ranges.
    pub(super) fn new(seed: u64, boots_at_once: bool, body: Option<Box<dyn Body>>) -> Self {
        let mut random = Random::new(seed, 1);
        let board = Board::new(&mut random);
        let (mut positions, mut servos) = ([0.0; COUNT], Vec::with_capacity(COUNT));
        for (index, position) in positions.iter_mut().enumerate() {
            *position = f64::from(CENTRE_TICKS) + random.within(25.0);
            servos.push(Servo::new(index, boots_at_once, &mut random));
        }
        let body = body.unwrap_or_else(|| Box::new(Standing::new(positions)));
        for (index, servo) in servos.iter_mut().enumerate() {
            servo.feel(body.joint(index));
        }
        let feet = body.foot_forces().map_or(Vec::new(), |_| FEET.map(|(_, id)| Foot::new(id)).into());
        let (dead, noise) = ([false; COUNT], Random::new(seed, 2));
        Self { time: Duration::ZERO, board, servos, feet, dead, body, noise }
    }

    fn switch_power(&mut self) {
        let is_on = self.board.gives_power();
        for (servo, is_dead) in self.servos.iter_mut().zip(self.dead) {
            servo.set_power(is_on && !is_dead);
        }
    }
}

impl Devices for Robot {
    fn protocol(&self) -> Protocol {
        Protocol::Dynamixel1
    }

    fn baud(&self) -> u32 {
        BAUD_RATE
    }

    fn advance_to(&mut self, now: Duration) {
        while self.time + STEP <= now {
            self.time += STEP;
            let (dt, volts) = (STEP.as_secs_f64(), self.board.volts());
            let commands: [_; COUNT] = std::array::from_fn(|index| self.servos[index].command(dt, volts));
            self.body.advance(STEP, &commands);
            for (index, servo) in self.servos.iter_mut().enumerate() {
                servo.advance(dt, volts, self.body.joint(index));
            }
            let current_a = self.servos.iter().map(Servo::current_a).sum();
            self.board.advance(dt, current_a, &self.body.imu(), &mut self.noise);
        }
    }

    fn begin_step(&mut self) {
        self.body.begin_step();
    }

    fn set_dead(&mut self, is_dead: &dyn Fn(Id) -> bool) {
        for (dead, servo) in self.dead.iter_mut().zip(&self.servos) {
            *dead = is_dead(servo.id());
        }
        for foot in &mut self.feet {
            foot.is_dead = is_dead(foot.id);
        }
        self.switch_power();
    }

    fn answer(&mut self, packet: &Packet<'_>, is_lost: &mut dyn FnMut() -> bool) -> Vec<Answer> {
        if let Some(forces) = self.body.foot_forces() {
            for (foot, forces) in self.feet.iter_mut().zip([forces.right, forces.left]) {
                foot.feel(forces);
            }
        }
        let has_power = self.board.gives_power();
        let board: &mut dyn Device = &mut self.board;
        let feet = self.feet.iter_mut().filter(|foot| has_power && !foot.is_dead);
        let feet = feet.map(|foot| &mut foot.unit as &mut dyn Device);
        let servos = self.servos.iter_mut().filter(|servo| servo.is_awake());
        let mut awake: Vec<&mut dyn Device> =
            std::iter::once(board).chain(feet).chain(servos.map(|servo| servo as &mut dyn Device)).collect();
        let answers = answer(Protocol::Dynamixel1, &mut awake, packet, is_lost);
        self.switch_power();
        answers
    }

    fn press(&mut self, number: usize, held: Duration) {
        self.board.press(number, held.as_secs_f64());
    }
}

/// Id, return delay and status return level have the same addresses in board and servos.
const _: () = {
    const fn same(one: &Field, other: &Field) -> bool {
        one.address == other.address && one.size == other.size
    }
    assert!(same(&cm730::ID, &mx28::ID) && same(&cm730::RETURN_DELAY, &mx28::RETURN_DELAY));
    assert!(same(&cm730::STATUS_RETURN_LEVEL, &mx28::STATUS_RETURN_LEVEL));
};

/// Implements [`Device`] for a type with the fields `table` and `registered`.
macro_rules! device {
    ($type:ty, $error:expr) => {
        impl Device for $type {
            fn id(&self) -> u8 {
                self.table.get(&mx28::ID).to_le_bytes()[0]
            }
            fn status_return_level(&self) -> u16 {
                self.table.get(&mx28::STATUS_RETURN_LEVEL)
            }
            fn return_delay(&self) -> Duration {
                Duration::from_micros(2 * u64::from(self.table.get(&mx28::RETURN_DELAY)))
            }
            fn error(&self) -> StatusError {
                $error(self)
            }
            fn identity(&self) -> [u8; 3] {
                let [low, high] = self.table.get(&mx28::MODEL_NUMBER).to_le_bytes();
                [low, high, self.table.get(&mx28::FIRMWARE_VERSION).to_le_bytes()[0]]
            }
            fn read(&self, address: u16, length: u16) -> Result<Vec<u8>, StatusError> {
                let byte = |number: u16| u8::try_from(number).map_err(|_| StatusError::RANGE);
                self.table.read(byte(address)?, byte(length)?).map(<[u8]>::to_vec)
            }
            fn write(&mut self, address: u16, data: &[u8]) -> Result<(), StatusError> {
                <$type>::write(self, u8::try_from(address).map_err(|_| StatusError::RANGE)?, data)
            }
            fn registered(&mut self) -> &mut Option<(u16, Vec<u8>)> {
                &mut self.registered
            }
        }
    };
}

device!(Board, |_: &Board| StatusError::NONE);
device!(Servo, Servo::error);
