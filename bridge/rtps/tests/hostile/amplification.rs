//! What a third party is sent whose address was announced by somebody else.

use std::cell::Cell;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::rc::Rc;
use std::time::Duration;

use downbeat_rtps::wire::{
    AckNack, Data, EntityId, FragmentSet, Guid, GuidPrefix, Heartbeat, HeartbeatFragment, InlineQos,
    MessageBuilder, NackFragment, Payload, SequenceNumber, SequenceNumberSet,
};

use crate::robot::{PEER, READER, ROBOT, Robot, STRANGER, WRITER, announcement, endpoint, message, stranger};

const SECOND: Duration = Duration::from_secs(1);
/// The address in the announcements, whose owner sends nothing.
const VICTIM: SocketAddrV4 = STRANGER;

const WRITERS: [EntityId; 3] =
    [EntityId::SEDP_PUBLICATIONS_WRITER, EntityId::SEDP_SUBSCRIPTIONS_WRITER, EntityId::WLP_WRITER];

/// Returns the bytes to the victim and those of the attacker, who repeats what `attack` returns for each
/// count.
fn measure(attack: impl Fn(&Robot, u32) -> Vec<Vec<u8>>) -> (usize, usize) {
    let mut robot = Robot::new();
    for number in 0..100 {
        robot.add_endpoints(&format!("rt/{number}"));
    }
    robot.network.run_for(SECOND);
    let sent = Rc::new(Cell::new(0));
    let to_victim = sent.clone();
    robot.network.watch = Box::new(move |flight| {
        if flight.to.ip() == VICTIM.ip() {
            to_victim.set(to_victim.get() + flight.bytes.len());
        }
    });
    let mut forged = 0;
    for count in 1..=40 {
        for datagram in attack(&robot, count) {
            forged += datagram.len();
            robot.network.inject(ROBOT, VICTIM, &datagram);
        }
        robot.write(&"x".repeat(20_000));
        robot.run_for(SECOND / 4);
    }
    robot.run_for(30 * SECOND);
    robot.talk();
    (sent.get(), forged)
}

