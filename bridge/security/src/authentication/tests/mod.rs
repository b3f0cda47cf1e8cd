//! Handshakes of two participants over a link that can lose, repeat and reorder messages.

mod attacks;
mod conversations;
mod recorded;

use std::sync::LazyLock;
use std::time::{Duration, Instant, SystemTime};

use downbeat_rtps::wire::{EntityId, Guid, GuidPrefix};
use fuzzing::Random;

use super::{Context, Handshake, Identity, Output, Refusal, RemoteIdentity, SharedSecret, derive_prefix};
use crate::pki::{Authority, Certificate, PrivateKey};
use crate::tokens::{ByteOrder, GenericMessage};

/// In 2027, when all certificates of the tests are valid.
const TIME: Duration = Duration::from_secs(1_798_761_600);
const SECOND: Duration = Duration::from_secs(1);

static START: LazyLock<Instant> = LazyLock::new(Instant::now);

fn file(path: &str) -> Vec<u8> {
    let path = format!("{}/tests/data/{path}", env!("CARGO_MANIFEST_DIR"));
    std::fs::read(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// The keystore of most participants here.
const OURS: &str = "all_domains";
/// Another, whose authority has the same name.
const OTHER: &str = "captured";

fn certificate(keystore: &str, name: &str) -> Certificate {
    Certificate::from_pem(&file(&format!("keystores/{keystore}/{name}.pem"))).unwrap()
}

fn key(keystore: &str, name: &str) -> PrivateKey {
    PrivateKey::from_pem(&file(&format!("keystores/{keystore}/enclaves/{name}/key.pem"))).unwrap()
}

fn identity(keystore: &str, name: &str) -> Identity {
    Identity {
        certificate: certificate(keystore, &format!("enclaves/{name}/cert")),
        key: key(keystore, name),
        authority: Authority::new(certificate(keystore, "public/ca.cert"), None).unwrap(),
        permissions_document: file(&format!("keystores/{keystore}/enclaves/{name}/permissions.p7s")),
    }
}

/// The holder of a certificate and its side of a handshake.
struct Peer {
    identity: Identity,
    guid: Guid,
    participant_data: Vec<u8>,
    time: SystemTime,
    random: Random,
    last_number: i64,
    handshake: Option<Handshake>,
    /// All that the handshake has put out, except messages.
    done: Vec<(RemoteIdentity, SharedSecret)>,
    refused: Vec<Refusal>,
    gave_up: Vec<Refusal>,
}

impl Peer {
    fn new(identity: Identity, seed: u64) -> Self {
        let candidate = GuidPrefix(std::array::from_fn(|index| index as u8));
        let guid = Guid::new(derive_prefix(&identity.certificate, candidate), EntityId::PARTICIPANT);
        Self {
            participant_data: participant_data(guid),
            identity,
            guid,
            time: SystemTime::UNIX_EPOCH + TIME,
            random: Random::new(seed),
            last_number: 0,
            handshake: None,
            done: Vec::new(),
            refused: Vec::new(),
            gave_up: Vec::new(),
        }
    }

    /// The holder of the certificate for `/talker`, whose derived GUID is smaller.
    fn talker() -> Self {
        Self::new(identity(OURS, "talker"), 1)
    }

    fn listener() -> Self {
        Self::new(identity(OURS, "listener"), 2)
    }

    /// The certificate names `/listener`, but is of another authority of the same name.
    fn stranger() -> Self {
        Self::new(identity(OTHER, "listener"), 3)
    }

    fn begin(&mut self, remote: Guid, now: Instant) {
        self.handshake = Some(Handshake::new(self.guid, remote, now));
    }

    fn with_context(
        &mut self,
        now: Instant,
        action: impl FnOnce(&mut Handshake, &mut Context<'_>) -> Vec<Output>,
    ) -> Vec<GenericMessage> {
        let random = &mut self.random;
        let mut context = Context {
            identity: &self.identity,
            participant_data: &self.participant_data,
            random: &mut |bytes| bytes.fill_with(|| random.bits() as u8),
            last_number: &mut self.last_number,
            now,
            time: self.time,
        };
        let outputs = action(self.handshake.as_mut().unwrap(), &mut context);
        let mut sent = Vec::new();
        for output in outputs {
            match output {
                Output::Send(message) => sent.push(message),
                Output::Done { remote, secret } => self.done.push((*remote, secret)),
                Output::Refused(refusal) => self.refused.push(refusal),
                Output::GaveUp(refusal) => self.gave_up.push(refusal),
            }
        }
        sent
    }

    fn handle(&mut self, message: &GenericMessage, now: Instant) -> Vec<GenericMessage> {
        // What arrives has been on the wire.
        let mut bytes = Vec::new();
        message.emit(&mut bytes, ByteOrder::Little);
        let message = GenericMessage::parse(&bytes).unwrap();
        self.with_context(now, |handshake, context| handshake.handle(&message, context))
    }

    fn handle_timeout(&mut self, now: Instant) -> Vec<GenericMessage> {
        self.with_context(now, |handshake, context| handshake.handle_timeout(context))
    }

    fn next_timeout(&self) -> Option<Instant> {
        self.handshake.as_ref().unwrap().next_timeout()
    }

    fn is_done(&self) -> bool {
        self.handshake.as_ref().unwrap().is_done()
    }

    /// The last reason why a message was dropped.
    fn last_refused(&self) -> Option<&Refusal> {
        self.refused.last()
    }
}

fn participant_data(guid: Guid) -> Vec<u8> {
    [&[0, 0x50, 0, 16][..], &guid.to_bytes(), &[0, 1, 0, 0]].concat()
}

/// Begins a handshake and returns the two, the initiator's first.
fn pair(mut talker: Peer, mut listener: Peer) -> (Peer, Peer) {
    talker.begin(listener.guid, *START);
    listener.begin(talker.guid, *START);
    (talker, listener)
}

/// The request, the reply and the final message of an undisturbed handshake.
fn three_messages(talker: &mut Peer, listener: &mut Peer) -> [GenericMessage; 3] {
    let request = only(talker.handle_timeout(*START));
    let reply = only(listener.handle(&request, *START));
    let last = only(talker.handle(&reply, *START));
    assert_eq!(listener.handle(&last, *START), []);
    [request, reply, last]
}

#[track_caller]
fn only<T: std::fmt::Debug>(of: Vec<T>) -> T {
    let [only] = <[T; 1]>::try_from(of).unwrap();
    only
}

#[track_caller]
fn assert_agree(talker: &Peer, listener: &Peer) {
    let ((of_listener, secret), (of_talker, other)) = (&talker.done[0], &listener.done[0]);
    assert_eq!(secret, other);
    assert_ne!(secret.challenge1, secret.challenge2);
    for (seen, peer) in [(of_listener, listener), (of_talker, talker)] {
        assert_eq!(seen.certificate, peer.identity.certificate);
        assert_eq!(seen.permissions_document, peer.identity.permissions_document);
        assert_eq!(seen.participant_data, peer.participant_data);
    }
}
