//! The keys of this participant and of its endpoints.

use std::collections::BTreeMap;

use downbeat_rtps::wire::EntityId;

use super::policy::Protection;
use crate::cryptography::{KeyId, KeyMaterial, Sealer, TransformKind};
use crate::tokens::Token;

/// Fills bytes with random ones that nobody can guess.
pub type Random = Box<dyn FnMut(&mut [u8]) + Send>;

const CLASS: &str = "DDS:Crypto:AES_GCM_GMAC";
const MATERIAL: &str = "dds.cryp.keymat";

/// The keys of an endpoint, as far as its messages are protected.
pub(super) struct EndpointKeys {
    pub(super) submessage: Option<Sealer>,
    pub(super) payload: Option<Sealer>,
}

impl EndpointKeys {
    /// What other participants need to read its messages. The key of submessages comes first: Fast DDS looks
    /// there.
    pub(super) fn tokens(&self) -> Vec<Token> {
        self.submessage.iter().chain(&self.payload).map(token).collect()
    }
}

/// All keys of this participant.
pub(super) struct OwnKeys {
    random: Random,
    latest: u32,
    pub(super) participant: Sealer,
    pub(super) endpoints: BTreeMap<EntityId, EndpointKeys>,
}

impl OwnKeys {
    /// With a key for whole messages of that kind; one that signs if none are protected, since Cyclone DDS
    /// waits for a key.
    pub(super) fn new(message: Option<TransformKind>, mut random: Random) -> Self {
        let mut latest = [0; 4];
        random(&mut latest);
        let mut latest = u32::from_be_bytes(latest);
        let kind = message.unwrap_or(TransformKind::Aes256Gmac);
        let participant = sealer(kind, &mut latest, &mut random);
        Self { random, latest, participant, endpoints: BTreeMap::new() }
    }

    pub(super) fn random(&mut self) -> &mut Random {
        &mut self.random
    }

    /// Makes the keys of an endpoint, unless it has them.
    pub(super) fn add(&mut self, entity: EntityId, protection: Protection) {
        let Self { random, latest, endpoints, .. } = self;
        endpoints.entry(entity).or_insert_with(|| {
            let submessage = protection.submessage.map(|kind| sealer(kind, latest, random));
            // A reader has no payloads, but Fast DDS expects a key of it.
            let has_payload = entity.is_writer() || submessage.is_none();
            let payload = protection.payload.filter(|_| has_payload);
            EndpointKeys { submessage, payload: payload.map(|kind| sealer(kind, latest, random)) }
        });
    }

    pub(super) fn participant_token(&self) -> Token {
        token(&self.participant)
    }
}

fn sealer(kind: TransformKind, latest: &mut u32, random: &mut Random) -> Sealer {
    *latest = latest.wrapping_add(1).max(1); // 0 is the key of the key exchange
    Sealer::new(KeyMaterial::generate(kind, KeyId(latest.to_be_bytes()), &mut **random), &mut **random)
}

fn token(sealer: &Sealer) -> Token {
    let mut token = Token::new(CLASS);
    token.binary.push((MATERIAL.to_owned(), sealer.material().emit().to_vec()));
    token
}

/// The keys in tokens of another participant.
pub(super) fn materials(tokens: &[Token]) -> impl Iterator<Item = KeyMaterial> {
    let values =
        tokens.iter().filter(|token| token.class_id == CLASS).filter_map(|token| token.binary(MATERIAL));
    values.filter_map(|value| KeyMaterial::parse(value).ok().flatten())
}