fn addressed(robot: &Robot, write: impl FnOnce(&mut MessageBuilder<'_>) -> bool) -> Vec<u8> {
    let robot = robot.prefix();
    message(stranger(1), |message| {
        message.info_destination(robot);
        write(message)
    })
}

fn with_announcement(attack: impl Fn(&Robot, u32) -> Vec<Vec<u8>>) -> (usize, usize) {
    measure(|robot, count| {
        let mut datagrams = if count == 1 { vec![announcement(stranger(1))] } else { Vec::new() };
        datagrams.extend(attack(robot, count));
        datagrams
    })
}

fn acknowledgement(robot: &Robot, writer: EntityId, base: i64, is_asking: bool, count: u32) -> Vec<u8> {
    let mut missing = SequenceNumberSet::new(SequenceNumber(base));
    if is_asking {
        (base..base + 256).for_each(|number| {
            let _ = missing.insert(SequenceNumber(number));
        });
    }
    addressed(robot, |message| {
        message.ack_nack(&AckNack { reader: READER, writer, missing, count, is_final: false })
    })
}

fn removal(sender: GuidPrefix, guid: Guid) -> Vec<u8> {
    message(sender, |message| {
        message.data(&Data {
            reader: EntityId::UNKNOWN,
            writer: EntityId::SPDP_WRITER,
            number: SequenceNumber::FIRST,
            inline_qos: InlineQos::removal(guid),
            payload: Payload::None,
        })
    })
}

#[test]
fn an_address_that_did_not_answer_is_sent_at_most_three_times_what_was_sent_in_its_name() {
    let kinds: [(&str, (usize, usize)); 9] = [
        ("announcements", measure(|_, count| vec![announcement(stranger(count % 3))])),
        (
            "announcements and farewells",
            measure(|_, _| {
                let participant = Guid::new(stranger(1), EntityId::PARTICIPANT);
                vec![announcement(stranger(1)), removal(stranger(1), participant)]
            }),
        ),
        (
            "first acknowledgements",
            with_announcement(|robot, count| {
                WRITERS
                    .map(|writer| acknowledgement(robot, writer, i64::from(count % 2), false, count))
                    .into()
            }),
        ),
        (
            "acknowledgements of guessed numbers",
            with_announcement(|robot, count| {
                let guesses = [2, 50, 200, 1 << 20, (1 << 20) + 1, 1 << 32, 1 << 40, 1 << 61];
                let guess = guesses[count as usize % guesses.len()];
                let asking = WRITERS.map(|writer| acknowledgement(robot, writer, guess, true, count));
                let content = WRITERS.map(|writer| acknowledgement(robot, writer, guess, false, count));
                [asking, content].concat()
            }),
        ),
        (
            "requests for fragments",
            with_announcement(|robot, count| {
                let request = |writer: EntityId| {
                    let mut missing = FragmentSet::new(1);
                    assert!(missing.insert(1));
                    let number = SequenceNumber(i64::from(count));
                    addressed(robot, |message| {
                        message.nack_fragment(&NackFragment {
                            reader: READER,
                            writer,
                            number,
                            missing,
                            count,
                        })
                    })
                };
                [WRITERS[0], WRITERS[1], robot.writer].map(request).into()
            }),
        ),
        (
            "heartbeats",
            with_announcement(|robot, count| {
                let heartbeat = |writer: EntityId| {
                    addressed(robot, |message| {
                        message.heartbeat(&Heartbeat {
                            reader: EntityId::UNKNOWN,
                            writer,
                            first: SequenceNumber::FIRST,
                            last: SequenceNumber(200),
                            count,
                            is_final: false,
                            is_liveliness: false,
                        })
                    })
                };
                WRITERS.map(heartbeat).into()
            }),
        ),
        (
            "heartbeats of fragments",
            with_announcement(|robot, count| {
                let heartbeat = |writer: EntityId| {
                    addressed(robot, |message| {
                        let (reader, number) = (EntityId::UNKNOWN, SequenceNumber(1));
                        message.heartbeat_fragment(&HeartbeatFragment {
                            reader,
                            writer,
                            number,
                            last: 200,
                            count,
                        })
                    })
                };
                WRITERS.map(heartbeat).into()
            }),
        ),
        (
            "a reader",
            with_announcement(|robot, count| {
                let number = SequenceNumber(i64::from(count));
                let user = acknowledgement(robot, robot.writer, i64::from(count), true, count);
                vec![endpoint(stranger(1), READER, number, "rt/state"), user]
            }),
        ),
        (
            "a writer",
            with_announcement(|_, count| {
                vec![endpoint(stranger(1), WRITER, SequenceNumber(i64::from(count)), "rt/commands")]
            }),
        ),
    ];
    for (kind, (sent, forged)) in kinds {
        println!("{kind}: {sent} bytes for {forged}, {:.2} times", sent as f64 / forged as f64);
        assert!(sent <= 3 * forged, "{kind}: {sent} bytes for {forged}");
    }
}

#[test]
fn only_the_numbers_of_a_heartbeat_to_its_address_validate_a_participant() {
    for is_right in [false, true] {
        let mut robot = Robot::new();
        robot.hear(&announcement(stranger(1)));
        let (first, _) = robot.network.heartbeats[&(stranger(1), EntityId::SEDP_SUBSCRIPTIONS_WRITER)];
        let base = if is_right { first.0 } else { first.0 - 1 };
        for number in 0..100 {
            robot.add_endpoints(&format!("rt/{number}"));
        }
        let sent = robot.sent();
        let answer = acknowledgement(&robot, EntityId::SEDP_SUBSCRIPTIONS_WRITER, base, false, 1);
        robot.hear(&answer);
        assert_eq!(robot.sent() - sent > 10_000, is_right);
    }
}

#[test]
fn numbers_differ_between_participants() {
    let mut robot = Robot::new();
    (1..=20).for_each(|number| robot.hear(&announcement(stranger(number))));
    let writer = EntityId::SEDP_PUBLICATIONS_WRITER;
    let mut numbers: Vec<_> =
        (1..=20).map(|number| robot.network.heartbeats[&(stranger(number), writer)].0.0).collect();
    numbers.sort_unstable();
    assert!(numbers.windows(2).all(|pair| pair[1] > pair[0]), "{numbers:?}");
}

#[test]
fn a_closed_port_ends_an_unknown_participant_and_pauses_a_known_one() {
    let mut robot = Robot::new();
    robot.hear(&announcement(stranger(1)));
    assert_eq!(robot.participant().remote_participants().count(), 2);
    robot.network.call(ROBOT, |participant, now| participant.handle_refusal(now, VICTIM));
    assert_eq!(robot.participant().remote_participants().count(), 1);

    let peer = SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, 2), 7411);
    robot.network.nodes[PEER].is_running = false;
    robot.run_for(SECOND / 10);
    robot.network.call(ROBOT, |participant, now| participant.handle_refusal(now, peer));
    let sent = Rc::new(Cell::new(0));
    let to_peer = sent.clone();
    robot.network.watch = Box::new(move |flight| {
        if flight.to.ip() == peer.ip() {
            to_peer.set(to_peer.get() + 1);
        }
    });
    robot.write("nobody hears it");
    robot.run_for(SECOND / 2);
    assert_eq!(sent.get(), 0);
    robot.run_for(SECOND);
    assert!(sent.get() > 0);
    robot.network.nodes[PEER].is_running = true;
    robot.talk();
}
