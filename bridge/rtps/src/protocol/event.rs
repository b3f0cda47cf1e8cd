//! Events of a participant.

use std::net::SocketAddrV4;
use std::sync::Arc;

use super::{Fault, Report, Sample};
use crate::{
    qos::Policy,
    wire::{EntityId, Guid, GuidPrefix},
};

/// An event. Events are reported in the order in which they happened.
///
/// `local` is an endpoint of this participant. `remote` is any other endpoint, of this or another
/// participant.
#[derive(Debug, Clone)]
pub enum Event {
    /// A sample arrived.
    Sample {
        reader: EntityId,
        sample: Sample,
    },
    /// Two endpoints discovered each other. A reliable reader counts as matched once it has answered the
    /// writer, because only then is it certain to receive samples.
    Matched {
        local: EntityId,
        remote: Guid,
    },
    /// This many known reliable readers have yet to answer a writer. Samples are kept for them.
    Awaiting {
        writer: EntityId,
        count: usize,
    },
    /// A matched endpoint was removed, or its participant left.
    Unmatched {
        local: EntityId,
        remote: Guid,
    },
    /// A policy prevents two endpoints of a topic from matching. Reported once for each pair.
    Incompatible {
        local: EntityId,
        remote: Guid,
        policy: Policy,
    },
    /// Two endpoints of a topic have different types. Reported once for each pair.
    OtherType {
        local: EntityId,
        remote: Guid,
        /// The type of `remote`.
        type_name: Arc<str>,
    },
    /// The deadline was missed `count` times since the last such event: the offered deadline of a writer or
    /// the requested deadline of a reader.
    DeadlineMissed {
        local: EntityId,
        count: u64,
    },
    /// The application did not assert a writer in time. Reported once until it does.
    LivelinessLost {
        writer: EntityId,
    },
    /// The liveliness of a matched writer changed.
    LivelinessChanged {
        reader: EntityId,
        writer: Guid,
        change: LivelinessChange,
    },
    /// `count` samples will never arrive: the writer no longer has them, or they were dropped here.
    Lost {
        reader: EntityId,
        writer: Guid,
        count: u64,
    },
    /// Every matched reliable reader has acknowledged all samples.
    Acknowledged {
        writer: EntityId,
    },
    /// A matched reader knows no samples of a writer any more: its participant had given this one up, for
    /// example because it was suspended for longer than its lease, and has found it again.
    BegunAnew {
        writer: EntityId,
        reader: Guid,
    },
    /// There is room again after a write was refused because the window was full.
    WindowOpen {
        writer: EntityId,
    },
    EndpointFound {
        remote: Guid,
    },
    /// A remote endpoint announced changed policies or user data.
    EndpointChanged {
        remote: Guid,
    },
    EndpointLeft {
        remote: Guid,
    },
    ParticipantFound {
        remote: GuidPrefix,
    },
    ParticipantLeft {
        remote: GuidPrefix,
        reason: Departure,
    },
    /// The guard reports something to the user.
    Security(Report),
    /// Invalid input was received `count` times since the last event of this kind, which is reported at most
    /// once a minute.
    Warning {
        fault: Fault,
        from: SocketAddrV4,
        count: u64,
    },
}

/// How the counts of alive and not alive writers of a reader change (DDS 1.4, section 2.2.4.1,
/// `LIVELINESS_CHANGED`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LivelinessChange {
    /// One more writer is alive.
    Alive,
    /// A writer that was not alive is alive again.
    Revived,
    /// A writer that was alive is no longer alive.
    NotAlive,
    /// A writer that was alive is no longer matched.
    AliveRemoved,
    /// A writer that was not alive is no longer matched.
    NotAliveRemoved,
}

impl LivelinessChange {
    /// Returns the changes of the counts of alive and not alive writers.
    pub fn counts(self) -> (i32, i32) {
        match self {
            Self::Alive => (1, 0),
            Self::Revived => (1, -1),
            Self::NotAlive => (-1, 1),
            Self::AliveRemoved => (-1, 0),
            Self::NotAliveRemoved => (0, -1),
        }
    }
}

/// Why a participant was removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Departure {
    /// It announced its departure.
    Disposed,
    /// No message arrived from it within its lease.
    LeaseRanOut,
    /// It was never validated, and its host has no open port at its address, or wrong acknowledgements came
    /// in its name.
    Unreachable,
    /// It never answered, and the room was needed for others.
    Crowded,
    /// The guard no longer admits it.
    Refused,
}
