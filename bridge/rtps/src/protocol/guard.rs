//! The hooks for DDS Security: announcements, admission, keys, and the protection of payloads and messages.

use std::time::Instant;

use bytes::Bytes;

use super::Now;
use crate::wire::{EndpointData, Guid, GuidPrefix, ParticipantData};

/// Decides which participants and endpoints are admitted, and protects messages.
///
/// The state machines are independent of it: they only process plain messages of admitted participants.
/// After each call that takes the time, the participant does what [`Guard::poll`] returns, and calls
/// [`Guard::handle_timeout`] at [`Guard::next_timeout`].
pub trait Guard: Send {
    /// Adds to the data that this participant announces what belongs to security. Called again when they
    /// change.
    fn complete_participant(&mut self, own: &mut ParticipantData);

    /// Adds to the announcement of a local endpoint how it is protected, or denies it.
    fn complete_endpoint(&mut self, now: Now, own: &mut EndpointData) -> Result<(), Denial>;

    /// Called when a participant announces itself, and again after [`Demand::Reconsider`] or
    /// [`Participant::reconsider`](super::Participant::reconsider).
    fn admit_participant(&mut self, now: Now, remote: &ParticipantData) -> Admission;

    /// Whether a participant has proven its identity, so that it is matched with the protected builtin
    /// endpoints.
    fn is_authenticated(&self, remote: GuidPrefix) -> bool;

    /// Called before two endpoints match. After [`Admission::Wait`] it is called again in the same way as
    /// above.
    fn admit_endpoint(&mut self, now: Now, local: &EndpointData, remote: &EndpointData) -> Admission;

    /// How the discovery of a topic is protected.
    fn protection_of(&self, topic: &str) -> TopicProtection;

    /// Forgets the keys and the state of a participant that has left.
    fn forget_participant(&mut self, remote: GuidPrefix);

    /// Forgets the keys of an endpoint that was removed, local or remote.
    fn forget_endpoint(&mut self, endpoint: Guid);

    /// Handles what another participant sent over a channel.
    fn handle_message(&mut self, now: Now, channel: Channel, from: GuidPrefix, payload: &[u8]);

    fn handle_timeout(&mut self, now: Now);

    fn next_timeout(&self) -> Option<Instant>;

    /// Returns the oldest demand that has not been returned yet.
    fn poll(&mut self) -> Option<Demand>;

    fn room(&self) -> Room;

    /// Protects a datagram for a participant, [`GuidPrefix::UNKNOWN`] for all. Endpoints that
    /// [establish protection](crate::wire::EntityId::establishes_protection) do not share datagrams with
    /// others. Nothing is sent if it returns `false`.
    fn encode(&mut self, to: GuidPrefix, datagram: &mut Vec<u8>) -> bool;

    /// Appends the plain form of a datagram to `out`, without submessages that had to be protected and were
    /// not. Nothing is handled if it returns `false`.
    fn decode(&mut self, now: Now, from: GuidPrefix, datagram: &[u8], out: &mut Vec<u8>) -> bool;
}

/// The bytes by which [`Guard::encode`] lengthens a datagram, at most.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Room {
    pub message: usize,
    pub submessage: usize,
}

/// A guard's decision about a new participant or endpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Admission {
    Admit,
    /// Not yet: authentication or the exchange of keys is in progress.
    Wait,
    Refuse,
}

/// Why a local endpoint may not be created, as a sentence.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Denial(pub String);

/// Whether announcements of the endpoints of a topic, and of their liveliness, use protected channels.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TopicProtection {
    pub discovery: bool,
    pub liveliness: bool,
}

/// The topics by which guards of two participants talk (DDS Security 1.1, sections 7.4.3 and 7.4.4).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Channel {
    /// Best effort and in clear, with every participant that has it: handshakes.
    Stateless,
    /// Reliable and protected, with authenticated participants: keys.
    Volatile,
}

/// What a guard wants the participant to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Demand {
    /// To send a message to another participant.
    Send { channel: Channel, to: GuidPrefix, message: Bytes },
    /// To ask again about a participant and its endpoints.
    Reconsider(GuidPrefix),
    /// To report something to the user.
    Report(Report),
}

/// Something that whoever operates the robot should know, as a sentence.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Report {
    /// The participant that it is about.
    pub remote: Option<GuidPrefix>,
    pub text: String,
    pub severity: Severity,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Severity {
    /// A participant was authenticated.
    Info,
    /// Somebody was refused, or something ends soon.
    Warning,
}
