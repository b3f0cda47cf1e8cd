//! The engine of this project, `downbeat-rtps`, behind [`Middleware`]: names, identities and policies
//! translated.

#[cfg_attr(not(feature = "security"), path = "unprotected.rs")]
mod protection;
mod qos;

use super::{
    Aliveness, Direction, DiscoveryRange, Endpoint, EndpointEvent, EventHandler, Gid, MatchHandler,
    Middleware, MiddlewareError, ParticipantOptions, QosPolicyKind, Reader, ReaderCounter, RemoteEndpoint,
    Sample, SampleHandler, SampleIdentity, SecurityWatch, WriteError, WriteOptions, Writer,
};
use bytes::Bytes;
pub use downbeat_rtps::SOCKET_BUFFER;
pub use downbeat_rtps::protocol::Counters;
use downbeat_rtps::protocol::{self, EndpointConfig, LivelinessChange};
use downbeat_rtps::wire::{
    self, EndpointData, EntityId, Guid, GuidPrefix, InlineQos, SequenceNumber, VendorId,
};
use downbeat_rtps::{Options, Participant, Range};
use protection::Protection;
use std::sync::Arc;
use std::time::Duration;

/// In front of the hash in the user data of an endpoint (`rmw_dds_common`,
/// `encode_type_hash_for_user_data_qos`).
const TYPE_HASH: &str = "typehash=";

/// A participant of a domain.
pub struct RtpsParticipant {
    participant: Participant,
    protection: Option<Protection>,
}

impl RtpsParticipant {
    /// Joins a domain.
    ///
    /// # Errors
    /// [`MiddlewareError::Join`] when no UDP ports are free, or the system refuses sockets or a thread, and
    /// [`MiddlewareError::Security`] when security is enforced and impossible.
    pub fn new(options: &ParticipantOptions) -> Result<Self, MiddlewareError> {
        let range = match options.discovery_range {
            DiscoveryRange::Off => Range::Off,
            DiscoveryRange::Localhost => Range::Localhost,
            DiscoveryRange::Subnet => Range::Subnet,
        };
        let protection = Protection::of(options)?;
        let enclave = options.security.as_ref().map_or("/", |security| security.enclave());
        let joined = Participant::join(&Options {
            static_peers: options.static_peers.clone(),
            lease: options.lease,
            user_data: format!("enclave={enclave};").into_bytes(),
            security: protection.as_ref().map(Protection::guard),
            ..Options::new(options.domain_id, range)
        });
        let domain_id = options.domain_id;
        let failed =
            |error: downbeat_rtps::JoinError| MiddlewareError::Join { domain_id, reason: error.to_string() };
        Ok(Self { participant: joined.map_err(failed)?, protection })
    }

    /// Counts the traffic and the invalid input since the participant joined.
    #[must_use]
    pub fn counters(&self) -> Counters {
        self.participant.counters()
    }
}

impl Middleware for RtpsParticipant {
    fn gid(&self) -> Gid {
        gid(Guid::new(self.participant.prefix(), EntityId::PARTICIPANT))
    }

    fn create_writer(&self, endpoint: &Endpoint) -> Result<Box<dyn Writer>, MiddlewareError> {
        let created = self.participant.create_writer(config(endpoint)?);
        Ok(Box::new(RtpsWriter(created.map_err(|error| refused("writer", endpoint, &error))?)))
    }

    fn create_reader(
        &self,
        endpoint: &Endpoint,
        mut on_sample: SampleHandler,
    ) -> Result<Box<dyn Reader>, MiddlewareError> {
        let on_sample = move |received| on_sample(sample(received));
        let created = self.participant.create_reader(config(endpoint)?, Box::new(on_sample));
        Ok(Box::new(RtpsReader(created.map_err(|error| refused("reader", endpoint, &error))?)))
    }

    fn remote_endpoints(&self) -> Vec<RemoteEndpoint> {
        self.participant.remote_endpoints().into_iter().map(remote).collect()
    }

    fn remote_participants(&self) -> Option<Vec<[u8; 12]>> {
        Some(self.participant.remote_participants().into_iter().map(|prefix| prefix.0).collect())
    }

    fn vendor_of(&self, peer: Gid) -> [u8; 2] {
        vendor_of(peer, |prefix| self.participant.vendor_of(prefix))
    }

    fn subject_of(&self, participant: Gid) -> Option<String> {
        self.protection.as_ref()?.subject_of(prefix(participant))
    }

    fn security(&self) -> Option<SecurityWatch> {
        self.protection.as_ref().map(Protection::watch)
    }

    fn leave(&self) {
        self.participant.leave();
    }
}

