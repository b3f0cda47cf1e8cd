//! What a guard tells the rest of the program.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};

use downbeat_rtps::wire::GuidPrefix;

/// The most refusals that are kept.
const MOST_REFUSALS: usize = 32;

/// The state of a guard, for tools and diagnostics. Clones show the same state.
#[derive(Debug, Clone, Default)]
pub struct Status(Arc<Mutex<Inner>>);

#[derive(Debug, Default)]
struct Inner {
    authenticated: BTreeMap<GuidPrefix, String>,
    refusals: VecDeque<String>,
    refused: u64,
}

impl Status {
    /// The subject of the certificate of an authenticated participant, such as `CN=/robot`.
    pub fn subject(&self, participant: GuidPrefix) -> Option<String> {
        self.lock(|inner| inner.authenticated.get(&participant).cloned())
    }

    /// The number of participants that have proven their identity.
    pub fn authenticated(&self) -> usize {
        self.lock(|inner| inner.authenticated.len())
    }

    /// How often somebody was refused, and the latest reasons, each a sentence.
    pub fn refusals(&self) -> (u64, Vec<String>) {
        self.lock(|inner| (inner.refused, inner.refusals.iter().cloned().collect()))
    }

    pub(super) fn admit(&self, participant: GuidPrefix, subject: &str) {
        self.lock(|inner| inner.authenticated.insert(participant, subject.to_owned()));
    }

    pub(super) fn forget(&self, participant: GuidPrefix) {
        self.lock(|inner| inner.authenticated.remove(&participant));
    }

    pub(super) fn refuse(&self, why: &str) {
        self.lock(|inner| {
            inner.refused += 1;
            if inner.refusals.len() == MOST_REFUSALS {
                inner.refusals.pop_front();
            }
            inner.refusals.push_back(why.to_owned());
        });
    }

    fn lock<T>(&self, call: impl FnOnce(&mut Inner) -> T) -> T {
        call(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
