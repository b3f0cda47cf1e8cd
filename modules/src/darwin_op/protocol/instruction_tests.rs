//! Golden packets (ROBOTIS e-Manual and the DARwIn-OP framework's own traffic) and round trips.
#![allow(clippy::unwrap_used)]

use super::super::BulkReadEntry;
use super::*;
use proptest::prelude::*;

fn id(raw: u8) -> Id {
    Id::new(raw).unwrap()
}

fn parsed(bytes: &[u8]) -> Vec<u8> {
    // Parsed and written again: golden packets must round-trip.
    Instruction::parse(&Packet::new_checked(bytes).unwrap()).unwrap().to_bytes()
}

#[track_caller]
fn is_golden(instruction: Instruction<'_>, golden: &[u8]) {
    assert_eq!(instruction.to_bytes(), golden);
    assert_eq!(parsed(golden), golden);
    assert_eq!(Instruction::parse(&Packet::new_checked(golden).unwrap()), Ok(instruction));
}

#[test]
fn ping_matches_the_framework() {
    is_golden(Instruction::Ping { id: Id::CM730 }, &[0xFF, 0xFF, 0xC8, 0x02, 0x01, 0x34]);
}

#[test]
fn write_matches_the_framework_and_the_manual() {
    let power_on = Instruction::Write { id: Id::CM730, address: 24, data: &[1] };
    is_golden(power_on, &[0xFF, 0xFF, 0xC8, 0x04, 0x03, 0x18, 0x01, 0x17]);
    let limits = Instruction::Write { id: id(1), address: 12, data: &[0x64, 0xAA] };
    is_golden(limits, &[0xFF, 0xFF, 0x01, 0x05, 0x03, 0x0C, 0x64, 0xAA, 0xDC]);
    let head_green = Instruction::Write { id: Id::CM730, address: 26, data: &[0xE0, 0x03] };
    is_golden(head_green, &[0xFF, 0xFF, 0xC8, 0x05, 0x03, 0x1A, 0xE0, 0x03, 0x32]);
}

#[test]
fn read_matches_the_manual() {
    let temperature = Instruction::Read { id: id(1), address: 43, length: 1 };
    is_golden(temperature, &[0xFF, 0xFF, 0x01, 0x04, 0x02, 0x2B, 0x01, 0xCC]);
}

#[test]
fn sync_write_matches_the_manual() {
    let bytes = [0, 0x10, 0, 0x50, 0x01, 0x01, 0x20, 0x02, 0x60, 0x03];
    let block = SyncWriteBlock::new(4, &bytes).unwrap();
    let golden = [0xFF, 0xFF, 0xFE, 0x0E, 0x83, 0x1E, 0x04, 0, 0x10, 0, 0x50, 1, 1, 0x20, 2, 0x60, 3, 0x67];
    is_golden(Instruction::SyncWrite { address: 30, block }, &golden);
    let entries: Vec<_> = block.entries().collect();
    assert_eq!(entries, [(id(0), &bytes[1..5]), (id(1), &bytes[6..10])]);
}

#[test]
fn bulk_read_matches_the_manual_and_the_framework() {
    let bytes = [2, 1, 30, 2, 2, 36];
    let block = BulkReadBlock::new(&bytes).unwrap();
    let golden = [0xFF, 0xFF, 0xFE, 0x09, 0x92, 0, 2, 1, 0x1E, 2, 2, 0x24, 0x1D];
    is_golden(Instruction::BulkRead { block }, &golden);
    let one = BulkReadEntry { length: 30, id: Id::CM730, address: 24 }.to_bytes();
    let block = BulkReadBlock::new(&one).unwrap();
    is_golden(Instruction::BulkRead { block }, &[0xFF, 0xFF, 0xFE, 0x06, 0x92, 0x00, 0x1E, 0xC8, 0x18, 0x6B]);
}

#[test]
fn unknown_instructions_and_invalid_parameters_are_distinguished() {
    let parse = |id, code, parameters: &[u8]| {
        let mut bytes = Vec::new();
        emit_packet(id, code, parameters, &mut bytes);
        Instruction::parse(&Packet::new_checked(bytes).unwrap()).map(|_| ()).unwrap_err()
    };
    assert_eq!(parse(id(1), 0x82, &[]), InstructionError::Unknown { code: 0x82 });
    assert_eq!(parse(id(1), READ, &[1]), InstructionError::Parameters { code: READ, count: 1 });
    let all = Id::BROADCAST;
    assert_eq!(parse(all, SYNC_WRITE, &[30, 2, 1, 0]), InstructionError::Parameters { code: 0x83, count: 4 });
    assert_eq!(parse(all, BULK_READ, &[0, 1, 2]), InstructionError::Parameters { code: 0x92, count: 3 });
    assert_eq!(
        parse(id(3), BULK_READ, &[0, 1, 1, 1]),
        InstructionError::NotBroadcast { code: 0x92, id: id(3) }
    );
}

fn any_id() -> impl Strategy<Value = Id> {
    (0..=254_u8).prop_map(id)
}

proptest! {
    #[test]
    fn single_device_instructions_survive_a_round_trip(
        id in any_id(), address: u8, length: u8, data in proptest::collection::vec(any::<u8>(), 0..=252),
    ) {
        for instruction in [
            Instruction::Ping { id },
            Instruction::Read { id, address, length },
            Instruction::Write { id, address, data: &data },
            Instruction::RegWrite { id, address, data: &data },
            Instruction::Action { id },
            Instruction::FactoryReset { id },
        ] {
            let bytes = instruction.to_bytes();
            let packet = Packet::new_checked(&bytes).unwrap();
        prop_assert_eq!(Instruction::parse(&packet), Ok(instruction));
        }
    }

    #[test]
    fn blocks_survive_a_round_trip(
        address: u8, data_length in 0..20_u8, ids in proptest::collection::vec(0..=254_u8, 0..12), fill: u8,
    ) {
        let written: Vec<u8> =
            ids.iter().flat_map(|id| std::iter::once(*id).chain((0..data_length).map(|_| fill))).collect();
        let block = SyncWriteBlock::new(data_length, &written).unwrap();
        let write = Instruction::SyncWrite { address, block };
        let bytes = write.to_bytes();
        let packet = Packet::new_checked(&bytes).unwrap();
        prop_assert_eq!(Instruction::parse(&packet), Ok(write));

        let read: Vec<u8> = ids.iter().flat_map(|id| [data_length, *id, address]).collect();
        let read = Instruction::BulkRead { block: BulkReadBlock::new(&read).unwrap() };
        let bytes = read.to_bytes();
        let packet = Packet::new_checked(&bytes).unwrap();
        prop_assert_eq!(Instruction::parse(&packet), Ok(read));
    }

    #[test]
    fn parsing_any_bytes_never_panics(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        if let Ok(packet) = Packet::new_checked(&bytes) {
            let _ = Instruction::parse(&packet);
        }
    }
}
