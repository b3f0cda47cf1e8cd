//! Shared code of the executor's tests.
#![allow(dead_code, missing_docs)]

use std::sync::{Arc, Mutex};
use std::time::Duration;

use downbeat_executor::*;

/// Longer than any wait of a test on a busy machine.
pub const WATCHDOG: Duration = Duration::from_secs(30);

/// The time between two cycles.
pub const STEP: Duration = Duration::from_millis(1);

/// The topics of the executor itself.
pub const OWN_TOPICS: [&str; 4] =
    [DetachedStep::TOPIC, SettingsChange::TOPIC, CycleRuns::TOPIC, ModuleEvent::TOPIC];

type SetUp = Box<dyn FnOnce(&mut Setup<'_, Scripted>) -> Result<(), SetupError> + Send>;

/// A module whose setup is a closure; its callbacks capture their data.
pub struct Scripted {
    set_up: Option<SetUp>,
    log: Log,
}

impl Module for Scripted {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        match self.set_up.take() {
            Some(set_up) => set_up(setup),
            None => Ok(()),
        }
    }

    fn shutdown(&mut self, ctx: &mut Context<'_>) {
        self.log.note(format!("{} ends", ctx.module_name()));
    }
}

pub fn module(
    set_up: impl FnOnce(&mut Setup<'_, Scripted>) -> Result<(), SetupError> + Send + 'static,
) -> Scripted {
    Scripted { set_up: Some(Box::new(set_up)), log: Log::default() }
}

/// A module that logs its end.
pub fn module_that_ends(
    log: &Log,
    set_up: impl FnOnce(&mut Setup<'_, Scripted>) -> Result<(), SetupError> + Send + 'static,
) -> Scripted {
    Scripted { log: log.clone(), ..module(set_up) }
}

/// A log of events in order.
#[derive(Clone, Default)]
pub struct Log(Arc<Mutex<Vec<String>>>);

impl Log {
    pub fn note(&self, entry: impl Into<String>) {
        self.0.lock().unwrap().push(entry.into());
    }

    /// Takes the entries since the last take.
    pub fn take(&self) -> Vec<String> {
        std::mem::take(&mut *self.0.lock().unwrap())
    }
}

pub fn manual_core() -> (Core, ManualClock) {
    let clock = ManualClock::new(Time::ZERO);
    (Core::new().with_clock(clock.clone()), clock)
}

/// Runs cycles, each a step after the previous one.
pub fn cycles(core: &mut Core, clock: &ManualClock, count: usize) {
    for _ in 0..count {
        core.cycle().unwrap();
        clock.advance(STEP);
    }
}

pub fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let begin = std::time::Instant::now();
    while !is_so() {
        assert!(begin.elapsed() < WATCHDOG, "{what}: not within the watchdog's time");
        std::thread::sleep(Duration::from_millis(1));
    }
}

pub fn detached() -> ModuleOptions {
    ModuleOptions { synchrony: Synchrony::Detached(Inbox::KeepAll), ..ModuleOptions::default() }
}
