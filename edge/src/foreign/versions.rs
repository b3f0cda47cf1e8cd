//! The versions of a module in another language: what it is made from, when it is made, and whether it has
//! stopped.

use super::contract::{Foreign, MakeForeign};
use super::declarations::Declarations;
use downbeat_executor::{SettingValue, Time};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A module that was loaded and set up, and has not joined a core.
pub type Prepared = (Box<dyn Foreign>, Declarations);

/// Knows the versions of one module: what its files hold or, in a replay, what they held when the bag was
/// recorded. All lives of the module share it.
pub trait Versions: Send + Sync {
    /// Loads the version that is in force now.
    ///
    /// # Errors
    /// Why it cannot be loaded.
    fn load(&self) -> Result<Box<dyn Foreign>, String>;

    /// Takes a version for the next life that another thread has prepared.
    fn take_prepared(&self) -> Option<Prepared> {
        None
    }

    /// Returns a newer version than the running one, once.
    ///
    /// # Errors
    /// Why the newer version cannot be used.
    fn successor(&self, running: &mut dyn Foreign, _now: Time) -> Result<Option<Box<dyn Foreign>>, String> {
        running.successor()
    }

    /// Describes the version that was just made, for a recording; `None` if it is the one that was described
    /// before.
    fn describe(&self, _made: Made<'_>) -> Option<Vec<u8>> {
        None
    }

    /// Notes that the module has joined or stopped.
    fn note(&self, _life: Life) {}

    /// Whether the module is asked for a successor even if it does not [ask for that](Declarations::reload).
    fn has_successors(&self) -> bool {
        false
    }

    /// When the running version was replaced, in a replay: it is asked for its successor at that time.
    fn next_reload(&self) -> Option<Time> {
        None
    }

    /// What the log calls the files; empty if there are none.
    fn source(&self) -> String {
        String::new()
    }
}

/// How a version was made.
#[derive(Clone, Copy, Debug)]
pub enum Made<'a> {
    /// At the start, or after the life before had ended. With the reason if that failed.
    Anew(Option<&'a str>),
    /// In the place of a running one, which noticed it at this time.
    Reloaded(Time),
}

/// What became of a module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Life {
    /// It has joined the core, or is active again.
    Runs,
    /// It could not be made, has ended by an error, or refused a transition.
    Stopped,
}

/// Loads the module and lets it declare what it needs.
///
/// # Errors
/// Why it cannot be loaded, or why it refuses.
pub fn prepare(
    versions: &dyn Versions,
    module: &str,
    settings: BTreeMap<String, SettingValue>,
    interfaces: &crate::Interfaces,
) -> Result<Prepared, String> {
    let mut foreign = versions.load()?;
    let mut declared = Declarations::new(module, settings).with_interfaces(interfaces.clone());
    foreign.setup(&mut declared)?;
    Ok((foreign, declared))
}

/// A module that is always made by the same closure.
pub(super) struct OneVersion(pub(super) Arc<MakeForeign>);

impl Versions for OneVersion {
    fn load(&self) -> Result<Box<dyn Foreign>, String> {
        (self.0)()
    }
}

/// Notes that the module stops if the callback ends by a panic.
pub(super) struct StopsByPanic<'a>(pub(super) &'a dyn Versions);

impl Drop for StopsByPanic<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.note(Life::Stopped);
        }
    }
}
