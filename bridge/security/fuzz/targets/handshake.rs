//! The messages of handshakes, for the participant that has to begin and for the other one.

use std::sync::LazyLock;
use std::time::Instant;

use downbeat_rtps::wire::{EntityId, Guid, GuidPrefix};
use downbeat_security::authentication::{Context, Handshake, Identity, Output, derive_prefix};
use downbeat_security::pki::{Certificate, PrivateKey};
use downbeat_security::tokens::{ByteOrder, GenericMessage};

use super::pki::{AUTHORITY, keystore, time};

/// A participant whose random numbers are always the same.
struct Party {
    identity: Identity,
    guid: Guid,
    participant_data: Vec<u8>,
}

impl Party {
    fn new(certificate: &[u8], key: &[u8], permissions: &[u8]) -> Self {
        let certificate = Certificate::from_pem(certificate).expect("a certificate");
        let prefix = derive_prefix(&certificate, GuidPrefix([1; 12]));
        let guid = Guid::new(prefix, EntityId::PARTICIPANT);
        let identity = Identity {
            certificate,
            key: PrivateKey::from_pem(key).expect("a key"),
            authority: AUTHORITY.clone(),
            permissions_document: permissions.to_vec(),
        };
        let participant_data = [&[0, 0x50, 0, 16][..], &guid.to_bytes(), &[0, 1, 0, 0]].concat();
        Self { identity, guid, participant_data }
    }

    fn with<T>(&self, call: impl FnOnce(&mut Context<'_>) -> T) -> T {
        let mut next = 0;
        let mut random = |bytes: &mut [u8]| {
            next += 1;
            bytes.fill(next);
        };
        call(&mut Context {
            identity: &self.identity,
            participant_data: &self.participant_data,
            random: &mut random,
            last_number: &mut 0,
            now: *START,
            time: time(),
        })
    }
}

static START: LazyLock<Instant> = LazyLock::new(Instant::now);
static TALKER: LazyLock<Party> = LazyLock::new(|| {
    Party::new(
        keystore!("enclaves/talker/cert.pem"),
        keystore!("enclaves/talker/key.pem"),
        keystore!("enclaves/talker/permissions.p7s"),
    )
});
static LISTENER: LazyLock<Party> = LazyLock::new(|| {
    Party::new(
        keystore!("enclaves/listener/cert.pem"),
        keystore!("enclaves/listener/key.pem"),
        keystore!("enclaves/listener/permissions.p7s"),
    )
});

/// The talker after its request, and the request.
fn talker() -> (Handshake, GenericMessage) {
    let mut handshake = Handshake::new(TALKER.guid, LISTENER.guid, *START);
    let outputs = TALKER.with(|context| handshake.handle_timeout(context));
    let request = sent(outputs).expect("the request");
    (handshake, request)
}

fn sent(outputs: Vec<Output>) -> Option<GenericMessage> {
    outputs.into_iter().find_map(|output| match output {
        Output::Send(message) => Some(message),
        _ => None,
    })
}

/// The request, the reply and the final message.
static GENUINE: LazyLock<[GenericMessage; 3]> = LazyLock::new(|| {
    let (mut talker, request) = talker();
    let mut listener = Handshake::new(LISTENER.guid, TALKER.guid, *START);
    let reply = sent(LISTENER.with(|context| listener.handle(&request, context))).expect("the reply");
    let last = sent(TALKER.with(|context| talker.handle(&reply, context))).expect("the final message");
    let done = LISTENER.with(|context| listener.handle(&last, context));
    assert!(done.iter().any(|output| matches!(output, Output::Done { .. })));
    [request, reply, last]
});

/// Values without which a message means the same, since both sides know them.
const OPTIONAL: [&str; 4] = ["hash_c1", "hash_c2", "dh1", "dh2"];

/// Whether all that a message says is what the genuine one says.
fn is_genuine(message: &GenericMessage, genuine: &GenericMessage) -> bool {
    let ([token], [expected]) = (&*message.tokens, &*genuine.tokens) else { return false };
    let is_same = |(name, value): &(String, Vec<u8>)| {
        token.binary(name).map_or(OPTIONAL.contains(&&**name), |found| found == value)
    };
    expected.binary.iter().all(is_same)
}

/// Handles a message in both roles.
pub fn run(bytes: &[u8]) -> bool {
    let Ok(message) = GenericMessage::parse(bytes) else { return false };
    let [request, reply, last] = &*GENUINE;
    let class = message.tokens.first().map(|token| token.class_id.as_str()).unwrap_or_default();
    let done = |outputs: Vec<Output>| outputs.iter().any(|output| matches!(output, Output::Done { .. }));
    if class.ends_with("+Reply") {
        let (mut talker, _) = talker();
        if done(TALKER.with(|context| talker.handle(&message, context))) {
            assert!(is_genuine(&message, reply), "a changed reply passes");
        }
    } else {
        let mut listener = Handshake::new(LISTENER.guid, TALKER.guid, *START);
        if class.ends_with("+Final") {
            LISTENER.with(|context| listener.handle(request, context));
        }
        if done(LISTENER.with(|context| listener.handle(&message, context))) {
            assert!(is_genuine(&message, last), "a changed final message passes");
        }
    }
    true
}

pub fn messages() -> Vec<Vec<u8>> {
    let emitted = |message: &GenericMessage| {
        let mut emitted = Vec::new();
        message.emit(&mut emitted, ByteOrder::Little);
        emitted
    };
    GENUINE.iter().map(emitted).collect()
}
