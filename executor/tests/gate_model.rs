//! The gate between the core's thread and its workers, checked under every interleaving of a few cycles.
#![allow(clippy::unwrap_used, missing_docs)]

// The file under test, with the threads and atomics of loom.
#[path = "../src/threads/gate.rs"]
mod gate;

mod sync {
    pub(super) use loom::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
    pub(super) use loom::sync::{Arc, Mutex};
    pub(super) use loom::thread::{Thread, current, park};

    pub(super) fn unpoisoned<T>(locked: std::sync::LockResult<T>) -> T {
        locked.unwrap()
    }
}

use gate::{Gate, Patience, Seat};
use loom::sync::Arc;
use loom::sync::atomic::{AtomicUsize, Ordering};
use loom::thread::JoinHandle;

/// Polls this number of times before it parks.
struct Looks {
    limit: usize,
    left: usize,
}

impl Looks {
    fn new(limit: usize) -> Self {
        Self { limit, left: 0 }
    }
}

impl Patience for Looks {
    fn begin(&mut self) {
        self.left = self.limit;
    }

    fn lasts(&mut self) -> bool {
        let lasts = self.left > 0;
        self.left = self.left.saturating_sub(1);
        lasts
    }

    fn end(&mut self) {}
}

/// The data shared by the workers of a cycle, in place of the stage.
type Shared = Arc<AtomicUsize>;

struct Worker {
    seat: Arc<Seat<Shared>>,
    thread: JoinHandle<()>,
}

impl Worker {
    /// Counts 1 for each piece of work, after `run`.
    fn start(gate: &Arc<Gate>, looks: usize, run: impl Fn() + Send + 'static) -> Self {
        let seat = Arc::new(Seat::new(Arc::clone(gate)));
        let served = Arc::clone(&seat);
        let life = move |work: Shared| {
            run();
            work.fetch_add(1, Ordering::Relaxed);
        };
        let thread = loom::thread::spawn(move || served.serve(&mut Looks::new(looks), life));
        Self { seat, thread }
    }

    fn give(&self, work: &Shared) -> Result<(), Shared> {
        self.seat.give(Arc::clone(work), self.thread.thread())
    }

    fn end(self) {
        self.seat.close(self.thread.thread());
        self.thread.join().unwrap();
    }
}

/// How the core treats work that a worker has not begun when the core's own work is done.
#[derive(Clone, Copy, PartialEq)]
enum Late {
    IsWaitedFor,
    IsTakenBack,
}

/// Runs `cycles` cycles on new workers.
fn cycles(workers: usize, cycles: usize, looks: usize, late: Late) {
    let gate = Arc::new(Gate::new());
    let workers: Vec<_> = (0..workers).map(|_| Worker::start(&gate, looks, || {})).collect();
    let mut shared = Arc::new(AtomicUsize::new(0));
    for _ in 0..cycles {
        gate.expect(workers.len());
        for worker in &workers {
            assert!(worker.give(&shared).is_ok());
        }
        let mut taken_back = 0;
        for worker in workers.iter().filter(|_| late == Late::IsTakenBack) {
            if worker.seat.take_back().is_some() {
                taken_back += 1;
                gate.arrive();
            }
        }
        gate.wait(&mut Looks::new(looks));
        // All references are gone, and all work of the cycle is done or was taken back.
        let count = Arc::get_mut(&mut shared).expect("a worker kept the work of a cycle");
        assert_eq!(count.with_mut(std::mem::take) + taken_back, workers.len());
    }
    for worker in workers {
        worker.end();
    }
}

/// Checks all interleavings with at most this number of preemptions.
fn model(preemptions: usize, check: impl Fn() + Send + Sync + 'static) {
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = Some(preemptions);
    builder.check(check);
}

#[test]
fn a_worker_that_parks_misses_no_cycle() {
    model(3, || cycles(1, 3, 0, Late::IsWaitedFor));
}

#[test]
fn a_worker_that_looks_before_it_parks_misses_no_cycle() {
    model(3, || cycles(1, 2, 1, Late::IsWaitedFor));
}

#[test]
fn work_is_done_or_taken_back_and_never_both() {
    model(3, || cycles(1, 3, 0, Late::IsTakenBack));
}

#[test]
fn the_last_of_two_workers_wakes_the_core() {
    model(2, || cycles(2, 2, 0, Late::IsWaitedFor));
}

#[test]
fn two_workers_do_their_work_or_have_it_taken_back() {
    model(2, || cycles(2, 2, 0, Late::IsTakenBack));
}

#[test]
fn an_unpark_that_was_not_meant_for_the_wait_ends_no_wait() {
    model(3, || {
        let (gate, core) = (Arc::new(Gate::new()), loom::thread::current());
        // A module with the handle of the core's thread may cause this.
        let worker = Worker::start(&gate, 0, move || core.unpark());
        let mut shared = Arc::new(AtomicUsize::new(0));
        for _ in 0..2 {
            gate.expect(1);
            assert!(worker.give(&shared).is_ok());
            gate.wait(&mut Looks::new(0));
            assert!(Arc::get_mut(&mut shared).is_some());
        }
        worker.end();
    });
}

#[test]
fn what_a_worker_did_is_seen_after_the_wait() {
    model(3, || {
        let (gate, done) = (Arc::new(Gate::new()), Arc::new(AtomicUsize::new(0)));
        let does = Arc::clone(&done);
        let worker = Worker::start(&gate, 0, move || does.store(1, Ordering::Relaxed));
        let shared = Arc::new(AtomicUsize::new(0));
        gate.expect(1);
        assert!(worker.give(&shared).is_ok());
        gate.wait(&mut Looks::new(1));
        assert_eq!(done.load(Ordering::Relaxed), 1);
        worker.end();
    });
}

#[test]
fn a_worker_that_has_ended_hands_its_work_back() {
    model(3, || {
        let gate = Arc::new(Gate::new());
        let worker = Worker::start(&gate, 0, || {});
        worker.seat.close(worker.thread.thread());
        let shared = Arc::new(AtomicUsize::new(0));
        assert!(worker.give(&shared).is_err());
        worker.thread.join().unwrap();
        assert_eq!(Arc::strong_count(&shared), 1);
    });
}
