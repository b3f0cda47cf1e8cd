//! Participants and strangers that do not follow the protocol.

use super::*;

type Change = fn(&mut GenericMessage);

fn value<'a>(message: &'a mut GenericMessage, field: &str) -> &'a mut Vec<u8> {
    &mut message.tokens[0].binary.iter_mut().find(|(name, _)| name == field).unwrap().1
}

fn remove(message: &mut GenericMessage, field: &str) {
    message.tokens[0].binary.retain(|(name, _)| name != field);
}

#[test]
fn a_participant_of_another_authority_is_refused_in_both_roles() {
    // As replier: the talker refuses it.
    let (mut talker, mut stranger) = pair(Peer::talker(), Peer::stranger());
    stranger.identity.authority = talker.identity.authority.clone();
    let request = only(talker.handle_timeout(*START));
    let reply = only(stranger.handle(&request, *START));
    assert_eq!(talker.handle(&reply, *START), []);
    let text = talker.last_refused().unwrap().to_string();
    assert!(text.contains("names \"CN=sros2CA\" as its authority, but was not signed by its key"), "{text}");
    assert!(!talker.is_done());
    // As initiator, towards a participant with a greater GUID.
    let mut listener = Peer::listener();
    listener.guid.prefix.0[11] = 0xff;
    listener.participant_data = participant_data(listener.guid);
    let (mut stranger, mut listener) = pair(Peer::stranger(), listener);
    let request = only(stranger.handle_timeout(*START));
    assert_eq!(listener.handle(&request, *START), []);
    assert!(matches!(listener.last_refused(), Some(Refusal::Distrust(_))));
}

/// Each message of the talker, changed, and what the listener says of it.
#[test]
fn wrong_requests_are_refused_for_the_right_reason() {
    let subject = Refusal::Subject { prefix: Peer::talker().guid.prefix, subject: "CN=/listener".into() };
    let missing = |field| Refusal::Missing { field };
    let cases: Vec<(&str, Change, Refusal)> = vec![
        ("no certificate", |message| remove(message, "c.id"), missing("c.id")),
        ("no permissions", |message| remove(message, "c.perm"), missing("c.perm")),
        ("no data", |message| remove(message, "c.pdata"), missing("c.pdata")),
        ("no challenge", |message| remove(message, "challenge1"), missing("challenge1")),
        ("no key", |message| remove(message, "dh1"), missing("dh1")),
        (
            "changed permissions",
            |message| value(message, "c.perm").push(1),
            Refusal::Mismatch { field: "hash_c1" },
        ),
        (
            "empty permissions",
            |message| {
                remove(message, "hash_c1");
                value(message, "c.perm").clear();
            },
            Refusal::Permissions,
        ),
        (
            "the certificate of another",
            |message| {
                remove(message, "hash_c1");
                *value(message, "c.id") = certificate(OURS, "enclaves/listener/cert").pem().to_vec();
            },
            subject,
        ),
        (
            "no certificate but text",
            |message| {
                remove(message, "hash_c1");
                *value(message, "c.id") = b"certificate".to_vec();
            },
            Refusal::Certificate(crate::pki::PkiError::NoBlock { expected: "CERTIFICATE" }),
        ),
        (
            "data of another",
            |message| {
                remove(message, "hash_c1");
                *value(message, "c.pdata") = participant_data(Peer::listener().guid);
            },
            Refusal::OtherParticipant {
                found: Peer::listener().guid.prefix,
                expected: Peer::talker().guid.prefix,
            },
        ),
        (
            "data without a GUID",
            |message| {
                remove(message, "hash_c1");
                *value(message, "c.pdata") = vec![0, 1, 0, 0];
            },
            Refusal::ParticipantData,
        ),
        (
            "RSA signatures",
            |message| {
                remove(message, "hash_c1");
                *value(message, "c.dsign_algo") = b"RSASSA-PSS-SHA256\0".to_vec();
            },
            Refusal::SignatureAlgorithm { found: "RSASSA-PSS-SHA256\\0".into() },
        ),
        (
            "another key agreement",
            |message| {
                remove(message, "hash_c1");
                *value(message, "c.kagree_algo") = b"ECDH+secp384r1".to_vec();
            },
            Refusal::KeyAgreement { found: "ECDH+secp384r1".into() },
        ),
        (
            "a key of another kind",
            |message| value(message, "dh1").push(0),
            Refusal::PublicKey { field: "dh1" },
        ),
        (
            "a key beside the curve",
            |message| *value(message, "dh1").last_mut().unwrap() ^= 1,
            Refusal::PublicKey { field: "dh1" },
        ),
        (
            "a short challenge",
            |message| value(message, "challenge1").truncate(31),
            Refusal::Length { field: "challenge1", found: 31, expected: 32 },
        ),
        (
            "two challenges",
            |message| {
                let challenge = ("challenge1".to_owned(), vec![0; 32]);
                message.tokens[0].binary.push(challenge);
            },
            Refusal::Twice { field: "challenge1".into() },
        ),
        (
            "another step",
            |message| message.tokens[0].class_id = "DDS:Auth:PKI-DH:1.0+Reply".into(),
            Refusal::Class { found: "DDS:Auth:PKI-DH:1.0+Reply".into() },
        ),
        ("no token", |message| message.tokens.clear(), Refusal::Tokens { found: 0 }),
    ];
    let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
    let request = only(talker.handle_timeout(*START));
    for (case, change, expected) in cases {
        let mut wrong = request.clone();
        change(&mut wrong);
        assert_eq!(listener.handle(&wrong, *START), [], "{case}");
        assert_eq!(listener.last_refused(), Some(&expected), "{case}");
    }
    // None of them is in the way of the right one.
    let reply = only(listener.handle(&request, *START));
    let last = only(talker.handle(&reply, *START));
    listener.handle(&last, *START);
    assert_agree(&talker, &listener);
}

