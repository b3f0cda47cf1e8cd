#![allow(clippy::unwrap_used)]

mod refusals;

use fuzzing::Random;

use super::*;

const KINDS: [TransformKind; 4] = [
    TransformKind::Aes128Gmac,
    TransformKind::Aes128Gcm,
    TransformKind::Aes256Gmac,
    TransformKind::Aes256Gcm,
];

fn bytes_of(random: &mut Random) -> impl FnMut(&mut [u8]) {
    |bytes| bytes.fill_with(|| random.bits() as u8)
}

fn material(kind: TransformKind) -> KeyMaterial {
    KeyMaterial::generate(kind, KeyId([7, 0, 0, 1]), &mut bytes_of(&mut Random::new(1)))
}

fn pair(kind: TransformKind) -> (Sealer, Opener) {
    let sealer = Sealer::new(material(kind), &mut bytes_of(&mut Random::new(2)));
    (sealer, Opener::new(material(kind)))
}

/// As [`pair`], with origin authentication for this receiver and another one.
fn pair_with_receivers(kind: TransformKind) -> (Sealer, Opener) {
    let (mut sealer, _) = pair(kind);
    let receiver =
        |id| ReceiverKey::generate(KeyId([8, 0, 0, id]), &mut bytes_of(&mut Random::new(id.into())));
    sealer.set_receivers(vec![receiver(1), receiver(2)]);
    (sealer, Opener::new(material(kind).for_receiver(receiver(2))))
}

/// A sample with its encapsulation.
const PAYLOAD: [u8; 13] = [0, 1, 0, 0, 5, 0, 0, 0, b'l', b'e', b'f', b't', 0];
/// A HEARTBEAT.
const SUBMESSAGE: [u8; 32] =
    [7, 1, 28, 0, 0, 0, 0, 0, 0, 0, 4, 3, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 9, 0, 0, 0, 1, 0, 0, 0];

/// INFO_DST, then a HEARTBEAT whose header leaves its length open.
fn message() -> Vec<u8> {
    let mut message = b"RTPS\x02\x03\x01\x0f".to_vec();
    message.extend(1..=12);
    message.extend([14, 0, 0, 12]);
    message.extend(21..=32);
    message.extend(SUBMESSAGE);
    message[38..40].fill(0);
    message
}

fn message_with_lengths() -> Vec<u8> {
    let mut message = message();
    message[38] = 28;
    message
}

/// The three levels, so that each test treats all of them.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Level {
    Payload,
    Submessage,
    Message,
}

const LEVELS: [Level; 3] = [Level::Payload, Level::Submessage, Level::Message];

impl Level {
    fn plain(self) -> Vec<u8> {
        match self {
            Self::Payload => PAYLOAD.to_vec(),
            Self::Submessage => SUBMESSAGE.to_vec(),
            Self::Message => message(),
        }
    }

    /// What comes out where [`plain`](Self::plain) goes in.
    fn opened(self) -> Vec<u8> {
        match self {
            Self::Payload => [&PAYLOAD[..], &[0; 3]].concat(),
            Self::Submessage => SUBMESSAGE.to_vec(),
            Self::Message => message_with_lengths(),
        }
    }

    fn seal(self, sealer: &mut Sealer) -> Vec<u8> {
        self.try_seal(sealer, &self.plain()).unwrap()
    }

    fn try_seal(self, sealer: &mut Sealer, plain: &[u8]) -> Result<Vec<u8>, SealError> {
        match self {
            Self::Payload => sealer.payload(plain),
            Self::Submessage => {
                let mut out = Vec::new();
                sealer.submessage(plain, &mut out).map(|()| out)
            }
            Self::Message => {
                let mut datagram = plain.to_vec();
                sealer.message(&mut datagram).map(|()| datagram)
            }
        }
    }

