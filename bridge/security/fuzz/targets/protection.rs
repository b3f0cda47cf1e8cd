//! What is protected: only what was sealed is opened.

use downbeat_security::cryptography::{
    KeyId, KeyMaterial, Opener, Sealer, TransformKind, message_transform, payload_transform,
    split_submessage_group, submessage_transform,
};

const KINDS: [TransformKind; 4] = [
    TransformKind::Aes128Gmac,
    TransformKind::Aes128Gcm,
    TransformKind::Aes256Gmac,
    TransformKind::Aes256Gcm,
];

/// With an encapsulation, and padded.
const PAYLOAD: [u8; 16] = *b"\0\x01\0\0hello world!";
/// A DATA with that payload.
const SUBMESSAGE: [u8; 40] =
    *b"\x15\x05\x24\0\0\0\x10\0\0\0\0\0\0\0\x01\x03\0\0\0\0\x01\0\0\0\0\x01\0\0hello world!";
const HEADER: [u8; 20] = *b"RTPS\x02\x03\x01\x0fprefixprefix";

fn material(kind: TransformKind) -> KeyMaterial {
    KeyMaterial::generate(kind, KeyId([0, 0, 0, 9]), &mut |bytes| bytes.fill(7))
}

fn sealed(seal: impl Fn(&mut Sealer) -> Vec<u8>) -> Vec<Vec<u8>> {
    let sealer = |kind| Sealer::new(material(kind), &mut |bytes| bytes.fill(3));
    KINDS.map(|kind| seal(&mut sealer(kind))).into()
}

/// Opens with the key of each kind.
fn open<T: PartialEq + std::fmt::Debug, E>(open: impl Fn(&mut Opener) -> Result<T, E>, genuine: T) -> bool {
    let mut is_opened = false;
    for kind in KINDS {
        if let Ok(plain) = open(&mut Opener::new(material(kind))) {
            assert_eq!(plain, genuine);
            is_opened = true;
        }
    }
    is_opened
}

pub fn payload(bytes: &[u8]) -> bool {
    open(|opener| opener.payload(bytes), PAYLOAD.to_vec()) || payload_transform(bytes).is_ok()
}

pub fn payloads() -> Vec<Vec<u8>> {
    sealed(|sealer| sealer.payload(&PAYLOAD).expect("short"))
}

pub fn submessage(bytes: &[u8]) -> bool {
    let Ok((group, rest)) = split_submessage_group(bytes) else { return submessage_transform(bytes).is_ok() };
    assert_eq!(group.len() + rest.len(), bytes.len());
    let opened = |opener: &mut Opener| {
        let mut out = Vec::new();
        opener.submessage(group, &mut out).map(|()| out)
    };
    open(opened, SUBMESSAGE.to_vec());
    true
}

pub fn submessages() -> Vec<Vec<u8>> {
    sealed(|sealer| {
        let mut out = Vec::new();
        sealer.submessage(&SUBMESSAGE, &mut out).expect("one submessage");
        out
    })
}

pub fn datagram(bytes: &[u8]) -> bool {
    let genuine = [&HEADER[..], &SUBMESSAGE].concat();
    open(|opener| opener.message(bytes), genuine) || matches!(message_transform(bytes), Ok(Some(_)))
}

pub fn datagrams() -> Vec<Vec<u8>> {
    sealed(|sealer| {
        let mut datagram = [&HEADER[..], &SUBMESSAGE].concat();
        sealer.message(&mut datagram).expect("a message");
        datagram
    })
}
