//! Participants that follow the protocol, over bad links and with gaps.

use super::*;
use crate::authentication::{identity_token, permissions_token};
use crate::pki::{Crl, PkiError};

#[test]
fn two_participants_prove_themselves_and_share_a_secret() {
    let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
    let [request, reply, last] = three_messages(&mut talker, &mut listener);
    assert_agree(&talker, &listener);
    assert!(talker.is_done() && listener.is_done());
    assert_eq!((talker.next_timeout(), listener.next_timeout()), (None, None));
    // Fast DDS requires that each message names the one that it answers.
    let stateless = |peer: &Peer| Guid::new(peer.guid.prefix, EntityId::STATELESS_WRITER);
    assert_eq!((request.source, request.related), ((stateless(&talker), 1), (Guid::UNKNOWN, 0)));
    assert_eq!((reply.source, reply.related), ((stateless(&listener), 1), request.source));
    assert_eq!((last.source, last.related), ((stateless(&talker), 2), reply.source));
    let names = |message: &GenericMessage| {
        message.tokens[0].binary.iter().map(|(name, _)| name.clone()).collect::<Vec<_>>().join(" ")
    };
    let own = "c.id c.perm c.pdata c.dsign_algo c.kagree_algo";
    assert_eq!(names(&request), format!("{own} hash_c1 dh1 challenge1"));
    assert_eq!(names(&reply), format!("{own} hash_c2 dh2 hash_c1 dh1 challenge1 challenge2 signature"));
    assert_eq!(names(&last), "hash_c1 hash_c2 dh1 dh2 challenge1 challenge2 signature");
}

#[test]
fn the_prefix_is_derived_from_the_subject() {
    // Computed by Python's hashlib.
    assert_eq!(Peer::talker().guid.prefix.to_string(), "93eb4bd165cd3ce995b7a341");
    assert_eq!(Peer::listener().guid.prefix.to_string(), "b604d120075f3ce995b7a341");
}

#[test]
fn tokens_in_announcements_name_the_subjects() {
    let talker = Peer::talker();
    let token = identity_token(&talker.identity.certificate, talker.identity.authority.certificate());
    assert_eq!(token.class_id, "DDS:Auth:PKI-DH:1.0");
    assert_eq!(
        (token.property("dds.cert.sn"), token.property("dds.ca.sn")),
        (Some("CN=/talker"), Some("CN=sros2CA"))
    );
    assert_eq!(token.property("dds.cert.algo"), Some("ECDSA-SHA256"));
    assert_eq!(permissions_token().class_id, "DDS:Access:Permissions:1.0");
}

#[test]
fn handshakes_survive_loss_repetition_and_reordering() {
    for seed in fuzzing::rounds(60) {
        let mut random = Random::new(seed);
        let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
        // Messages on their way, and when they arrive.
        let mut link: Vec<(Instant, bool, GenericMessage)> = Vec::new();
        let mut now = *START;
        while !(talker.is_done() && listener.is_done()) {
            assert!(now < *START + 50 * SECOND, "seed {seed}: no result in time");
            let mut sent = Vec::new();
            sent.extend(talker.handle_timeout(now).into_iter().map(|message| (true, message)));
            sent.extend(listener.handle_timeout(now).into_iter().map(|message| (false, message)));
            link.sort_by_key(|(due, _, _)| *due);
            let arrived = link.partition_point(|(due, _, _)| *due <= now);
            for (_, is_by_talker, message) in link.drain(..arrived) {
                let receiver = if is_by_talker { &mut listener } else { &mut talker };
                let answers = receiver.handle(&message, now);
                sent.extend(answers.into_iter().map(|message| (!is_by_talker, message)));
            }
            for (is_by_talker, message) in sent {
                for _ in 0..random.below(3) {
                    let due = now + Duration::from_millis(random.below(400) as u64);
                    link.push((due, is_by_talker, message.clone()));
                }
            }
            let timeouts = [talker.next_timeout(), listener.next_timeout()];
            let due = link.iter().map(|(due, _, _)| Some(*due)).chain(timeouts).flatten().min();
            now = due.unwrap_or(now).max(now + Duration::from_millis(1));
        }
        assert_agree(&talker, &listener);
        assert_eq!((talker.done.len(), listener.done.len()), (1, 1), "seed {seed}");
        assert_eq!((&*talker.gave_up, &*listener.gave_up), (&[][..], &[][..]), "seed {seed}");
    }
}

