//! How long to wait for answers.

use super::super::protocol::{Instruction, Packet};
use super::ExpectedStatus;
use std::time::Duration;

/// 12 bit times at 1 Mbit/s for each byte: ten bits and some slack.
const NANOSECONDS_PER_BYTE: u64 = 12_000;

/// Time for processing in the devices and in the operating system, as in the DARwIn-OP framework.
pub const STATUS_SLACK: Duration = Duration::from_millis(5);

/// The time-out for the answers after sending `instruction`.
///
/// As in the DARwIn-OP framework: `slack`, plus 12 microseconds for each byte sent or, for a bulk read, for
/// one and a half times the expected bytes.
#[must_use]
pub fn status_timeout(instruction: &[u8], expected: &[ExpectedStatus], slack: Duration) -> Duration {
    let packet = Packet::new_checked(instruction);
    let is_bulk_read = packet
        .as_ref()
        .is_ok_and(|packet| matches!(Instruction::parse(packet), Ok(Instruction::BulkRead { .. })));
    let nanoseconds = if is_bulk_read {
        let to_come: usize = expected.iter().map(ExpectedStatus::packet_length).sum();
        to_come as u64 * NANOSECONDS_PER_BYTE * 3 / 2
    } else {
        instruction.len() as u64 * NANOSECONDS_PER_BYTE
    };
    slack + Duration::from_nanos(nanoseconds)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::super::protocol::{BulkReadBlock, Id};
    use super::*;

    #[test]
    fn a_ping_has_five_milliseconds_and_the_time_of_its_own_bytes() {
        let ping = Instruction::Ping { id: Id::CM730 }.to_bytes();
        let expected = [ExpectedStatus { id: Id::CM730, parameters: 0 }];
        assert_eq!(status_timeout(&ping, &expected, STATUS_SLACK), Duration::from_micros(5_072));
    }

    #[test]
    fn a_bulk_read_has_one_and_a_half_times_the_time_of_its_answers() {
        let block = [30, 200, 24, 8, 1, 36];
        let read = Instruction::BulkRead { block: BulkReadBlock::new(&block).unwrap() }.to_bytes();
        let expected = [
            ExpectedStatus { id: Id::CM730, parameters: 30 },
            ExpectedStatus { id: Id::new(1).unwrap(), parameters: 8 },
        ];
        assert_eq!(status_timeout(&read, &expected, STATUS_SLACK), Duration::from_micros(5_900));
    }
}
