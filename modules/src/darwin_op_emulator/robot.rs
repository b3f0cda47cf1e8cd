//! All devices, and their answers to instructions.
//!
//! # Attitude of the body
//! Both feet are assumed to stand flat, so turning a leg's joints turns the body instead of the foot. With the axes of
//! the joints (forward, left, up), the right foot is turned against the body by
//!
//! - pitch: hip pitch + knee - ankle pitch (the left leg mirrored),
//! - roll: ankle roll - hip roll, yaw: - hip yaw (both legs alike),
//!
//! the body against the floor by the opposite, averaged over both legs, with a lag.

use super::board::{Board, Button};
use super::control_table::ControlTable;
use super::random::Random;
use super::servo::Servo;
use crate::darwin_op::protocol::{BulkReadBlock, Id, Instruction, Packet, Status, StatusError};
use crate::darwin_op::tables::joints::COUNT;
use crate::darwin_op::tables::units::STANDARD_GRAVITY;
use crate::darwin_op::tables::{Field, cm730, mx28};
use std::time::Duration;

/// The step of the physics.
const STEP: Duration = Duration::from_millis(1);

/// An answer of a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Answer {
    /// The status packet.
    pub(super) packet: Vec<u8>,
    /// The delay before it, from the device's setting.
    pub(super) return_delay: Duration,
}

/// The robot.
pub(super) struct Robot {
    time: Duration,
    board: Board,
    servos: Vec<Servo>,
    dead: [bool; COUNT],
    attitude: Attitude,
    noise: Random,
}

impl Robot {
    pub(super) fn new(seed: u64, boots_at_once: bool) -> Self {
        let mut random = Random::new(seed, 1);
        let board = Board::new(&mut random);
        let servos: Vec<Servo> =
            (0..COUNT).map(|index| Servo::new(index, boots_at_once, &mut random)).collect();
        let attitude = Attitude::at_rest(&angles(&servos));
        let (dead, noise) = ([false; COUNT], Random::new(seed, 2));
        Self { time: Duration::ZERO, board, servos, dead, attitude, noise }
    }

    /// Advances to `now`.
    pub(super) fn advance_to(&mut self, now: Duration) {
        while self.time + STEP <= now {
            self.time += STEP;
            let dt = STEP.as_secs_f64();
            let volts = self.board.volts();
            for servo in &mut self.servos {
                servo.advance(dt, volts);
            }
            self.attitude.advance(dt, &angles(&self.servos));
            let current_a = self.servos.iter().map(Servo::current_a).sum();
            self.board.advance(dt, current_a, &self.attitude, &mut self.noise);
        }
    }

    /// Sets which servos are dead: without power, as if disconnected.
    pub(super) fn set_dead(&mut self, is_dead: impl Fn(Id) -> bool) {
        for (dead, servo) in self.dead.iter_mut().zip(&self.servos) {
            *dead = is_dead(servo.id());
        }
        self.switch_power();
    }

    pub(super) fn press(&mut self, button: Button, held: Duration) {
        self.board.press(button, held.as_secs_f64());
    }

    /// Executes an instruction.
    ///
    /// `is_lost` is called before each answer; a lost answer has the same effect as a silent device, also for
    /// the devices after it.
    pub(super) fn answer(
        &mut self,
        packet: &Packet<&[u8]>,
        is_lost: &mut dyn FnMut() -> bool,
    ) -> Vec<Answer> {
        let answers = match Instruction::parse(packet) {
            Ok(Instruction::SyncWrite { address, block }) => {
                for (id, data) in block.entries() {
                    if let Some(device) = self.device(id) {
                        // Nobody answers, so errors are not reported.
                        let _ = device.write(address, data);
                    }
                }
                Vec::new()
            }
            Ok(Instruction::BulkRead { block }) => self.answer_in_turn(block, is_lost),
            Ok(instruction) if instruction.id().is_broadcast() => {
                for device in self.devices() {
                    let _ = obey(device, &instruction);
                }
                Vec::new()
            }
            Ok(instruction) => {
                let answer = self.device(instruction.id()).and_then(|device| obey(device, &instruction));
                answer.into_iter().filter(|_| !is_lost()).collect()
            }
            Err(_) => {
                let device = self.device(packet.id());
                let answer = device.map(|device| answer_of(device, StatusError::INSTRUCTION, &[]));
                answer.into_iter().filter(|_| !is_lost()).collect()
            }
        };
        self.switch_power();
        answers
    }

