#![allow(clippy::unwrap_used)]

use super::*;
use crate::middleware::rejoining::Rejoining;
use crate::middleware::{RejoinStep, Sample};
use bytes::Bytes;
use downbeat_msgs::qos::QosProfile;
use rustdds::{StatusEvented, WriteOptionsBuilder};
use std::sync::mpsc::channel;
use std::time::Instant;

const LONG: Duration = Duration::from_secs(60);
const DOMAIN: u16 = 154;

type Bomb = rustdds::no_key::DataWriter<OutgoingBody, SendLittleEndian>;

fn options() -> ParticipantOptions {
    ParticipantOptions { discovery_range: DiscoveryRange::Localhost, ..ParticipantOptions::new(DOMAIN) }
}

fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    let start = Instant::now();
    while !condition() {
        assert!(start.elapsed() < LONG, "gave up waiting until {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn cdr(bytes: usize) -> Bytes {
    [&[0, 1, 0, 0], &*vec![7; bytes]].concat().into()
}

/// The event loop of rustdds 0.15.1 panics, where debug assertions are on, at a sample that is fragmented and names another:
/// what [`first_fragment`] keeps from it. That is a fault of its own in its own thread, of which no call tells.
#[test]
fn a_panic_on_a_thread_of_rustdds_brings_all_endpoints_back_on_a_new_participant() {
    let bomb = Arc::new(Mutex::new(None::<Bomb>));
    let join = {
        let bomb = Arc::clone(&bomb);
        move |sink| {
            let participant = DdsParticipant::watched(&options(), sink)?;
            let endpoint = Endpoint::new("rt/bomb", "T", QosProfile::DEFAULT);
            let qos = qos::policies(&endpoint, Direction::Out)?;
            let topic = participant.topic(&endpoint, &qos).unwrap();
            let writer = participant.publisher.create_datawriter_no_key(&topic, Some(qos)).unwrap();
            bomb.lock().unwrap().get_or_insert(writer);
            Ok(Box::new(participant) as Box<dyn Middleware>)
        }
    };
    let alice = Rejoining::join(join).unwrap();
    let bob = DdsParticipant::new(&options()).unwrap();
    let chatter = Endpoint::new("rt/chatter", "T", QosProfile::DEFAULT);
    let (sender, samples) = channel();
    let on_sample = move |sample: Sample| {
        let _ = sender.send(sample.writer);
    };
    let _heard = bob.create_reader(&chatter, Box::new(on_sample)).unwrap();
    let _target =
        bob.create_reader(&Endpoint::new("rt/bomb", "T", QosProfile::DEFAULT), Box::new(|_| ())).unwrap();
    let writer = alice.create_writer(&chatter).unwrap();
    let (sender, steps) = channel();
    alice.on_rejoin(Box::new(move |step| drop(sender.send(step.clone()))));
    wait_until("the writer is matched", || writer.matched() == 1);
    writer.write(cdr(8)).unwrap();
    let before = samples.recv_timeout(LONG).unwrap();
    assert_eq!(before, writer.gid());

    let bomb = bomb.lock().unwrap().take().unwrap();
    wait_until("the bomb is matched", || bomb.try_recv_status().is_some());
    let of_nobody = rustdds::SampleIdentity { writer_guid: bomb.guid(), sequence_number: 1_i64.into() };
    let naming = WriteOptionsBuilder::new().related_sample_identity(of_nobody).build();
    let _ = bomb.write_with_options(OutgoingBody::from_cdr(cdr(200_000)).unwrap(), naming);
    drop(bomb);

    assert_eq!(steps.recv_timeout(LONG).unwrap(), RejoinStep::Leaving);
    let RejoinStep::Joined { participant, endpoints } = steps.recv_timeout(LONG).unwrap() else {
        panic!("left twice")
    };
    assert_eq!((participant, endpoints.get(&before)), (alice.gid(), Some(&writer.gid())));
    assert_ne!(writer.gid(), before);
    wait_until("the writer is matched again", || writer.matched() == 1);
    writer.write(cdr(8)).unwrap();
    assert_eq!(samples.recv_timeout(LONG).unwrap(), writer.gid());
}

#[test]
fn the_threads_of_a_participant_are_seen_and_seen_to_end() {
    let build =
        || DomainParticipantBuilder::new(DOMAIN - 1).with_only_networks([Ipv4Addr::LOCALHOST]).build();
    let (participant, threads) = EngineThreads::started_by(build).unwrap();
    assert!(!threads.is_one_gone());
    // Beyond the moment in which it answers itself.
    std::thread::sleep(ANSWERED);
    drop(participant);
    if cfg!(target_os = "linux") {
        wait_until("they have ended", || threads.is_one_gone());
    }
}
