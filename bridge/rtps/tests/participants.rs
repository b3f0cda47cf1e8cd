//! Discovery and communication of participants over a network without losses.

mod common;

#[allow(unused_imports)] // by `common`
use common::no_guard as guard;

use std::time::Duration;

use common::{Network, best_effort, endpoint, latched, payload, reliable};
use downbeat_rtps::{
    protocol::{Departure, EndpointConfig, Event, LivelinessChange, WriteOptions},
    qos::{Liveliness, Policy, Qos},
    wire::EntityId,
};

const SECOND: Duration = Duration::from_secs(1);

fn is_matched(network: &Network, node: usize, endpoint: EntityId, count: usize) -> bool {
    network.nodes[node].participant.matched(endpoint).len() == count
}

#[test]
fn two_participants_discover_each_other_and_exchange_samples_in_both_directions() {
    let mut network = Network::new(2);
    let writers = [network.writer(0, "rt/a", reliable()), network.writer(1, "rt/b", best_effort())];
    let readers = [network.reader(1, "rt/a", reliable()), network.reader(0, "rt/b", best_effort())];
    assert!(network.run_until(Duration::from_millis(100), |network| {
        is_matched(network, 0, writers[0], 1)
            && is_matched(network, 1, readers[0], 1)
            && is_matched(network, 1, writers[1], 1)
            && is_matched(network, 0, readers[1], 1)
    }));
    network.write(0, writers[0], "there");
    network.write(1, writers[1], "and back");
    network.run_for(Duration::from_millis(10));
    assert_eq!(network.nodes[1].texts(readers[0]), ["there"]);
    assert_eq!(network.nodes[0].texts(readers[1]), ["and back"]);
}

#[test]
fn endpoints_of_one_participant_communicate() {
    let mut network = Network::new(0);
    // Without addresses, as with the discovery range OFF.
    network.join(|config| config.addresses = Default::default());
    let reader = network.reader(0, "rt/a", reliable());
    let writer = network.writer(0, "rt/a", reliable());
    assert!(is_matched(&network, 0, writer, 1) && is_matched(&network, 0, reader, 1));
    network.write(0, writer, "to myself");
    assert_eq!(network.nodes[0].texts(reader), ["to myself"]);
    network.run_for(SECOND);
    assert!(network.nodes[0].participant.is_acknowledged(writer));
    assert_eq!(network.nodes[0].sent.0, 0);
    network.call(0, |participant, now| participant.remove_endpoint(now, writer));
    assert!(is_matched(&network, 0, reader, 0));
    let unmatched = |event: &Event| matches!(event, Event::Unmatched { .. });
    assert_eq!(network.nodes[0].count(unmatched), 2);
}

#[test]
fn three_participants_all_receive_from_a_writer() {
    let mut network = Network::new(3);
    let writer = network.writer(0, "rt/a", reliable());
    let readers: Vec<_> = (0..3).map(|node| network.reader(node, "rt/a", reliable())).collect();
    assert!(network.run_until(SECOND, |network| is_matched(network, 0, writer, 3)));
    network.run_for(Duration::from_millis(10));
    network.write(0, writer, "all");
    network.run_for(Duration::from_millis(10));
    for (node, reader) in readers.into_iter().enumerate() {
        assert_eq!(network.nodes[node].texts(reader), ["all"], "participant {node}");
    }
}

#[test]
fn a_late_joiner_gets_latched_samples_of_exact_depth_within_150_ms() {
    let mut network = Network::new(1);
    let writer = network.writer(0, "rt/a", latched(2));
    network.run_for(10 * SECOND);
    for text in ["one", "two", "three"] {
        network.write(0, writer, text);
    }
    network.run_for(10 * SECOND);
    let late = network.join(|_| {});
    let reader = network.reader(late, "rt/a", latched(10));
    assert!(network.run_until(Duration::from_millis(150), |network| {
        network.nodes[late].texts(reader) == ["two", "three"]
    }));
}

