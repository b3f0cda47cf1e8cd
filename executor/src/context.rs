//! What a callback can do.

use std::sync::Arc;

use crate::outbox::Outboxes;
use crate::setting::{SettingType, Settings};
use crate::timer::Timer;
use crate::{Publication, Setting, Time};

/// What a module owns beside its state.
pub(crate) struct ModuleIo {
    pub(crate) name: Arc<str>,
    pub(crate) outboxes: Outboxes,
    pub(crate) settings: Settings,
    pub(crate) timers: Vec<Timer>,
}

/// A callback's access to the executor. Everything it asks for takes effect in the sync phase.
pub struct Context<'a> {
    io: &'a mut ModuleIo,
    now: Time,
}

impl<'a> Context<'a> {
    pub(crate) fn new(io: &'a mut ModuleIo, now: Time) -> Self {
        Self { io, now }
    }

    pub(crate) fn io(&mut self) -> &mut ModuleIo {
        self.io
    }

    /// The time of this cycle: the same for every callback in it.
    #[must_use]
    pub fn now(&self) -> Time {
        self.now
    }

    /// The name under which the module was added.
    #[must_use]
    pub fn module_name(&self) -> &str {
        &self.io.name
    }

    /// Publishes a message: subscribers receive it in the next cycle.
    ///
    /// # Panics
    /// If this module has no such key. That of another module is not told apart where this one has a key of
    /// the same number and type.
    #[inline]
    pub fn publish<T: Send + Sync + 'static>(&mut self, publication: Publication<T>, message: T) {
        let is_own = self.io.outboxes.push(publication, message);
        assert!(is_own, "module \"{}\" published with a key of another module", self.io.name);
    }

    /// The value of a setting in this cycle.
    ///
    /// # Panics
    /// If this module has no such key. That of another module is not told apart where this one has a key of
    /// the same number and type.
    #[must_use]
    pub fn get<T: SettingType>(&self, setting: Setting<T>) -> &T {
        let value = self.io.settings.value(setting.index).and_then(T::from_value);
        match value {
            Some(value) => value,
            None => panic!("module \"{}\" read a setting with a key of another module", self.io.name),
        }
    }
}
