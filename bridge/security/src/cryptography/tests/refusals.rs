//! Wrong inputs.

use fuzzing::{Random, rounds};

use super::*;

/// Only flags without meaning are not protected.
#[test]
fn one_changed_bit_is_refused() {
    every_combination(|level, kind, pair| {
        let (mut sealer, mut opener) = pair(kind);
        let sealed = level.seal(&mut sealer);
        let receivers = if opener.material().has_receiver_key() { 2 } else { 0 };
        let flags = level.flags_at(sealed.len(), kind, receivers);
        let other_mac = sealed.len() - 40..sealed.len() - 20;
        for index in 0..sealed.len() {
            for bit in 0..8 {
                let mut changed = sealed.clone();
                changed[index] ^= 1 << bit;
                let result = level.open(&mut opener, &changed);
                let is_meaningless =
                    bit > 0 && flags.contains(&index) || receivers > 0 && other_mac.contains(&index);
                if is_meaningless {
                    assert_eq!(result, Ok(level.opened()));
                } else {
                    assert!(result.is_err(), "{level:?} {kind:?}: bit {bit} of byte {index}");
                }
            }
        }
    });
}

#[test]
fn data_cut_or_continued_anywhere_is_refused() {
    every_combination(|level, kind, pair| {
        let (mut sealer, mut opener) = pair(kind);
        let sealed = level.seal(&mut sealer);
        for len in 0..sealed.len() {
            assert!(level.open(&mut opener, &sealed[..len]).is_err(), "{level:?} {kind:?}: {len} bytes");
        }
        for trailing in [1, 4, 20, 24] {
            let longer = [&sealed[..], &vec![1; trailing]].concat();
            let result = level.open(&mut opener, &longer);
            if matches!(level, Level::Message) {
                assert_eq!(result, Ok(level.opened()), "what Fast DDS appends is not looked at");
            } else {
                assert!(result.is_err(), "{level:?} {kind:?}: {trailing} more");
            }
        }
    });
}

#[test]
fn data_of_another_key_is_refused() {
    every_combination(|level, kind, pair| {
        let (mut sealer, mut opener) = pair(kind);
        let sealed = level.seal(&mut sealer);
        let mut named_otherwise = sealed.clone();
        named_otherwise[level.header_at() + 7] ^= 1;
        assert_eq!(level.open(&mut opener, &named_otherwise), Err(OpenError::OtherKey));
        let same_name = KeyMaterial::generate(kind, KeyId([7, 0, 0, 1]), &mut bytes_of(&mut Random::new(9)));
        assert_eq!(level.open(&mut Opener::new(same_name), &sealed), Err(OpenError::Forged));
    });
}

#[test]
fn a_weaker_kind_than_agreed_is_refused() {
    for level in LEVELS {
        let sealed = level.seal(&mut pair(TransformKind::Aes256Gmac).0);
        let mut opener = pair(TransformKind::Aes256Gcm).1;
        assert_eq!(level.open(&mut opener, &sealed), Err(OpenError::OtherKind));
        let mut unknown = sealed;
        unknown[level.header_at() + 3] = 0;
        assert_eq!(level.open(&mut opener, &unknown), Err(OpenError::UnknownKind(0)));
    }
}

#[test]
fn data_for_other_receivers_is_refused() {
    for level in [Level::Submessage, Level::Message] {
        let (_, mut opener) = pair_with_receivers(TransformKind::Aes256Gcm);
        let for_all = level.seal(&mut pair(TransformKind::Aes256Gcm).0);
        assert_eq!(level.open(&mut opener, &for_all), Err(OpenError::NotForThisReceiver));
    }
}

/// What another receiver can do, who has the common key.
#[test]
fn a_forged_mac_of_the_receiver_is_refused() {
    for level in [Level::Submessage, Level::Message] {
        let (mut sealer, mut opener) = pair_with_receivers(TransformKind::Aes256Gcm);
        let forged_key = ReceiverKey::generate(KeyId([8, 0, 0, 2]), &mut bytes_of(&mut Random::new(77)));
        sealer.set_receivers(vec![forged_key]);
        assert_eq!(level.open(&mut opener, &level.seal(&mut sealer)), Err(OpenError::Forged));
    }
}

#[test]
fn a_receiver_without_key_ignores_the_macs_of_others() {
    let (mut sealer, _) = pair_with_receivers(TransformKind::Aes256Gmac);
    let sealed = Level::Message.seal(&mut sealer);
    assert_eq!(pair(TransformKind::Aes256Gmac).1.message(&sealed), Ok(message_with_lengths()));
}

#[test]
fn a_wrong_length_of_the_body_is_refused() {
    for (level, at) in [(Level::Payload, 20), (Level::Submessage, 28), (Level::Message, 48)] {
        let (mut sealer, mut opener) = pair(TransformKind::Aes256Gcm);
        let sealed = level.seal(&mut sealer);
        for length in [0_u32, 3, 64, 0x7fff_ffff, u32::MAX - 3, u32::MAX] {
            let mut changed = sealed.clone();
            changed[at..at + 4].copy_from_slice(&length.to_be_bytes());
            assert!(level.open(&mut opener, &changed).is_err(), "{level:?}: {length}");
        }
    }
}

#[test]
fn a_wrong_number_of_macs_is_refused() {
    for level in LEVELS {
        let (mut sealer, mut opener) = pair(TransformKind::Aes256Gcm);
        let sealed = level.seal(&mut sealer);
        for count in [1_u32, 0x0ccc_cccd, u32::MAX] {
            let mut changed = sealed.clone();
            let at = changed.len() - 4;
            changed[at..].copy_from_slice(&count.to_be_bytes());
            assert_eq!(level.open(&mut opener, &changed), Err(OpenError::Length), "{level:?}: {count}");
        }
    }
}