#[test]
fn both_sides_report_an_incompatible_policy_once() {
    let mut network = Network::new(2);
    let writer = network.writer(0, "rt/a", best_effort());
    let reader = network.reader(1, "rt/a", reliable());
    network.run_for(5 * SECOND);
    for (node, own) in [(0, writer), (1, reader)] {
        let named = |event: &Event| matches!(event, Event::Incompatible { local, policy: Policy::Reliability, .. } if *local == own);
        assert_eq!(network.nodes[node].count(named), 1);
        assert!(is_matched(&network, node, own, 0));
    }
}

#[test]
fn another_type_is_reported_and_does_not_match() {
    let mut network = Network::new(2);
    network.writer(0, "rt/a", reliable());
    let config = EndpointConfig { type_name: "other".into(), ..endpoint("rt/a", reliable()) };
    network.call(1, |participant, now| participant.create_reader(now, config)).expect("reader");
    network.run_for(SECOND);
    for (node, theirs) in network.nodes.iter().zip(["other", "std_msgs::msg::dds_::String_"]) {
        let named =
            |event: &Event| matches!(event, Event::OtherType { type_name, .. } if &**type_name == theirs);
        assert_eq!(node.count(named), 1);
        assert_eq!(node.count(|event| matches!(event, Event::Matched { .. })), 0);
    }
}

#[test]
fn a_removed_endpoint_is_unmatched_immediately_and_never_announced_to_new_participants() {
    let mut network = Network::new(2);
    let writer = network.writer(0, "rt/a", reliable());
    let reader = network.reader(1, "rt/a", reliable());
    assert!(network.run_until(SECOND, |network| is_matched(network, 1, reader, 1)));
    network.call(0, |participant, now| participant.remove_endpoint(now, writer));
    assert!(network.run_until(Duration::from_millis(10), |network| is_matched(network, 1, reader, 0)));
    let left = |event: &Event| matches!(event, Event::EndpointLeft { .. });
    assert_eq!(network.nodes[1].count(left), 1);
    network.run_for(SECOND);
    let late = network.join(|_| {});
    network.run_for(SECOND);
    assert_eq!(network.nodes[late].participant.remote_endpoints().count(), 1);
    assert_eq!(network.nodes[late].count(left), 0);
}

#[test]
fn a_participant_that_leaves_is_removed_when_it_no_longer_answers() {
    let mut network = Network::new(2);
    let writer = network.writer(0, "rt/a", reliable());
    let reader = network.reader(1, "rt/a", reliable());
    assert!(network.run_until(SECOND, |network| is_matched(network, 1, reader, 1)));
    network.run_for(SECOND);
    network.write(0, writer, "last words");
    network.call(0, |participant, now| participant.leave(now));
    network.nodes[0].is_running = false;
    assert!(network.run_until(Duration::from_millis(150), |network| is_matched(network, 1, reader, 0)));
    let left = |event: &Event| matches!(event, Event::ParticipantLeft { reason: Departure::Disposed, .. });
    assert_eq!(network.nodes[1].count(left), 1);
    assert_eq!(network.nodes[1].texts(reader), ["last words"]);
}

#[test]
fn a_silent_participant_is_removed_after_its_lease() {
    let mut network = Network::new(2);
    let reader = network.reader(0, "rt/a", reliable());
    network.writer(1, "rt/a", reliable());
    assert!(network.run_until(SECOND, |network| is_matched(network, 0, reader, 1)));
    network.run_for(60 * SECOND);
    assert!(is_matched(&network, 0, reader, 1), "announcements keep it alive");
    network.nodes[1].is_running = false;
    network.run_for(16 * SECOND);
    assert!(is_matched(&network, 0, reader, 1));
    network.run_for(5 * SECOND);
    assert!(is_matched(&network, 0, reader, 0));
}

#[test]
fn a_suspended_participant_comes_back_with_the_same_identity() {
    let mut network = Network::new(2);
    let writer = network.writer(0, "rt/a", reliable());
    let reader = network.reader(1, "rt/a", reliable());
    assert!(network.run_until(SECOND, |network| is_matched(network, 0, writer, 1)));
    network.nodes[1].is_running = false;
    network.run_for(60 * SECOND);
    assert!(is_matched(&network, 0, writer, 0));
    network.nodes[1].is_running = true;
    assert!(network.run_until(5 * SECOND, |network| is_matched(network, 0, writer, 1)));
    network.run_for(Duration::from_millis(500));
    network.write(0, writer, "welcome back");
    network.run_for(SECOND);
    assert_eq!(network.nodes[1].texts(reader), ["welcome back"]);
    // It was suspended, not the others, so it removes no participant.
    assert_eq!(network.nodes[1].count(|event| matches!(event, Event::ParticipantLeft { .. })), 0);
}