#[test]
fn a_lost_reply_and_a_lost_final_message_are_repeated() {
    let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
    let request = only(talker.handle_timeout(*START));
    let reply = only(listener.handle(&request, *START));
    let later = *START + Duration::from_millis(125);
    assert_eq!(only(talker.handle_timeout(later)), request);
    assert_eq!(only(listener.handle(&request, later)), reply);
    let last = only(talker.handle(&reply, later));
    // The final message is lost: the replier repeats its reply, the initiator its final message.
    assert_eq!(only(listener.handle_timeout(later)), reply);
    assert_eq!(only(talker.handle(&reply, later)), last);
    assert_eq!(listener.handle(&last, later), []);
    assert_agree(&talker, &listener);
    // Further copies change nothing.
    assert_eq!(only(talker.handle(&reply, later)), last);
    assert_eq!((listener.handle(&request, later), listener.handle(&last, later)), (vec![], vec![]));
    assert_eq!((talker.done.len(), listener.done.len()), (1, 1));
    assert_eq!((&*talker.refused, &*listener.refused), (&[][..], &[][..]));
}

#[test]
fn replies_without_the_optional_fields_are_accepted() {
    // As Cyclone DDS sends them, with strings that have their terminator.
    let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
    listener.identity.permissions_document.push(0);
    let request = only(talker.handle_timeout(*START));
    let without = |message: &GenericMessage, fields: &[&str]| {
        let mut message = message.clone();
        message.tokens[0].binary.retain(|(name, _)| !fields.contains(&&**name));
        message
    };
    let reply = only(listener.handle(&without(&request, &["hash_c1"]), *START));
    let last = only(talker.handle(&without(&reply, &["hash_c1", "hash_c2", "dh1"]), *START));
    listener.handle(&without(&last, &["hash_c1", "hash_c2", "dh1", "dh2"]), *START);
    assert_eq!(talker.done[0].1, listener.done[0].1);
    assert_eq!(talker.done[0].0.permissions_document, Peer::listener().identity.permissions_document);
}

#[test]
fn an_initiator_without_answers_sends_ever_less_gives_up_and_begins_again() {
    let (mut talker, listener) = pair(Peer::talker(), Peer::listener());
    let mut requests = Vec::new();
    while talker.gave_up.is_empty() {
        let now = talker.next_timeout().unwrap();
        requests.extend(talker.handle_timeout(now).into_iter().map(|message| (now, message)));
    }
    let no_answer = Refusal::NoAnswer { seconds: 60 };
    assert_eq!(talker.gave_up, [no_answer]);
    assert!((15..25).contains(&requests.len()), "{} requests", requests.len());
    let delays: Vec<_> = requests.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    assert_eq!(delays[0], Duration::from_millis(125));
    assert!(delays.is_sorted() && delays.last() == Some(&(5 * SECOND)), "{delays:?}");
    assert!(requests.iter().all(|(_, request)| *request == requests[0].1));
    // Later it tries again, with another random number and another key.
    let again = talker.next_timeout().unwrap();
    assert_eq!(again, *START + 120 * SECOND);
    let second = only(talker.handle_timeout(again));
    for field in ["challenge1", "dh1"] {
        assert_ne!(second.tokens[0].binary(field), requests[0].1.tokens[0].binary(field));
    }
    let mut listener = listener;
    let reply = only(listener.handle(&second, again));
    let last = only(talker.handle(&reply, again));
    listener.handle(&last, again);
    assert_agree(&talker, &listener);
}