    fn open(self, opener: &mut Opener, sealed: &[u8]) -> Result<Vec<u8>, OpenError> {
        match self {
            Self::Payload => opener.payload(sealed),
            Self::Submessage => {
                let mut out = Vec::new();
                let result = opener.submessage(sealed, &mut out).map(|()| out.clone());
                assert!(result.is_ok() || out.is_empty(), "left {out:?} after {result:?}");
                result
            }
            Self::Message => opener.message(sealed),
        }
    }

    fn transform(self, sealed: &[u8]) -> Result<Transform, OpenError> {
        match self {
            Self::Payload => payload_transform(sealed),
            Self::Submessage => submessage_transform(sealed),
            Self::Message => message_transform(sealed).map(|transform| transform.unwrap()),
        }
    }

    /// Where the header of 20 bytes begins.
    fn header_at(self) -> usize {
        match self {
            Self::Payload => 0,
            Self::Submessage => 4,
            Self::Message => 24,
        }
    }

    /// The bytes of flags in the headers of SEC_PREFIX, SEC_BODY and SEC_POSTFIX.
    fn flags_at(self, sealed_len: usize, kind: TransformKind, receivers: usize) -> Vec<usize> {
        let prefix = match self {
            Self::Payload => return Vec::new(),
            _ => self.header_at() - 3,
        };
        let body = kind.encrypts().then_some(prefix + 24);
        [prefix, sealed_len - 23 - 20 * receivers].into_iter().chain(body).collect()
    }
}

fn every_combination(mut test: impl FnMut(Level, TransformKind, fn(TransformKind) -> (Sealer, Opener))) {
    for level in LEVELS {
        for kind in KINDS {
            test(level, kind, pair);
            if level != Level::Payload {
                test(level, kind, pair_with_receivers);
            }
        }
    }
}

#[test]
fn what_is_sealed_opens() {
    every_combination(|level, kind, pair| {
        let (mut sealer, mut opener) = pair(kind);
        for _ in 0..3 {
            let sealed = level.seal(&mut sealer);
            assert_eq!(level.transform(&sealed), Ok(Transform { kind, key: KeyId([7, 0, 0, 1]) }));
            assert_eq!(level.open(&mut opener, &sealed), Ok(level.opened()), "{level:?} {kind:?}");
            assert_eq!(sealed.len() % 4, 0);
        }
    });
}

/// A fragment begins with any bytes, also such that look like an encapsulation.
#[test]
fn a_fragment_keeps_its_bytes() {
    for kind in KINDS {
        let (mut sealer, mut opener) = pair(kind);
        for fragment in [&[0, 1, 2, 3, 4, 5, 6, 7][..], &[0; 12], &[]] {
            let sealed = sealer.payload(fragment).unwrap();
            assert_eq!(opener.payload(&sealed).unwrap(), fragment);
        }
        let padded = sealer.payload(&[0, 1, 2, 3, 4]).unwrap();
        assert_eq!(opener.payload(&padded).unwrap(), [0, 1, 2, 3, 4, 0, 0, 0]);
    }
}

#[test]
fn only_encryption_hides_the_content() {
    every_combination(|level, kind, pair| {
        let sealed = level.seal(&mut pair(kind).0);
        let content = match level {
            Level::Payload => &PAYLOAD[4..],
            _ => &SUBMESSAGE[4..],
        };
        let is_readable = sealed.windows(content.len()).any(|window| window == content);
        assert_eq!(is_readable, !kind.encrypts(), "{level:?} {kind:?}");
    });
}

#[test]
fn no_use_of_a_key_repeats_its_initialization_vector() {
    let (mut sealer, _) = pair(TransformKind::Aes256Gcm);
    let mut ivs: Vec<_> = (0..100_000).map(|_| sealer.payload(&[]).unwrap()[8..20].to_vec()).collect();
    let sessions = ivs.chunk_by(|one, other| one[..4] == other[..4]).count();
    assert_eq!(sessions, 2, "a session has 65536 uses");
    ivs.sort();
    ivs.dedup();
    assert_eq!(ivs.len(), 100_000);
}

