//! Protection of what is sent.

use super::SealError;
use super::footer::ReceiverMac;
use super::header::{CryptoHeader, Transform};
use super::material::{KeyId, KeyMaterial, ReceiverKey};
use super::session::{Mac, SessionCipher};

/// Uses and bytes after which a session gets a new key. AES-GCM itself allows 2^32 uses (NIST SP 800-38D);
/// a peer computes one HMAC for each new session.
const SESSION_USES: u32 = 1 << 16;
const SESSION_BYTES: u64 = 1 << 32;

/// Protects what one participant, writer or reader sends, with one key.
///
/// There is one sealer per key, since no two uses of a key may have the same initialization vector.
pub struct Sealer {
    material: KeyMaterial,
    receivers: Vec<ReceiverKey>,
    first_session: u32,
    session: u32,
    /// Continues over sessions.
    iv_suffix: u64,
    uses: u32,
    bytes: u64,
    cipher: SessionCipher,
    receiver_ciphers: Vec<(KeyId, SessionCipher)>,
}

impl Sealer {
    /// Creates a sealer whose first session and initialization vector are random. The two participants of a
    /// key exchange seal with the same key, and only this keeps their initialization vectors apart.
    pub fn new(material: KeyMaterial, random: &mut dyn FnMut(&mut [u8])) -> Self {
        let (mut session, mut iv_suffix) = ([0; 4], [0; 8]);
        random(&mut session);
        random(&mut iv_suffix);
        let cipher = SessionCipher::common(&material, session);
        Self {
            material,
            receivers: Vec::new(),
            first_session: u32::from_be_bytes(session),
            session: u32::from_be_bytes(session),
            iv_suffix: u64::from_be_bytes(iv_suffix),
            uses: 0,
            bytes: 0,
            cipher,
            receiver_ciphers: Vec::new(),
        }
    }

    /// The key in use.
    pub fn material(&self) -> &KeyMaterial {
        &self.material
    }

    /// Whether it has sealed something in that session.
    pub fn has_used(&self, session: [u8; 4]) -> bool {
        let after_first = u32::from_be_bytes(session).wrapping_sub(self.first_session);
        after_first <= self.session.wrapping_sub(self.first_session)
    }

    /// Sets the receivers for which submessages and messages get a MAC of their own (origin authentication).
    /// Each adds 20 bytes to whatever is sealed.
    pub fn set_receivers(&mut self, receivers: Vec<ReceiverKey>) {
        self.receivers = receivers;
        self.derive_receiver_ciphers();
    }

    fn derive_receiver_ciphers(&mut self) {
        let session = self.session.to_be_bytes();
        let cipher = |key| SessionCipher::for_receiver(&self.material, key, session);
        self.receiver_ciphers = self.receivers.iter().map(|key| (key.id, cipher(key))).collect();
    }

    /// Begins a use of the key for `len` bytes.
    pub(super) fn next(&mut self, len: usize) -> CryptoHeader {
        if self.uses >= SESSION_USES || self.bytes >= SESSION_BYTES {
            self.session = self.session.wrapping_add(1);
            self.cipher = SessionCipher::common(&self.material, self.session.to_be_bytes());
            self.derive_receiver_ciphers();
            (self.uses, self.bytes) = (0, 0);
        }
        self.uses += 1;
        self.bytes = self.bytes.saturating_add(len as u64);
        self.iv_suffix = self.iv_suffix.wrapping_add(1);
        let mut iv = [0; 12];
        let (session, suffix) = iv.split_at_mut(4);
        session.copy_from_slice(&self.session.to_be_bytes());
        suffix.copy_from_slice(&self.iv_suffix.to_be_bytes());
        CryptoHeader { transform: Transform { kind: self.material.kind, key: self.material.id }, iv }
    }

    /// Signs `data`, and encrypts it in place if the key does.
    pub(super) fn protect(&self, header: &CryptoHeader, data: &mut [u8]) -> Result<Mac, SealError> {
        if self.material.kind.encrypts() {
            self.cipher.encrypt(&header.iv, data)
        } else {
            self.cipher.sign(&header.iv, data)
        }
        .map_err(|_| SealError::TooLong)
    }

    /// Signs the common MAC for each receiver.
    pub(super) fn receiver_macs(
        &self,
        header: &CryptoHeader,
        common: &Mac,
    ) -> Result<Vec<ReceiverMac>, SealError> {
        let sign = |(key, cipher): &(KeyId, SessionCipher)| {
            let mac = cipher.sign(&header.iv, common).map_err(|_| SealError::TooLong)?;
            Ok(ReceiverMac { key: *key, mac })
        };
        self.receiver_ciphers.iter().map(sign).collect()
    }
}

impl std::fmt::Debug for Sealer {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Sealer").field("material", &self.material).finish_non_exhaustive()
    }
}
