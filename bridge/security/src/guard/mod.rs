//! What the RTPS engine asks: who is admitted, which keys are exchanged, and how messages are protected.

mod flood;
mod frames;
mod handshakes;
mod keys;
mod policy;
mod reports;
mod session;
mod status;
mod transform;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use downbeat_rtps::protocol::{
    Admission, BUILTIN_OF_SECURITY, Builtin, Channel, Demand, Denial, Guard, Now, Report, Room, Severity,
    TopicProtection,
};
use downbeat_rtps::qos::Reliability;
use downbeat_rtps::wire::{
    BuiltinEndpoints, EndpointData, EntityId, Guid, GuidPrefix, ParticipantData, ParticipantSecurity,
};

pub use keys::Random;
pub use status::Status;

use crate::access::TopicRule;
use crate::authentication::{Handshake, Identity, derive_prefix, identity_token, permissions_token};
use crate::enclave::Enclave;
use crate::pki::Certificate;
use crate::tokens::{ByteOrder, GenericMessage, class};
use flood::Flood;
use keys::OwnKeys;
use policy::Policy;
use reports::Reports;
use session::Session;
use transform::Disbelief;

/// The most participants whose handshakes are in progress.
const MOST_HANDSHAKES: usize = 128;
/// If there are as many, the oldest of those that take longer than this makes room: a handshake takes
/// milliseconds.
const SLOW: Duration = Duration::from_secs(2);
/// Handshake messages in the name of one participant that are handled at once, and the time after which one
/// more is: each costs up to a millisecond.
const STEPS: u32 = 20;
const STEP_PERIOD: Duration = Duration::from_millis(500);
/// The same for all participants together that have not proven their identity.
const ALL_STEPS: u32 = 200;
const ALL_STEPS_PERIOD: Duration = Duration::from_millis(10);
/// Handshakes begun at once with participants of hosts that share a limit, and the time after which one more
/// is.
const BEGINNINGS: u32 = 64;
const BEGINNING_PERIOD: Duration = Duration::from_millis(500);
/// The number of these limits.
const HOSTS: usize = 64;
/// How often a participant that has proven its identity may ask to do so anew: anybody can ask in its name.
const RENEWAL: Duration = Duration::from_secs(10);
/// How long a refused participant has to wait before it is asked for its identity again.
const REFUSED: Duration = Duration::from_secs(30);
/// The most refused participants that are remembered.
const MOST_REFUSED: usize = 512;
/// How often the validity of certificates and permissions is checked.
const CHECK_PERIOD: Duration = Duration::from_secs(60);

/// The guard of a participant with the identity of an enclave.
pub struct SecurityGuard {
    prefix: GuidPrefix,
    credentials: Arc<Credentials>,
    keys: OwnKeys,
    /// The own announcement as handshakes contain it.
    participant_data: Vec<u8>,
    remotes: BTreeMap<GuidPrefix, Remote>,
    /// Until when refused participants wait.
    refused: BTreeMap<GuidPrefix, Instant>,
    /// Numbers of the messages over the two channels.
    last_number: i64,
    beginnings: [Option<Flood>; HOSTS],
    all_steps: Option<Flood>,
    demands: VecDeque<Demand>,
    /// Participants to be asked about again.
    reconsidered: BTreeSet<GuidPrefix>,
    checks_at: Option<Instant>,
    reports: Reports,
    status: Status,
}

/// A participant whose identity is being proven, or is.
struct Remote {
    handshake: Handshake,
    steps: Flood,
    begun: Instant,
    bits: BuiltinEndpoints,
    session: Option<Box<Session>>,
}

/// What an enclave says about one domain: who this participant is, and which rules apply.
pub struct Credentials {
    identity: Identity,
    permissions_ca: Certificate,
    policy: Policy,
}

