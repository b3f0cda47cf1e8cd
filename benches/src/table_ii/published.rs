//! The times reported by the platform's authors.

use std::time::Duration;

use crate::Load;

/// A time of the published table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Published {
    /// The exact time.
    Took(Duration),
    /// An upper bound, which is the resolution of the table.
    TookLessThan(Duration),
}

impl Published {
    /// The time, or its upper bound.
    #[must_use]
    pub fn bound(self) -> Duration {
        match self {
            Self::Took(time) | Self::TookLessThan(time) => time,
        }
    }
}

/// The published time of a cell, if known. It was measured on another machine.
#[must_use]
pub fn published(load: Load) -> Option<Published> {
    match (load.modules, load.messages) {
        (10, 100) => Some(Published::TookLessThan(Duration::from_millis(1))),
        (1000, 100_000) => Some(Published::Took(Duration::from_millis(13_508))),
        _ => None,
    }
}
