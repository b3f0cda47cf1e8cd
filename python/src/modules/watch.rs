//! Reports callbacks that do not return, with the line of Python that they are in.

use parking_lot::Mutex;
use pyo3::prelude::*;
use std::cell::Cell;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

/// How long a callback of a module without a deadline may take unreported.
const PATIENCE: Duration = Duration::from_secs(1);
const PERIOD: Duration = Duration::from_millis(50);

/// The callbacks of one module.
pub(super) struct Watch(Arc<Watched>);

/// A callback is running while this lives.
pub(super) struct Running<'a>(&'a Watched);

struct Watched {
    module: String,
    patience: Duration,
    run: Mutex<Option<Run>>,
}

struct Run {
    /// The identity that Python gives the thread.
    thread: u64,
    since: Instant,
    /// When the run is reported, or reported again.
    report_after: Duration,
}

static ALL: Mutex<Vec<Weak<Watched>>> = Mutex::new(Vec::new());

impl Watch {
    pub(super) fn new(module: &str, deadline: Option<Duration>) -> Self {
        let patience = deadline.unwrap_or(PATIENCE);
        let watched = Arc::new(Watched { module: module.to_owned(), patience, run: Mutex::default() });
        let mut all = ALL.lock();
        if all.is_empty() {
            let started = std::thread::Builder::new().name("python watch".to_owned()).spawn(watch);
            if let Err(error) = started {
                tracing::warn!("callbacks that do not return will not be reported: {error}");
            }
        }
        all.push(Arc::downgrade(&watched));
        Self(watched)
    }

    pub(super) fn begin(&self, py: Python<'_>) -> Running<'_> {
        let (thread, since) = (thread_identity(py), Instant::now());
        *self.0.run.lock() = Some(Run { thread, since, report_after: self.0.patience });
        Running(&self.0)
    }
}

impl Drop for Running<'_> {
    fn drop(&mut self) {
        *self.0.run.lock() = None;
    }
}

/// Runs until no module is left.
fn watch() {
    loop {
        std::thread::sleep(PERIOD);
        let mut all = ALL.lock();
        all.retain(|watched| watched.strong_count() > 0);
        if all.is_empty() {
            return;
        }
        let watched: Vec<_> = all.iter().filter_map(Weak::upgrade).collect();
        drop(all);
        watched.iter().for_each(|watched| watched.look());
    }
}

impl Watched {
    fn look(&self) {
        let late = self.run.lock().as_mut().and_then(|run| {
            let elapsed = run.since.elapsed();
            let is_late = elapsed >= run.report_after;
            is_late.then(|| {
                run.report_after = elapsed * 10;
                (run.thread, elapsed)
            })
        });
        let Some((thread, elapsed)) = late else { return };
        // Attaching waits for whoever holds the interpreter lock: this thread has nothing else to do.
        let place = Python::attach(|py| {
            let place = py.import("downbeat.loading")?.call_method1("place_of_thread", (thread,))?;
            place.extract::<Option<String>>()
        });
        if let Ok(Some(place)) = place {
            let module = &*self.module;
            tracing::warn!(module, "has not returned for {:.3} s: {place}", elapsed.as_secs_f64());
        }
    }
}

fn thread_identity(py: Python<'_>) -> u64 {
    thread_local!(static IDENTITY: Cell<u64> = const { Cell::new(0) });
    IDENTITY.with(|identity| {
        if identity.get() == 0 {
            let found = py.import("threading").and_then(|module| module.call_method0("get_ident"));
            identity.set(found.and_then(|found| found.extract()).unwrap_or(u64::MAX));
        }
        identity.get()
    })
}
