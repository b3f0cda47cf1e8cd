//! Participants of the keystore whose documents are wrong.

use downbeat_security::access::{Permissions, smime};
use downbeat_security::enclave::Enclave;

use crate::keystore::valid;
use crate::liar::Lies;
use crate::world::{
    Ca, GOVERNANCE, ROBOT, SECOND, World, YEAR, lies_are_refused, permissions_text, permitted, refuses,
};

const BOTH: [&str; 2] = ["/talker", "/listener"];

/// The robot refuses each other one whose permissions `change` changes.
#[track_caller]
fn refuses_changed(change: impl Fn(&Ca, &mut Enclave), why: &str) {
    let ca = Ca::new(1, valid());
    for name in BOTH {
        let mut enclave = ca.enclave(name);
        change(&ca, &mut enclave);
        refuses(&ca.enclave("/robot"), &enclave, why);
    }
}

#[test]
fn the_permissions_of_somebody_else() {
    let others = |ca: &Ca, enclave: &mut Enclave| {
        enclave.permissions_document = ca.enclave("/robot").permissions_document;
    };
    refuses_changed(others, "it sent the permissions of somebody else");
}

#[test]
fn permissions_that_were_changed_after_they_were_signed() {
    let changed = |_: &Ca, enclave: &mut Enclave| {
        let text = String::from_utf8(enclave.permissions_document.clone()).unwrap();
        enclave.permissions_document = text.replace("DENY", "ALLOW").into_bytes();
    };
    refuses_changed(changed, "the text was changed after it was signed");
}

#[test]
fn permissions_without_a_signature() {
    let plain = |_: &Ca, enclave: &mut Enclave| {
        enclave.permissions_document = permissions_text(enclave).into_bytes();
    };
    refuses_changed(plain, "this is no signed document");
}

/// CVE-2023-24010 and others: certificates in a document were trusted.
#[test]
fn permissions_signed_with_a_certificate_that_they_bring_along() {
    let own = |_: &Ca, enclave: &mut Enclave| {
        let text = permissions_text(enclave);
        enclave.permissions_document =
            smime::sign(text.as_bytes(), &enclave.certificate, &enclave.key, valid());
    };
    refuses_changed(own, "signed by somebody else than \"CN=sros2CA\"");
    let other = |_: &Ca, enclave: &mut Enclave| {
        enclave.permissions_document = Ca::new(2, valid()).sign(&permissions_text(enclave));
    };
    refuses_changed(other, "signed by somebody else than \"CN=sros2CA\"");
}

#[test]
fn no_permissions_at_all() {
    refuses_changed(|_, enclave| enclave.permissions_document.clear(), "has sent no permissions document");
}

#[test]
fn permissions_that_are_no_permissions() {
    for (text, why) in [
        (GOVERNANCE, "its permissions:"),
        ("<dds><permissions>\0</permissions></dds>", "its permissions:"), // as in CVE-2026-45094
        ("", "its permissions:"),
    ] {
        let signed = |ca: &Ca, enclave: &mut Enclave| enclave.permissions_document = ca.sign(text);
        refuses_changed(signed, why);
    }
}

#[test]
fn permissions_for_another_domain() {
    let ca = Ca::new(1, valid());
    for name in BOTH {
        let mut enclave = ca.enclave(name);
        let text = permissions_text(&enclave).replace("<id>0</id>", "<id>7</id>");
        enclave.permissions_document = ca.sign(&text);
        refuses(&ca.enclave("/robot"), &enclave, "its permissions allow nothing in domain 0");
    }
}

#[test]
fn permissions_that_are_not_valid_now() {
    let ca = Ca::new(1, valid());
    for (year, name) in [("2025", "/talker"), ("2031", "/listener")] {
        let mut enclave = ca.enclave(name);
        let text = permissions_text(&enclave);
        let between = |tag: &str| {
            let start = text.find(&format!("<{tag}>")).unwrap() + tag.len() + 2;
            &text[start..start + text[start..].find('<').unwrap()]
        };
        let shifted = text
            .replace(between("not_before"), &format!("{year}-01-01T00:00:00"))
            .replace(between("not_after"), &format!("{year}-12-31T00:00:00"));
        enclave.permissions_document = ca.sign(&shifted);
        refuses(&ca.enclave("/robot"), &enclave, "its permissions are not valid now");
    }
}

