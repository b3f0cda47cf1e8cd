//! The thread that sends what must not be dropped: Zenoh blocks the sender while a peer is slow.

use crate::middleware::{MiddlewareError, WriteError};
use crossbeam::channel::{Sender, unbounded};
use parking_lot::{Condvar, Mutex};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The most messages that wait to be sent, and the most bytes of these.
const MOST_WAITING: usize = 4096;
const MOST_BYTES: usize = 64 << 20;

type Job = (usize, Box<dyn FnOnce() + Send>);

/// Sends messages in their order on a thread of its own. Dropping it sends what waits.
pub(super) struct Outbox {
    jobs: Sender<Job>,
    waiting: Arc<Waiting>,
}

#[derive(Default)]
struct Waiting {
    /// The number of messages, and their bytes.
    now: Mutex<(usize, usize)>,
    sent: Condvar,
}

impl Outbox {
    pub(super) fn start() -> Result<Self, MiddlewareError> {
        // Bounded by `Waiting`.
        let (jobs, received) = unbounded::<Job>();
        let waiting = Arc::<Waiting>::default();
        let of_thread = Arc::clone(&waiting);
        let run = move || {
            for (bytes, job) in received {
                job();
                let mut now = of_thread.now.lock();
                *now = (now.0 - 1, now.1 - bytes);
                of_thread.sent.notify_all();
            }
        };
        std::thread::Builder::new().name("downbeat-zenoh-out".into()).spawn(run)?;
        Ok(Self { jobs, waiting })
    }

    /// Sends a message of `bytes` bytes with `job`, after those before.
    ///
    /// # Errors
    /// [`WriteError::WindowFull`] when too much waits.
    pub(super) fn send(&self, bytes: usize, job: impl FnOnce() + Send + 'static) -> Result<(), WriteError> {
        let mut now = self.waiting.now.lock();
        if now.0 >= MOST_WAITING || (now.0 > 0 && now.1 + bytes > MOST_BYTES) {
            return Err(WriteError::WindowFull);
        }
        *now = (now.0 + 1, now.1 + bytes);
        self.jobs.send((bytes, Box::new(job))).map_err(|_| WriteError::Panicked)
    }

    /// Waits until nothing waits any more, at most for `timeout`. Returns true if so.
    pub(super) fn flush(&self, timeout: Duration) -> bool {
        let until = Instant::now() + timeout;
        let mut now = self.waiting.now.lock();
        while now.0 > 0 {
            if self.waiting.sent.wait_until(&mut now, until).timed_out() {
                return now.0 == 0;
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::sync::mpsc;

    #[test]
    fn what_waits_is_bounded_and_sent_in_order() {
        let outbox = Outbox::start().unwrap();
        let (release, held) = mpsc::channel::<()>();
        let (sender, sent) = mpsc::channel();
        outbox.send(1, move || assert!(held.recv().is_err())).unwrap();
        for number in 1..MOST_WAITING {
            let sender = sender.clone();
            outbox.send(1, move || sender.send(number).unwrap()).unwrap();
        }
        assert_eq!(outbox.send(1, || ()), Err(WriteError::WindowFull));
        assert!(!outbox.flush(Duration::from_millis(1)));
        drop((release, sender));
        assert!(outbox.flush(Duration::from_secs(60)));
        assert!(sent.iter().eq(1..MOST_WAITING));
        let most = MOST_BYTES;
        outbox.send(most * 2, || ()).unwrap();
    }
}
