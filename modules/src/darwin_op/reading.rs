//! The data of one bulk read.

use super::bus::{Exchange, ExpectedStatus};
use super::protocol::{BulkReadBlock, BulkReadEntry, Id, Instruction, Receiver, Status, StatusError};
use super::tables::joints::{COUNT, JOINTS};
use super::tables::{Field, cm730, mx28};
use downbeat_executor::Time;

/// From the power switch to the battery voltage.
const BOARD_FIRST: u8 = cm730::DXL_POWER.address;
const BOARD_LENGTH: u8 = cm730::VOLTAGE.end() - BOARD_FIRST;
/// From the position to the temperature.
const SERVO_FIRST: u8 = mx28::PRESENT_POSITION.address;
const SERVO_LENGTH: u8 = mx28::PRESENT_TEMPERATURE.end() - SERVO_FIRST;

/// The raw data of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct BoardReading {
    pub(super) gives_power: bool,
    /// Bit 0 mode, bit 1 start.
    pub(super) buttons: u16,
    /// X, Y, Z.
    pub(super) gyro: [u16; 3],
    /// X, Y, Z.
    pub(super) acceleration: [u16; 3],
    /// 0.1 V.
    pub(super) voltage: u16,
}

/// The raw data of a servo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ServoReading {
    pub(super) position: u16,
    pub(super) speed: u16,
    pub(super) load: u16,
    /// 0.1 V.
    pub(super) voltage: u16,
    pub(super) celsius: u16,
    pub(super) error: StatusError,
}

/// The result of one bulk read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Reading {
    /// When it was requested.
    pub(super) sent: Time,
    pub(super) board: Option<BoardReading>,
    /// By joint; `None` for those that were not polled or did not answer.
    pub(super) servos: [Option<ServoReading>; COUNT],
    /// The position in the request of the first device that did not answer.
    pub(super) first_missing: Option<usize>,
    /// Whether any device after that one answered.
    pub(super) chain_went_on: bool,
}

/// The instruction that reads the board and the servos of these joints, and the expected answers.
pub(super) fn request(joints: &[usize]) -> (Vec<u8>, Vec<ExpectedStatus>) {
    let board = BulkReadEntry { length: BOARD_LENGTH, id: Id::CM730, address: BOARD_FIRST };
    let servos = joints.iter().map(|joint| {
        let id = JOINTS[*joint].id;
        BulkReadEntry { length: SERVO_LENGTH, id, address: SERVO_FIRST }
    });
    let entries: Vec<BulkReadEntry> = std::iter::once(board).chain(servos).collect();
    let bytes = entries.iter().map(|entry| entry.to_bytes()).collect::<Vec<_>>().concat();
    let expected = entries.iter().map(|entry| ExpectedStatus { id: entry.id, parameters: entry.length });
    // Consists of complete entries with valid ids, so it is a block.
    let instruction = BulkReadBlock::new(&bytes).map(|block| Instruction::BulkRead { block }.to_bytes());
    (instruction.unwrap_or_default(), expected.collect())
}

/// Parses the answers to [`request`].
pub(super) fn understand(exchange: &Exchange, joints: &[usize]) -> Reading {
    let mut reading = Reading {
        sent: exchange.sent,
        board: None,
        servos: [None; COUNT],
        first_missing: None,
        chain_went_on: false,
    };
    for_each_status(&exchange.reply, |Status { id, error, parameters }| {
        if id == Id::CM730 {
            reading.board = board_reading(parameters);
        } else if let Some(joint) = joints.iter().find(|joint| JOINTS[**joint].id == id) {
            reading.servos[*joint] = servo_reading(parameters, error);
        }
    });
    let servos = joints.iter().map(|joint| reading.servos[*joint].is_some());
    let mut answered = std::iter::once(reading.board.is_some()).chain(servos);
    reading.first_missing = answered.position(|answered| !answered);
    reading.chain_went_on = answered.any(|answered| answered);
    reading
}