impl Credentials {
    /// The credentials of an enclave for a domain.
    ///
    /// # Errors
    /// Returns a sentence if the enclave does not allow the domain.
    pub fn new(enclave: &Enclave, domain_id: u32, now: SystemTime) -> Result<Self, Denial> {
        let rule = enclave.for_domain(domain_id).map_err(|error| Denial(error.to_string()))?.clone();
        let grant = enclave.grant(now).map_err(|error| Denial(error.to_string()))?.clone();
        let subject = enclave.certificate.subject();
        if rule.join_access_control && !grant.may_join(domain_id) {
            return Err(Denial(format!(
                "the permissions of {subject:?} allow nothing in domain {domain_id}: set ROS_DOMAIN_ID to a domain that they \
                 name, or sign new ones"
            )));
        }
        let kinds = [rule.rtps, rule.discovery, rule.liveliness];
        let mut kinds = kinds.into_iter().chain(rule.topics.iter().map(|topic| topic.metadata));
        if kinds.any(|kind| kind.has_origin()) {
            return Err(Denial(
                "the governance asks for origin authentication, which is not supported: use SIGN or ENCRYPT"
                    .to_owned(),
            ));
        }
        let identity = Identity {
            certificate: enclave.certificate.clone(),
            key: enclave.key.clone(),
            authority: enclave.authority.clone(),
            permissions_document: enclave.permissions_document.clone(),
        };
        let policy = Policy { domain_id, rule, grant };
        Ok(Self { identity, permissions_ca: enclave.permissions_ca.clone(), policy })
    }

    /// The subject of the certificate.
    pub fn subject(&self) -> &str {
        self.identity.certificate.subject()
    }
}

impl SecurityGuard {
    /// The guard of a participant that would have the prefix `candidate` without security.
    /// [`Self::prefix`] is the one that it has to have.
    pub fn new(credentials: Arc<Credentials>, candidate: GuidPrefix, random: Random, status: Status) -> Self {
        let policy = &credentials.policy;
        let mut keys = OwnKeys::new(policy::transform(policy.rule.rtps), random);
        for Builtin { writer, reader, .. } in BUILTIN_OF_SECURITY {
            for entity in [writer, reader] {
                keys.add(entity, policy.builtin_protection(entity));
            }
        }
        Self {
            prefix: derive_prefix(&credentials.identity.certificate, candidate),
            credentials,
            keys,
            participant_data: Vec::new(),
            remotes: BTreeMap::new(),
            refused: BTreeMap::new(),
            last_number: 0,
            beginnings: [const { None }; HOSTS],
            all_steps: None,
            demands: VecDeque::new(),
            reconsidered: BTreeSet::new(),
            checks_at: None,
            reports: Reports::default(),
            status,
        }
    }

    /// The prefix that belongs to the identity.
    pub fn prefix(&self) -> GuidPrefix {
        self.prefix
    }

    /// Reports that somebody or something is refused.
    fn refuse(&mut self, now: Now, remote: GuidPrefix, reason: String) {
        self.status.refuse(&reason);
        if let Some(text) = self.reports.tell(now.steady, reason) {
            self.report(Some(remote), text, Severity::Warning);
        }
    }

    fn report(&mut self, remote: Option<GuidPrefix>, text: String, severity: Severity) {
        self.demands.push_back(Demand::Report(Report { remote, text, severity }));
    }

    /// Sends the keys of an endpoint of this participant to one of another, if its messages are protected.
    fn send_endpoint_keys(&mut self, prefix: GuidPrefix, ours: EntityId, theirs: EntityId) {
        let Some(session) = self.remotes.get_mut(&prefix).and_then(|remote| remote.session.as_mut()) else {
            return;
        };
        let tokens = self.keys.endpoints.get(&ours).map(keys::EndpointKeys::tokens).unwrap_or_default();
        if tokens.is_empty() || !session.note_sent(ours, theirs) {
            return;
        }
        let class = if ours.is_writer() { class::WRITER_CRYPTO_TOKENS } else { class::READER_CRYPTO_TOKENS };
        self.send_keys(prefix, class, Some((ours, theirs)), tokens);
    }

