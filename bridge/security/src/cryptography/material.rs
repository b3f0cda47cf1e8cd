//! Keys that participants, writers and readers send each other (DDS Security 1.1, section 9.5.2.1).

use hmac::{Hmac, KeyInit, Mac};
use sha2::{Digest, Sha256};
use zeroize::{Zeroize, ZeroizeOnDrop, Zeroizing};

/// Longest key and salt in bytes.
pub(super) const MAX_KEY_LEN: usize = 32;

/// What a key does to the data that it protects.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TransformKind {
    /// Signs with a key of 128 bits, leaves the data readable.
    Aes128Gmac = 1,
    /// Encrypts and signs with a key of 128 bits.
    Aes128Gcm = 2,
    /// Signs with a key of 256 bits, leaves the data readable.
    Aes256Gmac = 3,
    /// Encrypts and signs with a key of 256 bits.
    Aes256Gcm = 4,
}

impl TransformKind {
    /// Whether the data is encrypted. It is signed in any case.
    pub fn encrypts(self) -> bool {
        matches!(self, Self::Aes128Gcm | Self::Aes256Gcm)
    }

    /// Bytes of a key.
    pub fn key_len(self) -> usize {
        match self {
            Self::Aes128Gmac | Self::Aes128Gcm => 16,
            Self::Aes256Gmac | Self::Aes256Gcm => MAX_KEY_LEN,
        }
    }

    pub(super) fn from_bytes(bytes: [u8; 4]) -> Option<Self> {
        match bytes {
            [0, 0, 0, 1] => Some(Self::Aes128Gmac),
            [0, 0, 0, 2] => Some(Self::Aes128Gcm),
            [0, 0, 0, 3] => Some(Self::Aes256Gmac),
            [0, 0, 0, 4] => Some(Self::Aes256Gcm),
            _ => None,
        }
    }

    pub(super) fn to_bytes(self) -> [u8; 4] {
        [0, 0, 0, self as u8]
    }
}

/// Names a key among those of one participant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct KeyId(pub [u8; 4]);

impl KeyId {
    /// The key of the key exchange, see [`KeyMaterial::for_key_exchange`]. Other keys have other identifiers.
    pub const KEY_EXCHANGE: Self = Self([0; 4]);
}

/// Why received key material is not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MaterialError {
    /// The bytes end before the last field.
    #[error("key material ends early")]
    Truncated,
    /// Bytes follow the last field.
    #[error("key material is followed by {0} more bytes")]
    Trailing(usize),
    /// The kind is none of those of the specification.
    #[error("key material of unknown kind {0:#010x}")]
    Kind(u32),
    /// A key or the salt does not have the length of the kind.
    #[error("key material holds a key of {found} bytes where its kind requires {expected}")]
    KeyLength {
        /// As declared by the sender.
        found: u32,
        /// As the kind requires.
        expected: usize,
    },
    /// A key or the salt consists of zeros.
    #[error("key material holds a key of zeros")]
    ZeroKey,
    /// The identifier of the key is that of the key exchange.
    #[error("key material has the reserved key identifier 0")]
    ReservedId,
}

/// A key that one sender shares with one receiver, so that the receiver knows that no other receiver forged
/// the data (origin authentication).
#[derive(Clone, PartialEq, Eq, Zeroize, ZeroizeOnDrop)]
pub struct ReceiverKey {
    #[zeroize(skip)]
    pub(super) id: KeyId,
    pub(super) key: [u8; MAX_KEY_LEN],
}

impl ReceiverKey {
    /// Creates the key of one receiver. `id` differs from all other keys of this participant.
    pub fn generate(id: KeyId, random: &mut dyn FnMut(&mut [u8])) -> Self {
        let mut key = [0; MAX_KEY_LEN];
        random(&mut key);
        Self { id, key }
    }
}

impl std::fmt::Debug for ReceiverKey {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("ReceiverKey").field("id", &self.id).finish_non_exhaustive()
    }
}

