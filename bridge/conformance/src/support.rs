//! What the cases share: endpoints whose samples go into a channel, and waiting on a condition with a
//! watchdog.

use bytes::Bytes;
use downbeat_bridge::middleware::{Endpoint, EndpointEvent, EventHandler, Middleware, Reader, Sample};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// Generous: the machine may be busy, and transient local data of a late reader takes seconds with some
/// engines.
pub(crate) const WATCHDOG: Duration = Duration::from_secs(30);

/// Polls a condition that has no event to wait on.
pub(crate) fn wait_until(what: &str, condition: impl FnMut() -> bool) {
    assert!(holds_within(WATCHDOG, condition), "gave up waiting until {what}");
}

/// Polls a condition that may never hold.
pub(crate) fn holds_within(time: Duration, mut condition: impl FnMut() -> bool) -> bool {
    let start = Instant::now();
    while !condition() {
        if start.elapsed() > time {
            return false;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    true
}

/// A reader whose samples go into a channel.
pub(crate) fn subscribe(
    participant: &dyn Middleware,
    endpoint: &Endpoint,
) -> (Box<dyn Reader>, Receiver<Sample>) {
    let (sender, samples) = channel();
    let handler = Box::new(move |sample| {
        // The case may have stopped listening.
        let _ = sender.send(sample);
    });
    let reader = participant.create_reader(endpoint, handler);
    (reader.unwrap_or_else(|error| panic!("{error}")), samples)
}

/// The events of an endpoint, in a channel.
pub(crate) fn events(on_event: impl FnOnce(EventHandler)) -> Receiver<EndpointEvent> {
    let (sender, events) = channel();
    on_event(Box::new(move |event| {
        // The case may have stopped listening.
        let _ = sender.send(event.clone());
    }));
    events
}

pub(crate) fn next<T>(of: &Receiver<T>) -> T {
    of.recv_timeout(WATCHDOG).unwrap_or_else(|_| panic!("nothing came within the watchdog time"))
}

/// Receives until `expected` comes.
pub(crate) fn wait_for<T: PartialEq>(of: &Receiver<T>, expected: T) {
    while next(of) != expected {}
}

/// A little-endian payload with `body`.
pub(crate) fn cdr(body: impl AsRef<[u8]>) -> Bytes {
    [&[0, 1, 0, 0], body.as_ref()].concat().into()
}