    fn send_keys(
        &mut self,
        prefix: GuidPrefix,
        class: &str,
        ends: Option<(EntityId, EntityId)>,
        tokens: Vec<crate::tokens::Token>,
    ) {
        self.last_number += 1;
        let (source_endpoint, destination_endpoint) = match ends {
            Some((ours, theirs)) => (Guid::new(self.prefix, ours), Guid::new(prefix, theirs)),
            None => (Guid::UNKNOWN, Guid::UNKNOWN),
        };
        let message = GenericMessage {
            source: (Guid::new(self.prefix, EntityId::VOLATILE_WRITER), self.last_number),
            related: (Guid::UNKNOWN, 0),
            destination_participant: Guid::new(prefix, EntityId::PARTICIPANT),
            destination_endpoint,
            source_endpoint,
            class: class.to_owned(),
            tokens,
        };
        self.send(Channel::Volatile, prefix, &message);
    }

    /// Takes keys of an authenticated participant.
    fn take_keys(&mut self, from: GuidPrefix, message: &GenericMessage) {
        let session = self.remotes.get_mut(&from).and_then(|remote| remote.session.as_mut());
        let Some(session) = session else { return };
        match message.class.as_str() {
            class::PARTICIPANT_CRYPTO_TOKENS => session.take_participant(&message.tokens),
            class::WRITER_CRYPTO_TOKENS | class::READER_CRYPTO_TOKENS => {
                let (theirs, ours) = (message.source_endpoint, message.destination_endpoint);
                if theirs.prefix == from
                    && ours.prefix == self.prefix
                    && session.take_endpoint(theirs.entity, ours.entity, &message.tokens)
                    && !ours.entity.is_builtin()
                {
                    self.reconsidered.insert(from);
                }
            }
            _ => {}
        }
    }

    /// Checks whether authenticated participants still are what they have proven.
    fn check_validity(&mut self, now: Now) {
        self.checks_at = Some(now.steady + CHECK_PERIOD);
        let mut ended = Vec::new();
        for (prefix, remote) in &self.remotes {
            let Some(session) = &remote.session else { continue };
            if let Err(distrust) = self.credentials.identity.authority.check(&session.certificate, time(now))
            {
                ended.push((*prefix, distrust.to_string()));
            } else if !session.grant.valid(time(now)) {
                let subject = session.certificate.subject();
                ended.push((*prefix, format!("the permissions of {subject} have expired; sign new ones")));
            }
        }
        for (prefix, reason) in ended {
            self.refuse(now, prefix, reason);
            self.turn_away(now, prefix);
        }
    }

    /// Why an endpoint of an authenticated participant may not match a local one; `None` if it may.
    fn objection(
        &self,
        session: &Session,
        rule: &TopicRule,
        local: &EndpointData,
        remote: &EndpointData,
    ) -> Option<String> {
        let subject = session.certificate.subject();
        let verb = if remote.guid.entity.is_writer() { "publish" } else { "subscribe to" };
        let decision = self.credentials.policy.decide(&session.grant, rule, remote);
        if !decision.is_allowed {
            return Some(format!("{subject} may not {verb} {}: {}", remote.topic, decision.rule));
        }
        if let (Some(ours), Some(theirs)) = (local.security, remote.security)
            && policy::contradicts(ours, theirs)
        {
            return Some(format!(
                "{subject} protects {} in another way: all keystores of a domain need the same governance",
                remote.topic
            ));
        }
        None
    }
}

impl Guard for SecurityGuard {
    fn complete_participant(&mut self, own: &mut ParticipantData) {
        own.builtin_endpoints = BuiltinEndpoints(own.builtin_endpoints.0 | BuiltinEndpoints::OF_SECURITY);
        // Whoever is not authenticated learns nothing else.
        own.name.clear();
        let token = |order| {
            let mut identity_token_bytes = Vec::new();
            let mut permissions_token_bytes = Vec::new();
            let authority = self.credentials.identity.authority.certificate();
            identity_token(&self.credentials.identity.certificate, authority)
                .emit(&mut identity_token_bytes, order);
            permissions_token().emit(&mut permissions_token_bytes, order);
            ParticipantSecurity {
                identity_token: identity_token_bytes,
                permissions_token: permissions_token_bytes,
                is_big_endian: order == ByteOrder::Big,
                attributes: self.credentials.policy.attributes(),
            }
        };
        let mut data = ParticipantData { security: Some(token(ByteOrder::Big)), ..own.clone() };
        data.prefix = self.prefix;
        let mut payload = Vec::new();
        data.emit_big_endian(&mut payload);
        own.security = Some(token(ByteOrder::Little));
        // Handshakes contain it without encapsulation.
        self.participant_data = payload.split_off(4);
    }

