//! What guards say to each other.

use downbeat_security::cryptography::{KeyId, KeyMaterial, ReceiverKey, TransformKind};
use downbeat_security::tokens::{ByteOrder, GenericMessage, Token};

/// A token in both byte orders; emitted, it is read as the same.
pub fn token(bytes: &[u8]) -> bool {
    let orders = [ByteOrder::Big, ByteOrder::Little];
    let parsed = orders.map(|order| {
        let Ok(token) = Token::parse(bytes, order) else { return false };
        let mut emitted = Vec::new();
        token.emit(&mut emitted, order);
        assert_eq!(Token::parse(&emitted, order), Ok(token));
        true
    });
    parsed.contains(&true)
}

pub fn tokens() -> Vec<Vec<u8>> {
    let emitted = |message: &GenericMessage| {
        let mut emitted = Vec::new();
        message.tokens.first().expect("a token").emit(&mut emitted, ByteOrder::Little);
        emitted
    };
    recorded().iter().map(|bytes| emitted(&GenericMessage::parse(bytes).expect("a message"))).collect()
}

/// A message of the two channels; emitted, it is read as the same.
pub fn message(bytes: &[u8]) -> bool {
    let Ok(message) = GenericMessage::parse(bytes) else { return false };
    for order in [ByteOrder::Big, ByteOrder::Little] {
        let mut emitted = Vec::new();
        message.emit(&mut emitted, order);
        assert_eq!(GenericMessage::parse(&emitted).as_ref(), Ok(&message));
    }
    true
}

pub fn recorded() -> Vec<Vec<u8>> {
    [
        include_bytes!("../../tests/data/handshakes/fastdds/request.bin").as_slice(),
        include_bytes!("../../tests/data/handshakes/fastdds/reply.bin"),
        include_bytes!("../../tests/data/handshakes/fastdds/final.bin"),
        include_bytes!("../../tests/data/handshakes/cyclone/request.bin"),
        include_bytes!("../../tests/data/handshakes/cyclone/auth_request_of_listener.bin"),
    ]
    .map(<[u8]>::to_vec)
    .into()
}

/// The keys of an endpoint or a participant.
pub fn key_material(bytes: &[u8]) -> bool {
    let Ok(Some(material)) = KeyMaterial::parse(bytes) else { return false };
    assert_eq!(KeyMaterial::parse(&material.emit()), Ok(Some(material)));
    true
}

pub fn key_materials() -> Vec<Vec<u8>> {
    let mut fill = |bytes: &mut [u8]| bytes.fill(7);
    let kinds = [TransformKind::Aes128Gmac, TransformKind::Aes256Gcm];
    let plain = kinds.map(|kind| KeyMaterial::generate(kind, KeyId([0, 0, 0, 9]), &mut fill));
    let receiver = ReceiverKey::generate(KeyId([0, 0, 0, 5]), &mut fill);
    let for_receiver = plain.last().expect("two kinds").for_receiver(receiver);
    plain.iter().chain([&for_receiver]).map(|material| material.emit().to_vec()).collect()
}
