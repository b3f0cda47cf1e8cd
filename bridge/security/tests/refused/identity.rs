//! Participants that are not whom the robot trusts.

use downbeat_rtps::wire::GuidPrefix;
use downbeat_security::enclave::Enclave;
use downbeat_security::guard::Credentials;
use downbeat_security::pki::{Authority, Crl};
use downbeat_security::tokens::GenericMessage;

use crate::keystore::{enclave as recorded, valid};
use crate::liar::Lies;
use crate::world::{Ca, SECOND, World, YEAR, governed, lies_are_refused, refuses};

/// The first has to send the request to the robot, the second the reply.
const BOTH: [&str; 2] = ["/talker", "/listener"];

fn robot(ca: &Ca) -> Enclave {
    ca.enclave("/robot")
}

#[test]
fn those_of_the_same_keystore_match() {
    let ca = Ca::new(1, valid());
    for name in BOTH {
        let mut world = World::new(&robot(&ca));
        let node = world.join(&ca.enclave(name));
        let (writer, _) = world.equip(node);
        world.network.run_for(SECOND);
        world.assert_matched(1);
        world.network.write(node, writer, "hello");
        world.network.run_for(SECOND);
        assert_eq!(world.texts(), ["hello"]);
        assert_eq!(world.said(), "");
    }
}

#[test]
fn the_certificate_of_another_authority_of_the_same_name() {
    let (ours, other) = (Ca::new(1, valid()), Ca::new(2, valid()));
    refuses(&robot(&ours), &other.enclave("/talker"), "but was not signed by its key");
    // The listener refuses the request, so that the robot gets no answer.
    let mut world = World::new(&robot(&ours));
    let node = world.join(&other.enclave("/listener"));
    world.equip(node);
    world.network.run_for(65 * SECOND);
    world.assert_said("no valid message of the handshake has arrived for 60 s");
    world.assert_alone();
    let (_, said) = world.statuses[node].refusals();
    assert!(said.iter().any(|text| text.contains("but was not signed by its key")), "{said:?}");
}

#[test]
fn an_expired_certificate() {
    let ca = Ca::new(1, valid() - 9 * YEAR);
    for name in BOTH {
        let expired = ca.enclave_at(name, valid() - 11 * YEAR, valid() - 2 * YEAR);
        refuses(&robot(&ca), &expired, "expired on");
    }
}

#[test]
fn a_certificate_that_is_not_valid_yet() {
    let ca = Ca::new(1, valid());
    for name in BOTH {
        let early = ca.enclave_at(name, valid() + YEAR, valid() + YEAR);
        refuses(&robot(&ca), &early, "is not valid before");
    }
}

#[test]
fn a_revoked_certificate() {
    let mut robot = recorded("/robot");
    let crl = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/crl.pem")).unwrap();
    let ca = robot.authority.certificate().clone();
    robot.authority = Authority::new(ca, Some(Crl::from_pem(&crl).unwrap())).unwrap();
    refuses(&robot, &recorded("/listener"), "was revoked by its authority");
    // The others are still trusted.
    let mut world = World::new(&robot);
    let talker = world.join(&recorded("/talker"));
    world.equip(talker);
    world.network.run_for(SECOND);
    world.assert_matched(1);
}

/// CVE-2025-67108: an expired certificate kept its match.
#[test]
fn a_match_ends_when_the_certificate_expires() {
    let ca = Ca::new(1, valid());
    let mut world = World::new(&robot(&ca));
    let short = ca.enclave_at("/talker", valid() - 9 * YEAR, valid());
    let node = world.join(&short);
    world.equip(node);
    world.network.run_for(SECOND);
    world.assert_matched(1);
    world.network.wall_offset_ns += (2 * YEAR).as_nanos() as i64;
    world.network.run_for(62 * SECOND);
    world.assert_said("the certificate of \"CN=/talker\" expired on");
    world.assert_alone();
    world.network.run_for(120 * SECOND);
    world.assert_alone();
}

#[test]
fn the_guid_of_another_subject() {
    let ca = Ca::new(1, valid());
    for name in BOTH {
        let said = |message: &mut GenericMessage| {
            // Its hash would be that of its own data.
            message.tokens[0].binary.retain(|(name, _)| !name.starts_with("hash_c"));
        };
        let disguise = Some([GuidPrefix::UNKNOWN; 2]);
        let lies = Lies { said: Some(Box::new(said)), disguise, ..Lies::default() };
        lies_are_refused(&robot(&ca), &ca.enclave(name), lies, "does not belong to the certificate");
    }
}

#[test]
fn a_signature_by_another_key() {
    let ca = Ca::new(1, valid());
    for name in BOTH {
        let mut thief = ca.enclave(name);
        thief.key = ca.enclave("/thief").key;
        refuses(&robot(&ca), &thief, "does not have the private key of");
    }
}

#[test]
fn the_governance_of_another_domain_and_none_at_all() {
    let ca = Ca::new(1, valid());
    let denial = |enclave: &Enclave, domain_id| {
        Credentials::new(enclave, domain_id, valid()).err().unwrap().to_string()
    };
    assert!(denial(&robot(&ca), 7).contains("has no rule for domain 7"));
    let everywhere = governed(robot(&ca), &[("id", "7")]);
    assert!(denial(&everywhere, 7).contains("allow nothing in domain 7"));
}

#[test]
fn a_governance_that_protects_less_is_noticed_at_the_first_announcement() {
    let ca = Ca::new(1, valid());
    for (element, value) in [
        ("rtps_protection_kind", "NONE"),
        ("rtps_protection_kind", "ENCRYPT"),
        ("discovery_protection_kind", "NONE"),
        ("discovery_protection_kind", "SIGN"),
        ("liveliness_protection_kind", "NONE"),
    ] {
        let other = governed(ca.enclave("/talker"), &[(element, value)]);
        refuses(&robot(&ca), &other, "its governance protects the domain in another way");
    }
}

#[test]
fn a_governance_that_protects_a_topic_less_is_noticed_before_it_matches() {
    let ca = Ca::new(1, valid());
    for (element, value) in [
        ("metadata_protection_kind", "NONE"),
        ("metadata_protection_kind", "SIGN"),
        ("data_protection_kind", "NONE"),
        ("data_protection_kind", "SIGN"),
        ("enable_read_access_control", "false"),
        ("enable_write_access_control", "false"),
    ] {
        let mut world = World::new(&robot(&ca));
        let node = world.join(&governed(ca.enclave("/talker"), &[(element, value)]));
        world.equip(node);
        world.network.run_for(2 * SECOND);
        world.assert_said("in another way");
        world.assert_matched(0);
    }
}