    fn complete_endpoint(&mut self, _: Now, own: &mut EndpointData) -> Result<(), Denial> {
        let Some(rule) = self.credentials.policy.topic(&own.topic) else {
            return Err(Denial(format!(
                "the governance has no rule for topic {:?}: add one, such as for \"*\"",
                own.topic
            )));
        };
        let decision = self.credentials.policy.decide(&self.credentials.policy.grant, rule, own);
        if !decision.is_allowed {
            let verb = if own.guid.entity.is_writer() { "publish" } else { "subscribe to" };
            return Err(Denial(format!(
                "the permissions of {} do not allow it to {verb} {:?}: {}",
                self.credentials.identity.certificate.subject(),
                own.topic,
                decision.rule
            )));
        }
        own.security = Some(Policy::endpoint_attributes(rule));
        let protection = Policy::protection(rule);
        if protection.is_any() {
            self.keys.add(own.guid.entity, protection);
        }
        Ok(())
    }

    fn admit_participant(&mut self, now: Now, remote: &ParticipantData) -> Admission {
        let known = match self.remotes.get_mut(&remote.prefix) {
            None => return self.meet(now, remote),
            Some(known) => known,
        };
        known.bits = BuiltinEndpoints(known.bits.0 | remote.builtin_endpoints.0);
        let bits = known.bits;
        if known.session.is_none() {
            return Admission::Wait;
        }
        self.send_builtin_keys(remote.prefix, bits);
        Admission::Admit
    }

    fn is_authenticated(&self, remote: GuidPrefix) -> bool {
        self.remotes.get(&remote).is_some_and(|remote| remote.session.is_some())
    }

    fn admit_endpoint(&mut self, now: Now, local: &EndpointData, remote: &EndpointData) -> Admission {
        let (ours, theirs) = (local.guid.entity, remote.guid.entity);
        let Some(rule) = self.credentials.policy.topic(&local.topic) else { return Admission::Refuse };
        let protection = Policy::protection(rule);
        let prefix = remote.guid.prefix;
        let Some(session) = self.remotes.get(&prefix).and_then(|remote| remote.session.as_ref()) else {
            let is_open = !rule.read && !rule.write && !protection.is_any() && !rule.discovery;
            return if self.credentials.policy.rule.allow_unauthenticated && is_open {
                Admission::Admit
            } else {
                Admission::Refuse
            };
        };
        let objection = self.objection(session, rule, local, remote);
        if objection.is_none() {
            self.send_endpoint_keys(prefix, ours, theirs);
        }
        let Some(session) = self.remotes.get_mut(&prefix).and_then(|remote| remote.session.as_mut()) else {
            return Admission::Refuse;
        };
        if let Some(reason) = objection {
            if session.note_reported(ours, theirs) {
                self.refuse(now, prefix, reason);
            }
            return Admission::Refuse;
        }
        session.endpoints.insert(theirs, protection);
        // Samples wait for a reliable reader until it acknowledges them, for which its key is needed. Others
        // are not worth sending before it has answered. Cyclone DDS has no key for a reader where only
        // payloads are protected.
        let is_reliable = |data: &EndpointData| data.qos.reliability == Reliability::Reliable;
        let needs_key = match theirs.is_writer() {
            true => protection.is_any(),
            false => protection.submessage.is_some() && !(is_reliable(local) && is_reliable(remote)),
        };
        if needs_key && !session.has_received(theirs, ours) { Admission::Wait } else { Admission::Admit }
    }

    fn protection_of(&self, topic: &str) -> TopicProtection {
        let rule = self.credentials.policy.topic(topic);
        TopicProtection {
            // What has no rule is not announced at all.
            discovery: rule.is_none_or(|rule| rule.discovery),
            liveliness: rule.is_none_or(|rule| rule.liveliness),
        }
    }

    fn forget_participant(&mut self, remote: GuidPrefix) {
        self.remotes.remove(&remote);
        self.status.forget(remote);
    }