/// Visits all valid answers in these bytes.
pub(super) fn for_each_status(bytes: &[u8], mut visit: impl FnMut(Status<'_>)) {
    let mut receiver = Receiver::new();
    receiver.push(bytes);
    receiver.end();
    while let Some(packet) = receiver.next_packet() {
        if let Ok(status) = Status::parse(&packet) {
            visit(status);
        }
    }
}

fn board_reading(piece: &[u8]) -> Option<BoardReading> {
    if piece.len() != usize::from(BOARD_LENGTH) {
        return None;
    }
    let value = |field: &Field| field.value_in(piece, BOARD_FIRST);
    Some(BoardReading {
        gives_power: value(&cm730::DXL_POWER)? == 1,
        buttons: value(&cm730::BUTTON)?,
        gyro: [value(&cm730::GYRO_X)?, value(&cm730::GYRO_Y)?, value(&cm730::GYRO_Z)?],
        acceleration: [value(&cm730::ACC_X)?, value(&cm730::ACC_Y)?, value(&cm730::ACC_Z)?],
        voltage: value(&cm730::VOLTAGE)?,
    })
}

fn servo_reading(piece: &[u8], error: StatusError) -> Option<ServoReading> {
    if piece.len() != usize::from(SERVO_LENGTH) {
        return None;
    }
    let value = |field: &Field| field.value_in(piece, SERVO_FIRST);
    Some(ServoReading {
        position: value(&mx28::PRESENT_POSITION)?,
        speed: value(&mx28::PRESENT_SPEED)?,
        load: value(&mx28::PRESENT_LOAD)?,
        voltage: value(&mx28::PRESENT_VOLTAGE)?,
        celsius: value(&mx28::PRESENT_TEMPERATURE)?,
        error,
    })
}

#[cfg(test)]
mod tests {
    use super::super::bus::{ExchangeKind, Outcome};
    use super::*;

    fn answer(id: Id, parameters: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        Status { id, error: StatusError::NONE, parameters }.emit(&mut out);
        out
    }

    fn servo(joint: usize) -> Vec<u8> {
        answer(JOINTS[joint].id, &[0, 8, 5, 4, 10, 0, 121, 33])
    }

    fn understood(reply: Vec<u8>) -> Reading {
        let exchange = Exchange {
            sequence: 0,
            kind: ExchangeKind::Transfer,
            sent: Time::from_nanos(5),
            duration_us: 1,
            instruction: Vec::new(),
            reply,
            outcome: Outcome::Ok,
            error: String::new(),
        };
        understand(&exchange, &[0, 3, 4])
    }

    #[test]
    fn the_board_is_read_first_and_the_request_fits_into_one_packet() {
        let (instruction, expected) = request(&(0..COUNT).collect::<Vec<_>>());
        assert_eq!(&instruction[..9], [0xFF, 0xFF, 0xFE, 66, 0x92, 0, 27, 200, 24]);
        assert_eq!((instruction.len(), expected.len()), (70, 21));
    }

    #[test]
    fn each_answer_goes_to_its_joint() {
        let mut board = [0; 27];
        board[0] = 1;
        board[26] = 119;
        let reading = understood([answer(Id::CM730, &board), servo(0), servo(3), servo(4)].concat());
        assert_eq!(reading.board.map(|board| (board.gives_power, board.voltage)), Some((true, 119)));
        let position = reading.servos[3].map(|servo| (servo.position, servo.speed, servo.celsius));
        assert_eq!(position, Some((2048, 1029, 33)));
        assert_eq!((reading.servos[1], reading.first_missing), (None, None));
    }

    #[test]
    fn a_broken_chain_and_a_corrupt_answer_are_distinguished() {
        let board = answer(Id::CM730, &[0; 27]);
        let broken = understood([board.clone(), servo(0)].concat());
        assert_eq!((broken.first_missing, broken.chain_went_on), (Some(2), false));
        let mut bad = servo(3);
        bad[6] ^= 1;
        let corrupt = understood([board, servo(0), bad, servo(4)].concat());
        assert_eq!((corrupt.first_missing, corrupt.chain_went_on), (Some(2), true));
    }

    #[test]
    fn an_answer_of_another_length_is_ignored() {
        let reading = understood(answer(JOINTS[0].id, &[1, 2]));
        assert_eq!(reading.servos[0], None);
    }
}