#[test]
fn a_renewed_session_opens_like_the_first() {
    let (mut sealer, mut opener) = pair_with_receivers(TransformKind::Aes256Gcm);
    let first = Level::Submessage.seal(&mut sealer);
    for _ in 0..65_536 {
        sealer.payload(&[]).unwrap();
    }
    let later = Level::Submessage.seal(&mut sealer);
    assert_ne!(first[12..16], later[12..16], "same session");
    for sealed in [&first, &later, &first] {
        assert_eq!(Level::Submessage.open(&mut opener, sealed), Ok(SUBMESSAGE.to_vec()));
    }
}

#[test]
fn many_sessions_may_alternate() {
    let mut opener = Opener::new(material(TransformKind::Aes128Gcm));
    let mut random = Random::new(5);
    let sealed: Vec<_> = (0..20)
        .map(|_| {
            let mut sealer = Sealer::new(material(TransformKind::Aes128Gcm), &mut bytes_of(&mut random));
            sealer.payload(&PAYLOAD).unwrap()
        })
        .collect();
    for _ in 0..2 {
        for sealed in &sealed {
            assert_eq!(opener.payload(sealed), Ok(Level::Payload.opened()));
        }
    }
}

#[test]
fn a_protected_submessage_is_split_from_what_follows() {
    for kind in KINDS {
        let sealed = Level::Submessage.seal(&mut pair(kind).0);
        let followed = [&sealed[..], &SUBMESSAGE[..]].concat();
        assert_eq!(split_submessage_group(&followed), Ok((&sealed[..], &SUBMESSAGE[..])));
        assert_eq!(split_submessage_group(&SUBMESSAGE), Err(OpenError::Structure));
        assert_eq!(split_submessage_group(&followed[..24]), Err(OpenError::Truncated));
        assert_eq!(
            split_submessage_group(&[&followed[..24], &SUBMESSAGE].concat()),
            Err(OpenError::Truncated)
        );
        let without_postfix = [&sealed[..sealed.len() - 24], &SUBMESSAGE].concat();
        assert_eq!(split_submessage_group(&without_postfix), Err(OpenError::Structure));
    }
}

#[test]
fn an_unprotected_message_has_no_transform() {
    assert_eq!(message_transform(&message()), Ok(None));
    assert_eq!(message_transform(&message()[..19]), Err(OpenError::Truncated));
}

