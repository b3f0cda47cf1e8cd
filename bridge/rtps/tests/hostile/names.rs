//! Names and data of others that are no text, or that control terminals.

use downbeat_rtps::qos::Qos;
use downbeat_rtps::wire::{EndpointData, EntityId, Guid, ParticipantData, SequenceNumber};

use crate::robot::{
    READER, Robot, WRITER, announcer, endpoint_data, participant_data, sample, stranger, survives,
};

/// Stands for bytes that are no text.
const PLACE: &str = "PLACE";
const BYTES: [&[u8; 5]; 5] =
    [b"\xff\xfe\x1b[2", b"\x1b[2J\n", b"\xc2\x9b31m", b"a\0b\0c", b"\xed\xa0\x80\x07\r"];

/// Replaces the places in what was written.
fn with_bytes(mut written: Vec<u8>, bytes: &[u8; 5]) -> Vec<u8> {
    let mut at = 0;
    while let Some(found) = written[at..].windows(5).position(|window| window == PLACE.as_bytes()) {
        at += found;
        written[at..at + 5].copy_from_slice(bytes);
    }
    written
}

fn participant(number: u32) -> Vec<u8> {
    let mut payload = Vec::new();
    let of = participant_data(stranger(number));
    let user_data = format!("enclave=/{PLACE};{PLACE}").into_bytes();
    ParticipantData { user_data, name: PLACE.to_owned(), ..of }.emit(&mut payload);
    sample(stranger(number), EntityId::SPDP_WRITER, SequenceNumber::FIRST, &payload)
}

fn endpoint(entity: EntityId, number: i64, topic: &str, type_name: &str, partition: &str) -> Vec<u8> {
    let mut payload = Vec::new();
    let of = endpoint_data(Guid::new(stranger(1), entity), topic);
    let qos = Qos { partition: vec![partition.to_owned()], ..Qos::writer_default() };
    let user_data = format!("typehash={PLACE};").into_bytes();
    EndpointData { type_name: type_name.to_owned(), qos, user_data, ..of }.emit(&mut payload);
    sample(stranger(1), announcer(entity), SequenceNumber(number), &payload)
}

#[test]
fn bytes_that_are_no_text_in_every_name() {
    let string = "std_msgs::msg::dds_::String_";
    for bytes in BYTES {
        survives(|robot: &mut Robot| {
            robot.meet(stranger(1));
            let names = [
                (PLACE, string, ""),
                ("rt/commands", PLACE, ""),
                ("rt/commands", string, PLACE),
                ("rt/PLACE", "PLACE::msg::dds_::String_", "PLACE*"),
            ];
            for (number, (topic, type_name, partition)) in (2..).zip(names) {
                for entity in [EntityId::user_writer(0x70), EntityId::user_reader(0x70)] {
                    robot.hear(&with_bytes(endpoint(entity, number, topic, type_name, partition), bytes));
                }
            }
            // Also of the matched ones, which are announced again.
            for entity in [WRITER, READER] {
                robot.hear(&with_bytes(endpoint(entity, 6, "rt/commands", string, PLACE), bytes));
            }
            robot.hear(&with_bytes(participant(2), bytes));
        });
    }
}
