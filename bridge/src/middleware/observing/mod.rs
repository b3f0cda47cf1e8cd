//! A participant that tells of its endpoints what an engine does not: deadlines that were missed, liveliness, and messages that
//! were lost.
//!
//! All of it follows from the times and the numbers of samples, so it is the same over every engine:
//! - a **deadline** runs from the first sample on, and each period without another is told;
//! - **lost** are the numbers of a writer that a reader did not get: on their way, or since the history of either side was too
//!   short for a burst;
//! - a writer of **liveliness** `manual_by_topic` shows by each sample that it is alive (an assertion without a sample is
//!   not seen); one that is `automatic` counts as alive while it is matched.
//!
//! Nothing is measured of endpoints that nobody has asked for events ([`Writer::on_event`], [`Reader::on_event`]).

mod observation;

use super::rpc::{RpcThread, TimeLimited};
use super::{
    Endpoint, EndpointEvent, EventHandler, Gid, MatchHandler, Middleware, MiddlewareError, Reader,
    RejoinHandler, RemoteEndpoint, Sample, SampleHandler, WriteError, WriteOptions, Writer,
};
use bytes::Bytes;
use downbeat_msgs::qos::QosProfile;
use observation::{ReaderObservation, WriterObservation};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak};
use std::time::{Duration, Instant};

/// See the module.
pub struct Observing {
    inner: Box<dyn Middleware>,
    clock: Arc<QosClock>,
}

impl Observing {
    /// Observes the endpoints of a participant.
    #[must_use]
    pub fn over(inner: Box<dyn Middleware>) -> Self {
        Self { inner, clock: Arc::default() }
    }
}

impl Middleware for Observing {
    fn gid(&self) -> Gid {
        self.inner.gid()
    }

    fn create_writer(&self, endpoint: &Endpoint) -> Result<Box<dyn Writer>, MiddlewareError> {
        let inner = self.inner.create_writer(endpoint)?;
        let (qos, clock, watch) = (endpoint.qos, Arc::clone(&self.clock), OnceLock::new());
        Ok(Box::new(ObservedWriter { inner, qos, clock, watch }))
    }

    fn create_reader(
        &self,
        endpoint: &Endpoint,
        mut on_sample: SampleHandler,
    ) -> Result<Box<dyn Reader>, MiddlewareError> {
        let watch = Arc::new(OnceLock::<Arc<ReaderWatch>>::new());
        let watched = Arc::clone(&watch);
        let observed = move |sample: Sample| {
            if let Some(watch) = watched.get() {
                watch.heard(&sample);
            }
            on_sample(sample);
        };
        let inner = self.inner.create_reader(endpoint, Box::new(observed))?;
        Ok(Box::new(ObservedReader { inner, qos: endpoint.qos, clock: Arc::clone(&self.clock), watch }))
    }

    fn remote_endpoints(&self) -> Vec<RemoteEndpoint> {
        self.inner.remote_endpoints()
    }

    fn on_rejoin(&self, handler: RejoinHandler) {
        self.inner.on_rejoin(handler);
    }
}

/// The thread that keeps the times, from the first on.
#[derive(Default)]
struct QosClock(OnceLock<Option<RpcThread>>);

impl QosClock {
    fn watch(&self, limited: Weak<dyn TimeLimited>) {
        let thread = self.0.get_or_init(|| {
            let failed =
                |error| tracing::error!(%error, "deadlines and liveliness are not watched: no thread");
            RpcThread::start_named("downbeat-qos").map_err(failed).ok()
        });
        if let Some(thread) = thread {
            thread.link().watch(limited);
        }
    }

    fn look_again(&self) {
        if let Some(Some(thread)) = self.0.get() {
            thread.link().look_again();
        }
    }
}

struct ObservedWriter {
    inner: Box<dyn Writer>,
    qos: QosProfile,
    clock: Arc<QosClock>,
    watch: OnceLock<Arc<WriterWatch>>,
}

struct WriterWatch {
    clock: Arc<QosClock>,
    observation: Mutex<Option<WriterObservation>>,
    handler: Mutex<Arc<EventHandler>>,
}

impl Writer for ObservedWriter {
    fn gid(&self) -> Gid {
        self.inner.gid()
    }

    fn matched(&self) -> usize {
        self.inner.matched()
    }

    fn matched_readers(&self) -> Vec<Gid> {
        self.inner.matched_readers()
    }

    fn on_match(&self, handler: MatchHandler) {
        self.inner.on_match(handler);
    }

