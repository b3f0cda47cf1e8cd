//! The launcher with a fixed number of threads.

use std::num::NonZeroUsize;
use std::sync::Arc;
use std::thread::JoinHandle;

use crossbeam::channel::{Receiver, Sender, bounded};

use crate::{Launcher, Stage};

/// Why a pool could not be made.
#[derive(Debug, thiserror::Error)]
pub enum PoolError {
    /// The system gave no thread.
    #[error("cannot start a thread of the pool: {0}")]
    Thread(#[from] std::io::Error),
}

/// Divides the modules of a cycle among `n` threads, that of the core among them. Each takes the next
/// module that none has taken, so a long one does not hold up the rest.
pub struct Pool {
    workers: Vec<Worker>,
    done: Receiver<()>,
}

struct Worker {
    work: Option<Sender<Arc<Stage>>>,
    thread: Option<JoinHandle<()>>,
}

impl Pool {
    /// A pool of `threads` threads, the calling one included.
    ///
    /// # Errors
    /// If the system refuses a thread.
    pub fn new(threads: NonZeroUsize) -> Result<Self, PoolError> {
        let (report, done) = bounded(threads.get());
        let mut workers = Vec::new();
        for number in 1..threads.get() {
            let (work, stages) = bounded::<Arc<Stage>>(1);
            let report = report.clone();
            let thread = std::thread::Builder::new()
                .name(format!("pool-{number}"))
                .spawn(move || work_on(&stages, &report))?;
            workers.push(Worker { work: Some(work), thread: Some(thread) });
        }
        Ok(Self { workers, done })
    }
}

fn work_on(stages: &Receiver<Arc<Stage>>, report: &Sender<()>) {
    for stage in stages {
        // Dropped after the stage, whatever happens: the report says that this thread holds it no longer.
        let _report = ReportOnDrop(report);
        let stage = stage;
        while stage.run_next() {}
    }
}

struct ReportOnDrop<'a>(&'a Sender<()>);

impl Drop for ReportOnDrop<'_> {
    fn drop(&mut self) {
        // Nobody waits for it only when the pool is gone, and then the channel of stages ends too.
        let _ = self.0.send(());
    }
}

impl Launcher for Pool {
    fn process(&mut self, stage: &mut Arc<Stage>) {
        // A helper for each module beyond the first: fewer wake-ups in a cycle where little is due.
        let helpers = stage.runnable().saturating_sub(1).min(self.workers.len());
        let sent = self.workers[..helpers]
            .iter()
            .filter(|worker| worker.work.as_ref().is_some_and(|work| work.send(Arc::clone(stage)).is_ok()))
            .count();
        while stage.run_next() {}
        for _ in 0..sent {
            // Cannot fail while the workers live, and they live as long as the pool.
            let _ = self.done.recv();
        }
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        for worker in &mut self.workers {
            worker.work = None;
        }
        for worker in &mut self.workers {
            if let Some(thread) = worker.thread.take() {
                let _ = thread.join();
            }
        }
    }
}
