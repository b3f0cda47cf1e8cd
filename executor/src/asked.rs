//! Of which mechanisms something was asked, so that the others need not look.

/// Of which mechanisms a module has asked something in this cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Asked(u16);

impl Asked {
    pub(crate) const MESSAGES: Self = Self(1);
    pub(crate) const CALLS: Self = Self(2);
    pub(crate) const ANSWERS: Self = Self(4);
    pub(crate) const COMMANDS: Self = Self(8);
    pub(crate) const MECHANISMS: Self = Self(16);
    pub(crate) const WORK: Self = Self(32);
    /// The module's state changed, or the time for which it waits.
    pub(crate) const STATE: Self = Self(64);
    /// The module panicked.
    pub(crate) const PANIC: Self = Self(128);
    /// Not of a module: something came from another thread.
    pub(crate) const JOINED: Self = Self(256);
    /// Not of a module: holds in each sync phase.
    pub(crate) const ALWAYS: Self = Self(512);

    pub(crate) const fn or(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    #[inline]
    pub(crate) fn add(&mut self, other: Self) {
        self.0 |= other.0;
    }

    #[inline]
    pub(crate) fn has(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    pub(crate) fn is_empty(self) -> bool {
        self.0 == 0
    }
}