#[test]
fn a_participant_that_was_removed_on_one_side_is_matched_again() {
    let mut network = Network::new(2);
    let writer = network.writer(0, "rt/a", reliable());
    let reader = network.reader(1, "rt/a", reliable());
    assert!(network.run_until(SECOND, |network| is_matched(network, 1, reader, 1)));
    // Nothing arrives from 0 at 1 for longer than the lease; 0 receives from 1 all the time.
    let deaf = network.nodes[0].address;
    network.fate =
        Box::new(move |flight| if *flight.from.ip() == deaf { vec![] } else { vec![common::DELAY] });
    network.run_for(25 * SECOND);
    assert!(is_matched(&network, 1, reader, 0));
    network.fate = Box::new(|_| vec![common::DELAY]);
    assert!(network.run_until(10 * SECOND, |network| {
        is_matched(network, 1, reader, 1) && is_matched(network, 0, writer, 1)
    }));
    network.run_for(SECOND);
    network.write(0, writer, "again");
    network.run_for(SECOND);
    assert_eq!(network.nodes[1].texts(reader), ["again"]);
}

#[test]
fn static_peers_are_kept_without_multicast_if_only_one_lists_the_other() {
    let mut network = Network::new(1);
    let first = std::net::SocketAddrV4::new(network.nodes[0].address, common::METATRAFFIC_PORT);
    network.join(|config| config.addresses.announce_to.push(first));
    network.fate =
        Box::new(|flight| if flight.to.ip().is_multicast() { vec![] } else { vec![common::DELAY] });
    let writer = network.writer(0, "rt/a", reliable());
    network.reader(1, "rt/a", reliable());
    assert!(network.run_until(SECOND, |network| is_matched(network, 0, writer, 1)));
    network.run_for(120 * SECOND);
    for node in &network.nodes {
        assert_eq!(node.count(|event| matches!(event, Event::ParticipantLeft { .. })), 0);
    }
}

#[test]
fn a_lost_answer_is_sent_again() {
    let mut network = Network::new(1);
    let writer = network.writer(0, "rt/a", reliable());
    network.run_for(10 * SECOND);
    // Like Fast DDS, which announces itself before it receives.
    let start = network.elapsed;
    let is_deaf = std::rc::Rc::new(std::cell::Cell::new(true));
    let still = is_deaf.clone();
    let late = network.join(|_| {});
    let deaf = network.nodes[late].address;
    network.fate =
        Box::new(
            move |flight| {
                if still.get() && *flight.to.ip() == deaf { vec![] } else { vec![common::DELAY] }
            },
        );
    network.reader(late, "rt/a", reliable());
    network.run_for(Duration::from_millis(50));
    is_deaf.set(false);
    assert!(network.run_until(Duration::from_millis(100), |network| is_matched(network, 0, writer, 1)));
    assert!(network.elapsed - start < Duration::from_millis(150));
}

#[test]
fn participants_of_other_domains_are_ignored() {
    let mut network = Network::new(1);
    network.join(|config| config.domain_id = 7);
    network.run_for(5 * SECOND);
    assert_eq!(network.nodes[0].participant.remote_participants().count(), 0);
    assert_eq!(network.nodes[0].count(|event| matches!(event, Event::Warning { .. })), 0);
}

#[test]
fn changed_addresses_are_followed() {
    let mut network = Network::new(2);
    let writer = network.writer(0, "rt/a", reliable());
    let reader = network.reader(1, "rt/a", reliable());
    assert!(network.run_until(SECOND, |network| is_matched(network, 0, writer, 1)));
    network.run_for(SECOND);
    let moved = std::net::Ipv4Addr::new(10, 0, 0, 99);
    network.nodes[1].address = moved;
    network.call(1, |participant, now| participant.set_addresses(now, common::addresses(moved)));
    network.write(0, writer, "to the new address");
    network.run_for(Duration::from_millis(300));
    assert_eq!(network.nodes[1].texts(reader), ["to the new address"]);
}

