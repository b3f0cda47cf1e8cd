//! Synchronises the core's thread with its workers in each cycle.
//!
//! The core's thread gives work to the *seats* of workers and waits at the *gate* until all workers have
//! arrived. Each side polls for a short while and then parks, and is unparked only by the event for which it
//! waits. The state of a seat alone decides which thread may access its work, so its lock is never contended:
//!
//! ```text
//!            give                  serve
//!   Idle ───────────────► Ready ───────────► Busy ───► Idle, and arrives at the gate
//!    │ ▲                   ▲ │
//!    │ └───── take_back ───┼─┘
//!    └──► Parked ──────────┘ give, which unparks
//! ```
//!
//! `tests/gate_model.rs` checks this file under all interleavings of a few cycles.

use crossbeam::utils::CachePadded;

use super::sync::{Arc, AtomicU32, AtomicUsize, Mutex, Ordering, Thread, current, park, unpoisoned};

/// How long a thread polls before it parks.
pub(crate) trait Patience {
    /// Called when a wait begins.
    fn begin(&mut self);
    /// Called after each unsuccessful poll; false if the thread should park.
    fn lasts(&mut self) -> bool;
    /// Called when the wait has ended.
    fn end(&mut self);
}

/// Counts the workers that have yet to arrive.
#[derive(Debug)]
pub(crate) struct Gate {
    /// The number of workers that have not arrived, plus [`WAITING`] if the core's thread is about to park.
    missing: CachePadded<AtomicUsize>,
    waiter: Mutex<Option<Thread>>,
}

const WAITING: usize = 1 << (usize::BITS - 1);

/// The place where one worker receives its work.
#[derive(Debug)]
pub(crate) struct Seat<T> {
    place: CachePadded<Place<T>>,
    gate: Arc<Gate>,
}

#[derive(Debug)]
struct Place<T> {
    state: AtomicU32,
    work: Mutex<Option<T>>,
}

/// The worker polls for work.
const IDLE: u32 = 0;
/// The worker is parked, or about to park.
const PARKED: u32 = 1;
/// Work is available, and the worker has not taken it.
const READY: u32 = 2;
/// The worker is running its work.
const BUSY: u32 = 3;
/// The worker has ended, or must end.
const CLOSED: u32 = 4;

impl Gate {
    pub(crate) fn new() -> Self {
        Self { missing: CachePadded::new(AtomicUsize::new(0)), waiter: Mutex::new(None) }
    }

    /// Sets the number of workers that must arrive. Called while none is outstanding.
    pub(crate) fn expect(&self, count: usize) {
        self.missing.store(count, Ordering::Relaxed);
    }

    /// Reports the arrival of one worker.
    pub(crate) fn arrive(&self) {
        if self.missing.fetch_sub(1, Ordering::AcqRel) == WAITING | 1 {
            // The waiter stays in its place: this may already be the wait of a later cycle, whose last
            // arrival needs it.
            let waiter = unpoisoned(self.waiter.lock()).clone();
            if let Some(waiter) = waiter {
                waiter.unpark();
            }
        }
    }

    /// Waits until all expected workers have arrived. Their writes are visible afterwards.
    pub(crate) fn wait(&self, patience: &mut impl Patience) {
        if self.missing.load(Ordering::Acquire) == 0 {
            return;
        }
        patience.begin();
        while self.missing.load(Ordering::Acquire) != 0 {
            if !patience.lasts() {
                self.park();
                break;
            }
        }
        patience.end();
    }

    fn park(&self) {
        *unpoisoned(self.waiter.lock()) = Some(current());
        if self.missing.fetch_or(WAITING, Ordering::AcqRel) != 0 {
            while self.missing.load(Ordering::Acquire) != WAITING {
                park();
            }
        }
        self.missing.store(0, Ordering::Relaxed);
    }
}

impl<T> Seat<T> {
    /// A seat whose worker arrives at `gate`.
    pub(crate) fn new(gate: Arc<Gate>) -> Self {
        let place = Place { state: AtomicU32::new(IDLE), work: Mutex::new(None) };
        Self { place: CachePadded::new(place), gate }
    }

    /// Gives work to the worker, which runs on `thread`. Called only if the worker has none.
    ///
    /// # Errors
    /// Returns the work if the worker has ended.
    pub(crate) fn give(&self, work: T, thread: &Thread) -> Result<(), T> {
        self.put(Some(work));
        if self.change(IDLE, READY) {
            return Ok(());
        }
        // Between cycles, the worker can only have parked or ended.
        if self.change(PARKED, READY) {
            thread.unpark();
            return Ok(());
        }
        self.put(None).map_or(Ok(()), Err)
    }

    /// Takes back work that the worker has not begun. The worker will not arrive for it.
    pub(crate) fn take_back(&self) -> Option<T> {
        self.change(READY, IDLE).then(|| self.put(None)).flatten()
    }

    /// Ends the worker, which runs on `thread`, after its current work.
    pub(crate) fn close(&self, thread: &Thread) {
        self.place.state.swap(CLOSED, Ordering::AcqRel);
        thread.unpark();
    }

    /// The loop of the worker: runs its work until the seat is closed. Arrives at the gate after each run,
    /// when `run` has returned and dropped the work.
    pub(crate) fn serve(&self, patience: &mut impl Patience, mut run: impl FnMut(T)) {
        while self.is_taken(patience) {
            let arrival = Arrival(self);
            if let Some(work) = self.put(None) {
                run(work);
            }
            drop(arrival);
        }
    }

    /// Waits for work and takes it; false if the seat is closed.
    fn is_taken(&self, patience: &mut impl Patience) -> bool {
        patience.begin();
        loop {
            match self.place.state.load(Ordering::Acquire) {
                READY => {
                    if self.change(READY, BUSY) {
                        patience.end();
                        return true;
                    }
                }
                CLOSED => return false,
                _ if patience.lasts() => {}
                _ => {
                    if self.change(IDLE, PARKED) {
                        while self.place.state.load(Ordering::Acquire) == PARKED {
                            park();
                        }
                        // The worker was woken by work, even if that has been taken back; more work may
                        // follow soon.
                        patience.end();
                        patience.begin();
                    }
                }
            }
        }
    }

    fn change(&self, from: u32, to: u32) -> bool {
        self.place.state.compare_exchange(from, to, Ordering::AcqRel, Ordering::Relaxed).is_ok()
    }

    fn put(&self, work: Option<T>) -> Option<T> {
        std::mem::replace(&mut *unpoisoned(self.place.work.lock()), work)
    }
}

/// Arrives at the gate when dropped, so that a panic of a worker does not block the core's thread.
struct Arrival<'a, T>(&'a Seat<T>);

impl<T> Drop for Arrival<'_, T> {
    fn drop(&mut self) {
        let next = if std::thread::panicking() { CLOSED } else { IDLE };
        self.0.change(BUSY, next);
        self.0.gate.arrive();
    }
}
