//! How participants prove their identities, and what follows: whether one is admitted, and its session.

use bytes::Bytes;
use downbeat_rtps::protocol::{Admission, BUILTIN_OF_SECURITY, Builtin, Channel, Demand, Now, Severity};
use downbeat_rtps::wire::{BuiltinEndpoints, EntityId, Guid, GuidPrefix, ParticipantData};

use super::flood::Flood;
use super::session::Session;
use super::{
    BEGINNING_PERIOD, BEGINNINGS, CHECK_PERIOD, HOSTS, MOST_HANDSHAKES, MOST_REFUSED, REFUSED, RENEWAL,
    Remote, SLOW, STEP_PERIOD, STEPS, SecurityGuard, described, policy, time,
};
use crate::access::{Grant, Permissions, smime};
use crate::authentication::{Context, Handshake, Output, RemoteIdentity, SharedSecret};
use crate::cryptography::{KeyMaterial, Sealer};
use crate::tokens::{ByteOrder, GenericMessage, class};

impl SecurityGuard {
    /// Whether a new participant may begin to prove its identity.
    pub(super) fn meet(&mut self, now: Now, remote: &ParticipantData) -> Admission {
        let Some(security) = remote.security.as_ref().filter(|security| !security.identity_token.is_empty())
        else {
            if self.credentials.policy.rule.allow_unauthenticated {
                return Admission::Admit;
            }
            let reason = format!(
                "participants without security are ignored, as the governance demands ({}, {})",
                described(remote),
                "it announces no certificate"
            );
            self.refuse(now, remote.prefix, reason);
            return Admission::Refuse;
        };
        if policy::contradicts(self.credentials.policy.attributes(), security.attributes) {
            let reason = format!(
                "{} is ignored: its governance protects the domain in another way (attributes {:#010x} {:#010x} \
                 instead of {:#010x} {:#010x}); all keystores of a domain need the same governance",
                described(remote),
                security.attributes.mask,
                security.attributes.plugin_mask,
                self.credentials.policy.attributes().mask,
                self.credentials.policy.attributes().plugin_mask,
            );
            self.refuse(now, remote.prefix, reason);
            return Admission::Refuse;
        }
        let bits = BuiltinEndpoints::STATELESS_WRITER | BuiltinEndpoints::STATELESS_READER;
        if !remote.builtin_endpoints.has(bits) {
            self.refuse(
                now,
                remote.prefix,
                format!("{} is ignored: it does not authenticate", described(remote)),
            );
            return Admission::Refuse;
        }
        if self.refused.get(&remote.prefix).is_some_and(|until| *until > now.steady) {
            return Admission::Refuse;
        }
        if !self.may_begin(now, remote) || !self.has_room(now) {
            // It announces itself again.
            return Admission::Refuse;
        }
        let guid = |prefix| Guid::new(prefix, EntityId::PARTICIPANT);
        let handshake = Handshake::new(guid(self.prefix), guid(remote.prefix), now.steady);
        let steps = Flood::new(STEPS, STEP_PERIOD, now.steady);
        let bits = remote.builtin_endpoints;
        let known = Remote { handshake, steps, begun: now.steady, bits, session: None };
        self.remotes.insert(remote.prefix, known);
        self.run_handshakes(now);
        Admission::Wait
    }

    /// Whether one more handshake may be in progress, perhaps in the place of a slow one.
    pub(super) fn has_room(&mut self, now: Now) -> bool {
        let open = || self.remotes.iter().filter(|(_, remote)| remote.session.is_none());
        if open().count() < MOST_HANDSHAKES {
            return true;
        }
        let oldest = open().min_by_key(|(_, remote)| remote.begun);
        let slow = oldest.filter(|(_, remote)| now.steady.saturating_duration_since(remote.begun) > SLOW);
        let Some(slow) = slow.map(|(prefix, _)| *prefix) else { return false };
        self.turn_away(now, slow);
        true
    }

    /// Whether one more handshake may begin with a participant of that host.
    pub(super) fn may_begin(&mut self, now: Now, remote: &ParticipantData) -> bool {
        let address = remote.metatraffic_unicast.first().map_or(0, |address| address.ip().to_bits());
        // Neighbours have different limits.
        let index = address.wrapping_mul(0x9e37_79b9) as usize >> 8;
        let beginnings = self.beginnings.get_mut(index % HOSTS);
        beginnings.is_some_and(|beginnings| {
            let new = || Flood::new(BEGINNINGS, BEGINNING_PERIOD, now.steady);
            beginnings.get_or_insert_with(new).permits(now.steady)
        })
    }

    /// Begins a handshake again with a participant that may have forgotten this one.
    pub(super) fn begin_again(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(remote) = self.remotes.get_mut(&prefix) else { return };
        if remote.session.is_some() && now.steady.saturating_duration_since(remote.begun) < RENEWAL {
            return;
        }
        if remote.steps.permits(now.steady) {
            if remote.session.is_some() {
                remote.begun = now.steady;
            }
            remote.handshake.begin_again(now.steady);
            self.run_handshakes(now);
        }
    }

    /// Sends what is due in handshakes.
    pub(super) fn run_handshakes(&mut self, now: Now) {
        let due = |remote: &Remote| remote.handshake.next_timeout().is_some_and(|at| at <= now.steady);
        let due: Vec<_> =
            self.remotes.iter().filter(|(_, remote)| due(remote)).map(|(prefix, _)| *prefix).collect();
        for prefix in due {
            self.with_handshake(now, prefix, Handshake::handle_timeout);
        }
    }