#[test]
fn related_identities_and_single_receivers_are_transmitted() {
    let mut network = Network::new(3);
    let writer = network.writer(0, "rr/sReply", reliable());
    let readers = [network.reader(1, "rr/sReply", reliable()), network.reader(2, "rr/sReply", reliable())];
    assert!(network.run_until(SECOND, |network| is_matched(network, 0, writer, 2)));
    network.run_for(Duration::from_millis(200));
    let related = downbeat_rtps::wire::SampleIdentity {
        writer: network.guid(2, readers[1]),
        number: downbeat_rtps::wire::SequenceNumber(7),
    };
    let mut options = WriteOptions { only_to: Some(network.guid(2, readers[1])), ..WriteOptions::default() };
    options.inline_qos.related_sample_identity = Some(related);
    network
        .call(0, |participant, now| participant.write(now, writer, payload("reply"), options))
        .expect("written");
    network.write(0, writer, "to all");
    network.run_for(SECOND);
    assert_eq!(network.nodes[1].texts(readers[0]), ["to all"]);
    assert_eq!(network.nodes[2].texts(readers[1]), ["reply", "to all"]);
    let carried = |event: &Event| matches!(event, Event::Sample { sample, .. } if sample.inline_qos.related_sample_identity == Some(related));
    assert_eq!(network.nodes[2].count(carried), 1);
}

fn living(liveliness: Liveliness, lease: Duration) -> Qos {
    Qos { liveliness, lease: Some(lease), ..reliable() }
}

fn changes(network: &Network, node: usize) -> Vec<LivelinessChange> {
    let changes = network.nodes[node].events.iter().filter_map(|event| match event {
        Event::LivelinessChanged { change, .. } => Some(*change),
        _ => None,
    });
    changes.collect()
}

#[test]
fn automatic_liveliness_lasts_as_long_as_the_participant() {
    let mut network = Network::new(2);
    let qos = living(Liveliness::Automatic, SECOND);
    network.writer(0, "rt/a", qos.clone());
    network.reader(1, "rt/a", qos.clone());
    network.reader(0, "rt/a", qos);
    network.run_for(10 * SECOND);
    assert_eq!(changes(&network, 0), [LivelinessChange::Alive]);
    assert_eq!(changes(&network, 1), [LivelinessChange::Alive]);
    network.nodes[0].is_running = false;
    network.run_for(2 * SECOND);
    assert_eq!(changes(&network, 1), [LivelinessChange::Alive, LivelinessChange::NotAlive]);
    network.run_for(20 * SECOND);
    assert_eq!(changes(&network, 1)[2..], [LivelinessChange::NotAliveRemoved]);
}

#[test]
fn manual_liveliness_is_lost_without_assertion_and_reported_on_both_sides() {
    let mut network = Network::new(2);
    let qos = living(Liveliness::ManualByTopic, SECOND);
    let writer = network.writer(0, "rt/a", qos.clone());
    let reader = network.reader(1, "rt/a", qos);
    assert!(network.run_until(SECOND, |network| is_matched(network, 1, reader, 1)));
    let lost = |event: &Event| matches!(event, Event::LivelinessLost { .. });
    network.write(0, writer, "alive");
    for _ in 0..5 {
        network.run_for(SECOND / 2);
        network.call(0, |participant, now| participant.assert_liveliness(now, writer));
    }
    assert_eq!(changes(&network, 1), [LivelinessChange::Alive]);
    assert_eq!(network.nodes[0].count(lost), 0);
    network.run_for(3 * SECOND);
    assert_eq!(changes(&network, 1), [LivelinessChange::Alive, LivelinessChange::NotAlive]);
    assert_eq!(network.nodes[0].count(lost), 1);
    network.call(0, |participant, now| participant.assert_liveliness(now, writer));
    network.run_for(SECOND / 2);
    assert_eq!(changes(&network, 1)[2..], [LivelinessChange::Revived]);
    network.call(0, |participant, now| participant.remove_endpoint(now, writer));
    network.run_for(SECOND / 2);
    assert_eq!(changes(&network, 1)[3..], [LivelinessChange::AliveRemoved]);
}

