//! History, lifespan, deadline, liveliness, and samples for a single reader.

use super::*;

#[test]
fn the_last_samples_are_kept_and_the_others_counted_as_lost() {
    let mut world = World::pair(&reliable());
    world.write_numbered(0, 0..5);
    world.settle();
    world.cut.push((0, 1));
    world.write_numbered(0, 5..50);
    world.cut.clear();
    world.settle();
    assert_eq!(world.lost(1), 35);
    assert_eq!(world.numbers(1), (0..5).chain(40..50).collect::<Vec<_>>());
}

#[test]
fn a_writer_that_keeps_all_waits_for_its_readers() {
    let mut world = World::pair(&Qos { history: History::KeepAll, ..reliable() });
    world.settle();
    world.cut.push((1, 0));
    let written = (0..1000).take_while(|number| world.write(0, sample(*number)).is_ok()).count();
    assert_eq!(written, 64);
    world.run(Duration::from_secs(10));
    assert!(!world.sides[0].writer.can_write(world.now, &world.sides[0].links));
    world.cut.clear();
    world.settle();
    assert!(world.sides[0].writer.can_write(world.now, &world.sides[0].links));
    assert_eq!(world.sides[0].events.last(), Some(&WriterEvent::Acknowledged));
    assert_eq!(world.numbers(1), (0..64).collect::<Vec<_>>());
}

#[test]
fn a_sample_for_one_reader_is_a_gap_for_the_others() {
    let mut world = World::new(4, &reliable(), true);
    for reader in 1..4 {
        world.match_both(0, reader);
    }
    world.settle();
    for number in 0..90 {
        let only_to = (number % 10 < 9).then(|| Guid::new(prefix(1 + number as usize % 3), READER));
        world.write_with(0, sample(number), WriteOptions { only_to, ..Default::default() }).unwrap();
        world.run(MS / 10);
    }
    world.settle();
    for reader in 1..4 {
        let due = (0..90).filter(|number| number % 10 == 9 || 1 + number % 3 == reader).collect::<Vec<_>>();
        assert_eq!((world.lost(reader as usize), world.numbers(reader as usize)), (0, due));
    }
    // No other reader receives it.
    world.run(10 * MS);
    let sent = world.sent;
    let only_to = Some(Guid::new(prefix(1), READER));
    world.write_with(0, sample(90), WriteOptions { only_to, ..Default::default() }).unwrap();
    world.run(Duration::from_secs(1));
    assert!(world.sides[0].writer.is_acknowledged());
    assert_eq!(world.sent - sent, 2);
}

#[test]
fn a_discarded_sample_is_neither_received_nor_lost() {
    let mut world = World::new(2, &Qos { history: History::KeepAll, ..latched() }, true);
    world.write_numbered(0, 0..9);
    for number in [2, 3, 7] {
        world.sides[0].writer.discard(SequenceNumber(number));
    }
    world.match_both(0, 1);
    world.settle();
    assert_eq!((world.lost(1), world.numbers(1)), (0, vec![0, 3, 4, 5, 7, 8]));
}

#[test]
fn expired_samples_are_neither_sent_nor_delivered() {
    let mut world = World::new(2, &Qos { lifespan: Some(100 * MS), ..latched() }, true);
    world.write_numbered(0, 0..2);
    world.run(90 * MS);
    world.write_numbered(0, 2..4);
    world.run(20 * MS);
    world.match_both(0, 1);
    world.settle();
    assert_eq!(world.numbers(1), [2, 3]);
    // A sample that expires while it waits for an earlier one is not delivered. A step of the wall clock
    // expires nothing here.
    world.now.wall_ns -= 1_000_000_000_000;
    world.write_numbered(0, 4..5);
    world.settle();
    assert_eq!(world.numbers(1), [4]);
    assert!(world.sides[0].writer.next_timeout().is_some());
    world.run(Duration::from_secs(1));
    assert_eq!(world.sides[0].writer.next_timeout(), None);
}

#[test]
fn missed_deadlines_are_counted_on_both_sides() {
    let mut world = World::pair(&Qos { deadline: Some(100 * MS), ..reliable() });
    world.run(Duration::from_secs(1));
    assert!(world.sides[0].events.iter().all(|event| *event == WriterEvent::Acknowledged));
    for number in 0..10 {
        world.write_numbered(0, number..number + 1);
        world.run(90 * MS);
    }
    world.settle();
    assert!(world.sides[0].events.iter().all(|event| *event == WriterEvent::Acknowledged));
    world.numbers(1);
    world.run(290 * MS);
    let offered = world.sides[0].events.iter();
    let offered = offered.filter(|event| **event == WriterEvent::DeadlineMissed { count: 1 }).count();
    assert_eq!((offered, world.sides[1].received.len()), (3, 3));
    // A suspension of the host is one event.
    world.advance(Duration::from_secs(10));
    world.step();
    assert_eq!(world.sides[1].received[3..], [Received::DeadlineMissed { count: 100 }]);
}

#[test]
fn a_silent_writer_loses_its_liveliness() {
    let qos = Qos { liveliness: Liveliness::ManualByTopic, lease: Some(100 * MS), ..reliable() };
    let mut world = World::pair(&qos);
    let writer = Guid::new(prefix(0), WRITER);
    world.write_numbered(0, 0..1);
    for _ in 0..10 {
        world.run(90 * MS);
        let side = &mut world.sides[0];
        side.writer.assert_liveliness(world.now, &mut side.links);
    }
    world.run(MS);
    let changed = |is_alive| Received::LivelinessChanged { writer, is_alive };
    assert_eq!(world.sides[0].events, [WriterEvent::Acknowledged]);
    assert_eq!(world.sides[1].received[0], changed(true));
    assert_eq!(world.numbers(1), [0]);
    world.run(Duration::from_secs(5));
    assert_eq!(world.sides[0].events.pop(), Some(WriterEvent::LivelinessLost));
    assert_eq!(std::mem::take(&mut world.sides[1].received), [changed(false)]);
    world.write_numbered(0, 1..2);
    world.run(MS);
    assert_eq!(world.sides[1].received[0], changed(true));
    assert_eq!(world.numbers(1), [1]);
}

#[test]
fn a_best_effort_reader_gets_the_newest_and_counts_the_others() {
    let mut world = World::pair(&best_effort());
    (world.loss, world.jitter) = (20, MS);
    for number in 0..1000 {
        world.write_numbered(0, number..number + 1);
        world.run(MS / 2);
    }
    world.settle();
    let (lost, numbers) = (world.lost(1), world.numbers(1));
    assert!(numbers.is_sorted() && numbers.len() > 500, "{}", numbers.len());
    let before_first = u64::from(numbers[0]);
    let after_last = u64::from(999 - numbers[numbers.len() - 1]);
    assert_eq!(lost + numbers.len() as u64 + before_first + after_last, 1000);
}
