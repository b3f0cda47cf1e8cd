//! The state with one remote participant.

use std::time::Instant;

use downbeat_rtps::wire::Guid;

use super::context::{Context, Output, Peers};
use super::initiator::Initiator;
use super::refusal::Refusal;
use super::replier::Replier;
use crate::tokens::{GenericMessage, class};

/// Proves the identity of the own participant to another one and the other's to the own one.
///
/// Call [`Self::handle_timeout`] at [`Self::next_timeout`], which is at once for the initiator, and
/// [`Self::handle`] with each message of class [`class::AUTHENTICATION`] from the other participant. Each
/// message costs at most two verifications, one signature and two operations of key agreement, and only if
/// its cheap parts are right. If the other participant asks to begin ([`class::AUTHENTICATION_REQUEST`]), it
/// may have lost its state: see [`Self::begin_again`].
#[derive(Debug)]
pub struct Handshake {
    peers: Peers,
    role: Role,
}

#[derive(Debug)]
enum Role {
    Initiator(Initiator),
    Replier(Replier),
}

impl Handshake {
    /// Begins the handshake of two participants, which have these GUIDs.
    pub fn new(local: Guid, remote: Guid, now: Instant) -> Self {
        let role = match local < remote {
            true => Role::Initiator(Initiator::new(now)),
            false => Role::Replier(Replier::new(now)),
        };
        Self { peers: Peers { local, remote }, role }
    }

    /// Returns whether the other participant has proven its identity.
    pub fn is_done(&self) -> bool {
        match &self.role {
            Role::Initiator(initiator) => initiator.is_done(),
            Role::Replier(replier) => replier.is_done(),
        }
    }

    /// When to call [`Self::handle_timeout`].
    pub fn next_timeout(&self) -> Option<Instant> {
        match &self.role {
            Role::Initiator(initiator) => initiator.next_timeout(),
            Role::Replier(replier) => replier.next_timeout(),
        }
    }

    /// Sends what is due.
    pub fn handle_timeout(&mut self, context: &mut Context<'_>) -> Vec<Output> {
        match &mut self.role {
            Role::Initiator(initiator) => initiator.handle_timeout(self.peers, context),
            Role::Replier(replier) => replier.handle_timeout(self.peers, context),
        }
    }

    /// Begins again, if the other participant waits for that: the initiator does not notice that the replier
    /// has forgotten it. What was proven stays so until it is proven anew.
    pub fn begin_again(&mut self, now: Instant) {
        if let Role::Initiator(initiator) = &mut self.role {
            initiator.begin_again(now);
        }
    }

    /// Handles a message that came from the other participant.
    pub fn handle(&mut self, message: &GenericMessage, context: &mut Context<'_>) -> Vec<Output> {
        let is_ours = message.class == class::AUTHENTICATION
            && message.destination_participant == self.peers.local
            && message.source.0.prefix == self.peers.remote.prefix;
        if !is_ours {
            return Vec::new();
        }
        let [token] = &*message.tokens else {
            return vec![Output::Refused(Refusal::Tokens { found: message.tokens.len() })];
        };
        match &mut self.role {
            Role::Initiator(initiator) => initiator.handle(self.peers, message.source, token, context),
            Role::Replier(replier) => replier.handle(self.peers, message.source, token, context),
        }
    }
}