    pub(super) fn with_handshake(
        &mut self,
        now: Now,
        prefix: GuidPrefix,
        call: impl FnOnce(&mut Handshake, &mut Context<'_>) -> Vec<Output>,
    ) {
        let Some(remote) = self.remotes.get_mut(&prefix) else { return };
        let mut context = Context {
            identity: &self.credentials.identity,
            participant_data: &self.participant_data,
            random: &mut **self.keys.random(),
            last_number: &mut self.last_number,
            now: now.steady,
            time: time(now),
        };
        for output in call(&mut remote.handshake, &mut context) {
            match output {
                Output::Send(message) => self.send(Channel::Stateless, prefix, &message),
                Output::Done { remote, secret } => self.establish(now, prefix, &remote, &secret),
                Output::Refused(refusal) => {
                    self.refuse(now, prefix, format!("a participant cannot prove its identity: {refusal}"));
                }
                Output::GaveUp(refusal) => {
                    let reason = format!("participant {prefix} is not authenticated: {refusal}");
                    self.refuse(now, prefix, reason);
                }
            }
        }
    }

    pub(super) fn send(&mut self, channel: Channel, to: GuidPrefix, message: &GenericMessage) {
        let mut payload = Vec::new();
        message.emit(&mut payload, ByteOrder::Little);
        self.demands.push_back(Demand::Send { channel, to, message: Bytes::from(payload) });
    }

    /// Checks the permissions of a participant that has proven its identity, and begins to exchange keys.
    pub(super) fn establish(
        &mut self,
        now: Now,
        prefix: GuidPrefix,
        remote: &RemoteIdentity,
        secret: &SharedSecret,
    ) {
        let subject = remote.certificate.subject().to_owned();
        let grant = match self.permissions_of(now, remote) {
            Ok(grant) => grant,
            Err(reason) => {
                self.refuse(now, prefix, format!("{subject} is refused: {reason}"));
                return self.turn_away(now, prefix);
            }
        };
        let exchange = KeyMaterial::for_key_exchange(&secret.challenge1, &secret.challenge2, &secret.secret);
        let sealer = Sealer::new(exchange.clone(), &mut **self.keys.random());
        let mut session = Session::new(remote.certificate.clone(), grant, exchange, sealer);
        let Some(known) = self.remotes.get_mut(&prefix) else { return };
        // Its keys stay the same if it has only forgotten this participant, or somebody pretends that it has.
        if let Some(before) = known.session.take() {
            session.keep_keys_of(*before);
        }
        known.session = Some(Box::new(session));
        let bits = known.bits;
        self.status.admit(prefix, &subject);
        self.report(Some(prefix), format!("{subject} has proven its identity"), Severity::Info);
        self.checks_at.get_or_insert(now.steady + CHECK_PERIOD);
        // The channel for keys is opened before they are sent.
        self.demands.push_back(Demand::Reconsider(prefix));
        let token = self.keys.participant_token();
        self.send_keys(prefix, class::PARTICIPANT_CRYPTO_TOKENS, None, vec![token]);
        self.send_builtin_keys(prefix, bits);
    }

    /// Sends the keys of the builtin endpoints to those that another participant has.
    pub(super) fn send_builtin_keys(&mut self, prefix: GuidPrefix, bits: BuiltinEndpoints) {
        for Builtin { writer, reader, writer_bit, reader_bit } in BUILTIN_OF_SECURITY {
            if bits.has(reader_bit) {
                self.send_endpoint_keys(prefix, writer, reader);
            }
            if bits.has(writer_bit) {
                self.send_endpoint_keys(prefix, reader, writer);
            }
        }
    }

    /// The grant of a participant in its permissions, which have to be signed and valid.
    pub(super) fn permissions_of(&self, now: Now, remote: &RemoteIdentity) -> Result<Grant, String> {
        let document = smime::verify(&remote.permissions_document, &self.credentials.permissions_ca);
        let document = document.map_err(|error| format!("its permissions are not accepted: {error}"))?;
        let text = String::from_utf8(document).map_err(|_| "its permissions are no text".to_owned())?;
        let permissions = Permissions::parse(&text).map_err(|error| format!("its permissions: {error}"))?;
        let subject = remote.certificate.subject();
        if permissions.grant(subject).is_none() {
            return Err("it sent the permissions of somebody else".to_owned());
        }
        let grant = permissions.valid_grant(subject, time(now));
        let grant = grant.ok_or("its permissions are not valid now: sign new ones, or set the clock")?;
        if self.credentials.policy.rule.join_access_control
            && !grant.may_join(self.credentials.policy.domain_id)
        {
            return Err(format!(
                "its permissions allow nothing in domain {}",
                self.credentials.policy.domain_id
            ));
        }
        Ok(grant.clone())
    }

    /// Forgets a participant, and does not admit it again for a while.
    pub(super) fn turn_away(&mut self, now: Now, prefix: GuidPrefix) {
        self.refused.retain(|_, until| *until > now.steady);
        if self.refused.len() < MOST_REFUSED {
            self.refused.insert(prefix, now.steady + REFUSED);
        }
        self.remotes.remove(&prefix);
        self.status.forget(prefix);
        self.demands.push_back(Demand::Reconsider(prefix));
    }
}
