//! The builtin endpoints that announce something.

use crate::{
    qos::History,
    wire::{BuiltinEndpoints, EntityId},
};

/// A writer and a reader that each participant has, and the bits by which it announces them.
#[derive(Debug, Clone, Copy)]
pub struct Builtin {
    pub writer: EntityId,
    pub reader: EntityId,
    pub writer_bit: u32,
    pub reader_bit: u32,
}

impl Builtin {
    /// How much of it concerns those that join later: all announced endpoints, the last assertion, the
    /// current data of the participant.
    pub(crate) fn history(&self) -> History {
        match self.writer {
            EntityId::WLP_WRITER | EntityId::WLP_SECURE_WRITER | EntityId::SPDP_SECURE_WRITER => {
                History::KeepLast(1)
            }
            _ => History::KeepAll,
        }
    }
}

pub(crate) const BUILTIN: [Builtin; 3] = [
    Builtin {
        writer: EntityId::SEDP_PUBLICATIONS_WRITER,
        reader: EntityId::SEDP_PUBLICATIONS_READER,
        writer_bit: BuiltinEndpoints::SEDP_PUBLICATIONS_WRITER,
        reader_bit: BuiltinEndpoints::SEDP_PUBLICATIONS_READER,
    },
    Builtin {
        writer: EntityId::SEDP_SUBSCRIPTIONS_WRITER,
        reader: EntityId::SEDP_SUBSCRIPTIONS_READER,
        writer_bit: BuiltinEndpoints::SEDP_SUBSCRIPTIONS_WRITER,
        reader_bit: BuiltinEndpoints::SEDP_SUBSCRIPTIONS_READER,
    },
    Builtin {
        writer: EntityId::WLP_WRITER,
        reader: EntityId::WLP_READER,
        writer_bit: BuiltinEndpoints::WLP_WRITER,
        reader_bit: BuiltinEndpoints::WLP_READER,
    },
];

/// Those whose messages are protected, for authenticated participants.
pub const BUILTIN_OF_SECURITY: [Builtin; 4] = [
    Builtin {
        writer: EntityId::SEDP_PUBLICATIONS_SECURE_WRITER,
        reader: EntityId::SEDP_PUBLICATIONS_SECURE_READER,
        writer_bit: BuiltinEndpoints::SEDP_PUBLICATIONS_SECURE_WRITER,
        reader_bit: BuiltinEndpoints::SEDP_PUBLICATIONS_SECURE_READER,
    },
    Builtin {
        writer: EntityId::SEDP_SUBSCRIPTIONS_SECURE_WRITER,
        reader: EntityId::SEDP_SUBSCRIPTIONS_SECURE_READER,
        writer_bit: BuiltinEndpoints::SEDP_SUBSCRIPTIONS_SECURE_WRITER,
        reader_bit: BuiltinEndpoints::SEDP_SUBSCRIPTIONS_SECURE_READER,
    },
    Builtin {
        writer: EntityId::WLP_SECURE_WRITER,
        reader: EntityId::WLP_SECURE_READER,
        writer_bit: BuiltinEndpoints::WLP_SECURE_WRITER,
        reader_bit: BuiltinEndpoints::WLP_SECURE_READER,
    },
    Builtin {
        writer: EntityId::SPDP_SECURE_WRITER,
        reader: EntityId::SPDP_SECURE_READER,
        writer_bit: BuiltinEndpoints::SPDP_SECURE_WRITER,
        reader_bit: BuiltinEndpoints::SPDP_SECURE_READER,
    },
];

/// All of them.
pub(super) fn all() -> impl Iterator<Item = Builtin> {
    BUILTIN.into_iter().chain(BUILTIN_OF_SECURITY)
}