/// The master key and salt of a participant, writer or reader, from which the keys of sessions are derived.
///
/// [`Sealer`](super::Sealer) protects with it what is sent, [`Opener`](super::Opener) checks and decrypts
/// what is received.
#[derive(Clone, PartialEq, Eq, Zeroize, ZeroizeOnDrop)]
pub struct KeyMaterial {
    #[zeroize(skip)]
    pub(super) kind: TransformKind,
    #[zeroize(skip)]
    pub(super) id: KeyId,
    pub(super) salt: [u8; MAX_KEY_LEN],
    pub(super) key: [u8; MAX_KEY_LEN],
    pub(super) receiver: Option<ReceiverKey>,
}

impl KeyMaterial {
    /// The form in which an endpoint says that it has no key: kind, salt, identifiers and keys are empty.
    pub const NO_KEY: [u8; 24] = [0; 24];

    /// Creates material of our own. `id` differs from all other keys of this participant, and from
    /// [`KeyId::KEY_EXCHANGE`].
    pub fn generate(kind: TransformKind, id: KeyId, random: &mut dyn FnMut(&mut [u8])) -> Self {
        let mut material = Self { kind, id, salt: [0; MAX_KEY_LEN], key: [0; MAX_KEY_LEN], receiver: None };
        random(&mut material.salt);
        random(&mut material.key);
        material
    }

    /// Derives the material that protects the exchange of all other keys between two participants, from
    /// the result of their handshake (section 9.5.3.1). Both have the same, and use it in both directions.
    pub fn for_key_exchange(challenge1: &[u8], challenge2: &[u8], shared_secret: &[u8]) -> Self {
        let derive = |parts: [&[u8]; 3]| {
            let key = parts.iter().fold(Sha256::new(), |hash, part| hash.chain_update(part)).finalize();
            hmac_sha256(&key, &[shared_secret])
        };
        Self {
            kind: TransformKind::Aes256Gcm,
            id: KeyId::KEY_EXCHANGE,
            salt: *derive([challenge1, b"keyexchange salt", challenge2]),
            key: *derive([challenge2, b"key exchange key", challenge1]),
            receiver: None,
        }
    }

    /// What the key does.
    pub fn kind(&self) -> TransformKind {
        self.kind
    }

    /// The identifier by which protected data names this material.
    pub fn id(&self) -> KeyId {
        self.id
    }

    /// Whether the receiver has a key of its own, and so requires origin authentication.
    pub fn has_receiver_key(&self) -> bool {
        self.receiver.is_some()
    }

    /// The same material in the form that is sent to one receiver of data with origin authentication. The
    /// [`Sealer`](super::Sealer) is given the same receiver key.
    pub fn for_receiver(&self, receiver: ReceiverKey) -> Self {
        Self { receiver: Some(receiver), ..self.clone() }
    }

    /// Parses the property `dds.cryp.keymat` of a token. `None` is an endpoint without a key.
    ///
    /// # Errors
    /// See [`MaterialError`].
    pub fn parse(bytes: &[u8]) -> Result<Option<Self>, MaterialError> {
        let mut rest = bytes;
        let kind = array(&mut rest)?;
        if kind == [0; 4] {
            return Ok(None); // Fast DDS appends 40 zeros to it, more than its empty fields have
        }
        let kind = TransformKind::from_bytes(kind).ok_or(MaterialError::Kind(u32::from_be_bytes(kind)))?;
        let salt = key(&mut rest, kind)?;
        let id = KeyId(array(&mut rest)?);
        let sender_key = key(&mut rest, kind)?;
        if id == KeyId::KEY_EXCHANGE {
            return Err(MaterialError::ReservedId);
        }
        let receiver = match KeyId(array(&mut rest)?) {
            KeyId([0, 0, 0, 0]) => match u32::from_be_bytes(array(&mut rest)?) {
                0 => None,
                found => return Err(MaterialError::KeyLength { found, expected: 0 }),
            },
            id => Some(ReceiverKey { id, key: *key(&mut rest, kind)? }),
        };
        match rest.len() {
            0 => Ok(Some(Self { kind, id, salt: *salt, key: *sender_key, receiver })),
            trailing => Err(MaterialError::Trailing(trailing)),
        }
    }

