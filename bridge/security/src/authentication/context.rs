//! What a handshake takes and gives.

use std::time::{Duration, Instant, SystemTime};

use downbeat_rtps::wire::{EntityId, Guid};

use super::identity::{Identity, RemoteIdentity, SharedSecret};
use super::refusal::{Refusal, shown};
use crate::tokens::{GenericMessage, Token, class};

/// After this time without a result it is reported why, and the initiator pauses for as long.
pub(super) const GIVE_UP: Duration = Duration::from_secs(60);

/// What a handshake takes from its surroundings.
pub struct Context<'a> {
    /// Of the own participant.
    pub identity: &'a Identity,
    /// The own announcement, as a big-endian parameter list without encapsulation. It must hold the GUID.
    pub participant_data: &'a [u8],
    /// Fills a slice with random bytes, of the quality that keys need.
    pub random: &'a mut dyn FnMut(&mut [u8]),
    /// The number of the last message over the stateless channel, to any participant.
    pub last_number: &'a mut i64,
    /// The steady clock.
    pub now: Instant,
    /// The time of day, to which certificates must be valid.
    pub time: SystemTime,
}

/// What a handshake wants, in this order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Output {
    /// To send a message over the stateless channel.
    Send(GenericMessage),
    /// The other participant has proven its identity. If it loses its state and proves itself again, this
    /// comes again, with another secret that replaces the one before.
    Done {
        /// What it has proven.
        remote: Box<RemoteIdentity>,
        /// Known to the two participants only.
        secret: SharedSecret,
    },
    /// A message was dropped. The handshake goes on, because anyone can send a wrong message.
    Refused(Refusal),
    /// There is no result for a minute, for the last reason seen. The handshake begins again later.
    GaveUp(Refusal),
}

/// The two participants.
#[derive(Clone, Copy, Debug)]
pub(super) struct Peers {
    pub(super) local: Guid,
    pub(super) remote: Guid,
}

impl Peers {
    /// Addresses a token to the other participant. `related` is the message that it answers.
    pub(super) fn message(
        self,
        token: Token,
        related: Option<(Guid, i64)>,
        context: &mut Context<'_>,
    ) -> GenericMessage {
        *context.last_number += 1;
        GenericMessage {
            source: (Guid::new(self.local.prefix, EntityId::STATELESS_WRITER), *context.last_number),
            related: related.unwrap_or((Guid::UNKNOWN, 0)),
            destination_participant: self.remote,
            destination_endpoint: Guid::UNKNOWN,
            source_endpoint: Guid::UNKNOWN,
            class: class::AUTHENTICATION.into(),
            tokens: vec![token],
        }
    }
}

/// The refusal of a token of a class that does not fit the role.
pub(super) fn unexpected(token: &Token) -> Output {
    Output::Refused(Refusal::Class { found: shown(token.class_id.as_bytes()) })
}
