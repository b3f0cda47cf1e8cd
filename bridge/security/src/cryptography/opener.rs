//! Checks and decryption of what is received.

use super::OpenError;
use super::footer::CryptoFooter;
use super::header::CryptoHeader;
use super::material::KeyMaterial;
use super::session::{SessionCipher, SessionId};

/// Sessions whose keys are kept. Fast DDS begins a new one after 32 uses, and what it sends again may be of
/// an older one.
const MAX_SESSIONS: usize = 4;

/// Checks and decrypts what one participant, writer or reader sent, with one key.
///
/// Data that was seen before is accepted again: sequence numbers, which are inside the protection, tell the
/// RTPS layer what it already has.
pub struct Opener {
    material: KeyMaterial,
    /// The latest last.
    sessions: Vec<Session>,
}

struct Session {
    id: SessionId,
    cipher: SessionCipher,
    receiver: Option<SessionCipher>,
}

impl Opener {
    /// Creates an opener. If the material has a key of this receiver, only data that is signed with it too
    /// is accepted.
    pub fn new(material: KeyMaterial) -> Self {
        Self { material, sessions: Vec::new() }
    }

    /// The key in use.
    pub fn material(&self) -> &KeyMaterial {
        &self.material
    }

    /// Appends the content of `data` to `out`, which is unchanged after an error.
    pub(super) fn open(
        &mut self,
        header: &CryptoHeader,
        data: &[u8],
        footer: &CryptoFooter<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), OpenError> {
        if header.transform.key != self.material.id {
            return Err(OpenError::OtherKey);
        }
        if header.transform.kind != self.material.kind {
            return Err(OpenError::OtherKind);
        }
        let id = header.session();
        let known = self.sessions.iter().position(|session| session.id == id);
        let session = match known {
            Some(index) => self.sessions.remove(index),
            None => self.derive(id),
        };
        let result = session.open(&self.material, header, data, footer, out);
        // A forged session must not displace one in use.
        if known.is_some() || result.is_ok() {
            if self.sessions.len() == MAX_SESSIONS {
                self.sessions.remove(0);
            }
            self.sessions.push(session);
        }
        result
    }

    fn derive(&self, id: SessionId) -> Session {
        Session {
            id,
            cipher: SessionCipher::common(&self.material, id),
            receiver: (self.material.receiver.as_ref())
                .map(|key| SessionCipher::for_receiver(&self.material, key, id)),
        }
    }
}

impl Session {
    fn open(
        &self,
        material: &KeyMaterial,
        header: &CryptoHeader,
        data: &[u8],
        footer: &CryptoFooter<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), OpenError> {
        if let (Some(key), Some(cipher)) = (&material.receiver, &self.receiver) {
            let mac = footer.receiver(key.id).ok_or(OpenError::NotForThisReceiver)?;
            cipher.verify(&header.iv, &footer.common, &mac).map_err(|_| OpenError::Forged)?;
        }
        if !material.kind.encrypts() {
            self.cipher.verify(&header.iv, data, &footer.common).map_err(|_| OpenError::Forged)?;
            out.extend_from_slice(data);
            return Ok(());
        }
        let start = out.len();
        out.extend_from_slice(data);
        let data = out.get_mut(start..).unwrap_or_default();
        self.cipher.decrypt(&header.iv, data, &footer.common).map_err(|_| {
            out.truncate(start);
            OpenError::Forged
        })
    }
}

impl std::fmt::Debug for Opener {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Opener").field("material", &self.material).finish_non_exhaustive()
    }
}