    /// The value of the property `dds.cryp.keymat` of a token, in big-endian CDR.
    pub fn emit(&self) -> Zeroizing<Vec<u8>> {
        let len = self.kind.key_len();
        // No reallocation: it would leave keys behind.
        let mut out = Zeroizing::new(Vec::with_capacity(24 + 3 * MAX_KEY_LEN));
        let sequence = |out: &mut Vec<u8>, bytes: &[u8; MAX_KEY_LEN]| {
            out.extend((len as u32).to_be_bytes());
            out.extend(bytes.iter().take(len));
        };
        out.extend(self.kind.to_bytes());
        sequence(&mut out, &self.salt);
        out.extend(self.id.0);
        sequence(&mut out, &self.key);
        match &self.receiver {
            None => out.extend([0; 8]),
            Some(receiver) => {
                out.extend(receiver.id.0);
                sequence(&mut out, &receiver.key);
            }
        }
        out
    }
}

impl std::fmt::Debug for KeyMaterial {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut debug = formatter.debug_struct("KeyMaterial");
        debug.field("kind", &self.kind).field("id", &self.id).field("receiver", &self.receiver);
        debug.finish_non_exhaustive()
    }
}

/// HMAC-SHA256 over the concatenation of `parts`.
pub(super) fn hmac_sha256(key: &[u8], parts: &[&[u8]]) -> Zeroizing<[u8; 32]> {
    let mut hmac = <Hmac<Sha256> as KeyInit>::new_from_slice(key).expect("HMAC takes keys of any length");
    parts.iter().for_each(|part| hmac.update(part));
    Zeroizing::new(hmac.finalize().into_bytes().into())
}

fn array<const N: usize>(rest: &mut &[u8]) -> Result<[u8; N], MaterialError> {
    let (array, after) = rest.split_first_chunk().ok_or(MaterialError::Truncated)?;
    *rest = after;
    Ok(*array)
}

