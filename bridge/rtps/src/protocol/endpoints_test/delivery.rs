//! Samples arrive complete, once and in order, with few datagrams.

use super::*;

#[test]
fn samples_arrive_once_and_in_order() {
    let mut world = World::pair(&reliable());
    world.write_numbered(0, 0..1000);
    world.settle();
    assert_eq!(world.numbers(1), (0..1000).collect::<Vec<_>>());
}

#[test]
fn samples_arrive_once_and_in_order_over_a_bad_network() {
    for seed in 1..30 {
        let mut world = World::pair(&Qos { history: History::KeepAll, ..reliable() });
        (world.random, world.loss, world.duplication, world.jitter) = (seed * 77, 30, 10, 5 * MS);
        for number in 0..200 {
            while world.write(0, sample(number)).is_err() {
                world.run(MS);
            }
            world.transmit();
        }
        world.settle();
        assert_eq!(world.numbers(1), (0..200).collect::<Vec<_>>(), "seed {seed}");
        assert_eq!(world.lost(1), 0);
    }
}

#[test]
fn large_samples_arrive_complete_over_a_bad_network() {
    for (seed, is_ours) in (1..20).flat_map(|seed| [(seed, true), (seed, false)]) {
        let mut world = World::new(2, &Qos { history: History::KeepAll, ..reliable() }, is_ours);
        (world.random, world.loss, world.duplication, world.jitter) = (seed * 77, 20, 10, 5 * MS);
        world.match_both(0, 1);
        for number in 0..5 {
            world.write(0, large(number, 1_000_003)).unwrap();
            world.run(MS);
        }
        world.settle();
        let received = std::mem::take(&mut world.sides[1].received);
        assert_eq!(received.len(), 5, "seed {seed} {is_ours}");
        for (number, received) in received.iter().enumerate() {
            let Received::Sample(sample) = received else { panic!("{received:?}") };
            assert!(sample.payload == large(number as u32, 1_000_003));
        }
    }
}

#[test]
fn large_samples_cost_one_datagram_per_fragment_and_few_answers() {
    let mut world = World::pair(&reliable());
    world.settle();
    let before = world.sent;
    for number in 0..8 {
        world.write(0, large(number, 1_000_000)).unwrap();
        world.settle();
    }
    assert_eq!(world.numbers(1), (0..8).collect::<Vec<_>>());
    let fragments = 8 * 16;
    assert!(world.sent - before <= fragments + fragments / 4, "{} datagrams", world.sent - before);
}

#[test]
fn nothing_is_sent_after_the_acknowledgements() {
    for qos in [reliable(), latched(), best_effort()] {
        let mut world = World::pair(&qos);
        world.write_numbered(0, 0..100);
        world.run(Duration::from_secs(5));
        let sent = world.sent;
        world.run(Duration::from_secs(3600));
        assert_eq!(world.sent, sent);
        assert!(world.sides[0].writer.is_acknowledged());
        assert_eq!(world.sides[0].writer.next_timeout(), None);
    }
}

#[test]
fn a_flood_of_small_samples_shares_datagrams() {
    let mut world = World::pair(&Qos { history: History::KeepLast(2000), ..reliable() });
    world.settle();
    let before = world.sent;
    for number in 0..1000 {
        world.write(0, sample(number)).unwrap();
    }
    world.settle();
    assert_eq!(world.numbers(1).len(), 1000);
    assert!(world.sent - before < 10, "{} datagrams", world.sent - before);
}

#[test]
fn samples_in_quick_succession_share_acknowledgements() {
    let mut world = World::pair(&Qos { history: History::KeepLast(2000), ..reliable() });
    world.settle();
    let before = world.sent;
    for number in 0..1000 {
        world.write(0, sample(number)).unwrap();
        world.run(MS / 10);
    }
    world.settle();
    assert_eq!(world.numbers(1).len(), 1000);
    assert!(world.sent - before < 1060, "{} datagrams", world.sent - before);
}

#[test]
fn a_reader_that_moves_to_another_link_continues() {
    let mut world = World::pair(&reliable());
    world.write_numbered(0, 0..5);
    world.settle();
    world.cut.push((0, 1));
    world.write_numbered(0, 5..9);
    world.cut.clear();
    let side = &mut world.sides[0];
    side.to[1] = side.links.open(LinkOptions {
        destination: Destination::Unicast(SocketAddrV4::new(Ipv4Addr::LOCALHOST, 9)),
        peer: prefix(1),
        max_datagram: 1472,
        fragment_size: 1344,
        receive_buffer: None,
    });
    world.match_reader(0, 1);
    world.settle();
    assert_eq!((world.lost(1), world.numbers(1)), (0, (0..9).collect()));
}

#[test]
fn many_readers_receive_all_samples_and_acknowledge_once() {
    let mut world = World::new(9, &Qos { history: History::KeepAll, ..reliable() }, true);
    (1..9).for_each(|reader| world.match_both(0, reader));
    (world.loss, world.jitter) = (10, MS);
    for number in 0..50 {
        world.write(0, large(number, 70_000)).unwrap();
        world.run(5 * MS);
    }
    world.settle();
    for reader in 1..9 {
        assert_eq!((world.lost(reader), world.numbers(reader)), (0, (0..50).collect()));
    }
}