    fn answer_in_turn(&mut self, block: BulkReadBlock<'_>, is_lost: &mut dyn FnMut() -> bool) -> Vec<Answer> {
        let mut answers = Vec::new();
        for entry in block.entries() {
            // Each device waits for the answer of the one before it.
            let Some(device) = self.device(entry.id).filter(|_| !is_lost()) else { break };
            let read = Instruction::Read { id: entry.id, address: entry.address, length: entry.length };
            let Some(answer) = obey(device, &read) else { break };
            answers.push(answer);
        }
        answers
    }

    fn switch_power(&mut self) {
        let is_on = self.board.gives_power();
        for (servo, is_dead) in self.servos.iter_mut().zip(self.dead) {
            servo.set_power(is_on && !is_dead);
        }
    }

    /// The device with this id, if it has power.
    fn device(&mut self, id: Id) -> Option<&mut dyn Device> {
        self.devices().find(|device| device.id() == id.raw())
    }

    fn devices(&mut self) -> impl Iterator<Item = &mut dyn Device> {
        let board: &mut dyn Device = &mut self.board;
        let servos = self.servos.iter_mut().filter(|servo| servo.is_awake());
        std::iter::once(board).chain(servos.map(|servo| servo as &mut dyn Device))
    }
}

fn angles(servos: &[Servo]) -> [f64; COUNT] {
    std::array::from_fn(|index| servos[index].angle_rad())
}

/// The common interface of board and servos.
trait Device {
    fn table(&self) -> &ControlTable;
    fn error(&self) -> StatusError;
    fn write(&mut self, address: u8, data: &[u8]) -> Result<(), StatusError>;
    fn registered(&mut self) -> &mut Option<(u8, Vec<u8>)>;

    /// Id, return delay and status return level have the same addresses in board and servos.
    fn id(&self) -> u8 {
        self.table().get(&mx28::ID).to_le_bytes()[0]
    }
}

const _: () = {
    const fn same(one: &Field, other: &Field) -> bool {
        one.address == other.address && one.size == other.size
    }
    assert!(same(&cm730::ID, &mx28::ID) && same(&cm730::RETURN_DELAY, &mx28::RETURN_DELAY));
    assert!(same(&cm730::STATUS_RETURN_LEVEL, &mx28::STATUS_RETURN_LEVEL));
};

impl Device for Board {
    fn table(&self) -> &ControlTable {
        &self.table
    }
    fn error(&self) -> StatusError {
        StatusError::NONE
    }
    fn write(&mut self, address: u8, data: &[u8]) -> Result<(), StatusError> {
        Board::write(self, address, data)
    }
    fn registered(&mut self) -> &mut Option<(u8, Vec<u8>)> {
        &mut self.registered
    }
}

impl Device for Servo {
    fn table(&self) -> &ControlTable {
        &self.table
    }
    fn error(&self) -> StatusError {
        Servo::error(self)
    }
    fn write(&mut self, address: u8, data: &[u8]) -> Result<(), StatusError> {
        Servo::write(self, address, data)
    }
    fn registered(&mut self) -> &mut Option<(u8, Vec<u8>)> {
        &mut self.registered
    }
}

/// The lowest status return level that answers reads.
const READS: u16 = 1;
const ALL: u16 = 2;

/// Executes an instruction for one device; `None` if its settings say not to answer.
fn obey(device: &mut dyn Device, instruction: &Instruction<'_>) -> Option<Answer> {
    let level = device.table().get(&mx28::STATUS_RETURN_LEVEL);
    let result = match *instruction {
        Instruction::Ping { .. } => return Some(answer_of(device, StatusError::NONE, &[])),
        Instruction::Read { address, length, .. } => {
            let (error, data) = match device.table().read(address, length) {
                Ok(data) => (StatusError::NONE, data.to_vec()),
                Err(error) => (error, Vec::new()),
            };
            return (level >= READS).then(|| answer_of(device, error, &data));
        }
        Instruction::Write { address, data, .. } => device.write(address, data),
        Instruction::RegWrite { address, data, .. } => {
            *device.registered() = Some((address, data.to_vec()));
            Ok(())
        }
        Instruction::Action { .. } => match device.registered().take() {
            Some((address, data)) => device.write(address, &data),
            None => Err(StatusError::INSTRUCTION),
        },
        Instruction::FactoryReset { .. } | Instruction::SyncWrite { .. } | Instruction::BulkRead { .. } => {
            Err(StatusError::INSTRUCTION)
        }
    };
    (level >= ALL).then(|| answer_of(device, result.err().unwrap_or_default(), &[]))
}

