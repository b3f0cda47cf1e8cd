//! When acknowledgements are requested, and how soon losses are noticed in spite of that.

use super::*;

/// The QoS of a writer that waits for acknowledgements.
fn keep_all() -> Qos {
    Qos { history: History::KeepAll, ..reliable() }
}

/// Pairs of this engine, with a window, and of others, without one.
fn settled_pairs(qos: &Qos) -> [World; 2] {
    [true, false].map(|is_ours| {
        let mut world = World::new(2, qos, is_ours);
        world.match_both(0, 1);
        world.settle();
        // Since the heartbeats of the match.
        world.run(100 * MS);
        (world.acknowledgements, world.asking) = (0, 0);
        world
    })
}

#[test]
fn a_stream_is_acknowledged_ten_times_a_second() {
    for period in [8 * MS, MS, MS / 4] {
        for mut world in settled_pairs(&reliable()) {
            let count = (4000 * MS).as_nanos() / period.as_nanos();
            for number in 0..count as u32 {
                world.write(0, sample(number)).unwrap();
                world.run(period);
            }
            world.settle();
            assert_eq!(world.numbers(1).len() as u128, count);
            // The last one is for the end of the stream. At 4 kHz, 64 kB are sent in 25 ms.
            let most = if period < MS { 4000 / 25 + 1 } else { 41 };
            assert!(
                world.acknowledgements <= most && world.acknowledgements == world.asking,
                "{period:?}: {} asked, {} acknowledged",
                world.asking,
                world.acknowledgements
            );
        }
    }
}

#[test]
fn a_stream_costs_one_datagram_per_sample() {
    for mut world in settled_pairs(&reliable()) {
        let before = world.sent;
        for number in 0..500 {
            world.write(0, sample(number)).unwrap();
            world.run(8 * MS);
        }
        world.settle();
        assert!(world.sent - before <= 500 + 42, "{} datagrams", world.sent - before);
    }
}

#[test]
fn a_sample_after_a_pause_requests_its_acknowledgement_itself() {
    for mut world in settled_pairs(&reliable()) {
        let before = world.sent;
        for number in 0..30 {
            world.write(0, sample(number)).unwrap();
            world.run(33 * MS);
            assert!(world.sides[0].writer.is_acknowledged());
        }
        assert_eq!(world.sent - before, 60);
    }
}

#[test]
fn a_lost_sample_of_a_stream_is_repaired_when_the_next_one_arrives() {
    for mut world in settled_pairs(&reliable()) {
        for number in 0..20 {
            if number == 10 {
                world.cut.push((0, 1));
            }
            world.write(0, sample(number)).unwrap();
            world.transmit();
            world.cut.clear();
            world.run(MS);
            if number == 11 {
                assert_eq!(world.numbers(1), (0..12).collect::<Vec<_>>());
            }
            world.run(7 * MS);
        }
        assert_eq!(world.numbers(1), (12..20).collect::<Vec<_>>());
    }
}

#[test]
fn a_lost_last_sample_is_repaired_20_ms_later() {
    for mut world in settled_pairs(&reliable()) {
        world.write_numbered(0, 0..1);
        world.run(8 * MS);
        world.cut.push((0, 1));
        world.write_numbered(0, 1..2);
        world.cut.clear();
        world.run(19 * MS);
        assert_eq!(world.numbers(1), [0]);
        world.run(2 * MS);
        assert_eq!(world.numbers(1), [1]);
        assert!(world.sides[0].writer.is_acknowledged());
    }
}

#[test]
fn a_lost_request_is_repeated() {
    for mut world in settled_pairs(&reliable()) {
        world.cut.push((1, 0));
        world.write_numbered(0, 0..1);
        world.run(50 * MS);
        assert!(world.asking >= 2, "{}", world.asking);
        world.cut.clear();
        world.run(100 * MS);
        assert!(world.sides[0].writer.is_acknowledged());
    }
}

#[test]
fn an_unanswered_request_is_repeated_with_the_next_samples_of_a_stream() {
    for mut world in settled_pairs(&reliable()) {
        world.cut.push((1, 0));
        for number in 0..4 {
            world.write(0, sample(number)).unwrap();
            world.run(8 * MS);
        }
        assert_eq!(world.asking, 4);
        world.cut.clear();
        for number in 4..12 {
            world.write(0, sample(number)).unwrap();
            world.run(8 * MS);
        }
        assert_eq!((world.asking, world.acknowledgements), (5, 1));
        assert_eq!(world.numbers(1), (0..12).collect::<Vec<_>>());
    }
}

#[test]
fn a_writer_that_keeps_all_never_waits_for_a_reader_that_answers() {
    for mut world in settled_pairs(&keep_all()) {
        for number in 0..2000 {
            world.write(0, sample(number)).unwrap();
            world.run(MS / 2);
        }
        world.settle();
        assert_eq!(world.numbers(1), (0..2000).collect::<Vec<_>>());
    }
}

#[test]
fn a_half_full_window_of_the_link_requests_acknowledgements() {
    let mut world = World::pair(&Qos { history: History::KeepLast(1), ..reliable() });
    world.settle();
    world.run(100 * MS);
    world.asking = 0;
    let to = world.sides[0].to[1];
    let size = world.sides[0].links.window_size(to).unwrap();
    // In flight from other writers.
    world.sides[0].links.change_in_flight(to, 0, size / 2);
    for number in 0..50 {
        world.write(0, sample(number)).unwrap();
        world.run(8 * MS);
    }
    assert_eq!(world.asking, 50);
}

#[test]
fn a_stream_is_not_taken_for_a_stalled_peer() {
    let mut world = World::pair(&Qos { history: History::KeepLast(1), ..reliable() });
    world.settle();
    let to = world.sides[0].to[1];
    let size = world.sides[0].links.window_size(to).unwrap();
    for number in 0..12 {
        world.write(0, sample(number)).unwrap();
        world.run(8 * MS);
    }
    // Some 90 ms after the last request, a large sample waits for others in the window.
    world.sides[0].links.change_in_flight(to, 0, size);
    world.write(0, large(12, 1_000_000)).unwrap();
    world.run(8 * MS);
    world.write(0, sample(13)).unwrap();
    world.run(8 * MS);
    world.sides[0].links.change_in_flight(to, size, 0);
    world.settle();
    let received = std::mem::take(&mut world.sides[1].received);
    assert_eq!(received.len(), 14, "the large sample was given up");
}

#[test]
fn acknowledgements_are_requested_at_once_if_somebody_waits_for_them() {
    for mut world in settled_pairs(&reliable()) {
        for number in 0..3 {
            world.write(0, sample(number)).unwrap();
            world.run(8 * MS);
        }
        assert!(!world.sides[0].writer.is_acknowledged());
        let side = &mut world.sides[0];
        side.writer.ask_all(world.now, &mut side.links);
        world.run(MS);
        assert!(world.sides[0].writer.is_acknowledged());
    }
}
