//! Readers that join late or have lost their state.

use super::*;

#[test]
fn a_late_joiner_gets_exactly_the_depth() {
    let mut world = World::new(3, &latched(), true);
    world.match_both(0, 1);
    world.write_numbered(0, 0..25);
    world.settle();
    world.match_both(0, 2);
    world.settle();
    assert_eq!(world.numbers(2), (15..25).collect::<Vec<_>>());
    world.write_numbered(0, 25..27);
    world.settle();
    assert_eq!((world.numbers(2), world.lost(2)), (vec![25, 26], 0));
}

#[test]
fn a_late_joiner_gets_large_samples_even_if_its_first_answers_are_lost() {
    for is_ours in [true, false] {
        let mut world = World::new(2, &latched(), is_ours);
        for number in 0..12 {
            world.write(0, large(number, 3_000_000)).unwrap();
        }
        world.match_reader(0, 1);
        world.run(200 * MS);
        world.match_writer(0, 1);
        world.settle();
        assert_eq!((world.numbers(1), world.lost(1)), ((2..12).collect(), 0));
    }
}

#[test]
fn a_late_best_effort_reader_of_a_latched_topic_gets_the_depth() {
    let mut world = World::new(2, &Qos { reliability: Reliability::BestEffort, ..latched() }, true);
    world.write_numbered(0, 0..25);
    world.match_writer(0, 1);
    world.match_reader(0, 1);
    world.settle();
    assert_eq!(world.numbers(1), (15..25).collect::<Vec<_>>());
}

#[test]
fn a_volatile_late_joiner_gets_nothing_old() {
    let mut world = World::new(3, &reliable(), true);
    world.match_both(0, 1);
    world.write_numbered(0, 0..25);
    world.match_both(0, 2);
    world.write_numbered(0, 25..27);
    world.settle();
    assert_eq!((world.numbers(2), world.lost(2)), (vec![25, 26], 0));
}

#[test]
fn a_volatile_late_joiner_of_a_latched_writer_gets_nothing_old() {
    let mut world = World::new(2, &latched(), true);
    world.write_numbered(0, 0..25);
    world.sides[1].reader = Reader::new(ReaderConfig {
        guid: Guid::new(prefix(1), READER),
        qos: reliable(),
        max_sample_size: 1000,
        max_open_bytes: 1000,
    });
    world.match_both(0, 1);
    world.write_numbered(0, 25..27);
    // A reader without a heartbeat addressed to it may request all samples.
    let all = &mut SequenceNumberSet::new(SequenceNumber::FIRST);
    (1..=25).for_each(|number| assert!(all.insert(SequenceNumber(number))));
    let ask = AckNack { reader: READER, writer: WRITER, missing: *all, count: 1, is_final: false };
    let side = &mut world.sides[0];
    side.writer.handle_ack_nack(world.now, Guid::new(prefix(1), READER), &ask, &mut side.links);
    world.settle();
    assert_eq!((world.numbers(1), world.lost(1)), (vec![25, 26], 0));
}

#[test]
fn a_reader_requests_a_first_heartbeat_with_increasing_delays() {
    let mut world = World::new(2, &reliable(), true);
    world.match_writer(0, 1);
    let mut asked = Vec::new();
    for _ in 0..6 {
        let sent = world.sent;
        while world.sent == sent {
            let next = world.next_event().unwrap();
            world.advance(next - world.now.steady);
            world.step();
            world.transmit();
        }
        asked.push((world.now.steady - world.start).as_millis());
    }
    assert_eq!(asked, [10, 30, 70, 150, 310, 630]);
    world.run(Duration::from_secs(60));
    let sent = world.sent;
    world.run(Duration::from_secs(30));
    assert_eq!(world.sent - sent, 10);
    world.match_reader(0, 1);
    world.run(MS);
    let sent = world.sent;
    world.run(Duration::from_secs(60));
    assert_eq!(world.sent, sent);
}

#[test]
fn a_reader_that_has_lost_its_state_gets_the_history_again() {
    let mut world = World::pair(&latched());
    world.write_numbered(0, 0..25);
    world.settle();
    assert_eq!(world.numbers(1).len(), 25);
    world.sides[1].reader.unmatch_writer(Guid::new(prefix(0), WRITER));
    world.run(Duration::from_secs(1));
    world.match_writer(0, 1);
    world.run(Duration::from_secs(1));
    assert_eq!(world.numbers(1), (15..25).collect::<Vec<_>>());
    world.write_numbered(0, 25..26);
    world.settle();
    assert_eq!(world.numbers(1), [25]);
}

#[test]
fn a_volatile_reader_that_has_lost_its_state_gets_new_samples() {
    let mut world = World::pair(&reliable());
    world.write_numbered(0, 0..25);
    world.settle();
    world.numbers(1);
    world.sides[1].reader.unmatch_writer(Guid::new(prefix(0), WRITER));
    world.run(Duration::from_secs(1));
    world.match_writer(0, 1);
    world.run(Duration::from_secs(1));
    world.write_numbered(0, 25..26);
    world.settle();
    assert_eq!((world.numbers(1), world.lost(1)), (vec![25], 0));
}
