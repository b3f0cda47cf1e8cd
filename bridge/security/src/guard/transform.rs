//! Protection of datagrams, and what of a received one is believed.

use downbeat_rtps::wire::{EntityId, Header};

use super::frames::{self, Frame, Kind};
use super::keys::{EndpointKeys, OwnKeys};
use super::policy::{self, Policy, Protection};
use super::session::Session;
use crate::cryptography::{
    KeyId, OpenError, message_transform, payload_transform, split_submessage_group, submessage_session,
    submessage_transform,
};

/// The bytes of a header, a body and a footer around a payload, with padding.
const PAYLOAD_GROWTH: usize = 20 + 4 + 3 + 20;
/// The bytes of SEC_PREFIX, SEC_BODY and SEC_POSTFIX, with padding.
const SUBMESSAGE_GROWTH: usize = 24 + 8 + 3 + 24;
/// The bytes of SRTPS_PREFIX, INFO_SRC, SEC_BODY and SRTPS_POSTFIX, with padding.
pub(super) const MESSAGE_GROWTH: usize = 24 + 24 + 8 + 3 + 24;
/// What a submessage grows by at most.
pub(super) const GROWTH: usize = PAYLOAD_GROWTH + SUBMESSAGE_GROWTH;

/// Protects a datagram in place; `None` if that is impossible. `session` is that of the only receiver.
pub(super) fn seal(
    datagram: &mut Vec<u8>,
    keys: &mut OwnKeys,
    policy: &Policy,
    session: Option<&mut Session>,
) -> Option<()> {
    let clear = std::mem::take(datagram);
    let (header, mut rest) = clear.split_at_checked(Header::LEN)?;
    datagram.reserve(clear.len() + MESSAGE_GROWTH + 4 * GROWTH);
    datagram.extend_from_slice(header);
    let mut session = session;
    let mut is_exempt = true;
    while !rest.is_empty() {
        let (frame, following) = frames::split(rest)?;
        rest = following;
        let Kind::Of(entity) = frame.kind() else {
            datagram.extend_from_slice(frame.0);
            continue;
        };
        is_exempt &= entity.establishes_protection();
        if is_volatile(entity) {
            session.as_deref_mut()?.exchange_sealer.submessage(frame.0, datagram).ok()?;
        } else if let Some(keys) = keys.endpoints.get_mut(&entity) {
            seal_submessage(frame, keys, datagram)?;
        } else {
            datagram.extend_from_slice(frame.0);
        }
    }
    if !is_exempt && policy.rule.rtps.is_protected() {
        keys.participant.message(datagram).ok()?;
    }
    Some(())
}

fn seal_submessage(frame: Frame<'_>, keys: &mut EndpointKeys, out: &mut Vec<u8>) -> Option<()> {
    let with_payload;
    let mut plain = frame.0;
    if let Some(sealer) = &mut keys.payload
        && let Some((front, payload)) = frame.split_payload()
    {
        let sealed = sealer.payload(payload).ok()?;
        let mut whole = Vec::with_capacity(front.len() + sealed.len());
        frame.append_with_payload(front, &sealed, &mut whole)?;
        with_payload = whole;
        plain = &with_payload;
    }
    match &mut keys.submessage {
        Some(sealer) => sealer.submessage(plain, out).ok()?,
        None => out.extend_from_slice(plain),
    }
    Some(())
}

/// Why a part of a datagram is not believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub(super) enum Disbelief {
    /// Its key has not arrived yet, or its sender is not authenticated: that is normal while participants
    /// meet.
    #[error("its key is not known")]
    NoKey,
    #[error("it is not protected, although the governance demands it")]
    Clear,
    #[error("it was changed on its way, or does not come from the participant that it names")]
    Forged,
    #[error("it is protected with the key of another endpoint")]
    OtherEndpoint,
    #[error("its protection is malformed")]
    Malformed,
}

impl From<OpenError> for Disbelief {
    fn from(error: OpenError) -> Self {
        match error {
            OpenError::OtherKey => Self::NoKey,
            OpenError::Forged | OpenError::Source => Self::Forged,
            _ => Self::Malformed,
        }
    }
}

/// What became of a datagram.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub(super) struct Opened {
    /// How many submessages of endpoints are believed.
    pub(super) kept: usize,
    /// The gravest reason why something is not.
    pub(super) dropped: Option<Disbelief>,
}

/// Appends the plain form of a datagram of a participant to `out`, without what is not believed. `session` is
/// that of its sender.
pub(super) fn open(
    datagram: &[u8],
    policy: &Policy,
    mut session: Option<&mut Session>,
    out: &mut Vec<u8>,
) -> Opened {
    let mut opened = Opened::default();
    let Some(header) = datagram.get(..Header::LEN) else {
        return Opened { dropped: Some(Disbelief::Malformed), ..opened };
    };
    out.extend_from_slice(header);
    let whole;
    let (mut is_protected, mut message) = (false, datagram);
    match message_transform(datagram) {
        Ok(None) => {}
        Ok(Some(_)) => {
            let opener = session.as_deref_mut().and_then(|session| session.participant.as_mut());
            let result = opener.ok_or(Disbelief::NoKey).and_then(|opener| Ok(opener.message(datagram)?));
            match result {
                Ok(plain) => whole = plain,
                Err(disbelief) => return Opened { dropped: Some(disbelief), ..opened },
            }
            (is_protected, message) = (true, &whole);
        }
        Err(_) => return Opened { dropped: Some(Disbelief::Malformed), ..opened },
    }
    let mut rest = message.get(Header::LEN..).unwrap_or_default();
    while let Some((frame, following)) = frames::split(rest) {
        let result = match frame.kind() {
            Kind::Protected => match split_submessage_group(rest) {
                Ok((group, following)) => {
                    rest = following;
                    open_group(group, policy, session.as_deref_mut(), is_protected, out)
                }
                // Where the next submessage begins is unknown.
                Err(_) => {
                    opened.dropped = opened.dropped.max(Some(Disbelief::Malformed));
                    break;
                }
            },
            kind => {
                rest = following;
                match kind {
                    Kind::Of(entity) => accept(
                        frame,
                        entity,
                        policy,
                        session.as_deref_mut(),
                        Layers { message: is_protected, submessage: false },
                        out,
                    )
                    .map(|()| 1),
                    Kind::Info => {
                        out.extend_from_slice(frame.0);
                        Ok(0)
                    }
                    // A source other than the header's could be anybody.
                    _ => Ok(0),
                }
            }
        };
        match result {
            Ok(kept) => opened.kept += kept,
            Err(disbelief) => opened.dropped = opened.dropped.max(Some(disbelief)),
        }
    }
    opened
}