/// Fast DDS aligns the number of MACs; the DATA of RustDDS is padded behind it.
#[test]
fn zeros_after_the_mac_of_a_payload_are_accepted() {
    for kind in KINDS {
        let (mut sealer, mut opener) = pair(kind);
        let header = sealer.next(PAYLOAD.len());
        let mut sealed = Vec::new();
        header.write(&mut sealed);
        if kind.encrypts() {
            sealed.extend((PAYLOAD.len() as u32).to_be_bytes());
        }
        let mut data = PAYLOAD;
        let mac = sealer.protect(&header, &mut data).unwrap();
        sealed.extend(data);
        footer::write_footer(&mac, &[], &mut sealed);
        for _ in 0..4 {
            assert_eq!(opener.payload(&sealed), Ok(PAYLOAD.to_vec()));
            sealed.push(0);
        }
        let error = if kind.encrypts() { OpenError::Length } else { OpenError::Forged };
        assert_eq!(opener.payload(&sealed), Err(error));
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The salt counts from 1, the key from 33, the session is a0a1a2a3 and the first suffix is 1.
fn known(kind: TransformKind) -> (Sealer, Opener) {
    let mut next = 0_u8;
    let material = KeyMaterial::generate(kind, KeyId([0xc0, 0xc1, 0xc2, 0xc3]), &mut |bytes| {
        bytes.fill_with(|| {
            next += 1;
            next
        });
    });
    let sealer = Sealer::new(material.clone(), &mut |bytes| match bytes.len() {
        4 => bytes.copy_from_slice(&[0xa0, 0xa1, 0xa2, 0xa3]),
        _ => bytes.fill(0),
    });
    (sealer, Opener::new(material))
}

/// Computed with Python's `hmac` and `cryptography`.
#[test]
fn known_answers() {
    let check = |kind, level: Level, expected: &str| {
        let (mut sealer, mut opener) = known(kind);
        let sealed = level.seal(&mut sealer);
        assert_eq!(hex(&sealed), expected, "{level:?} {kind:?}");
        assert_eq!(level.open(&mut opener, &sealed), Ok(level.opened()));
    };
    check(
        TransformKind::Aes256Gcm,
        Level::Payload,
        "00000004c0c1c2c3a0a1a2a30000000000000001000000108b74b776995f340a56cedefccd7827f825d014b6d2\
         9ead659347e741cab6e5af00000000",
    );
    check(
        TransformKind::Aes128Gcm,
        Level::Payload,
        "00000002c0c1c2c3a0a1a2a30000000000000001000000109b565d906cd024359b7992bac23470e2785111f969\
         80a858b35110bfb960437f00000000",
    );
    check(
        TransformKind::Aes128Gmac,
        Level::Payload,
        "00000001c0c1c2c3a0a1a2a3000000000000000100010000050000006c65667400000000d6b7da208a34e856b5\
         108135945c6cd800000000",
    );
    check(
        TransformKind::Aes256Gcm,
        Level::Submessage,
        "3101140000000004c0c1c2c3a0a1a2a3000000000000000130012400000000208c74ab769c5f340a3aabbc8bcd\
         7827f82705bb5be7d8536fb90f659f1a300ded32011400ee8afa942e25fffab511631891ceb87400000000",
    );
    check(
        TransformKind::Aes256Gmac,
        Level::Submessage,
        "3101140000000003c0c1c2c3a0a1a2a3000000000000000107011c000000000000000403000000000100000000\
         000000090000000100000032011400dd36146409415b8a20d87d7d7e12de4b00000000",
    );
    check(
        TransformKind::Aes256Gmac,
        Level::Message,
        "525450530203010f0102030405060708090a0b0c3301140000000003c0c1c2c3a0a1a2a300000000000000010c\
         011400000000000203010f0102030405060708090a0b0c0e00000c15161718191a1b1c1d1e1f2007011c000000\
         0000000004030000000001000000000000000900000001000000340114003aca609c7d8dbf3f11d3a48e355fa9\
         8b00000000",
    );
    check(
        TransformKind::Aes256Gcm,
        Level::Message,
        "525450530203010f0102030405060708090a0b0c3301140000000004c0c1c2c3a0a1a2a3000000000000000130\
         014c00000000488774a3769c5f340a38a8b987cc7a24fc2303bc53eed25863be0f65930e261af520061505be3a\
         4f11022095bc10479c4611acb3a882c7fb105648a55e4d1444208217ba1b0a55f68b3401140036764d6e3fe031\
         7643db0d16f569f3e800000000",
    );
}

/// Prints the cost of protection; `cargo test --release -- --ignored --nocapture cost`.
#[test]
#[ignore = "measures"]
fn cost() {
    let time = |times: u32, mut work: Box<dyn FnMut()>| {
        let start = std::time::Instant::now();
        (0..times).for_each(|_| work());
        start.elapsed().as_secs_f64() / f64::from(times)
    };
    for kind in [TransformKind::Aes256Gmac, TransformKind::Aes256Gcm] {
        for (len, times) in [(100, 100_000), (1000, 100_000), (921_600, 200)] {
            let payload = vec![1; len];
            let (mut sealer, mut opener) = pair(kind);
            let sealed = sealer.payload(&payload).unwrap();
            let plain = payload.clone();
            let seal = time(times, Box::new(move || drop(std::hint::black_box(sealer.payload(&plain)))));
            let open = time(times, Box::new(move || drop(std::hint::black_box(opener.payload(&sealed)))));
            let rate = |seconds: f64| len as f64 / seconds / 1e6;
            println!(
                "{kind:?}, {len} B: sealed in {:.0} ns ({:.0} MB/s), opened in {:.0} ns ({:.0} MB/s)",
                seal * 1e9,
                rate(seal),
                open * 1e9,
                rate(open),
            );
        }
    }
}
