//! AES in Galois/counter mode with the keys of sessions (sections 9.5.3.3.1 to 9.5.3.3.3).

use aes_gcm::{AeadInOut, Aes128Gcm, Aes256Gcm, KeyInit};

use super::material::{KeyMaterial, MAX_KEY_LEN, ReceiverKey, TransformKind, hmac_sha256};

/// Identifies a session; the first bytes of every initialization vector in it.
pub(super) type SessionId = [u8; 4];
/// Unique for each use of a session.
pub(super) type InitializationVector = [u8; 12];
/// Message authentication code.
pub(super) type Mac = [u8; 16];

/// The data is longer than AES-GCM permits, or its MAC does not match.
#[derive(Debug)]
pub(super) struct Failed;

/// A cipher with the key of a session.
pub(super) enum SessionCipher {
    Aes128(Box<Aes128Gcm>),
    Aes256(Box<Aes256Gcm>),
}

impl SessionCipher {
    /// The cipher for all receivers.
    pub(super) fn common(material: &KeyMaterial, session: SessionId) -> Self {
        Self::derive(b"SessionKey", material, &material.key, session)
    }

    /// The cipher for one receiver.
    pub(super) fn for_receiver(material: &KeyMaterial, receiver: &ReceiverKey, session: SessionId) -> Self {
        Self::derive(b"SessionReceiverKey", material, &receiver.key, session)
    }

    fn derive(label: &[u8], material: &KeyMaterial, key: &[u8; MAX_KEY_LEN], session: SessionId) -> Self {
        match material.kind {
            TransformKind::Aes128Gmac | TransformKind::Aes128Gcm => {
                let short = |bytes: &[u8; MAX_KEY_LEN]| *bytes.first_chunk::<16>().expect("32 bytes");
                let key = hmac_sha256(&short(key), &[label, &short(&material.salt), &session]);
                Self::Aes128(Box::new(Aes128Gcm::new(&short(&key).into())))
            }
            TransformKind::Aes256Gmac | TransformKind::Aes256Gcm => {
                let key = hmac_sha256(key, &[label, &material.salt, &session]);
                Self::Aes256(Box::new(Aes256Gcm::new((&*key).into())))
            }
        }
    }

    /// Encrypts in place.
    pub(super) fn encrypt(&self, iv: &InitializationVector, data: &mut [u8]) -> Result<Mac, Failed> {
        self.seal(iv, &[], data)
    }

    /// The MAC of readable data.
    pub(super) fn sign(&self, iv: &InitializationVector, data: &[u8]) -> Result<Mac, Failed> {
        self.seal(iv, data, &mut [])
    }

    /// Decrypts in place; `data` is unchanged if the MAC does not match.
    pub(super) fn decrypt(
        &self,
        iv: &InitializationVector,
        data: &mut [u8],
        mac: &Mac,
    ) -> Result<(), Failed> {
        self.open(iv, &[], data, mac)
    }

    /// Checks the MAC of readable data, in a time that does not depend on where it differs.
    pub(super) fn verify(&self, iv: &InitializationVector, data: &[u8], mac: &Mac) -> Result<(), Failed> {
        self.open(iv, data, &mut [], mac)
    }

    fn seal(&self, iv: &InitializationVector, readable: &[u8], data: &mut [u8]) -> Result<Mac, Failed> {
        match self {
            Self::Aes128(cipher) => cipher.encrypt_inout_detached(iv.into(), readable, data.into()),
            Self::Aes256(cipher) => cipher.encrypt_inout_detached(iv.into(), readable, data.into()),
        }
        .map(Mac::from)
        .map_err(|_| Failed)
    }

    fn open(
        &self,
        iv: &InitializationVector,
        readable: &[u8],
        data: &mut [u8],
        mac: &Mac,
    ) -> Result<(), Failed> {
        match self {
            Self::Aes128(cipher) => {
                cipher.decrypt_inout_detached(iv.into(), readable, data.into(), mac.into())
            }
            Self::Aes256(cipher) => {
                cipher.decrypt_inout_detached(iv.into(), readable, data.into(), mac.into())
            }
        }
        .map_err(|_| Failed)
    }
}
