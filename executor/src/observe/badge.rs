//! The module whose callback a thread is running; for logs.

use std::cell::Cell;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, RwLock};

use crate::threads::unpoisoned;

thread_local! {
    // A number and not a name, so that setting it is a single store and needs no destructor.
    static WORN: Cell<u32> = const { Cell::new(NOBODY) };
}

const NOBODY: u32 = u32::MAX;

/// The names of existing modules, by the numbers of their badges.
static NAMES: RwLock<Names> = RwLock::new(Names { by_number: Vec::new(), free: Vec::new() });

struct Names {
    by_number: Vec<Option<Named>>,
    free: Vec<u32>,
}

struct Named {
    name: Arc<str>,
    /// True while a callback of the module runs.
    is_running: Arc<AtomicBool>,
}

/// The name of the module whose callback runs on this thread; `None` outside of callbacks, in jobs, and on
/// threads that a module started itself.
///
/// For subscribers of `tracing` that show the module of a log line. The results of a module must not depend
/// on it.
///
/// ```
/// use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time, running_module};
///
/// struct Walker;
///
/// impl Module for Walker {
///     type Ports = ();
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         setup.each_run(|_, _| assert_eq!(running_module().as_deref(), Some("walker")));
///         Ok(())
///     }
/// }
///
/// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
/// core.add("walker", Walker)?;
/// core.cycle()?;
/// assert_eq!(running_module(), None);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[must_use]
pub fn running_module() -> Option<Arc<str>> {
    // The thread-local may have been destroyed while the thread ends.
    let number = WORN.try_with(Cell::get).unwrap_or(NOBODY);
    if number == NOBODY {
        return None;
    }
    let names = unpoisoned(NAMES.read());
    Some(Arc::clone(&names.by_number.get(number as usize)?.as_ref()?.name))
}

/// The names of all modules of this process whose callbacks run at this moment on any thread; for reports
/// about a core that does not respond.
///
/// ```
/// use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time, running_modules};
///
/// struct Walker;
///
/// impl Module for Walker {
///     type Ports = ();
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         setup.each_run(|_, _| {
///             let elsewhere = std::thread::spawn(running_modules).join();
///             assert!(elsewhere.is_ok_and(|names| names.iter().any(|name| &**name == "walker")));
///         });
///         Ok(())
///     }
/// }
///
/// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
/// core.add("walker", Walker)?;
/// core.cycle()?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[must_use]
pub fn running_modules() -> Vec<Arc<str>> {
    let names = unpoisoned(NAMES.read());
    let named = names.by_number.iter().flatten();
    named
        .filter(|named| named.is_running.load(Ordering::Relaxed))
        .map(|named| Arc::clone(&named.name))
        .collect()
}

/// The registered number of a module; freed when dropped.
pub(crate) struct Badge {
    number: u32,
    is_running: Arc<AtomicBool>,
}

impl Badge {
    pub(crate) fn new(name: Arc<str>) -> Self {
        let mut names = unpoisoned(NAMES.write());
        let number = names.free.pop().unwrap_or_else(|| {
            names.by_number.push(None);
            u32::try_from(names.by_number.len() - 1).unwrap_or(NOBODY)
        });
        let is_running = Arc::<AtomicBool>::default();
        if let Some(place) = names.by_number.get_mut(number as usize) {
            *place = Some(Named { name, is_running: Arc::clone(&is_running) });
        }
        Self { number, is_running }
    }

    /// Marks the module as running on this thread until the returned value is dropped.
    #[inline]
    pub(crate) fn wear(&self) -> Worn {
        WORN.set(self.number);
        self.is_running.store(true, Ordering::Relaxed);
        Worn
    }

    /// Marks the end of the callback. Destructors and log lines after it still run under the badge.
    #[inline]
    pub(crate) fn end(&self) {
        self.is_running.store(false, Ordering::Relaxed);
    }
}

impl Drop for Badge {
    fn drop(&mut self) {
        let mut names = unpoisoned(NAMES.write());
        if let Some(place) = names.by_number.get_mut(self.number as usize) {
            *place = None;
            names.free.push(self.number);
        }
    }
}

/// Marks the thread as running a module until it is dropped.
pub(crate) struct Worn;

impl Drop for Worn {
    #[inline]
    fn drop(&mut self) {
        WORN.set(NOBODY);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_badge_is_worn_by_one_thread_and_given_back() {
        let badge = Badge::new("walker".into());
        {
            let _worn = badge.wear();
            assert_eq!(running_module().as_deref(), Some("walker"));
            let elsewhere = std::thread::spawn(running_module).join();
            assert_eq!(elsewhere.ok(), Some(None));
        }
        assert_eq!(running_module(), None);
    }

    #[test]
    fn numbers_of_modules_that_are_gone_are_given_again() {
        let most = (0..1000).map(|_| Badge::new("passing".into()).number).max();
        // Tests in the same process may take numbers meanwhile, but not hundreds.
        assert!(most < Some(500));
    }
}