    fn forget_endpoint(&mut self, endpoint: Guid) {
        if endpoint.prefix == self.prefix {
            self.keys.endpoints.remove(&endpoint.entity);
            let sessions = self.remotes.values_mut().filter_map(|remote| remote.session.as_mut());
            sessions.for_each(|session| session.forget_ours(endpoint.entity));
        } else if let Some(remote) = self.remotes.get_mut(&endpoint.prefix)
            && let Some(session) = &mut remote.session
        {
            session.forget_theirs(endpoint.entity);
        }
    }

    fn handle_message(&mut self, now: Now, channel: Channel, from: GuidPrefix, payload: &[u8]) {
        if !self.remotes.contains_key(&from) {
            return;
        }
        let message = match GenericMessage::parse(payload) {
            Ok(message) => message,
            Err(error) => {
                return self.refuse(now, from, format!("a message about security is malformed: {error}"));
            }
        };
        let own = Guid::new(self.prefix, EntityId::PARTICIPANT);
        if ![own, Guid::UNKNOWN].contains(&message.destination_participant) {
            return;
        }
        match channel {
            Channel::Volatile => self.take_keys(from, &message),
            Channel::Stateless if message.class == class::AUTHENTICATION_REQUEST => {
                self.begin_again(now, from);
            }
            Channel::Stateless if message.class == class::AUTHENTICATION => {
                let Some(remote) = self.remotes.get_mut(&from) else { return };
                let all = || Flood::new(ALL_STEPS, ALL_STEPS_PERIOD, now.steady);
                let is_known = remote.session.is_some();
                let may_cost = remote.steps.permits(now.steady)
                    && (is_known || self.all_steps.get_or_insert_with(all).permits(now.steady));
                if may_cost {
                    self.with_handshake(now, from, |handshake, context| handshake.handle(&message, context));
                }
            }
            Channel::Stateless => {}
        }
    }

    fn handle_timeout(&mut self, now: Now) {
        self.run_handshakes(now);
        if self.checks_at.is_some_and(|at| at <= now.steady) {
            self.check_validity(now);
        }
    }

    fn next_timeout(&self) -> Option<Instant> {
        let handshakes = self.remotes.values().filter_map(|remote| remote.handshake.next_timeout());
        handshakes.chain(self.checks_at).min()
    }

    fn poll(&mut self) -> Option<Demand> {
        let demand = self.demands.pop_front();
        demand.or_else(|| self.reconsidered.pop_first().map(Demand::Reconsider))
    }

    fn room(&self) -> Room {
        Room { message: transform::MESSAGE_GROWTH, submessage: transform::GROWTH }
    }

    fn encode(&mut self, to: GuidPrefix, datagram: &mut Vec<u8>) -> bool {
        let session = self.remotes.get_mut(&to).and_then(|remote| remote.session.as_deref_mut());
        transform::seal(datagram, &mut self.keys, &self.credentials.policy, session).is_some()
    }

    fn decode(&mut self, now: Now, from: GuidPrefix, datagram: &[u8], out: &mut Vec<u8>) -> bool {
        let session = self.remotes.get_mut(&from).and_then(|remote| remote.session.as_deref_mut());
        let opened = transform::open(datagram, &self.credentials.policy, session, out);
        // While participants meet, messages arrive before the keys that open them.
        let Some(disbelief) = opened.dropped.filter(|dropped| *dropped != Disbelief::NoKey) else {
            return true;
        };
        let session = self.remotes.get(&from).and_then(|remote| remote.session.as_ref());
        if let Some(subject) = session.map(|session| session.certificate.subject()) {
            let reason = format!("a message in the name of {subject} is dropped: {disbelief}");
            self.refuse(now, from, reason);
        }
        opened.kept > 0
    }
}

/// What is known of a participant from its announcement.
fn described(remote: &ParticipantData) -> String {
    let address = remote.metatraffic_unicast.first();
    let address = address.map_or_else(|| "an unknown address".to_owned(), |address| address.ip().to_string());
    format!("the participant at {address}")
}

/// The time of day.
fn time(now: Now) -> SystemTime {
    UNIX_EPOCH + Duration::from_nanos(now.wall_ns.max(0).unsigned_abs())
}
