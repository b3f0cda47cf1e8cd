//! What a participant has to tell its user.

use std::net::SocketAddrV4;

use super::{Fault, Sample};
use crate::{
    qos::Policy,
    wire::{EntityId, Guid, GuidPrefix},
};

/// Something that happened, in the order in which it did.
///
/// `local` is an endpoint of this participant. `remote` is any other endpoint, of this participant or of another.
#[derive(Debug, Clone)]
pub enum Event {
    /// A sample arrived.
    Sample {
        reader: EntityId,
        sample: Sample,
    },
    /// Two endpoints found each other. A reliable reader counts once it has answered a writer: only then does it surely
    /// receive what is written.
    Matched {
        local: EntityId,
        remote: Guid,
    },
    /// A matched endpoint was removed, or its participant left.
    Unmatched {
        local: EntityId,
        remote: Guid,
    },
    /// A policy keeps two endpoints of one topic from matching. Reported once for each pair.
    Incompatible {
        local: EntityId,
        remote: Guid,
        policy: Policy,
    },
    /// Two endpoints of one topic have different types. Reported once for each pair.
    OtherType {
        local: EntityId,
        remote: Guid,
    },
    /// The deadline passed `count` times since the last such event: the offered one of a writer, the requested one of a reader.
    DeadlineMissed {
        local: EntityId,
        count: u64,
    },
    /// The application did not assert a writer in time. Reported once until it does.
    LivelinessLost {
        writer: EntityId,
    },
    /// What a reader holds of a writer's life changed.
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
    /// All that was written is acknowledged by every matched reliable reader.
    Acknowledged {
        writer: EntityId,
    },
    /// After a write that was refused for want of room there is room again.
    WindowOpen {
        writer: EntityId,
    },
    EndpointFound {
        remote: Guid,
    },
    /// It announced other policies or user data.
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
    /// Bad input: `count` times since the last event of this kind, of which there is at most one a minute.
    Warning {
        fault: Fault,
        from: SocketAddrV4,
        count: u64,
    },
}

/// How the counts of alive and not alive writers of a reader change (DDS 1.4, section 2.2.4.1, `LIVELINESS_CHANGED`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LivelinessChange {
    /// One more is alive.
    Alive,
    /// One that was not alive is alive again.
    Revived,
    /// One that was alive no longer is.
    NotAlive,
    /// One that was alive is no longer matched.
    AliveRemoved,
    /// One that was not alive is no longer matched.
    NotAliveRemoved,
}

impl LivelinessChange {
    /// By how much the counts of alive and of not alive writers change.
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

/// Why a participant is no longer known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Departure {
    /// It said so.
    Disposed,
    /// Nothing was heard of it for its lease.
    LeaseRanOut,
    /// It never answered, and others needed the room.
    Crowded,
    /// The guard no longer admits it.
    Refused,
}
