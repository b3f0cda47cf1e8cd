//! Golden packets (ROBOTIS e-Manual, the DARwIn-OP framework's own traffic, lerobot's mock of Feetech servos)
//! and round trips.
#![allow(clippy::unwrap_used)]

use super::*;
use proptest::prelude::*;

fn id(raw: u8) -> Id {
    Id::new(raw).unwrap()
}

#[track_caller]
fn is_golden(protocol: Protocol, instruction: Instruction, golden: &[u8]) {
    assert_eq!(instruction.to_bytes(protocol).unwrap(), golden);
    assert_eq!(Instruction::parse(&Packet::new_checked(protocol, golden).unwrap()), Ok(instruction));
}

#[track_caller]
fn golden_1(instruction: Instruction, golden: &[u8]) {
    is_golden(Protocol::Dynamixel1, instruction, golden);
}

/// `golden` without the header.
#[track_caller]
fn golden_2(instruction: Instruction, golden: &[u8]) {
    is_golden(Protocol::Dynamixel2, instruction, &[&[0xFF, 0xFF, 0xFD, 0], golden].concat());
}

#[test]
fn ping_matches_the_framework() {
    golden_1(Instruction::Ping { id: Id::CM730 }, &[0xFF, 0xFF, 0xC8, 0x02, 0x01, 0x34]);
}

#[test]
fn write_matches_the_framework_and_the_manual() {
    let power_on = Instruction::Write { id: Id::CM730, address: 24, data: vec![1] };
    golden_1(power_on, &[0xFF, 0xFF, 0xC8, 0x04, 0x03, 0x18, 0x01, 0x17]);
    let limits = Instruction::Write { id: id(1), address: 12, data: vec![0x64, 0xAA] };
    golden_1(limits, &[0xFF, 0xFF, 0x01, 0x05, 0x03, 0x0C, 0x64, 0xAA, 0xDC]);
    let head_green = Instruction::Write { id: Id::CM730, address: 26, data: vec![0xE0, 0x03] };
    golden_1(head_green, &[0xFF, 0xFF, 0xC8, 0x05, 0x03, 0x1A, 0xE0, 0x03, 0x32]);
}

#[test]
fn read_matches_the_manual() {
    let temperature = Instruction::Read { id: id(1), address: 43, length: 1 };
    golden_1(temperature, &[0xFF, 0xFF, 0x01, 0x04, 0x02, 0x2B, 0x01, 0xCC]);
}

#[test]
fn sync_write_matches_the_manual() {
    let entries = vec![(id(0), vec![0x10, 0, 0x50, 0x01]), (id(1), vec![0x20, 0x02, 0x60, 0x03])];
    let golden = [0xFF, 0xFF, 0xFE, 0x0E, 0x83, 0x1E, 0x04, 0, 0x10, 0, 0x50, 1, 1, 0x20, 2, 0x60, 3, 0x67];
    golden_1(Instruction::SyncWrite { address: 30, length: 4, entries }, &golden);
}

#[test]
fn bulk_read_matches_the_manual_and_the_framework() {
    let entries = vec![
        ReadEntry { id: id(1), address: 30, length: 2 },
        ReadEntry { id: id(2), address: 36, length: 2 },
    ];
    let golden = [0xFF, 0xFF, 0xFE, 0x09, 0x92, 0, 2, 1, 0x1E, 2, 2, 0x24, 0x1D];
    golden_1(Instruction::BulkRead { entries }, &golden);
    let entries = vec![ReadEntry { id: Id::CM730, address: 24, length: 30 }];
    golden_1(
        Instruction::BulkRead { entries },
        &[0xFF, 0xFF, 0xFE, 0x06, 0x92, 0x00, 0x1E, 0xC8, 0x18, 0x6B],
    );
}

#[test]
fn single_instructions_of_dynamixel_2_match_the_manual() {
    golden_2(Instruction::Ping { id: id(1) }, &[1, 3, 0, 1, 0x19, 0x4E]);
    golden_2(Instruction::Ping { id: Id::BROADCAST }, &[0xFE, 3, 0, 1, 0x31, 0x42]);
    let position = Instruction::Read { id: id(1), address: 132, length: 4 };
    golden_2(position, &[1, 7, 0, 2, 0x84, 0, 4, 0, 0x1D, 0x15]);
    let goal = Instruction::Write { id: id(1), address: 116, data: vec![0, 2, 0, 0] };
    golden_2(goal, &[1, 9, 0, 3, 0x74, 0, 0, 2, 0, 0, 0xCA, 0x89]);
    golden_2(Instruction::Action { id: id(1) }, &[1, 3, 0, 5, 0x02, 0xCE]);
    golden_2(Instruction::Reboot { id: id(1) }, &[1, 3, 0, 8, 0x2F, 0x4E]);
}