#[test]
fn a_reply_or_final_message_with_any_changed_field_is_refused() {
    let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
    let request = only(talker.handle_timeout(*START));
    let reply = only(listener.handle(&request, *START));
    let changed = |message: &GenericMessage, index: usize| {
        let mut message = message.clone();
        *message.tokens[0].binary[index].1.last_mut().unwrap() ^= 1;
        message
    };
    for index in 0..reply.tokens[0].binary.len() {
        assert_eq!(talker.handle(&changed(&reply, index), *START), []);
        assert_eq!(talker.refused.len(), index + 1);
    }
    assert!(talker.done.is_empty());
    let last = only(talker.handle(&reply, *START));
    for index in 0..last.tokens[0].binary.len() {
        assert_eq!(listener.handle(&changed(&last, index), *START), []);
        assert_eq!(listener.refused.len(), index + 1);
    }
    assert!(listener.done.is_empty());
    listener.handle(&last, *START);
    assert_agree(&talker, &listener);
}

#[test]
fn changed_hashes_that_fit_the_changed_credentials_do_not_fit_the_signature() {
    let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
    let request = only(talker.handle_timeout(*START));
    let mut reply = only(listener.handle(&request, *START));
    value(&mut reply, "c.perm").push(1);
    remove(&mut reply, "hash_c2");
    assert_eq!(talker.handle(&reply, *START), []);
    let expected = Refusal::Signature { subject: "CN=/listener".into() };
    assert_eq!(talker.last_refused(), Some(&expected));
}

