//! What the tests share: domains of their own on loopback, and waiting on a condition with a watchdog.
#![allow(dead_code, clippy::unwrap_used, clippy::missing_panics_doc)]

pub mod hosts;
pub mod matrix;
pub mod rclpy;
pub mod texts;

use bytes::Bytes;
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::middleware::rtps::RtpsParticipant;
use downbeat_bridge::middleware::{DiscoveryRange, Endpoint, Middleware, ParticipantOptions, Reader, Sample};
use downbeat_executor::{Core, CoreHandle};
use std::ops::Deref;
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Generous: the machine may be busy.
pub const WATCHDOG: Duration = Duration::from_secs(30);

/// The program behind [`rclpy::Peer`].
pub const PEER_SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/rclpy/peer.py");

/// The program behind [`rclpy::Peer::cyclonedds`].
pub const CYCLONEDDS_SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/cyclonedds/peer.py");

/// Something participants can join.
pub trait Domain {
    fn join(&self) -> Box<dyn Middleware>;
}

/// A DDS domain on loopback.
pub struct Dds(pub u16);

impl Domain for Dds {
    fn join(&self) -> Box<dyn Middleware> {
        Box::new(RtpsParticipant::new(&on_loopback(self.0)).unwrap())
    }
}

impl Domain for Hub {
    fn join(&self) -> Box<dyn Middleware> {
        Box::new(Hub::join(self))
    }
}

pub fn on_loopback(domain_id: u16) -> ParticipantOptions {
    ParticipantOptions { discovery_range: DiscoveryRange::Localhost, ..ParticipantOptions::new(domain_id) }
}

/// Polls a condition that has no event to wait on.
pub fn wait_until(what: &str, mut condition: impl FnMut() -> bool) {
    let start = Instant::now();
    while !condition() {
        assert!(start.elapsed() < WATCHDOG, "gave up waiting until {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// A reader whose samples go into a channel.
pub fn subscribe(participant: &dyn Middleware, endpoint: &Endpoint) -> (Box<dyn Reader>, Receiver<Sample>) {
    let (sender, samples) = channel();
    let handler = Box::new(move |sample| {
        // The test may have stopped listening.
        let _ = sender.send(sample);
    });
    (participant.create_reader(endpoint, handler).unwrap(), samples)
}

pub fn next(samples: &Receiver<Sample>) -> Sample {
    samples.recv_timeout(WATCHDOG).expect("a sample within the watchdog time")
}

/// A little-endian payload with `body`.
pub fn cdr(body: impl AsRef<[u8]>) -> Bytes {
    [&[0, 1, 0, 0], body.as_ref()].concat().into()
}

/// A core that runs on its own thread until this is dropped.
pub struct RunningCore {
    handle: CoreHandle,
    thread: Option<JoinHandle<()>>,
}

impl RunningCore {
    pub fn start(mut core: Core) -> Self {
        let handle = core.handle();
        Self { handle, thread: Some(std::thread::spawn(move || core.run().unwrap())) }
    }
}

impl Deref for RunningCore {
    type Target = CoreHandle;

    fn deref(&self) -> &CoreHandle {
        &self.handle
    }
}

impl Drop for RunningCore {
    fn drop(&mut self) {
        self.handle.stop();
        let ended = self.thread.take().map(JoinHandle::join);
        if !std::thread::panicking() {
            ended.transpose().unwrap();
        }
    }
}
