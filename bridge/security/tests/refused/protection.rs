//! Authenticated participants that do not protect what they send as they have to.

use std::sync::{Arc, Mutex};

use downbeat_rtps::wire::{EntityId, GuidPrefix, Header};
use downbeat_security::cryptography::{KeyMaterial, Sealer};
use downbeat_security::enclave::Enclave;
use downbeat_security::tokens::{GenericMessage, class};
use fuzzing::Random;

use crate::common::best_effort;
use crate::keystore::valid;
use crate::liar::Lies;
use crate::world::{Ca, ROBOT, SECOND, World, governed};

const NONE: [(&str, &str); 3] = kinds("NONE", "NONE", "NONE");

/// The kinds of protection of messages, submessages and payloads.
const fn kinds(
    message: &'static str,
    submessage: &'static str,
    payload: &'static str,
) -> [(&'static str, &'static str); 3] {
    [
        ("rtps_protection_kind", message),
        ("metadata_protection_kind", submessage),
        ("data_protection_kind", payload),
    ]
}

/// One level at a time, since the outer one hides what is wrong in the inner ones.
const LEVELS: [[(&str, &str); 3]; 6] = [
    kinds("SIGN", "NONE", "NONE"),
    kinds("ENCRYPT", "NONE", "NONE"),
    kinds("NONE", "SIGN", "NONE"),
    kinds("NONE", "ENCRYPT", "NONE"),
    kinds("NONE", "NONE", "SIGN"),
    kinds("NONE", "NONE", "ENCRYPT"),
];

/// A robot and a talker that is honest at first.
struct Meeting {
    world: World,
    talker: usize,
    writer: EntityId,
    lies: Arc<Mutex<Lies>>,
}

impl Meeting {
    fn new(governance: &[(&str, &str)]) -> Self {
        let ca = Ca::new(1, valid());
        let enclave = |name| -> Enclave { governed(ca.enclave(name), governance) };
        let mut world = World::new(&enclave("/robot"));
        let (talker, lies) = world.join_liar(&enclave("/talker"), Lies::default());
        let (writer, _) = world.equip(talker);
        world.network.run_for(SECOND);
        world.assert_matched(1);
        let mut meeting = Self { world, talker, writer, lies };
        meeting.write("honest");
        assert_eq!(meeting.world.texts(), ["honest"], "{governance:?}: {}", meeting.world.said());
        meeting
    }

    /// Samples of a best-effort writer, so that there is nothing else in the datagrams.
    fn write(&mut self, text: &str) {
        self.world.network.write(self.talker, self.writer, text);
        self.world.network.run_for(SECOND);
    }

    fn lie(&self, change: impl FnOnce(&mut Lies)) {
        change(&mut self.lies.lock().unwrap());
    }

    /// Nothing more arrived, the reason was told, and honest samples still arrive.
    #[track_caller]
    fn conclude(mut self, why: &str) {
        assert_eq!(self.world.texts(), ["honest"], "{}", self.world.said());
        self.world.assert_said(why);
        self.world.assert_said("CN=/talker");
        self.lie(|lies| (lies.plain, lies.sealed, lies.leaves_clear) = (None, None, false));
        self.write("again");
        assert_eq!(self.world.texts(), ["honest", "again"]);
    }
}

#[test]
fn a_code_that_is_wrong_by_one_bit_at_each_level() {
    for level in LEVELS {
        for from_end in [5, 20] {
            let mut meeting = Meeting::new(&level);
            meeting.lie(|lies| {
                let flip = move |datagram: &mut Vec<u8>| {
                    // The code is in front of the number of codes for single receivers.
                    let at = datagram.len() - from_end;
                    datagram[at] ^= 1;
                };
                lies.sealed = Some(Box::new(flip));
            });
            meeting.write("wrong");
            meeting.conclude("it was changed on its way");
        }
    }
}

#[test]
fn clear_messages_in_the_place_of_protected_ones_at_each_level() {
    for (index, level) in LEVELS.iter().enumerate() {
        let mut meeting = Meeting::new(level);
        meeting.lie(|lies| lies.leaves_clear = true);
        meeting.write("clear");
        meeting.conclude(if index < 4 { "it is not protected" } else { "its protection is malformed" });
    }
}

/// CVE-2026-45098: the length of an encrypted body was believed.
#[test]
fn lengths_of_bodies_that_go_beyond_the_message() {
    for level in [LEVELS[1], LEVELS[3], LEVELS[5]] {
        for length in [u32::MAX, 1 << 31, 0x1_0000, 0] {
            let mut meeting = Meeting::new(&level);
            let payload_at = level[2].1 == "ENCRYPT";
            meeting.lie(|lies| {
                let lengthen = move |datagram: &mut Vec<u8>| {
                    let at = match payload_at {
                        // Behind the header of the payload, of kind AES256-GCM.
                        true => {
                            let kind = [0, 0, 0, 4];
                            20 + datagram[20..].windows(4).position(|part| part == kind).unwrap() + 20
                        }
                        false => datagram.windows(2).position(|part| part == [0x30, 1]).unwrap() + 4,
                    };
                    datagram[at..at + 4].copy_from_slice(&length.to_be_bytes());
                };
                lies.sealed = Some(Box::new(lengthen));
            });
            meeting.write("too long");
            meeting.conclude("its protection is malformed");
        }
    }
}