fn answer_of(device: &dyn Device, error: StatusError, parameters: &[u8]) -> Answer {
    let mut packet = Vec::new();
    if let Some(id) = Id::new(device.id()) {
        Status { id, error: error | device.error(), parameters }.emit(&mut packet);
    }
    let return_delay = Duration::from_micros(2 * u64::from(device.table().get(&mx28::RETURN_DELAY)));
    Answer { packet, return_delay }
}

const LAG_S: f64 = 0.08;

/// Roll, pitch and yaw of the body relative to the floor, in rad, and their rates, in rad/s.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Attitude {
    angles: [f64; 3],
    rates: [f64; 3],
}

impl Attitude {
    /// The attitude at rest with these joint angles, in rad, in the order of the joints.
    fn at_rest(joints: &[f64; COUNT]) -> Self {
        Self { angles: lean(joints), rates: [0.0; 3] }
    }

    /// Advances by `dt` seconds.
    pub(super) fn advance(&mut self, dt: f64, joints: &[f64; COUNT]) {
        let target = lean(joints);
        self.rates = std::array::from_fn(|axis| (target[axis] - self.angles[axis]) / LAG_S);
        self.angles = std::array::from_fn(|axis| self.angles[axis] + self.rates[axis] * dt);
    }

    /// The angular rate of the body about forward, left, up, in rad/s. Small angles: rates of the angles.
    pub(super) fn angular_velocity(&self) -> [f64; 3] {
        self.rates
    }

    /// The specific force on the body forward, left, up, in m/s^2: gravity only.
    pub(super) fn specific_force(&self) -> [f64; 3] {
        let [roll, pitch, _] = self.angles;
        [
            -pitch.sin() * STANDARD_GRAVITY,
            pitch.cos() * roll.sin() * STANDARD_GRAVITY,
            pitch.cos() * roll.cos() * STANDARD_GRAVITY,
        ]
    }
}

fn lean(joints: &[f64; COUNT]) -> [f64; 3] {
    // By servo id, counted from 1.
    let joint = |id: usize| joints[id - 1];
    let right_pitch = -(joint(11) + joint(13) - joint(15));
    let left_pitch = joint(12) + joint(14) - joint(16);
    let right_roll = joint(9) - joint(17);
    let left_roll = joint(10) - joint(18);
    [(right_roll + left_roll) / 2.0, (right_pitch + left_pitch) / 2.0, (joint(7) + joint(8)) / 2.0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::darwin_op::tables::joints::JOINTS;
    use crate::darwin_op::tables::units::radians_from_ticks;

    #[test]
    fn standing_ready_to_walk_leans_thirteen_degrees_forward() {
        // The framework's hip pitch offset is 13 degrees.
        let ready = JOINTS.map(|joint| radians_from_ticks(joint.walking_ready_ticks, 0));
        let attitude = Attitude::at_rest(&ready);
        let [roll, pitch, yaw] = attitude.angles.map(f64::to_degrees);
        assert!((pitch - 12.9).abs() < 0.1 && roll.abs() < 0.1 && yaw == 0.0, "{roll} {pitch} {yaw}");
        let [forward, left, up] = attitude.specific_force();
        assert!(forward < -2.0 && left.abs() < 0.1 && up > 9.0);
    }

    #[test]
    fn leaning_forward_turns_about_the_left_axis() {
        let mut attitude = Attitude::default();
        let mut joints = [0.0; COUNT];
        // Both ankles let the shins forward.
        joints[14] = 0.2;
        joints[15] = -0.2;
        attitude.advance(0.001, &joints);
        assert!(attitude.angular_velocity()[1] > 0.0);
    }
}
