//! Handshakes that Cyclone DDS and Fast DDS had with each other, and the keys with which they agreed
//! (`tests/data/README.md`).

use sha2::{Digest, Sha256};

use super::*;
use crate::authentication::messages::{Reply, Request, verify_final};
use crate::pki::PkiError;

struct Recording {
    request: GenericMessage,
    reply: GenericMessage,
    last: GenericMessage,
    talker_key: [u8; 32],
    listener_key: [u8; 32],
    /// As hashed by both.
    secret: [u8; 32],
}

impl Recording {
    fn read(name: &str) -> Self {
        let message = |step| {
            let bytes = file(&format!("handshakes/{name}/{step}.bin"));
            let message = GenericMessage::parse(&bytes).unwrap();
            let mut emitted = Vec::new();
            message.emit(&mut emitted, ByteOrder::Little);
            // Cyclone DDS leaves out the padding at the end.
            let padding = emitted.strip_prefix(&*bytes);
            assert!(padding.is_some_and(|padding| [0; 3].starts_with(padding)), "{name}/{step}");
            message
        };
        let agreement = String::from_utf8(file(&format!("handshakes/{name}/agreement.txt"))).unwrap();
        let hex = |label: &str| {
            let line = agreement.lines().find_map(|line| line.strip_prefix(label)).unwrap();
            let pairs = line.as_bytes().chunks(2).map(|pair| std::str::from_utf8(pair).unwrap());
            pairs.map(|pair| u8::from_str_radix(pair, 16).unwrap()).collect::<Vec<_>>()
        };
        let key = |label| {
            let short = hex(label);
            let mut key = [0; 32];
            key[32 - short.len()..].copy_from_slice(&short);
            key
        };
        Self {
            request: message("request"),
            reply: message("reply"),
            last: message("final"),
            talker_key: key("talker private "),
            listener_key: key("listener private "),
            secret: Sha256::digest(hex("secret ")).into(),
        }
    }
}

const ALL: [&str; 3] = ["cyclone", "fastdds", "cyclone_to_fastdds"];

#[test]
fn recorded_messages_are_understood_and_their_signatures_hold() {
    let time = SystemTime::UNIX_EPOCH + TIME;
    let (talker, listener) = (identity(OTHER, "talker"), identity(OTHER, "listener"));
    for name in ALL {
        let Recording { request, reply, last, secret, .. } = Recording::read(name);
        let parsed = Request::parse(&request.tokens[0]).unwrap();
        let prefix = request.source.0.prefix;
        let remote = parsed.credentials.check(prefix, &listener, time).unwrap();
        assert_eq!(remote.certificate, talker.certificate);
        assert_eq!(remote.permissions_document, talker.permissions_document);
        let answer = Reply::parse(&reply.tokens[0], &parsed).unwrap();
        let replier = answer.credentials.check(reply.source.0.prefix, &talker, time).unwrap();
        assert_eq!(replier.certificate, listener.certificate);
        answer.verify(&replier).unwrap();
        verify_final(&last.tokens[0], &answer.exchange, &remote).unwrap();
        // What is signed by one is not signed by the other.
        let subject = "CN=/talker".to_owned();
        assert_eq!(answer.verify(&remote), Err(Refusal::Signature { subject }));
        // Fast DDS has all optional fields, and the order of ours.
        if name == "fastdds" {
            assert_eq!(parsed.emit(), request.tokens[0]);
        }
        if name != "cyclone" {
            assert_eq!(answer.emit(), reply.tokens[0]);
        }
        assert_ne!(secret, [0; 32]);
    }
}

/// The request and the final message are those of Fast DDS. The reply is ours, with the key and the random
/// number that Fast DDS had, and its data.
#[test]
fn the_request_of_fast_dds_is_answered_as_it_was() {
    let Recording { request, reply, last, listener_key, secret, .. } = Recording::read("fastdds");
    let recorded = |field| reply.tokens[0].binary(field).unwrap().to_vec();
    let (own, participant_data) = (identity(OTHER, "listener"), recorded("c.pdata"));
    let remote = Guid::new(request.source.0.prefix, EntityId::PARTICIPANT);
    let mut handshake = Handshake::new(request.destination_participant, remote, *START);
    let mut numbers = vec![listener_key.to_vec(), recorded("challenge2")];
    let mut context = Context {
        identity: &own,
        participant_data: &participant_data,
        random: &mut |bytes| bytes.copy_from_slice(&numbers.pop().unwrap()),
        last_number: &mut 0,
        now: *START,
        time: SystemTime::UNIX_EPOCH + TIME,
    };
    let Output::Send(mut ours) = only(handshake.handle(&request, &mut context)) else { panic!("no reply") };
    // Signatures of OpenSSL are random.
    let (name, _) = ours.tokens[0].binary.pop().unwrap();
    ours.tokens[0].binary.push((name, recorded("signature")));
    assert_eq!(ours, reply);
    let Output::Done { remote, secret: shared } = only(handshake.handle(&last, &mut context)) else {
        panic!("not done")
    };
    assert_eq!(shared.secret, secret);
    assert_eq!(shared.challenge1, request.tokens[0].binary("challenge1").unwrap());
    assert_eq!(shared.challenge2, *recorded("challenge2"));
    assert_eq!(remote.certificate, identity(OTHER, "talker").certificate);
}

#[test]
fn the_initiator_of_a_recorded_handshake_agrees_on_the_recorded_secret() {
    use crate::authentication::agreement::{EphemeralKey, Method};
    for name in ALL {
        let Recording { request, reply, talker_key, secret, .. } = Recording::read(name);
        let method = if name == "fastdds" { Method::Modp } else { Method::Ecdh };
        let key = EphemeralKey::generate(method, &mut |bytes| bytes.copy_from_slice(&talker_key));
        assert_eq!(key.agree(reply.tokens[0].binary("dh2").unwrap()), Some(secret), "{name}");
        assert_eq!(key.public(), request.tokens[0].binary("dh1").unwrap(), "{name}");
    }
}

#[test]
fn requests_to_begin_are_read_and_need_no_answer() {
    for path in ["cyclone/auth_request_of_listener", "cyclone_to_fastdds/auth_request_of_talker"] {
        let message = GenericMessage::parse(&file(&format!("handshakes/{path}.bin"))).unwrap();
        assert_eq!(message.class, crate::tokens::class::AUTHENTICATION_REQUEST);
        assert_eq!(message.tokens[0].binary("future_challenge").map(<[u8]>::len), Some(32));
        let remote = Guid::new(message.source.0.prefix, EntityId::PARTICIPANT);
        let mut peer = Peer::new(identity(OTHER, "talker"), 0);
        peer.guid = message.destination_participant;
        peer.begin(remote, *START);
        assert_eq!(peer.handle(&message, *START), []);
        assert_eq!(peer.refused, []);
    }
}

#[test]
fn a_recorded_certificate_is_not_one_of_another_keystore() {
    let request = Recording::read("cyclone").request;
    let mut listener = Peer::listener();
    listener.guid = request.destination_participant;
    listener.begin(Guid::new(request.source.0.prefix, EntityId::PARTICIPANT), *START);
    assert_eq!(listener.handle(&request, *START), []);
    let text = listener.last_refused().unwrap().to_string();
    assert!(text.contains("was not signed by its key"), "{text}");
    assert_ne!(text, Refusal::from(PkiError::Key).to_string());
}