#[test]
fn a_header_that_the_protected_source_contradicts_is_refused() {
    for kind in KINDS {
        let (mut sealer, mut opener) = pair(kind);
        let mut sealed = Level::Message.seal(&mut sealer);
        sealed[19] ^= 1;
        assert_eq!(opener.message(&sealed), Err(OpenError::Source));
    }
}

#[test]
fn submessages_in_the_wrong_place_are_refused() {
    let (mut sealer, mut opener) = pair(TransformKind::Aes256Gmac);
    let sealed = Level::Submessage.seal(&mut sealer);
    let (prefix, rest) = sealed.split_at(24);
    let (body, postfix) = rest.split_at(32);
    let mut open = |parts: &[&[u8]]| Level::Submessage.open(&mut opener, &parts.concat());
    assert_eq!(open(&[prefix, body, postfix]), Ok(SUBMESSAGE.to_vec()));
    assert_eq!(open(&[body, postfix]), Err(OpenError::Structure));
    assert_eq!(open(&[prefix, body, body, postfix]), Err(OpenError::Structure));
    assert_eq!(open(&[prefix, body, prefix]), Err(OpenError::Structure));
    assert_eq!(open(&[prefix, postfix, postfix]), Err(OpenError::Forged));
    assert_eq!(open(&[prefix, body]), Err(OpenError::Truncated));
    assert_eq!(open(&[prefix, body, postfix, postfix]), Err(OpenError::Structure));
}

/// Who has the key may write anything.
#[test]
fn content_that_is_not_submessages_is_refused() {
    let (mut sealer, mut opener) = pair(TransformKind::Aes256Gcm);
    for content in [&[7, 1, 200, 0, 1, 2, 3, 4][..], &[7, 1], &[]] {
        let header = sealer.next(content.len());
        let mut group = Vec::new();
        submessage::write_prefix(0x31, &header, &mut group);
        submessage::write_body_header(&header, content.len(), &mut group).unwrap();
        let mut data = content.to_vec();
        let mac = sealer.protect(&header, &mut data).unwrap();
        group.extend(data);
        submessage::pad_body(&header, content.len(), &mut group);
        submessage::write_postfix(0x32, &mac, &[], &mut group).unwrap();
        assert_eq!(Level::Submessage.open(&mut opener, &group), Err(OpenError::Content), "{content:?}");
    }
}

#[test]
fn what_is_no_submessage_is_not_sealed() {
    let (mut sealer, _) = pair(TransformKind::Aes256Gcm);
    for plain in
        [&[][..], &SUBMESSAGE[..31], &[SUBMESSAGE; 2].concat(), &[SUBMESSAGE.as_slice(), &[7]].concat()]
    {
        let mut out = vec![1, 2];
        assert_eq!(sealer.submessage(plain, &mut out), Err(SealError::NotSubmessages));
        assert_eq!(out, [1, 2]);
    }
    for datagram in [&message()[..15], &message()[..22], &SUBMESSAGE] {
        assert_eq!(sealer.message(&mut datagram.to_vec()), Err(SealError::NotSubmessages));
    }
}

/// The lengths of submessages have 16 bits.
#[test]
fn what_does_not_fit_into_a_submessage_is_not_sealed() {
    let submessage = |len: usize| {
        let mut submessage = vec![0; len];
        submessage[..4].copy_from_slice(&[0x15, 1, (len - 4) as u8, ((len - 4) >> 8) as u8]);
        submessage
    };
    let (mut sealer, mut opener) = pair(TransformKind::Aes256Gcm);
    let longest = Level::Submessage.try_seal(&mut sealer, &submessage(65_528)).unwrap();
    assert_eq!(Level::Submessage.open(&mut opener, &longest), Ok(submessage(65_528)));
    assert_eq!(Level::Submessage.try_seal(&mut sealer, &submessage(65_532)), Err(SealError::TooLong));
    let message = [&message()[..20], &submessage(65_532)].concat();
    assert_eq!(Level::Message.try_seal(&mut sealer, &message), Err(SealError::TooLong));
    let receiver = ReceiverKey::generate(KeyId([1; 4]), &mut |_| ());
    sealer.set_receivers(vec![receiver; 4000]);
    assert_eq!(Level::Submessage.try_seal(&mut sealer, &SUBMESSAGE), Err(SealError::TooLong));
}

/// Neither panics nor accepts what was not sealed, whatever the bytes.
#[test]
fn damaged_data_is_refused() {
    for round in rounds(3000) {
        let mut random = Random::new(round);
        let level = *random.choose(&LEVELS);
        let kind = *random.choose(&KINDS);
        let (mut sealer, mut opener) =
            if level == Level::Payload || random.one_in(2) { pair(kind) } else { pair_with_receivers(kind) };
        let mut damaged = level.seal(&mut sealer);
        for _ in 0..=random.below(4) {
            let at = random.below(damaged.len());
            match random.below(4) {
                0 => damaged.truncate(at),
                1 => damaged[at] = random.bits() as u8,
                2 => damaged[at] = *random.choose(&[0, 1, 0x7f, 0x80, 0xff]),
                _ => damaged.insert(at, random.bits() as u8),
            }
            if damaged.is_empty() {
                break;
            }
        }
        let (allocated, ()) = fuzzing::most_in(|| match level.open(&mut opener, &damaged) {
            Ok(opened) => assert_eq!(opened, level.opened(), "round {round}"),
            Err(_) => drop((submessage_transform(&damaged), split_submessage_group(&damaged))),
        });
        assert!(allocated < 10_000, "round {round}: {allocated} bytes");
    }
}