/// A key or salt as a sequence of bytes.
fn key(rest: &mut &[u8], kind: TransformKind) -> Result<Zeroizing<[u8; MAX_KEY_LEN]>, MaterialError> {
    let found = u32::from_be_bytes(array(rest)?);
    let expected = kind.key_len();
    if found as usize != expected {
        return Err(MaterialError::KeyLength { found, expected });
    }
    let (bytes, after) = rest.split_at_checked(expected).ok_or(MaterialError::Truncated)?;
    *rest = after;
    if bytes.iter().all(|byte| *byte == 0) {
        return Err(MaterialError::ZeroKey);
    }
    let mut key = Zeroizing::new([0; MAX_KEY_LEN]);
    key.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
    Ok(key)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn counting() -> impl FnMut(&mut [u8]) {
        let mut next = 0_u8;
        move |bytes| {
            for byte in bytes {
                next = next.wrapping_add(1);
                *byte = next;
            }
        }
    }

    fn material(kind: TransformKind) -> KeyMaterial {
        KeyMaterial::generate(kind, KeyId([1, 2, 3, 4]), &mut counting())
    }

    const KINDS: [TransformKind; 4] = [
        TransformKind::Aes128Gmac,
        TransformKind::Aes128Gcm,
        TransformKind::Aes256Gmac,
        TransformKind::Aes256Gcm,
    ];

    #[test]
    fn material_of_every_kind_survives_its_token() {
        for kind in KINDS {
            let plain = material(kind);
            let receiver = ReceiverKey::generate(KeyId([9; 4]), &mut counting());
            for material in [plain.clone(), plain.for_receiver(receiver)] {
                let bytes = material.emit();
                let parsed = KeyMaterial::parse(&bytes).unwrap().unwrap();
                assert_eq!((parsed.kind(), parsed.id()), (kind, KeyId([1, 2, 3, 4])));
                assert_eq!(parsed.has_receiver_key(), material.has_receiver_key());
                assert_eq!(*parsed.emit(), *bytes);
            }
        }
    }

    #[test]
    fn material_has_the_layout_of_the_specification() {
        let mut expected = vec![0, 0, 0, 2, 0, 0, 0, 16];
        expected.extend(1..=16);
        expected.extend([1, 2, 3, 4, 0, 0, 0, 16]);
        expected.extend(33..=48);
        expected.extend([0; 8]);
        assert_eq!(*material(TransformKind::Aes128Gcm).emit(), expected);
    }

    /// Computed with Python's `hashlib` and `hmac`.
    #[test]
    fn the_key_of_the_key_exchange_is_known() {
        let material = KeyMaterial::for_key_exchange(&[1; 32], &[2; 32], &[3; 32]);
        assert_eq!((material.kind(), material.id()), (TransformKind::Aes256Gcm, KeyId::KEY_EXCHANGE));
        assert_eq!(hex(&material.salt), "dc724efa09341e7e6298ff75ac9fafc93923f7a5f333c5432a39a30d249769b9");
        assert_eq!(hex(&material.key), "6c2e8f7ec1c7683b2508e3acdaa9e81c2157674e3f0cd0ca6770484f1d47a120");
    }

    fn hex(bytes: &[u8]) -> String {
        bytes.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    #[test]
    fn an_endpoint_may_have_no_key() {
        assert!(KeyMaterial::parse(&KeyMaterial::NO_KEY).unwrap().is_none());
        assert!(KeyMaterial::parse(&[0; 44]).unwrap().is_none(), "as Fast DDS sends it");
    }

    fn refusal(change: impl FnOnce(&mut Vec<u8>)) -> MaterialError {
        let mut bytes = material(TransformKind::Aes256Gcm).emit().to_vec();
        change(&mut bytes);
        KeyMaterial::parse(&bytes).expect_err("damaged material")
    }

    #[test]
    fn material_cut_anywhere_is_refused() {
        let whole = material(TransformKind::Aes256Gcm).emit();
        for len in 0..whole.len() {
            assert_eq!(KeyMaterial::parse(&whole[..len]).unwrap_err(), MaterialError::Truncated, "{len}");
        }
    }

    #[test]
    fn an_unknown_kind_is_refused() {
        assert_eq!(refusal(|bytes| bytes[3] = 5), MaterialError::Kind(5));
        assert_eq!(refusal(|bytes| bytes[0] = 1), MaterialError::Kind(0x0100_0004));
    }

    #[test]
    fn keys_of_other_lengths_are_refused() {
        let length = |found| MaterialError::KeyLength { found, expected: 32 };
        assert_eq!(refusal(|bytes| bytes[7] = 33), length(33));
        assert_eq!(refusal(|bytes| bytes[7] = 16), length(16));
        assert_eq!(refusal(|bytes| bytes[4..8].fill(255)), length(u32::MAX));
        assert_eq!(refusal(|bytes| bytes[47] = 0), length(0));
        let unnamed = MaterialError::KeyLength { found: 32, expected: 0 };
        assert_eq!(refusal(|bytes| bytes[87] = 32), unnamed, "the key of a receiver without identifier");
    }

    #[test]
    fn keys_of_zeros_are_refused() {
        assert_eq!(refusal(|bytes| bytes[8..40].fill(0)), MaterialError::ZeroKey);
        assert_eq!(refusal(|bytes| bytes[48..80].fill(0)), MaterialError::ZeroKey);
    }

    #[test]
    fn the_identifier_of_the_key_exchange_is_refused() {
        assert_eq!(refusal(|bytes| bytes[40..44].fill(0)), MaterialError::ReservedId);
    }

    #[test]
    fn bytes_after_the_material_are_refused() {
        assert_eq!(refusal(|bytes| bytes.push(0)), MaterialError::Trailing(1));
    }

    #[test]
    fn keys_are_not_printed() {
        let receiver = ReceiverKey { id: KeyId([9; 4]), key: [0xab; 32] };
        let mut material = material(KINDS[3]).for_receiver(receiver);
        material.key.fill(0xab);
        material.salt.fill(0xab);
        let printed = format!("{material:?}");
        assert!(!printed.contains("171"), "{printed}");
    }
}