/// The key of submessages in what was said about an endpoint.
fn key_of(log: &[GenericMessage], endpoint: EntityId) -> KeyMaterial {
    let said = log.iter().find(|message| {
        message.class == class::WRITER_CRYPTO_TOKENS && message.source_endpoint.entity == endpoint
    });
    let material = said.unwrap().tokens[0].binary("dds.cryp.keymat").unwrap();
    KeyMaterial::parse(material).unwrap().unwrap()
}

#[test]
fn the_key_of_another_writer_for_a_submessage() {
    let mut meeting = Meeting::new(&LEVELS[3]);
    let other = meeting.world.network.writer(meeting.talker, "rt/other", best_effort());
    meeting.world.network.reader(ROBOT, "rt/other", best_effort());
    meeting.world.network.run_for(SECOND);
    meeting.lie(|lies| {
        let mut random = Random::new(7);
        let mut fill = move |bytes: &mut [u8]| bytes.fill_with(|| random.bits() as u8);
        let mut sealer = Sealer::new(key_of(&lies.log, other), &mut fill);
        lies.leaves_clear = true;
        lies.plain = Some(Box::new(move |datagram| {
            let clear = std::mem::take(datagram);
            let (header, mut rest) = clear.split_at(Header::LEN);
            datagram.extend_from_slice(header);
            while let [id, _, low, high, ..] = *rest {
                let length = 4 + usize::from(u16::from_le_bytes([low, high]));
                let (submessage, following) = rest.split_at(if length == 4 { rest.len() } else { length });
                rest = following;
                match id {
                    0x15 => sealer.submessage(submessage, datagram).unwrap(),
                    _ => datagram.extend_from_slice(submessage),
                }
            }
        }));
    });
    meeting.write("with another key");
    meeting.conclude("it is protected with the key of another endpoint");
}

#[test]
fn the_key_of_another_writer_for_a_payload() {
    let mut meeting = Meeting::new(&LEVELS[5]);
    let other = meeting.world.network.writer(meeting.talker, "rt/other", best_effort());
    let reader = meeting.world.network.reader(ROBOT, "rt/other", best_effort());
    meeting.world.network.run_for(SECOND);
    let own = meeting.writer;
    meeting.lie(|lies| {
        // What one writer has protected comes in the name of the other.
        lies.sealed = Some(Box::new(move |datagram| {
            if let Some(at) = datagram.windows(4).position(|part| part == own.0) {
                datagram[at..at + 4].copy_from_slice(&other.0);
            }
        }));
    });
    meeting.write("in the name of another");
    assert!(meeting.world.network.nodes[ROBOT].texts(reader).is_empty());
    meeting.conclude("it is protected with the key of another endpoint");
}

#[test]
fn a_source_of_somebody_else_within_a_message_is_ignored() {
    let victim = GuidPrefix([0x77; 12]);
    for level in [NONE, LEVELS[0], LEVELS[1], LEVELS[3]] {
        let mut meeting = Meeting::new(&level);
        meeting.lie(|lies| {
            lies.plain = Some(Box::new(move |datagram| {
                let mut source = vec![0x0c, 1, 20, 0, 0, 0, 0, 0, 2, 3, 1, 0x44];
                source.extend(victim.0);
                datagram.splice(Header::LEN..Header::LEN, source);
            }));
        });
        meeting.write("in the name of another");
        let writers = meeting.world.network.nodes[ROBOT].events.iter().filter_map(|event| match event {
            downbeat_rtps::protocol::Event::Sample { sample, .. } => Some(sample.writer.prefix),
            _ => None,
        });
        let own = meeting.world.network.nodes[meeting.talker].participant.prefix();
        assert!(writers.into_iter().all(|prefix| prefix == own), "{level:?}");
    }
}

#[test]
fn a_protected_message_with_the_header_of_somebody_else() {
    for level in LEVELS {
        let mut meeting = Meeting::new(&level);
        let ca = Ca::new(1, valid());
        let third = meeting.world.join(&governed(ca.enclave("/listener"), &level));
        meeting.world.equip(third);
        meeting.world.network.run_for(SECOND);
        meeting.world.assert_matched(2);
        let third = meeting.world.network.nodes[third].participant.prefix();
        meeting.lie(|lies| {
            lies.sealed = Some(Box::new(move |datagram| datagram[8..20].copy_from_slice(&third.0)));
        });
        meeting.write("in the name of the third");
        assert_eq!(meeting.world.texts(), ["honest"], "{level:?}");
    }
}