struct RtpsWriter(downbeat_rtps::Writer);

impl Writer for RtpsWriter {
    fn gid(&self) -> Gid {
        gid(self.0.guid())
    }

    fn matched(&self) -> usize {
        self.0.matched()
    }

    fn readers(&self) -> usize {
        self.0.readers()
    }

    fn reader_counter(&self) -> ReaderCounter {
        Box::new(self.0.reader_counter())
    }

    fn matched_readers(&self) -> Vec<Gid> {
        self.0.matched_readers().into_iter().map(gid).collect()
    }

    fn vendor_of(&self, peer: Gid) -> [u8; 2] {
        vendor_of(peer, |prefix| self.0.vendor_of(prefix))
    }

    fn on_match(&self, handler: MatchHandler) {
        self.0.on_match(handler);
    }

    fn on_event(&self, handler: EventHandler) {
        self.0.on_event(listener(handler));
    }

    fn write_with(&self, cdr: Bytes, options: WriteOptions) -> Result<i64, WriteError> {
        if !is_cdr(&cdr) {
            return Err(WriteError::Encapsulation { found: cdr[..cdr.len().min(4)].to_vec() });
        }
        let related = options.related.map(|related| wire::SampleIdentity {
            writer: Guid::from_bytes(related.endpoint.0),
            number: SequenceNumber(related.number),
        });
        let options = protocol::WriteOptions {
            inline_qos: InlineQos { related_sample_identity: related, ..InlineQos::default() },
            only_to: options.only_to.map(|reader| Guid::from_bytes(reader.0)),
        };
        match self.0.write(cdr, options) {
            Ok(number) => Ok(number.0),
            Err(protocol::WriteError::WindowFull) => Err(WriteError::WindowFull),
            Err(error) => Err(WriteError::Engine(error.to_string())),
        }
    }

    fn assert_liveliness(&self) {
        self.0.assert_liveliness();
    }

    fn flush(&self, timeout: Duration) -> bool {
        self.0.flush(timeout)
    }
}

struct RtpsReader(downbeat_rtps::Reader);

impl Reader for RtpsReader {
    fn gid(&self) -> Gid {
        gid(self.0.guid())
    }

    fn matched(&self) -> usize {
        self.0.matched()
    }

    fn matched_writers(&self) -> Vec<Gid> {
        self.0.matched_writers().into_iter().map(gid).collect()
    }

    fn on_match(&self, handler: MatchHandler) {
        self.0.on_match(handler);
    }

    fn on_event(&self, handler: EventHandler) {
        self.0.on_event(listener(handler));
    }
}

/// Whether a payload begins with the encapsulation header of CDR, of either byte order (RTPS 2.5, table
/// 10.3).
pub(in crate::middleware) fn is_cdr(payload: &[u8]) -> bool {
    matches!(payload, [0, 0 | 1, _, _, ..])
}

/// The vendor of a participant or endpoint. In a protected domain the identity does not tell, but begins with
/// a bit that no vendor has (DDS Security 1.1, section 9.3.3).
fn vendor_of(peer: Gid, look_up: impl FnOnce(GuidPrefix) -> Option<VendorId>) -> [u8; 2] {
    let is_derived = peer.0[0] & 0x80 != 0;
    let known = if is_derived { look_up(prefix(peer)) } else { None };
    known.map_or_else(|| peer.vendor(), |vendor| vendor.0)
}

fn prefix(gid: Gid) -> GuidPrefix {
    Guid::from_bytes(gid.0).prefix
}

fn gid(guid: Guid) -> Gid {
    Gid(guid.to_bytes())
}

fn config(endpoint: &Endpoint) -> Result<EndpointConfig, MiddlewareError> {
    let mut config = EndpointConfig::new(&endpoint.topic_name, &endpoint.type_name, qos::to_rtps(endpoint)?);
    if let Some(hash) = &endpoint.type_hash {
        config.user_data = format!("{TYPE_HASH}{hash};").into();
    }
    config.send_window = endpoint.send_window.try_into().unwrap_or(usize::MAX);
    config.send_window_bytes = endpoint.send_window_bytes;
    Ok(config)
}

fn refused(kind: &'static str, endpoint: &Endpoint, error: &protocol::CreateError) -> MiddlewareError {
    MiddlewareError::Endpoint {
        endpoint: kind,
        topic_name: endpoint.topic_name.clone(),
        type_name: endpoint.type_name.clone(),
        reason: error.to_string(),
    }
}

