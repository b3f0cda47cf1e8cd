//! Datagrams that somebody sends in the name of the peer. The two must hear each other again within a second.

use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::Duration;

use downbeat_rtps::wire::{
    AckNack, Data, EntityId, FragmentSet, Gap, Guid, GuidPrefix, Heartbeat, HeartbeatFragment, InlineQos,
    MessageBuilder, NackFragment, Payload, SequenceNumber, SequenceNumberSet,
};

use crate::common::{Network, best_effort, reliable};
use crate::robot::{PEER, ROBOT, Robot, STRANGER, announcement, announcer, endpoint_data, message};

const SECOND: Duration = Duration::from_secs(1);
const FAR: i64 = 1 << 61;
const PEER_ADDRESS: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, 2), 7410);
const SEDP: [EntityId; 2] = [EntityId::SEDP_PUBLICATIONS_WRITER, EntityId::SEDP_SUBSCRIPTIONS_WRITER];

impl Robot {
    fn peer(&self) -> GuidPrefix {
        self.network.nodes[PEER].participant.prefix()
    }

    fn forge(&mut self, write: impl FnOnce(&mut MessageBuilder<'_>) -> bool) {
        self.forge_from(PEER_ADDRESS, write);
    }

    fn forge_from(&mut self, from: SocketAddrV4, write: impl FnOnce(&mut MessageBuilder<'_>) -> bool) {
        let datagram = message(self.peer(), write);
        self.network.inject(ROBOT, from, &datagram);
    }

    fn heartbeat(&mut self, writer: EntityId, first: i64, last: i64, count: u32) {
        let (first, last) = (SequenceNumber(first), SequenceNumber(last));
        let (reader, is_final, is_liveliness) = (EntityId::UNKNOWN, false, false);
        self.forge(|message| {
            message.heartbeat(&Heartbeat { reader, writer, first, last, count, is_final, is_liveliness })
        });
    }

    fn gap(&mut self, writer: EntityId, start: i64, end: i64) {
        let list = SequenceNumberSet::new(SequenceNumber(end));
        let (reader, start) = (EntityId::UNKNOWN, SequenceNumber(start));
        self.forge(|message| message.gap(&Gap { reader, writer, start, list }));
    }

    fn data(&mut self, writer: EntityId, number: i64, inline_qos: InlineQos, payload: Payload<'_>) {
        let (reader, number) = (EntityId::UNKNOWN, SequenceNumber(number));
        self.forge(|message| message.data(&Data { reader, writer, number, inline_qos, payload }));
    }

    fn acknowledge(&mut self, writer: EntityId, base: i64, count: u32) {
        let (reader, missing) = (self.peer_reader, SequenceNumberSet::new(SequenceNumber(base)));
        self.forge(|message| message.ack_nack(&AckNack { reader, writer, missing, count, is_final: true }));
    }

    /// The number of the next sample that a builtin writer of the peer sends to the robot.
    fn next_of(&self, writer: EntityId) -> i64 {
        self.network.heartbeats[&(self.prefix(), writer)].1.0 + 1
    }

    fn endpoint_of_peer(&mut self, entity: EntityId, topic: &str) {
        let writer = announcer(entity);
        let mut payload = Vec::new();
        endpoint_data(Guid::new(self.peer(), entity), topic).emit(&mut payload);
        let number = self.next_of(writer);
        self.data(writer, number, InlineQos::default(), Payload::Data(&payload));
    }

    fn dispose(&mut self, entity: EntityId) {
        let writer = announcer(entity);
        let (number, guid) = (self.next_of(writer), Guid::new(self.peer(), entity));
        self.data(writer, number, InlineQos::removal(guid), Payload::None);
    }
}

/// Runs an attack against a robot that hears its peer every 20 ms and one that hears it every 300 ms. Within
/// a second of simulated time both must hear each other again, and from then on every message.
fn is_heard_within_a_second(attack: impl Fn(&mut Robot)) {
    for period in [Duration::from_millis(20), Duration::from_millis(300)] {
        let mut robot = Robot::new();
        for _ in 0..5 {
            robot.talk();
            robot.run_for(period);
        }
        attack(&mut robot);
        let start = robot.network.elapsed;
        let mut index = 0;
        while robot.network.elapsed < start + SECOND {
            let text = format!("meanwhile {index}");
            robot.network.write(PEER, robot.peer_writer, &text);
            robot.write(&text);
            robot.run_for(period);
            index += 1;
        }
        let (reader, peer_reader) = (robot.reader, robot.peer_reader);
        for (node, reader) in [(ROBOT, reader), (PEER, peer_reader)] {
            let texts = robot.network.nodes[node].texts(reader);
            let last = texts.last().map(String::as_str).unwrap_or_default();
            assert_eq!(last, format!("meanwhile {}", index - 1), "node {node}, every {period:?}");
        }
        for _ in 0..10 {
            robot.talk();
        }
        // Discovery works as well.
        let new = robot.network.writer(PEER, "rt/new", reliable());
        let its = robot.network.reader(ROBOT, "rt/new", reliable());
        let back = robot.network.reader(PEER, "rt/back", reliable());
        let its_back = robot.network.writer(ROBOT, "rt/back", reliable());
        let is_matched = |network: &Network| {
            let matched = |node: usize, entity| network.nodes[node].participant.matched(entity).len() == 1;
            matched(PEER, new) && matched(ROBOT, its) && matched(PEER, back) && matched(ROBOT, its_back)
        };
        assert!(robot.network.run_until(SECOND, is_matched), "new endpoints are not found, every {period:?}");
    }
}

fn writers(robot: &Robot) -> [EntityId; 4] {
    [robot.peer_writer, SEDP[0], SEDP[1], EntityId::WLP_WRITER]
}

#[test]
fn one_heartbeat_far_ahead() {
    is_heard_within_a_second(|robot| {
        writers(robot).into_iter().for_each(|writer| robot.heartbeat(writer, FAR, FAR, 1 << 20));
    });
}

#[test]
fn many_heartbeats_far_ahead() {
    is_heard_within_a_second(|robot| {
        for count in 0..50 {
            for writer in writers(robot) {
                robot.heartbeat(writer, FAR + i64::from(count), FAR + i64::from(count), 1000 + count);
            }
        }
    });
}

#[test]
fn heartbeats_that_end_far_ahead() {
    is_heard_within_a_second(|robot| {
        for writer in writers(robot) {
            robot.heartbeat(writer, 1, FAR, 1000);
            robot.heartbeat(writer, 1, FAR + 1, 1001);
        }
    });
}

#[test]
fn a_heartbeat_that_skips_some_samples() {
    for skipped in [1, 2, 50, 900, 4000] {
        is_heard_within_a_second(|robot| {
            let (_, last) = robot.network.heartbeats[&(robot.prefix(), robot.peer_writer)];
            robot.heartbeat(robot.peer_writer, last.0 + skipped, last.0 + skipped, 100);
        });
    }
}

#[test]
fn heartbeats_of_the_past() {
    is_heard_within_a_second(|robot| {
        for count in 0..5 {
            for writer in writers(robot) {
                robot.heartbeat(writer, 1, 0, 1000 + count);
                robot.heartbeat(writer, 1, 1, 2000 + count);
            }
            robot.run_for(Duration::from_millis(20));
        }
    });
}

#[test]
fn gaps_far_ahead_and_of_the_next_samples() {
    is_heard_within_a_second(|robot| {
        for writer in writers(robot) {
            robot.gap(writer, 1, FAR);
            let (_, last) = robot.network.heartbeats[&(robot.prefix(), writer)];
            robot.gap(writer, last.0 + 1, FAR);
            robot.gap(writer, last.0 + 1, last.0 + 1000);
            robot.gap(writer, last.0 + 3, last.0 + 2000);
        }
    });
}

#[test]
fn samples_with_absurd_numbers() {
    is_heard_within_a_second(|robot| {
        let payload = [0, 1, 0, 0, 0x66, 0x66];
        for writer in writers(robot) {
            for number in [FAR, FAR + 1, FAR + 2, 1 << 40] {
                robot.data(writer, number, InlineQos::default(), Payload::Data(&payload));
            }
        }
    });
}

#[test]
fn a_heartbeat_far_ahead_confirmed_by_a_sample() {
    is_heard_within_a_second(|robot| {
        let payload = [0, 1, 0, 0, 0x66, 0x66];
        for writer in writers(robot) {
            robot.heartbeat(writer, FAR, FAR, 1000);
            robot.heartbeat(writer, FAR, FAR, 1001);
            robot.data(writer, FAR, InlineQos::default(), Payload::Data(&payload));
        }
    });
}

#[test]
fn counts_far_ahead() {
    is_heard_within_a_second(|robot| {
        for count in [i32::MAX as u32, u32::MAX, 1 << 30] {
            for writer in writers(robot) {
                let (first, last) = robot.network.heartbeats[&(robot.prefix(), writer)];
                robot.heartbeat(writer, first.0, last.0, count);
                let (reader, number) = (EntityId::UNKNOWN, last);
                robot.forge(|message| {
                    message.heartbeat_fragment(&HeartbeatFragment { reader, writer, number, last: 1, count })
                });
            }
            robot.acknowledge(robot.writer, 2, count);
            let (reader, writer) = (robot.peer_reader, robot.writer);
            let (number, missing) = (SequenceNumber(2), FragmentSet::new(1));
            robot.forge(|message| {
                message.nack_fragment(&NackFragment { reader, writer, number, missing, count })
            });
        }
    });
}

#[test]
fn acknowledgements_far_ahead_and_far_behind() {
    is_heard_within_a_second(|robot| {
        for (count, base) in (1000..).zip([FAR, 1 << 40, 500, 7, 2, 1, 0]) {
            robot.acknowledge(robot.writer, base, count);
            SEDP.into_iter().for_each(|writer| robot.acknowledge(writer, base, count));
        }
    });
}

#[test]
fn an_acknowledgement_of_samples_that_were_lost() {
    let mut robot = Robot::new();
    let writer = robot.add_endpoints("rt/kept");
    let reader = robot.network.reader(PEER, "rt/kept", crate::common::latched(3));
    robot.run_for(SECOND);
    robot.network.cut = vec![(ROBOT, PEER)];
    robot.network.write(ROBOT, writer, "lost");
    robot.run_for(Duration::from_millis(5));
    robot.network.cut.clear();
    let missing = SequenceNumberSet::new(SequenceNumber(2));
    robot
        .forge(|message| message.ack_nack(&AckNack { reader, writer, missing, count: 1000, is_final: true }));
    robot.run_for(SECOND / 10);
    robot.network.write(ROBOT, writer, "next");
    robot.run_for(SECOND);
    assert_eq!(robot.network.nodes[PEER].texts(reader), ["lost", "next"]);
}

/// A volatile writer drops what all its readers have acknowledged.
#[test]
fn acknowledgements_from_elsewhere_of_samples_that_were_lost() {
    let impossible = [FAR, 1 << 40, 100];
    let cases = [(STRANGER, [3; 3]), (STRANGER, impossible), (PEER_ADDRESS, impossible)];
    for (from, bases) in cases {
        let mut robot = Robot::new();
        robot.network.cut = vec![(ROBOT, PEER)];
        robot.write("lost");
        robot.run_for(Duration::from_millis(5));
        let (reader, writer) = (robot.peer_reader, robot.writer);
        for (count, base) in (1000..).zip(bases) {
            let missing = SequenceNumberSet::new(SequenceNumber(base));
            let is_final = true;
            robot.forge_from(from, |message| {
                message.ack_nack(&AckNack { reader, writer, missing, count, is_final })
            });
            let (number, missing) = (SequenceNumber(2), FragmentSet::new(1000));
            robot.forge_from(from, |message| {
                message.nack_fragment(&NackFragment { reader, writer, number, missing, count })
            });
        }
        robot.network.cut.clear();
        robot.run_for(SECOND);
        let texts = robot.network.nodes[PEER].texts(reader);
        assert_eq!(texts.last().map(String::as_str), Some("lost"), "{from}, {bases:?}");
    }
}

#[test]
fn a_farewell_of_the_participant() {
    is_heard_within_a_second(|robot| {
        for _ in 0..3 {
            let guid = Guid::new(robot.peer(), EntityId::PARTICIPANT);
            robot.data(EntityId::SPDP_WRITER, 2, InlineQos::removal(guid), Payload::None);
        }
    });
}

#[test]
fn other_addresses_of_the_participant() {
    is_heard_within_a_second(|robot| {
        let datagram = announcement(robot.peer());
        robot.network.inject(ROBOT, STRANGER, &datagram);
        robot.network.inject(ROBOT, PEER_ADDRESS, &datagram);
    });
}

#[test]
fn removals_of_endpoints() {
    is_heard_within_a_second(|robot| {
        robot.dispose(robot.peer_writer);
        robot.dispose(robot.peer_reader);
    });
}

#[test]
fn other_topics_of_endpoints() {
    is_heard_within_a_second(|robot| {
        robot.endpoint_of_peer(robot.peer_writer, "rt/elsewhere");
        robot.endpoint_of_peer(robot.peer_reader, "rt/elsewhere");
    });
}

#[test]
fn best_effort_samples_with_absurd_numbers() {
    for number in [FAR, 4000, 100] {
        let mut robot = Robot::new();
        let writer = robot.network.writer(PEER, "rt/fast", best_effort());
        let reader = robot.network.reader(ROBOT, "rt/fast", best_effort());
        robot.run_for(SECOND);
        let say = |robot: &mut Robot, text: &str| {
            robot.network.write(PEER, writer, text);
            robot.run_for(Duration::from_millis(50));
        };
        (0..5).for_each(|index| say(&mut robot, &index.to_string()));
        let payload = [0, 1, 0, 0, 0x66, 0x66];
        robot.data(writer, number, InlineQos::default(), Payload::Data(&payload));
        robot.gap(writer, 1, number);
        for index in 0..20 {
            say(&mut robot, &format!("after {index}"));
        }
        let texts = robot.network.nodes[ROBOT].texts(reader);
        assert_eq!(texts.last().map(String::as_str), Some("after 19"));
        let heard = texts.iter().filter(|text| text.starts_with("after")).count();
        assert!(heard >= 13, "{heard} of 20 after number {number}");
    }
}
