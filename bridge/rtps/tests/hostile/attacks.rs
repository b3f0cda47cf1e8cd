//! Hostile datagrams, including all that once crashed or silenced a process.

use std::time::Duration;

use downbeat_rtps::protocol::Fault;
use downbeat_rtps::wire::{
    AckNack, EntityId, FragmentSet, Gap, Heartbeat, HeartbeatFragment, NackFragment, SequenceNumber,
    SequenceNumberSet,
};

use crate::robot::{READER, Robot, WRITER, announcement, endpoint, fragment, message, stranger, survives};

const SECOND: Duration = Duration::from_secs(1);

/// Writers that the robot receives: builtin writers for discovery, and the writer of the stranger.
const WRITERS: [EntityId; 5] = [
    EntityId::SPDP_WRITER,
    EntityId::SEDP_PUBLICATIONS_WRITER,
    EntityId::SEDP_SUBSCRIPTIONS_WRITER,
    EntityId::WLP_WRITER,
    WRITER,
];

fn heartbeat(writer: EntityId, first: i64, last: i64, count: u32) -> Heartbeat {
    let (first, last) = (SequenceNumber(first), SequenceNumber(last));
    Heartbeat { reader: EntityId::UNKNOWN, writer, first, last, count, is_final: false, is_liveliness: false }
}

fn gap(writer: EntityId, start: i64, base: i64) -> Gap {
    let list = SequenceNumberSet::new(SequenceNumber(base));
    Gap { reader: EntityId::UNKNOWN, writer, start: SequenceNumber(start), list }
}

#[test]
fn fragments_of_an_unknown_writer_that_declare_four_gigabytes_are_not_kept() {
    survives(|robot| {
        for number in 1..=50 {
            robot.hear(&fragment(stranger(1), number, 1, u32::MAX));
            robot.hear(&fragment(stranger(1), number, 2, u32::MAX));
        }
        robot.run_for(SECOND);
    });
}

#[test]
fn fragments_of_a_matched_writer_that_declare_gigabytes_use_only_their_own_size() {
    survives(|robot| {
        robot.meet(stranger(1));
        let largest = robot.largest_sample();
        let mut number = 0;
        for sample_size in [u32::MAX, largest, largest - 1] {
            for _ in 0..50 {
                number += 1;
                robot.hear(&fragment(stranger(1), number, 1, sample_size));
                robot.hear(&fragment(stranger(1), number, sample_size / 1000, sample_size));
            }
        }
        robot.run_for(SECOND);
    });
}

#[test]
fn samples_that_are_never_completed_are_bounded() {
    survives(|robot| {
        robot.meet(stranger(1));
        for number in 1..=20_000 {
            robot.hear(&fragment(stranger(1), number, 1, 10_000));
        }
        robot.run_for(SECOND);
    });
}

#[test]
fn a_heartbeat_of_2_to_the_40_samples_costs_the_same_as_one_of_two() {
    survives(|robot| {
        robot.hear(&announcement(stranger(1)));
        for (count, writer) in (1..).zip(WRITERS) {
            robot.hear(&message(stranger(1), |message| {
                message.heartbeat(&heartbeat(writer, 1, 1 << 40, count))
            }));
        }
        robot.run_for(SECOND);
    });
    survives(|robot| {
        robot.meet(stranger(1));
        for (count, writer) in (1..).zip(WRITERS) {
            robot.hear(&message(stranger(1), |message| {
                message.heartbeat(&heartbeat(writer, 1, 1 << 40, count))
            }));
            robot.hear(&message(stranger(1), |message| {
                message.heartbeat(&heartbeat(writer, 1 << 39, 1 << 60, count + 10))
            }));
        }
        robot.run_for(60 * SECOND);
    });
}

#[test]
fn heartbeats_at_the_ends_of_the_number_range_do_no_harm() {
    survives(|robot| {
        robot.meet(stranger(1));
        let ends =
            [0, 1, 2, SequenceNumber::MAX.0 - 1, SequenceNumber::MAX.0, i64::MAX - 1, i64::MAX, i64::MIN, -1];
        let mut count = 0;
        for writer in WRITERS {
            for (first, last) in ends.iter().flat_map(|first| ends.map(|last| (*first, last))) {
                count += 1;
                robot.hear(&message(stranger(1), |message| {
                    message.heartbeat(&heartbeat(writer, first, last, count))
                }));
            }
        }
        robot.run_for(60 * SECOND);
    });
}

#[test]
fn a_gap_of_2_to_the_40_samples_costs_the_same_as_one_of_two() {
    survives(|robot| {
        robot.meet(stranger(1));
        for writer in WRITERS {
            robot.hear(&message(stranger(1), |message| message.gap(&gap(writer, 5, 1 << 40))));
            robot.hear(&message(stranger(1), |message| message.gap(&gap(writer, 1, SequenceNumber::MAX.0))));
        }
        robot.run_for(SECOND);
    });
}

#[test]
fn gaps_with_holes_between_them_are_bounded() {
    survives(|robot| {
        robot.meet(stranger(1));
        for number in 0..100_000 {
            robot.hear(&message(stranger(1), |message| {
                message.gap(&gap(WRITER, 10 + 2 * number, 11 + 2 * number))
            }));
        }
        robot.run_for(SECOND);
    });
}