#[test]
fn a_replier_without_a_request_asks_for_one_reports_that_none_comes_and_keeps_waiting() {
    let (_, mut listener) = pair(Peer::talker(), Peer::listener());
    let mut asked = Vec::new();
    while listener.gave_up.is_empty() {
        let now = listener.next_timeout().unwrap();
        asked.extend(listener.handle_timeout(now).into_iter().map(|message| (now, message.class)));
    }
    assert_eq!(listener.gave_up, [Refusal::NoAnswer { seconds: 60 }]);
    assert_eq!(asked[0], (*START + SECOND, "dds.sec.auth_request".to_owned()));
    assert!((10..20).contains(&asked.len()), "{} questions", asked.len());
    assert!(listener.next_timeout().is_some());
}

#[test]
fn a_replier_that_lost_its_state_is_answered_with_the_random_number_that_it_announced() {
    let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
    three_messages(&mut talker, &mut listener);
    let mut forgetful = Peer::new(listener.identity.clone(), 9);
    forgetful.begin(talker.guid, *START);
    let now = forgetful.next_timeout().unwrap();
    let question = only(forgetful.handle_timeout(now));
    assert_eq!(question.tokens[0].class_id, "DDS:Auth:PKI-DH:1.0+AuthReq");
    talker.handshake.as_mut().unwrap().begin_again(now);
    let request = only(talker.handle_timeout(now));
    let reply = only(forgetful.handle(&request, now));
    let challenge = question.tokens[0].binary("future_challenge");
    assert_eq!(reply.tokens[0].binary("challenge2"), challenge);
    let last = only(talker.handle(&reply, now));
    assert_eq!(forgetful.handle(&last, now), []);
    assert_eq!(talker.done[1].1, forgetful.done[0].1);
    assert_ne!(talker.done[0].1, talker.done[1].1);
}

#[test]
fn an_initiator_that_lost_its_state_proves_itself_again() {
    let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
    three_messages(&mut talker, &mut listener);
    talker.begin(listener.guid, *START);
    three_messages(&mut talker, &mut listener);
    assert_eq!((talker.done.len(), listener.done.len()), (2, 2));
    assert_eq!(talker.done[1].1, listener.done[1].1);
    assert_ne!(talker.done[0].1, talker.done[1].1);
}

#[test]
fn a_certificate_that_expires_later_or_was_revoked_is_refused() {
    let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
    let request = only(talker.handle_timeout(*START));
    let reply = only(listener.handle(&request, *START));
    let day = 24 * 60 * 60 * SECOND;
    talker.time += 3650 * day;
    assert_eq!(talker.handle(&reply, *START), []);
    let text = talker.last_refused().unwrap().to_string();
    assert!(text.contains("\"CN=sros2CA\" expired on 2036-11-25T"), "{text}");
    talker.time -= 3690 * day;
    assert_eq!(talker.handle(&reply, *START), []);
    let text = talker.last_refused().unwrap().to_string();
    assert!(text.contains("is not valid before 2026-11-2"), "{text}");
    talker.time += 40 * day;
    let crl = Crl::from_pem(&file("crl.pem")).unwrap();
    let ca = talker.identity.authority.certificate().clone();
    talker.identity.authority = Authority::new(ca, Some(crl)).unwrap();
    assert_eq!(talker.handle(&reply, *START), []);
    let text = talker.last_refused().unwrap().to_string();
    assert!(text.contains("\"CN=/listener\" was revoked"), "{text}");
    assert!(!talker.is_done());
    // What was last refused is the reason for giving up.
    let last = talker.last_refused().cloned();
    talker.handle_timeout(*START + 60 * SECOND);
    assert_eq!(talker.gave_up, last.as_slice());
}

#[test]
fn neither_debug_output_nor_errors_show_secrets() {
    let (mut talker, mut listener) = pair(Peer::talker(), Peer::listener());
    let request = only(talker.handle_timeout(*START));
    assert!(!format!("{:?}", talker.handshake).contains("SecretKey"));
    listener.handle(&request, *START);
    let secret = SharedSecret { challenge1: [1; 32], challenge2: [2; 32], secret: [3; 32] };
    assert_eq!(format!("{secret:?}"), "SharedSecret(..)");
    let error = Refusal::from(PkiError::EncryptedKey).to_string();
    assert!(error.starts_with("the certificate of the participant cannot be used: "), "{error}");
}
