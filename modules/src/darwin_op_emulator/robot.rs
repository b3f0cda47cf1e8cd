//! All devices, and their answers to instructions.

use super::board::{Board, Button};
use super::body::Body;
use super::control_table::ControlTable;
use super::random::Random;
use super::servo::Servo;
use super::standing::Standing;
use crate::darwin_op::protocol::{BulkReadBlock, Id, Instruction, Packet, Status, StatusError};
use crate::darwin_op::tables::joints::COUNT;
use crate::darwin_op::tables::units::CENTRE_TICKS;
use crate::darwin_op::tables::{Field, cm730, mx28};
use std::time::Duration;

/// How often servos and board measure and drive the body.
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
    body: Box<dyn Body>,
    noise: Random,
}

impl Robot {
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
        let (dead, noise) = ([false; COUNT], Random::new(seed, 2));
        Self { time: Duration::ZERO, board, servos, dead, body, noise }
    }

    /// Advances to `now`.
    pub(super) fn advance_to(&mut self, now: Duration) {
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

    /// A step of the owner of the bus begins.
    pub(super) fn begin_step(&mut self) {
        self.body.begin_step();
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