#[test]
fn requests_for_fragment_zero_and_for_missing_fragments_do_no_harm() {
    survives(|robot| {
        robot.meet(stranger(1));
        robot.write("state");
        let writers = [robot.writer, EntityId::SEDP_PUBLICATIONS_WRITER, EntityId::SPDP_WRITER];
        for count in 1..=726 {
            for (writer, base) in
                writers.iter().flat_map(|writer| [0, 1, 77, u32::MAX].map(|base| (*writer, base)))
            {
                let mut missing = FragmentSet::new(base);
                assert!(missing.insert(base));
                let (reader, number) = (READER, SequenceNumber(i64::from(count % 3 + 1)));
                let nack = NackFragment { reader, writer, number, missing, count };
                robot.hear(&message(stranger(1), |message| message.nack_fragment(&nack)));
            }
        }
        robot.run_for(20 * SECOND);
    });
}

#[test]
fn acknowledgements_of_unwritten_samples_do_no_harm() {
    survives(|robot| {
        robot.meet(stranger(1));
        robot.write("state");
        let mut count = 0;
        for base in [0, 1, 2, 1 << 40, SequenceNumber::MAX.0, i64::MAX, -1] {
            for writer in [robot.writer, EntityId::SEDP_PUBLICATIONS_WRITER, EntityId::SPDP_WRITER] {
                count += 1;
                let mut missing = SequenceNumberSet::new(SequenceNumber(base));
                (0..256_i64).for_each(|offset| {
                    let _ = missing.insert(SequenceNumber(base.saturating_add(offset)));
                });
                let ack_nack = AckNack { reader: READER, writer, missing, count, is_final: false };
                robot.hear(&message(stranger(1), |message| message.ack_nack(&ack_nack)));
            }
        }
        robot.run_for(20 * SECOND);
    });
}

#[test]
fn heartbeats_of_missing_fragments_do_no_harm() {
    survives(|robot| {
        robot.meet(stranger(1));
        for (count, last) in (1..).zip([1, 100, u32::MAX]) {
            let number = SequenceNumber(i64::from(count));
            let heartbeat =
                HeartbeatFragment { reader: EntityId::UNKNOWN, writer: WRITER, number, last, count };
            robot.hear(&message(stranger(1), |message| message.heartbeat_fragment(&heartbeat)));
        }
        robot.run_for(20 * SECOND);
    });
}

#[test]
fn five_hundred_participants_are_stored_and_removed() {
    survives(|robot| {
        for number in 0..500 {
            robot.hear(&announcement(stranger(number)));
        }
        robot.run_for(5 * SECOND);
        assert_eq!(robot.participant().remote_participants().count(), 501);
        robot.talk();
        robot.run_for(60 * SECOND);
        assert_eq!(robot.participant().remote_participants().count(), 1);
    });
}

#[test]
fn twenty_thousand_announcements_are_bounded_and_removed() {
    survives(|robot| {
        for number in 0..20_000 {
            robot.hear(&announcement(stranger(number)));
        }
        assert!(robot.participant().counters().faults(Fault::TooManyParticipants) > 19_000);
        robot.run_for(60 * SECOND);
        assert_eq!(robot.participant().remote_participants().count(), 1);
    });
}

#[test]
fn twenty_thousand_endpoints_are_bounded_and_removed() {
    survives(|robot| {
        robot.hear(&announcement(stranger(1)));
        for number in 1..=20_000 {
            let topic = format!("rt/{}/{number}", "x".repeat(400));
            let entity = EntityId::user_writer(number);
            robot.hear(&endpoint(stranger(1), entity, SequenceNumber(number.into()), &topic));
        }
        assert!(robot.participant().counters().faults(Fault::TooManyEndpoints) > 10_000);
        robot.run_for(60 * SECOND);
        assert_eq!(robot.participant().remote_endpoints().count(), 2);
    });
}

#[test]
fn topic_names_of_ten_kilobytes_are_refused() {
    survives(|robot| {
        robot.hear(&announcement(stranger(1)));
        for number in 1..=100 {
            let entity = EntityId::user_writer(number);
            robot.hear(&endpoint(stranger(1), entity, SequenceNumber(number.into()), &"x".repeat(10_000)));
        }
        assert_eq!(robot.participant().counters().faults(Fault::MalformedDiscovery), 100);
        assert_eq!(robot.participant().remote_endpoints().count(), 2);
    });
}

#[test]
fn two_hundred_readers_that_never_acknowledge_delay_no_other() {
    survives(|robot| {
        robot.meet(stranger(1));
        for number in 2..=200 {
            let entity = EntityId::user_reader(1000 + number);
            robot.hear(&endpoint(stranger(1), entity, SequenceNumber(number.into()), "rt/state"));
        }
        assert_eq!(robot.participant().matched(robot.writer).len(), 201);
        for number in 0..1000 {
            robot.write(&number.to_string());
            robot.run_for(Duration::from_millis(1));
        }
        robot.talk();
        let sent = robot.sent();
        robot.run_for(10 * SECOND);
        assert!(robot.sent() - sent < 1_000_000, "{} bytes to readers that are silent", robot.sent() - sent);
    });
}

#[test]
fn a_known_stranger_receives_at_most_three_times_its_bytes() {
    survives(|robot: &mut Robot| {
        let before = robot.sent();
        let mut forged = 0;
        for number in 1..50 {
            let datagram = announcement(stranger(number));
            forged += datagram.len() as u64;
            robot.hear(&datagram);
        }
        // Includes what the robot sends to its peer and to all.
        let announced = 50_000;
        assert!(robot.sent() - before < 3 * forged + announced, "{} for {forged}", robot.sent() - before);
    });
}