/// Opens a protected submessage. Returns the number of submessages of endpoints in it.
fn open_group(
    group: &[u8],
    policy: &Policy,
    session: Option<&mut Session>,
    is_message_protected: bool,
    out: &mut Vec<u8>,
) -> Result<usize, Disbelief> {
    let session = session.ok_or(Disbelief::NoKey)?;
    let key = submessage_transform(group)?.key;
    let mut plain = Vec::with_capacity(group.len());
    let owner = if key == KeyId::KEY_EXCHANGE {
        // Both participants have the same key: somebody may send back what this one has sent.
        if submessage_session(group).is_some_and(|it| session.exchange_sealer.has_used(it)) {
            return Err(Disbelief::Forged);
        }
        let opened = session.exchange_opener.submessage(group, &mut plain);
        // After each handshake there is another key with this id; what is still on its way has the one
        // before.
        opened.map_err(|error| if error == OpenError::Forged { Disbelief::NoKey } else { error.into() })?;
        None
    } else {
        let (entity, opener) = session.keys.get_mut(&key).ok_or(Disbelief::NoKey)?;
        opener.submessage(group, &mut plain)?;
        Some(*entity)
    };
    let (mut rest, mut kept) = (&plain[..], 0);
    while let Some((frame, following)) = frames::split(rest) {
        rest = following;
        match frame.kind() {
            Kind::Of(entity) if owner.map_or(is_volatile(entity), |owner| owner == entity) => {
                accept(
                    frame,
                    entity,
                    policy,
                    Some(&mut *session),
                    Layers { message: is_message_protected, submessage: true },
                    out,
                )?;
                kept += 1;
            }
            Kind::Of(_) => return Err(Disbelief::OtherEndpoint),
            _ if frame.is_timestamp() => out.extend_from_slice(frame.0),
            _ => {}
        }
    }
    Ok(kept)
}

/// The layers of protection that were found around a submessage.
#[derive(Debug, Clone, Copy)]
struct Layers {
    message: bool,
    submessage: bool,
}

/// Appends a submessage whose own protection is removed, with its plain payload, if it was protected as it
/// has to be: in a protected message, and by itself.
fn accept(
    frame: Frame<'_>,
    entity: EntityId,
    policy: &Policy,
    session: Option<&mut Session>,
    protected: Layers,
    out: &mut Vec<u8>,
) -> Result<(), Disbelief> {
    if entity.establishes_protection() {
        if is_volatile(entity) && !protected.submessage {
            return Err(Disbelief::Clear);
        }
        out.extend_from_slice(frame.0);
        return Ok(());
    }
    let Some(session) = session else {
        if !policy.rule.allow_unauthenticated || policy::is_secure_builtin(entity) {
            return Err(Disbelief::NoKey);
        }
        out.extend_from_slice(frame.0);
        return Ok(());
    };
    if policy.rule.rtps.is_protected() && !protected.message {
        // Cyclone DDS does not protect messages of plain discovery, which announces nothing protected.
        return Err(if entity.is_builtin() { Disbelief::NoKey } else { Disbelief::Clear });
    }
    let protection = match entity.is_builtin() {
        true => policy.builtin_protection(entity),
        // Of an endpoint that is not matched nothing is delivered.
        false => session.endpoints.get(&entity).copied().ok_or(Disbelief::NoKey)?,
    };
    if protection.submessage.is_some() && !protected.submessage {
        return Err(Disbelief::Clear);
    }
    match frame.split_payload().filter(|_| protection.payload.is_some()) {
        Some((front, payload)) => {
            let plain = open_payload(payload, entity, session, protection)?;
            frame.append_with_payload(front, &plain, out).ok_or(Disbelief::Malformed)
        }
        None => {
            out.extend_from_slice(frame.0);
            Ok(())
        }
    }
}

fn open_payload(
    payload: &[u8],
    entity: EntityId,
    session: &mut Session,
    protection: Protection,
) -> Result<Vec<u8>, Disbelief> {
    let transform = payload_transform(payload)?;
    if Some(transform.kind) != protection.payload && !transform.kind.encrypts() {
        return Err(Disbelief::Clear);
    }
    let (owner, opener) = session.keys.get_mut(&transform.key).ok_or(Disbelief::NoKey)?;
    if *owner != entity {
        return Err(Disbelief::OtherEndpoint);
    }
    Ok(opener.payload(payload)?)
}

fn is_volatile(entity: EntityId) -> bool {
    matches!(entity, EntityId::VOLATILE_WRITER | EntityId::VOLATILE_READER)
}