#[test]
fn a_match_ends_when_the_permissions_expire() {
    let ca = Ca::new(1, valid());
    let mut world = World::new(&ca.enclave("/robot"));
    let enclave = ca.enclave("/talker");
    let text = permissions_text(&enclave);
    let start = text.find("<not_after>").unwrap() + "<not_after>".len();
    let end = start + text[start..].find('<').unwrap();
    let text = text.replace(&text[start..end], "2027-06-01T00:00:00");
    let node = world.join(&permitted(enclave, &ca, &text));
    world.equip(node);
    world.network.run_for(SECOND);
    world.assert_matched(1);
    world.network.wall_offset_ns += YEAR.as_nanos() as i64;
    world.network.run_for(62 * SECOND);
    world.assert_said("the permissions of CN=/talker have expired");
    world.assert_alone();
}

#[test]
fn a_topic_that_the_permissions_do_not_allow() {
    let ca = Ca::new(1, valid());
    // It believes to have all permissions, but what it shows allows less.
    let mut less = ca.enclave("/talker");
    less.permissions_document = ca.sign(&permissions_text(&less).replace("rt/*", "rt/other*"));
    let mut world = World::new(&ca.enclave("/robot"));
    let node = world.join(&less);
    let (writer, reader) = world.equip(node);
    world.network.run_for(SECOND);
    world.network.write(node, writer, "an order");
    let own = world.writer;
    world.network.write(ROBOT, own, "a secret");
    world.network.run_for(SECOND);
    world.assert_said("CN=/talker may not publish rt/commands: ");
    world.assert_said("CN=/talker may not subscribe to rt/state: ");
    world.assert_said("default DENY");
    world.assert_matched(0);
    assert!(world.texts().is_empty());
    assert!(world.network.nodes[node].texts(reader).is_empty());
}

#[test]
fn a_governance_with_a_wrong_signature_is_not_loaded() {
    let (ca, other) = (Ca::new(1, valid()), Ca::new(2, valid()));
    let folder = ca.folder("/robot", valid());
    let governance = folder.join("governance.p7s");
    let genuine = std::fs::read_to_string(&governance).unwrap();
    let refusal = |document: &[u8]| {
        std::fs::remove_file(&governance).unwrap();
        std::fs::write(&governance, document).unwrap();
        Enclave::load(&folder, valid()).unwrap_err().to_string()
    };
    let changed = genuine.replace("ENCRYPT", "NONE");
    assert!(refusal(changed.as_bytes()).ends_with(&smime::SmimeError::Changed.to_string()));
    assert!(refusal(&other.sign(GOVERNANCE)).contains("signed by somebody else than"));
    let robot = Permissions::parse(&permissions_text(&ca.enclave("/talker"))).unwrap();
    assert!(robot.grant("CN=/robot").is_none());
    assert!(refusal(GOVERNANCE.as_bytes()).contains("this is no signed document"));
}

#[test]
fn tokens_of_handshakes_with_wrong_lengths() {
    // CVE-2025-62602 and CVE-2025-62603: lengths that go beyond the message.
    let ca = Ca::new(1, valid());
    for (name, at) in [("/talker", 0), ("/listener", 0), ("/talker", 1), ("/listener", 2)] {
        let said_bytes = move |bytes: &mut Vec<u8>| {
            // The lengths of the class, of the sequence of binary properties, and of the first name.
            let class = bytes.windows(12).position(|part| part == b"dds.sec.auth").unwrap();
            let token = bytes.windows(7).position(|part| part == b"DDS:Aut").unwrap();
            let field =
                [class - 4, token - 4, bytes.windows(5).position(|it| it == b"c.id\0").unwrap() - 4][at];
            bytes[field..field + 4].copy_from_slice(&[0xff; 4]);
        };
        let lies = Lies { said_bytes: Some(Box::new(said_bytes)), ..Lies::default() };
        let why = "a message about security is malformed: ";
        lies_are_refused(&ca.enclave("/robot"), &ca.enclave(name), lies, why);
    }
}
