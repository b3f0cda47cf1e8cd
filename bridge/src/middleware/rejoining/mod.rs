//! A participant that leaves its domain and joins it again, with all its endpoints, when its engine has lost touch.
//!
//! Two things bring that about. The engine may fail: a panic inside it, a thread of its that cannot go on. Or a peer
//! comes back after the network was away for longer than that peer's lease and shorter than ours (20 s of Fast DDS, 50 s of
//! rustdds): we have forgotten it, it has not forgotten us, and so it does not tell again which endpoints it has. A
//! participant with a new identity is new to everybody.
//!
//! What owns endpoints keeps them, and what was written last on transient local ones is written again. While the
//! participant is away, some 100 ms, samples of others are missed and writes are refused.

mod slot;

use super::{
    Endpoint, Gid, Middleware, MiddlewareError, Reader, RejoinHandler, RejoinStep, RemoteEndpoint,
    SampleHandler, Writer,
};
use crossbeam::channel::{Receiver, RecvTimeoutError, Sender, bounded};
use slot::{ReaderSlot, RejoiningReader, RejoiningWriter, WriterSlot};
use std::collections::BTreeMap;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Several peers come back one after another when a network does.
const SETTLING: Duration = Duration::from_millis(500);

/// Between one attempt to join and the next, and at the least between one rejoining and the next.
const PAUSE: Duration = Duration::from_secs(5);

/// Trouble that waits to be seen to; what is more says nothing new.
const MOST_TROUBLE: usize = 64;

/// How long an engine may take to end.
const BURIAL: Duration = Duration::from_secs(5);

/// Why a participant has lost touch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Trouble {
    /// A participant whose lease had run out is there again.
    PeerReturned(Gid),
    /// The engine failed.
    Engine(String),
}

impl fmt::Display for Trouble {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PeerReturned(peer) => write!(f, "participant {peer} was out of reach and is there again"),
            Self::Engine(problem) => write!(f, "the engine failed: {problem}"),
        }
    }
}

/// Where an engine tells its trouble, from any thread.
#[derive(Clone)]
pub struct TroubleSink(Sender<Event>);

impl TroubleSink {
    /// Tells it. Never blocks.
    pub fn tell(&self, trouble: Trouble) {
        let _ = self.0.try_send(Event::Trouble(trouble));
    }
}

enum Event {
    Trouble(Trouble),
    Stop,
}

/// Joins the domain with an engine that tells its trouble.
type Join = dyn Fn(TroubleSink) -> Result<Box<dyn Middleware>, MiddlewareError> + Send + Sync;

/// See the module.
pub struct Rejoining {
    shared: Arc<Shared>,
    events: Sender<Event>,
    supervisor: Option<JoinHandle<()>>,
}

struct Shared {
    join: Box<Join>,
    sink: TroubleSink,
    now: Mutex<Now>,
    on_rejoin: Mutex<Vec<RejoinHandler>>,
}

struct Now {
    gid: Gid,
    /// Nothing while it is away.
    engine: Option<Box<dyn Middleware>>,
    writers: Vec<Weak<WriterSlot>>,
    readers: Vec<Weak<ReaderSlot>>,
}

impl Rejoining {
    /// Joins the domain for the first time.
    ///
    /// # Errors
    /// Those of `join`, and [`MiddlewareError::Supervisor`] when no thread can be had to watch over the engine.
    pub fn join(
        join: impl Fn(TroubleSink) -> Result<Box<dyn Middleware>, MiddlewareError> + Send + Sync + 'static,
    ) -> Result<Self, MiddlewareError> {
        let (events, received) = bounded(MOST_TROUBLE);
        let sink = TroubleSink(events.clone());
        let engine = join(sink.clone())?;
        let now = Now { gid: engine.gid(), engine: Some(engine), writers: Vec::new(), readers: Vec::new() };
        let (join, now) = (Box::new(join), Mutex::new(now));
        let shared = Arc::new(Shared { join, sink, now, on_rejoin: Mutex::default() });
        let supervised = Arc::clone(&shared);
        let supervisor = std::thread::Builder::new()
            .name("downbeat-rejoin".to_owned())
            .spawn(move || supervise(&supervised, &received))
            .map_err(MiddlewareError::Supervisor)?;
        Ok(Self { shared, events, supervisor: Some(supervisor) })
    }
}

impl Middleware for Rejoining {
    fn gid(&self) -> Gid {
        lock(&self.shared.now).gid
    }

    fn create_writer(&self, endpoint: &Endpoint) -> Result<Box<dyn Writer>, MiddlewareError> {
        let mut now = lock(&self.shared.now);
        let writer = now.engine()?.create_writer(endpoint)?;
        let slot = Arc::new(WriterSlot::new(endpoint.clone(), writer, self.shared.sink.clone()));
        now.writers.push(Arc::downgrade(&slot));
        Ok(Box::new(RejoiningWriter(slot)))
    }

    fn create_reader(
        &self,
        endpoint: &Endpoint,
        on_sample: SampleHandler,
    ) -> Result<Box<dyn Reader>, MiddlewareError> {
        let on_sample = Arc::new(Mutex::new(on_sample));
        let mut now = lock(&self.shared.now);
        let reader = now.engine()?.create_reader(endpoint, slot::hand_to(&on_sample))?;
        let slot = Arc::new(ReaderSlot::new(endpoint.clone(), reader, on_sample));
        now.readers.push(Arc::downgrade(&slot));
        Ok(Box::new(RejoiningReader(slot)))
    }

    fn remote_endpoints(&self) -> Vec<RemoteEndpoint> {
        let now = lock(&self.shared.now);
        now.engine.as_ref().map(|engine| engine.remote_endpoints()).unwrap_or_default()
    }