#[test]
fn instructions_to_several_devices_of_dynamixel_2_match_the_manual() {
    let ids = vec![id(1), id(2)];
    golden_2(
        Instruction::SyncRead { address: 132, length: 4, ids },
        &[0xFE, 9, 0, 0x82, 0x84, 0, 4, 0, 1, 2, 0xCE, 0xFA],
    );
    let ids = vec![id(3), id(7), id(4)];
    golden_2(
        Instruction::FastSyncRead { address: 132, length: 4, ids },
        &[0xFE, 0x0A, 0, 0x8A, 0x84, 0, 4, 0, 3, 7, 4, 0x20, 0xF2],
    );
    let entries = vec![(id(1), vec![0x96, 0, 0, 0]), (id(2), vec![0xAA, 0, 0, 0])];
    golden_2(
        Instruction::SyncWrite { address: 116, length: 4, entries },
        &[0xFE, 0x11, 0, 0x83, 0x74, 0, 4, 0, 1, 0x96, 0, 0, 0, 2, 0xAA, 0, 0, 0, 0x82, 0x87],
    );
    let entries = vec![
        ReadEntry { id: id(1), address: 144, length: 2 },
        ReadEntry { id: id(2), address: 146, length: 1 },
    ];
    golden_2(
        Instruction::BulkRead { entries },
        &[0xFE, 0x0D, 0, 0x92, 1, 0x90, 0, 2, 0, 2, 0x92, 0, 1, 0, 0x1A, 0x05],
    );
    let entries = vec![
        WriteEntry { id: id(1), address: 32, data: vec![0xA0, 0] },
        WriteEntry { id: id(2), address: 31, data: vec![0x50] },
    ];
    golden_2(
        Instruction::BulkWrite { entries },
        &[0xFE, 0x10, 0, 0x93, 1, 0x20, 0, 2, 0, 0xA0, 0, 2, 0x1F, 0, 1, 0, 0x50, 0xB7, 0x68],
    );
}

#[test]
fn sync_read_of_feetech_has_the_frame_of_dynamixel_1() {
    let ids = vec![id(1), id(2), id(3)];
    let read = Instruction::SyncRead { address: 56, length: 2, ids };
    // FE + 7 + 82 + 38 + 2 + 1 + 2 + 3 = 1C7, the complement of C7 is 38.
    let golden = [0xFF, 0xFF, 0xFE, 7, 0x82, 0x38, 2, 1, 2, 3, 0x38];
    is_golden(Protocol::FeetechSts, read.clone(), &golden);
    for protocol in [Protocol::FeetechScs, Protocol::Dynamixel1] {
        assert_eq!(
            read.to_bytes(protocol),
            Err(EmitError::Instruction { protocol, instruction: "sync read" }),
            "not in {protocol}"
        );
    }
}

#[test]
fn an_address_beyond_255_needs_dynamixel_2() {
    let read = Instruction::Read { id: id(1), address: 580, length: 4 };
    assert_eq!(
        read.to_bytes(Protocol::FeetechSts).unwrap_err().to_string(),
        "Feetech STS has addresses and lengths up to 255, not 580"
    );
    assert!(read.to_bytes(Protocol::Dynamixel2).is_ok());
}

#[test]
fn unknown_instructions_and_invalid_parameters_are_distinguished() {
    let parse = |id, code, parameters: &[u8]| {
        let mut bytes = Vec::new();
        emit_packet(Protocol::Dynamixel1, id, code, parameters, &mut bytes).unwrap();
        Instruction::parse(&Packet::new_checked(Protocol::Dynamixel1, &bytes).unwrap()).unwrap_err()
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
    (0..=252_u8).prop_map(id)
}

fn round_trip(protocol: Protocol, instruction: &Instruction) -> Result<(), TestCaseError> {
    let bytes = instruction.to_bytes(protocol).unwrap();
    let packet = Packet::new_checked(protocol, &bytes).unwrap();
    prop_assert_eq!(&Instruction::parse(&packet), &Ok(instruction.clone()));
    Ok(())
}

proptest! {
    #[test]
    fn single_device_instructions_survive_a_round_trip(
        id in any_id(), address in 0..256_u16, length in 0..256_u16,
        data in proptest::collection::vec(any::<u8>(), 0..=252),
    ) {
        for protocol in Protocol::ALL {
            for instruction in [
                Instruction::Ping { id },
                Instruction::Read { id, address, length },
                Instruction::Write { id, address, data: data.clone() },
                Instruction::RegWrite { id, address, data: data.clone() },
                Instruction::Action { id },
                Instruction::FactoryReset { id },
            ] {
                round_trip(protocol, &instruction)?;
            }
        }
    }

    #[test]
    fn instructions_to_several_devices_survive_a_round_trip(
        address in 0..256_u16, length in 0..20_u16, ids in proptest::collection::vec(any_id(), 0..12), fill: u8,
    ) {
        let data = vec![fill; usize::from(length)];
        let entries = ids.iter().map(|id| (*id, data.clone())).collect();
        let sync_write = Instruction::SyncWrite { address, length, entries };
        let entries: Vec<_> = ids.iter().map(|id| ReadEntry { id: *id, address, length }).collect();
        let bulk_read = Instruction::BulkRead { entries: entries.clone() };
        let sync_read = Instruction::SyncRead { address, length, ids: ids.clone() };
        for protocol in Protocol::ALL {
            round_trip(protocol, &sync_write)?;
        }
        round_trip(Protocol::Dynamixel1, &bulk_read)?;
        round_trip(Protocol::FeetechSts, &sync_read)?;
        let written = ids.iter().map(|id| WriteEntry { id: *id, address, data: data.clone() }).collect();
        for instruction in [
            bulk_read,
            sync_read,
            Instruction::FastSyncRead { address, length, ids },
            Instruction::FastBulkRead { entries },
            Instruction::BulkWrite { entries: written },
        ] {
            round_trip(Protocol::Dynamixel2, &instruction)?;
        }
    }

    #[test]
    fn parsing_any_parameters_never_panics(
        code: u8, broadcast: bool, parameters in proptest::collection::vec(any::<u8>(), 0..250),
    ) {
        for protocol in Protocol::ALL {
            let mut bytes = Vec::new();
            let to = if broadcast { Id::BROADCAST } else { id(1) };
            emit_packet(protocol, to, code, &parameters, &mut bytes).unwrap();
            let _ = Instruction::parse(&Packet::new_checked(protocol, &bytes).unwrap());
        }
    }
}
