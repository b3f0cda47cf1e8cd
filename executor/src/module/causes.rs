//! The causes of a run, and sets of mechanisms, as bit sets.

use crate::TraceCause;

// The numbers of the core's mechanisms, in the order of the sync phase. User-defined mechanisms follow.

/// Adds, removes and pauses modules, and handles their panics.
pub(crate) const MODULES: usize = 0;
/// Runs work outside the cycle.
pub(crate) const JOBS: usize = 1;
/// Named values of modules.
pub(crate) const SETTINGS: usize = 2;
/// Topics. Their port and view have separate fields in a module, because they are used most.
pub(crate) const MESSAGES: usize = 3;
/// Requests and responses.
pub(crate) const SERVICES: usize = 4;
/// Timers and tasks.
pub(crate) const TIMERS: usize = 5;

/// The kinds of callbacks for which a module runs, in the order in which a run calls them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Causes(u16);

impl Causes {
    pub(crate) const NONE: Self = Self(0);
    pub(crate) const SETTINGS: Self = Self(1);
    pub(crate) const RESULTS: Self = Self(1 << 1);
    pub(crate) const MESSAGES: Self = Self(1 << 2);
    pub(crate) const REQUESTS: Self = Self(1 << 3);
    pub(crate) const REPLIES: Self = Self(1 << 4);
    pub(crate) const TASKS: Self = Self(1 << 5);
    pub(crate) const TIMERS: Self = Self(1 << 6);
    pub(crate) const EACH_RUN: Self = Self(1 << 7);
    /// No kind of callback: a transition, the end of a pause, or a run in every cycle.
    pub(crate) const WOKEN: Self = Self(1 << 8);
    /// The module's first run while it is active.
    pub(crate) const START: Self = Self(1 << 9);
    /// Callbacks of transitions ran before the others.
    pub(crate) const TRANSITION: Self = Self(1 << 10);
    /// The module's last callback.
    pub(crate) const STOP: Self = Self(1 << 11);
    /// Causes that follow from time alone.
    pub(crate) const DUE: Self = Self::REPLIES.and(Self::TASKS).and(Self::TIMERS);
    /// The causes of a first run, in which every callback checks for input.
    pub(crate) const ALL: Self = Self(0x37f);

    /// The number of kinds of callbacks.
    pub(crate) const KINDS: usize = 8;

    pub(crate) const fn and(self, other: Self) -> Self {
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

    pub(crate) fn without(self, other: Self) -> Self {
        Self(self.0 & !other.0)
    }

    /// The causes whose callbacks are called before those of `other`.
    pub(crate) fn before(self, other: Self) -> Self {
        Self(self.0 & (other.0 - 1))
    }

    #[inline]
    pub(crate) fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The causes except messages, for a trace.
    pub(crate) fn traced(self) -> Vec<TraceCause> {
        if self == Self::ALL {
            return vec![TraceCause::Start];
        }
        let mut causes = self;
        let mut found = Vec::new();
        if causes.0 & Self::DUE.0 == Self::DUE.0 {
            // A due time does not distinguish between the three kinds.
            found.push(TraceCause::Time);
            causes = causes.without(Self::DUE);
        }
        let kinds = [
            (Self::SETTINGS, TraceCause::Setting),
            (Self::RESULTS, TraceCause::Result),
            (Self::REQUESTS, TraceCause::Request),
            (Self::REPLIES, TraceCause::Response),
            (Self::TASKS, TraceCause::Time),
            (Self::TIMERS, TraceCause::Time),
            (Self::WOKEN, TraceCause::Woken),
        ];
        for (kind, cause) in kinds {
            if causes.has(kind) && !found.contains(&cause) {
                found.push(cause);
            }
        }
        found
    }

    /// The position of the kind in the order of a run.
    pub(crate) fn kind(self) -> usize {
        self.0.trailing_zeros() as usize
    }

    /// Removes and returns the kind that is called first.
    #[inline]
    pub(crate) fn take_kind(&mut self) -> Option<usize> {
        let kind = self.0.trailing_zeros() as usize;
        if kind >= Self::KINDS {
            return None;
        }
        self.0 &= self.0 - 1;
        Some(kind)
    }
}

/// A set of mechanisms, by number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Asked(u64);

impl Asked {
    /// Mechanisms from this number on share a bit, and therefore run more often than necessary.
    pub(crate) const SHARED: usize = 63;

    /// The set with this one mechanism.
    #[inline]
    pub(crate) const fn of(mechanism: usize) -> Self {
        Self(1 << if mechanism < Self::SHARED { mechanism } else { Self::SHARED })
    }

    #[inline]
    pub(crate) const fn bits(self) -> u64 {
        self.0
    }

    #[inline]
    pub(crate) const fn from_bits(bits: u64) -> Self {
        Self(bits)
    }

    #[inline]
    pub(crate) const fn or(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    #[inline]
    pub(crate) fn add(&mut self, other: Self) {
        self.0 |= other.0;
    }

    #[inline]
    pub(crate) fn remove(&mut self, other: Self) {
        self.0 &= !other.0;
    }

    #[inline]
    pub(crate) fn has(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    #[inline]
    pub(crate) fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The mechanisms from this number on.
    pub(crate) fn from(self, number: usize) -> Self {
        Self(self.0 & u64::MAX.checked_shl(number as u32).unwrap_or(0))
    }

    /// Removes and returns the first mechanism.
    #[inline]
    pub(crate) fn take_first(&mut self) -> Option<usize> {
        let first = (self.0 != 0).then(|| self.0.trailing_zeros() as usize);
        self.0 &= self.0.wrapping_sub(1);
        first
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_come_out_in_the_order_of_a_run() {
        let mut causes = Causes::TIMERS.and(Causes::WOKEN).and(Causes::SETTINGS);
        assert_eq!([causes.take_kind(), causes.take_kind(), causes.take_kind()], [Some(0), Some(6), None]);
        assert!(causes.has(Causes::WOKEN));
    }

    #[test]
    fn mechanisms_come_out_in_their_order() {
        let mut asked = Asked::of(3).or(Asked::of(5)).or(Asked::of(70));
        assert_eq!(asked.from(4), Asked::of(5).or(Asked::of(63)));
        assert_eq!([asked.take_first(), asked.take_first()], [Some(3), Some(5)]);
        assert_eq!([asked.take_first(), asked.take_first()], [Some(63), None]);
    }
}