    fn on_event(&self, handler: EventHandler) {
        let handler = Arc::new(handler);
        let watch = self.watch.get_or_init(|| {
            let observation = WriterObservation::new(&self.qos, Instant::now());
            let is_timed = observation.is_some();
            let watch = Arc::new(WriterWatch {
                clock: Arc::clone(&self.clock),
                observation: Mutex::new(observation),
                handler: Mutex::new(Arc::clone(&handler)),
            });
            if is_timed {
                self.clock.watch(Arc::<WriterWatch>::downgrade(&watch) as _);
                self.clock.look_again();
            }
            watch
        });
        *lock(&watch.handler) = handler;
        let watch = Arc::downgrade(watch);
        self.inner.on_event(Box::new(move |event| {
            if let Some(watch) = watch.upgrade() {
                watch.tell(&[*event]);
            }
        }));
    }

    fn write_with(&self, cdr: Bytes, options: WriteOptions) -> Result<i64, WriteError> {
        let number = self.inner.write_with(cdr, options)?;
        if let Some(watch) = self.watch.get() {
            watch.wrote();
        }
        Ok(number)
    }

    fn flush(&self, timeout: Duration) -> bool {
        self.inner.flush(timeout)
    }
}

impl WriterWatch {
    fn wrote(&self) {
        let is_new = lock(&self.observation).as_mut().is_some_and(|timed| timed.wrote(Instant::now()));
        if is_new {
            self.clock.look_again();
        }
    }

    fn tell(&self, events: &[EndpointEvent]) {
        let handler = Arc::clone(&lock(&self.handler));
        events.iter().for_each(|event| handler(event));
    }
}

impl TimeLimited for WriterWatch {
    fn due(&self) -> Option<Instant> {
        lock(&self.observation).as_ref().and_then(WriterObservation::due)
    }

    fn expire(&self, now: Instant) {
        let mut events = Vec::new();
        if let Some(timed) = lock(&self.observation).as_mut() {
            timed.expire(now, &mut events);
        }
        self.tell(&events);
    }
}

struct ObservedReader {
    inner: Box<dyn Reader>,
    qos: QosProfile,
    clock: Arc<QosClock>,
    watch: Arc<OnceLock<Arc<ReaderWatch>>>,
}

struct ReaderWatch {
    clock: Arc<QosClock>,
    observation: Mutex<ReaderObservation>,
    handler: Mutex<Arc<EventHandler>>,
}

impl Reader for ObservedReader {
    fn gid(&self) -> Gid {
        self.inner.gid()
    }

    fn matched(&self) -> usize {
        self.inner.matched()
    }

    fn matched_writers(&self) -> Vec<Gid> {
        self.inner.matched_writers()
    }

    fn on_match(&self, handler: MatchHandler) {
        self.inner.on_match(handler);
    }

    fn on_event(&self, handler: EventHandler) {
        let handler = Arc::new(handler);
        let watch = self.watch.get_or_init(|| {
            let watch = Arc::new(ReaderWatch {
                clock: Arc::clone(&self.clock),
                observation: Mutex::new(ReaderObservation::new(&self.qos)),
                handler: Mutex::new(Arc::clone(&handler)),
            });
            if self.qos.deadline.is_some() || self.qos.liveliness_lease_duration.is_some() {
                self.clock.watch(Arc::<ReaderWatch>::downgrade(&watch) as _);
            }
            watch
        });
        *lock(&watch.handler) = handler;
        let watch = Arc::downgrade(watch);
        self.inner.on_event(Box::new(move |event| {
            if let Some(watch) = watch.upgrade() {
                watch.observe(|timed, now, events| timed.told(*event, now, events));
            }
        }));
    }
}

impl ReaderWatch {
    fn heard(&self, sample: &Sample) {
        self.observe(|timed, now, events| timed.heard(sample.writer, sample.sequence_number, now, events));
    }

    fn observe(&self, look: impl FnOnce(&mut ReaderObservation, Instant, &mut Vec<EndpointEvent>) -> bool) {
        // Held until all is told, so that the handler hears of it in the order in which it happened.
        let handler = lock(&self.handler);
        // Takes no memory while nothing happens.
        let mut events = Vec::new();
        if look(&mut lock(&self.observation), Instant::now(), &mut events) {
            self.clock.look_again();
        }
        events.iter().for_each(|event| (**handler)(event));
    }
}

impl TimeLimited for ReaderWatch {
    fn due(&self) -> Option<Instant> {
        lock(&self.observation).due()
    }

    fn expire(&self, now: Instant) {
        self.observe(|timed, _, events| {
            timed.expire(now, events);
            false
        });
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