#[test]
fn missed_deadlines_are_reported_on_both_sides() {
    let mut network = Network::new(2);
    let qos = Qos { deadline: Some(SECOND), ..reliable() };
    let writer = network.writer(0, "rt/a", qos.clone());
    let reader = network.reader(1, "rt/a", qos);
    assert!(network.run_until(SECOND, |network| is_matched(network, 1, reader, 1)));
    for _ in 0..4 {
        network.write(0, writer, "in time");
        network.run_for(SECOND / 2);
    }
    let missed = |node: usize, network: &Network| {
        let counts = network.nodes[node].events.iter().filter_map(|event| match event {
            Event::DeadlineMissed { count, .. } => Some(*count),
            _ => None,
        });
        counts.sum::<u64>()
    };
    assert_eq!((missed(0, &network), missed(1, &network)), (0, 0));
    network.run_for(3 * SECOND);
    assert_eq!((missed(0, &network), missed(1, &network)), (3, 3));
}

#[test]
fn nothing_is_sent_after_acknowledgement() {
    let mut network = Network::new(2);
    let writer = network.writer(0, "rt/a", reliable());
    network.reader(1, "rt/a", reliable());
    network.run_for(SECOND);
    network.write(0, writer, "once");
    network.run_for(SECOND);
    let before: Vec<_> = network.nodes.iter().map(|node| node.sent.0).collect();
    network.run_for(60 * SECOND);
    for (node, before) in network.nodes.iter().zip(before) {
        // By multicast every 3 s, to the other every 20 s / 3.
        let sent = node.sent.0 - before;
        assert!(sent <= 21 + 9, "{sent} datagrams in a minute");
    }
}

#[test]
fn two_hundred_endpoints_match_within_100_ms() {
    let mut network = Network::new(2);
    let topics: Vec<_> = (0..100).map(|index| format!("rt/{index}")).collect();
    for topic in &topics {
        network.writer(0, topic, reliable());
        network.reader(0, topic, reliable());
        network.reader(1, topic, reliable());
    }
    let matched = |event: &Event| matches!(event, Event::Matched { .. });
    assert!(network.run_until(Duration::from_millis(100), |network| {
        network.nodes[1].count(matched) == 100 && network.nodes[0].count(matched) == 300
    }));
}

#[test]
fn samples_written_after_the_match_arrive_even_if_the_history_is_short() {
    let mut network = Network::new(2);
    let reader = network.reader(1, "rt/a", reliable());
    network.run_for(SECOND);
    // The writer's side knows the reader long before the reader's side knows the writer.
    let writer = network.writer(0, "rt/a", reliable());
    let is_matched_event = |network: &Network| {
        let is_match = |event: &Event| matches!(event, Event::Matched { local, .. } if *local == writer);
        network.nodes[0].count(is_match) == 1
    };
    assert!(!is_matched_event(&network), "the reader has not answered");
    assert!(network.run_until(Duration::from_millis(200), is_matched_event));
    for number in 0..100 {
        network.write(0, writer, &number.to_string());
    }
    network.run_for(SECOND);
    assert_eq!(network.nodes[1].texts(reader).len(), 100);
}

#[test]
fn a_known_reader_is_awaited_until_it_answers_or_leaves_and_gets_what_is_written_meanwhile() {
    let mut network = Network::new(2);
    let reader = network.reader(1, "rt/a", reliable());
    network.run_for(SECOND);
    let writer = network.writer(0, "rt/a", reliable());
    let awaited = |network: &Network| {
        let counts = network.nodes[0].events.iter().filter_map(|event| match event {
            Event::Awaiting { writer: of, count } if *of == writer => Some(*count),
            _ => None,
        });
        counts.collect::<Vec<_>>()
    };
    assert_eq!(awaited(&network), [1]);
    network.write(0, writer, "before the answer");
    network.run_for(SECOND);
    assert_eq!(awaited(&network), [1, 0]);
    assert_eq!(network.nodes[1].texts(reader), ["before the answer"]);

    let hasty = network.reader(1, "rt/a", reliable());
    assert!(network.run_until(SECOND, |network| awaited(network) == [1, 0, 1]));
    network.call(1, |participant, now| participant.remove_endpoint(now, hasty));
    network.run_for(SECOND);
    assert_eq!(awaited(&network).last(), Some(&0));
}