fn sample(received: protocol::Sample) -> Sample {
    Sample {
        cdr: received.payload,
        source_time_ns: received.source_timestamp.map(wire::Timestamp::to_nanos),
        writer: gid(received.writer),
        sequence_number: received.number.0,
        related: received
            .inline_qos
            .related_sample_identity
            .map(|related| SampleIdentity { endpoint: gid(related.writer), number: related.number.0 }),
    }
}

fn remote(data: EndpointData) -> RemoteEndpoint {
    let is_writer = data.guid.entity.is_writer();
    let profile = qos::from_rtps(&data.qos);
    RemoteEndpoint {
        gid: gid(data.guid),
        direction: if is_writer { Direction::Out } else { Direction::In },
        type_hash: type_hash(&data.user_data),
        topic_name: data.topic,
        type_name: data.type_name,
        reliability: profile.reliability,
        durability: profile.durability,
        deadline: profile.deadline,
        lifespan: profile.lifespan,
        liveliness: profile.liveliness,
        liveliness_lease_duration: profile.liveliness_lease_duration,
        node: None,
    }
}

/// The hash in the user data of an endpoint: entries `name=value;`, one of them `typehash=RIHS01_…;`.
fn type_hash(user_data: &[u8]) -> Option<String> {
    let hash =
        user_data.split(|byte| *byte == b';').find_map(|entry| entry.strip_prefix(TYPE_HASH.as_bytes()))?;
    let digits = hash.strip_prefix(b"RIHS01_")?;
    let is_hash = digits.len() == 64 && digits.iter().all(u8::is_ascii_hexdigit);
    is_hash.then(|| String::from_utf8_lossy(hash).into_owned())
}

fn listener(handler: EventHandler) -> downbeat_rtps::EventHandler {
    Box::new(move |event| {
        handler(&translated(event));
    })
}

fn translated(event: &downbeat_rtps::EndpointEvent) -> EndpointEvent {
    use downbeat_rtps::EndpointEvent as Event;
    match *event {
        Event::Matched { peer } => EndpointEvent::Matched { peer: gid(peer) },
        Event::Unmatched { peer } => EndpointEvent::Unmatched { peer: gid(peer) },
        Event::Incompatible { peer, policy } => {
            let policy = match policy {
                downbeat_rtps::qos::Policy::Durability => QosPolicyKind::Durability,
                downbeat_rtps::qos::Policy::Deadline => QosPolicyKind::Deadline,
                downbeat_rtps::qos::Policy::Liveliness => QosPolicyKind::Liveliness,
                downbeat_rtps::qos::Policy::Reliability => QosPolicyKind::Reliability,
                _ => QosPolicyKind::Other,
            };
            EndpointEvent::IncompatibleQos { peer: gid(peer), policy }
        }
        Event::OtherType { peer, ref type_name } => {
            EndpointEvent::IncompatibleType { peer: gid(peer), type_name: Arc::clone(type_name) }
        }
        Event::DeadlineMissed { count } => {
            EndpointEvent::DeadlineMissed { count: count.try_into().unwrap_or(u32::MAX) }
        }
        Event::LivelinessLost => EndpointEvent::LivelinessLost,
        Event::LivelinessChanged { peer, change } => {
            let now = match change {
                LivelinessChange::Alive | LivelinessChange::Revived => Aliveness::Alive,
                LivelinessChange::NotAlive => Aliveness::NotAlive,
                LivelinessChange::AliveRemoved | LivelinessChange::NotAliveRemoved => Aliveness::Gone,
            };
            EndpointEvent::LivelinessChanged { peer: gid(peer), now }
        }
        Event::BegunAnew { peer } => EndpointEvent::BegunAnew { peer: gid(peer) },
        Event::Lost { peer, count } => EndpointEvent::MessagesLost { peer: gid(peer), count },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_of_a_type_is_found_among_other_user_data() {
        let hash = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
        let found = |text: &str| type_hash(text.as_bytes());
        assert_eq!(found(&format!("typehash={hash};")).as_deref(), Some(hash));
        assert_eq!(found(&format!("serviceid=1;typehash={hash};\0")).as_deref(), Some(hash));
        assert_eq!(found("typehash=RIHS01_12;"), None);
        assert_eq!(found("typehash=RIHS02_00;"), None);
        assert_eq!(found(""), None);
    }

    #[test]
    fn cdr_of_either_byte_order_is_sent() {
        assert!(is_cdr(&[0, 0, 0, 0]) && is_cdr(&[0, 1, 0, 3, 7]));
        assert!(!is_cdr(&[0, 1, 0]) && !is_cdr(&[0, 3, 0, 0]) && !is_cdr(&[1, 1, 0, 0]));
    }
}