/// The attacker has seen all public parts of the talker: certificate, permissions, data.
#[test]
fn a_stolen_certificate_without_its_key_opens_nothing() {
    let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
    let mut thief = Peer::talker();
    thief.identity.key = key(OTHER, "listener");
    thief.random = Random::new(99);
    thief.begin(listener.guid, *START);
    let forged = only(thief.handle_timeout(*START));
    let reply = only(listener.handle(&forged, *START));
    let last = only(thief.handle(&reply, *START));
    assert_eq!(listener.handle(&last, *START), []);
    assert_eq!(listener.last_refused(), Some(&Refusal::Signature { subject: "CN=/talker".into() }));
    // The talker comes through all the same.
    three_messages(&mut talker, &mut listener);
    assert_agree(&talker, &listener);
    // And as replier, it does not come through.
    let (mut talker, mut thief) = pair(Peer::talker(), Peer::listener());
    thief.identity.key = key(OTHER, "listener");
    let request = only(talker.handle_timeout(*START));
    let reply = only(thief.handle(&request, *START));
    assert_eq!(talker.handle(&reply, *START), []);
    assert_eq!(talker.last_refused(), Some(&Refusal::Signature { subject: "CN=/listener".into() }));
}

#[test]
fn replayed_messages_neither_change_a_finished_handshake_nor_finish_a_new_one() {
    let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
    let recorded = three_messages(&mut talker, &mut listener);
    for message in recorded.iter().chain(recorded.iter().rev()) {
        talker.handle(message, *START);
        listener.handle(message, *START);
    }
    assert_eq!((talker.done.len(), listener.done.len()), (1, 1));
    assert!(talker.is_done() && listener.is_done());
    // The same participants, after both have lost their state.
    let (mut talker, mut listener) = pair(talker, listener);
    let request = only(talker.handle_timeout(*START));
    for message in &recorded {
        talker.handle(message, *START);
        listener.handle(message, *START);
    }
    assert_eq!((talker.done.len(), listener.done.len()), (1, 1));
    assert!(!talker.is_done() && !listener.is_done());
    let reply = only(listener.handle(&request, *START));
    let last = only(talker.handle(&reply, *START));
    listener.handle(&last, *START);
    assert_eq!(talker.done[1].1, listener.done[1].1);
    // A replay into the finished handshake of a new session, which the replier answers, but only once.
    listener.handle(&recorded[0], *START);
    listener.handle(&recorded[2], *START);
    assert_eq!(listener.done.len(), 2);
}

#[test]
fn messages_for_others_and_of_others_are_ignored() {
    let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
    let request = only(talker.handle_timeout(*START));
    let changes: [Change; 3] = [
        |message| message.destination_participant = Guid::UNKNOWN,
        |message| message.source.0.prefix.0[5] ^= 1,
        |message| message.class = "dds.sec.auth_request".into(),
    ];
    for change in changes {
        let mut other = request.clone();
        change(&mut other);
        assert_eq!(listener.handle(&other, *START), []);
    }
    assert_eq!(listener.refused, []);
}

#[test]
fn a_flood_of_forged_requests_costs_little_memory_and_few_messages() {
    let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
    let request = only(talker.handle_timeout(*START));
    let flood = |listener: &mut Peer, seed| {
        let mut forged = request.clone();
        let mut random = Random::new(seed);
        value(&mut forged, "challenge1").fill_with(|| random.bits() as u8);
        only(listener.handle(&forged, *START))
    };
    for seed in 0..20 {
        flood(&mut listener, seed);
    }
    let later = *START + SECOND;
    assert_eq!(listener.handle_timeout(later).len(), 4);
    // The right request is answered in the middle of them, and may be followed by three.
    let reply = only(listener.handle(&request, later));
    (20..23).for_each(|seed| drop(flood(&mut listener, seed)));
    let last = only(talker.handle(&reply, later));
    listener.handle(&last, later);
    assert_agree(&talker, &listener);
    assert_eq!(listener.next_timeout(), None);
    // Without a final message, a reply is repeated ten times at most.
    flood(&mut listener, 30);
    let mut repeated = 0;
    while let Some(due) = listener.next_timeout() {
        repeated += listener.handle_timeout(due).len();
    }
    assert_eq!(repeated, 10);
}
