//! The cost of invalid input, dead peers and small receive buffers.

use super::*;

#[test]
fn a_dead_reader_delays_no_other_and_costs_its_window() {
    for (size, count) in [(100, 5000), (100_000, 200), (1_000_000, 50)] {
        let mut world = World::new(3, &reliable(), true);
        world.match_both(0, 1);
        world.match_both(0, 2);
        world.run(MS);
        world.cut = vec![(0, 2), (2, 0)];
        for number in 0..count {
            world.write(0, large(number, size)).unwrap();
            world.run(10 * MS);
        }
        assert_eq!((world.numbers(1).len(), world.lost(1)), (count as usize, 0));
        assert!(!world.sides[0].writer.is_acknowledged());
        let sent = world.sent;
        world.run(Duration::from_secs(600));
        assert!(world.sent - sent < 250, "{} datagrams to a dead reader", world.sent - sent);
        world.cut.clear();
        world.settle();
        let (lost, numbers) = (world.lost(2), world.numbers(2));
        assert_eq!(numbers[numbers.len() - DEPTH..], (count - DEPTH as u32..count).collect::<Vec<_>>());
        assert_eq!(lost + numbers.len() as u64, u64::from(count));
    }
}

#[test]
fn a_writer_ahead_of_its_pacer_gets_a_full_window_and_loses_nothing() {
    let mut world = World::new(2, &best_effort(), false);
    world.match_both(0, 1);
    let mut written = 0;
    for _ in 0..200 {
        while world.write(0, large(written, 100_000)).is_ok() {
            written += 1;
        }
        world.run(10 * MS);
    }
    assert!(written > 500);
    world.settle();
    assert_eq!(world.numbers(1), (0..written).collect::<Vec<_>>());
}

#[test]
fn huge_ranges_cost_nothing() {
    let mut world = World::pair(&reliable());
    world.settle();
    let (reader, writer, huge) = (READER, WRITER, SequenceNumber(1 << 60));
    let guid = Guid::new(prefix(0), WRITER);
    let Side { reader: endpoint, received, links, .. } = &mut world.sides[1];
    let heartbeat = |first, last, count| Heartbeat {
        reader,
        writer,
        first: SequenceNumber(first),
        last,
        count,
        is_final: false,
        is_liveliness: false,
    };
    endpoint.handle_heartbeat(world.now, guid, &heartbeat(1, huge, 1000), received, links);
    let list = SequenceNumberSet::new(huge);
    endpoint.handle_gap(world.now, guid, &Gap { reader, writer, start: SequenceNumber(3), list }, received);
    endpoint.handle_heartbeat(world.now, guid, &heartbeat(1 << 59, huge, 1001), received, links);
    endpoint.handle_heartbeat(world.now, guid, &heartbeat(1 << 60, huge.previous(), 1002), received, links);
    let counts = received.iter().map(|received| match received {
        Received::Lost { count, .. } => *count,
        other => panic!("{other:?}"),
    });
    assert_eq!(counts.sum::<u64>(), (1 << 60) - 1);
    let side = &mut world.sides[0];
    let ask = AckNack { reader, writer, missing: list, count: 1000, is_final: false };
    side.writer.handle_ack_nack(world.now, Guid::new(prefix(1), READER), &ask, &mut side.links);
    world.run(Duration::from_secs(1));
}

#[test]
fn undeliverable_samples_are_bounded() {
    let mut world = World::pair(&reliable());
    world.settle();
    let guid = Guid::new(prefix(0), WRITER);
    let mut memory = 0;
    for number in (2..200_000_i64).step_by(2) {
        let side = &mut world.sides[1];
        let payload = [0; 1000];
        let data = crate::wire::Data {
            reader: READER,
            writer: WRITER,
            number: SequenceNumber(number),
            inline_qos: InlineQos::default(),
            payload: crate::wire::Payload::Data(&payload),
        };
        side.reader.handle_data(world.now, guid, None, &data, &mut side.received);
        memory = memory.max(side.reader.open_bytes());
    }
    assert!((500_000..700_000).contains(&memory), "{memory}");
    for number in 1000..200_000 {
        let side = &mut world.sides[1];
        let fragment = crate::wire::DataFragment {
            reader: READER,
            writer: WRITER,
            number: SequenceNumber(1 + 2 * (number % 500)),
            first: 2,
            count: 1,
            fragment_size: 1000,
            sample_size: 16_000_000,
            inline_qos: InlineQos::default(),
            payload: &[0; 1000],
            is_key: false,
        };
        side.reader.handle_fragment(world.now, guid, None, &fragment, &mut side.received);
        memory = memory.max(side.reader.open_bytes());
    }
    assert!(memory < 2_000_000, "{memory}");
    assert!(world.sides[1].received.is_empty());
    world.sides[1].reader.unmatch_writer(guid);
    assert_eq!(world.sides[1].reader.open_bytes(), 0);
}

#[test]
fn the_size_of_samples_bounds_the_window() {
    for (size, most) in [(1_000, 64), (1_000_000, 64), (8_000_000, 9), (100_000_000, 1)] {
        let mut world = World::pair(&Qos { history: History::KeepAll, ..reliable() });
        world.settle();
        world.cut = vec![(0, 1), (1, 0)];
        let payload = Bytes::from(vec![0; size]);
        let accepted = (0..100).take_while(|_| world.write(0, payload.clone()).is_ok()).count();
        assert_eq!(accepted, most, "{size} bytes");
        let side = &world.sides[0];
        assert!(!side.writer.can_write(world.now, &side.links));
    }
}

#[test]
fn a_deep_history_of_large_samples_is_kept() {
    let mut world = World::new(1, &latched(), true);
    let payload = Bytes::from(vec![0; 50_000_000]);
    for _ in 0..30 {
        world.write(0, payload.clone()).unwrap();
    }
    let writer = &world.sides[0].writer;
    assert_eq!(writer.next().0 - writer.first().0, DEPTH as i64);
}

#[test]
fn a_sample_beyond_the_limit_is_lost_and_blocks_nothing() {
    let mut world = World::pair(&reliable());
    world.write(0, large(0, 17 << 20)).unwrap();
    world.write_numbered(0, 1..2);
    world.settle();
    assert_eq!((world.lost(1), world.numbers(1)), (1, vec![1]));
}

/// What rclpy with the kernel's default buffer of 208 KiB must receive: camera images and large clouds, with
/// occasional delays.
#[test]
fn a_stock_receive_buffer_suffices_for_images() {
    for (size, count, period) in [(921_600, 300, 33 * MS), (8_000_000, 20, 500 * MS)] {
        for qos in [reliable(), best_effort()] {
            let mut world = World::new(2, &qos, false);
            world.match_both(0, 1);
            world.sides[1].socket = Some(Socket::default());
            world.lateness = MS;
            for number in 0..count {
                world.write(0, large(number, size)).unwrap();
                world.run(period);
            }
            world.settle();
            let lost = world.sides[1].socket.as_ref().unwrap().dropped;
            let arrived = world.numbers(1).len();
            println!("{size} B, {:?}: {arrived} of {count}, {lost} datagrams dropped", qos.reliability);
            assert_eq!(arrived, count as usize);
        }
    }
}