    fn on_rejoin(&self, handler: RejoinHandler) {
        lock(&self.shared.on_rejoin).push(handler);
    }
}

impl Drop for Rejoining {
    fn drop(&mut self) {
        // Waits where there is much trouble, which the supervisor takes in at all times but while it joins.
        let _ = self.events.send(Event::Stop);
        if let Some(supervisor) = self.supervisor.take() {
            let _ = supervisor.join();
        }
        let engine = lock(&self.shared.now).engine.take();
        drop(engine);
    }
}

impl Now {
    fn engine(&mut self) -> Result<&dyn Middleware, MiddlewareError> {
        self.writers.retain(|slot| slot.strong_count() > 0);
        self.readers.retain(|slot| slot.strong_count() > 0);
        self.engine.as_deref().ok_or(MiddlewareError::Away)
    }

    fn slots(&self) -> (Vec<Arc<WriterSlot>>, Vec<Arc<ReaderSlot>>) {
        let writers = self.writers.iter().filter_map(Weak::upgrade).collect();
        (writers, self.readers.iter().filter_map(Weak::upgrade).collect())
    }
}

/// Rejoins whenever there is trouble, until it is stopped.
fn supervise(shared: &Shared, events: &Receiver<Event>) {
    let mut waiting = None;
    loop {
        let event = waiting.take().map_or_else(|| events.recv(), |trouble| Ok(Event::Trouble(trouble)));
        let Ok(Event::Trouble(trouble)) = event else { return };
        tracing::warn!("leaving the domain to join it again: {trouble}");
        if wait(SETTLING, events).is_err() {
            return;
        }
        shared.leave();
        while let Err(error) = shared.join_again() {
            tracing::error!(%error, "the domain cannot be joined again; the next attempt is in {PAUSE:?}");
            if wait(PAUSE, events).is_err() {
                return;
            }
        }
        tracing::info!("joined the domain again");
        match wait(PAUSE, events) {
            Ok(trouble) => waiting = trouble,
            Err(Stopped) => return,
        }
    }
}

struct Stopped;

/// Waits all of that time, and returns the last trouble that came in it.
fn wait(time: Duration, events: &Receiver<Event>) -> Result<Option<Trouble>, Stopped> {
    let deadline = Instant::now() + time;
    let mut last = None;
    loop {
        match events.recv_deadline(deadline) {
            Ok(Event::Trouble(trouble)) => last = Some(trouble),
            Ok(Event::Stop) | Err(RecvTimeoutError::Disconnected) => return Err(Stopped),
            Err(RecvTimeoutError::Timeout) => return Ok(last),
        }
    }
}

impl Shared {
    /// Takes all endpoints and the participant away; the others are told.
    fn leave(&self) {
        self.tell(&RejoinStep::Leaving);
        let mut now = lock(&self.now);
        let (writers, readers) = now.slots();
        let engine = now.engine.take();
        drop(now);
        // Outside of all locks: handlers that still run ask for them.
        let writing = writers.iter().filter_map(|slot| slot.leave()).collect();
        let reading = readers.iter().filter_map(|slot| slot.leave()).collect();
        bury(writing, reading, engine);
        writers.iter().for_each(|slot| slot.tell_unmatched());
        readers.iter().for_each(|slot| slot.tell_unmatched());
    }

    fn join_again(&self) -> Result<(), MiddlewareError> {
        let engine = (self.join)(self.sink.clone())?;
        let mut now = lock(&self.now);
        let (writers, readers) = now.slots();
        let mut endpoints = BTreeMap::new();
        let moved = writers
            .iter()
            .map(|slot| slot.create_on(&*engine))
            .chain(readers.iter().map(|slot| slot.create_on(&*engine)));
        for moved in moved {
            match moved {
                Ok((before, after)) => drop(endpoints.insert(before, after)),
                Err(error) => tracing::error!(%error, "an endpoint is gone until the program starts again"),
            }
        }
        let participant = engine.gid();
        (now.gid, now.engine) = (participant, Some(engine));
        drop(now);
        self.tell(&RejoinStep::Joined { participant, endpoints });
        writers.iter().for_each(|slot| slot.tell_matches());
        readers.iter().for_each(|slot| slot.tell_matches());
        Ok(())
    }

    fn tell(&self, step: &RejoinStep) {
        lock(&self.on_rejoin).iter().for_each(|handler| handler(step));
    }
}

/// Drops an engine with its endpoints, which may have failed: it may panic again, or not come to an end. Then it is left
/// behind.
fn bury(writers: Vec<Box<dyn Writer>>, readers: Vec<Box<dyn Reader>>, engine: Option<Box<dyn Middleware>>) {
    let (done, end) = bounded::<()>(0);
    let drop_all = move || {
        let _done = done;
        // Each by itself: two panics at once would end the program.
        writers.into_iter().for_each(drop_guarded);
        readers.into_iter().for_each(drop_guarded);
        drop_guarded(engine);
    };
    match std::thread::Builder::new().name("downbeat-bury".to_owned()).spawn(drop_all) {
        // Ends when the thread drops its end of the channel.
        Ok(_) if end.recv_timeout(BURIAL) == Err(RecvTimeoutError::Timeout) => {
            tracing::warn!("the engine that failed does not end, and is left behind");
        }
        Ok(_) => {}
        Err(error) => tracing::warn!(%error, "no thread to end the old engine on"),
    }
}

fn drop_guarded<T>(what: T) {
    if catch_unwind(AssertUnwindSafe(|| drop(what))).is_err() {
        tracing::warn!("the engine that failed panicked again when it was ended");
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
