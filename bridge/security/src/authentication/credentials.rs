//! What a participant shows of itself in a handshake: the properties `c.*`.

use std::time::SystemTime;

use downbeat_rtps::wire::GuidPrefix;
use sha2::{Digest, Sha256};

use super::agreement::Method;
use super::fields::Fields;
use super::guid::{is_derived, prefix_in};
use super::identity::{Identity, RemoteIdentity, SIGNATURE_ALGORITHM};
use super::refusal::{Refusal, shown};
use crate::cdr::{ByteOrder, Writer};
use crate::pki::Certificate;
use crate::tokens::write_binary;

/// The names and values in the order in which they are hashed.
pub(super) struct Credentials<Value>(pub(super) [(&'static str, Value); 5]);

const NAMES: [&str; 5] = ["c.id", "c.perm", "c.pdata", "c.dsign_algo", "c.kagree_algo"];

impl<'a> Credentials<&'a [u8]> {
    pub(super) fn own(identity: &'a Identity, participant_data: &'a [u8], method: Method) -> Self {
        let [id, permissions, data, signature_algorithm, key_agreement] = NAMES;
        Self([
            (id, identity.certificate.pem()),
            (permissions, &identity.permissions_document),
            (data, participant_data),
            (signature_algorithm, SIGNATURE_ALGORITHM.as_bytes()),
            (key_agreement, method.name().as_bytes()),
        ])
    }

    pub(super) fn read(fields: Fields<'a>) -> Result<Self, Refusal> {
        let mut read = NAMES.map(|name| (name, &[][..]));
        for (name, value) in &mut read {
            *value = fields.get(name)?;
        }
        Ok(Self(read))
    }

    /// The method by which the participant wants to agree on a key.
    pub(super) fn method(&self) -> Result<Method, Refusal> {
        let [.., (_, name)] = self.0;
        let name = without_terminator(name);
        Method::from_name(name).ok_or_else(|| Refusal::KeyAgreement { found: shown(name) })
    }

    /// Checks what a participant with the GUID prefix `remote` has sent, except that it has the private key.
    /// The cheap checks come first.
    pub(super) fn check(
        &self,
        remote: GuidPrefix,
        identity: &Identity,
        time: SystemTime,
    ) -> Result<RemoteIdentity, Refusal> {
        let Self([(_, id), (_, permissions), (_, data), (_, signature_algorithm), _]) = *self;
        if without_terminator(signature_algorithm) != SIGNATURE_ALGORITHM.as_bytes() {
            return Err(Refusal::SignatureAlgorithm { found: shown(signature_algorithm) });
        }
        let permissions = without_terminator(permissions);
        if permissions.is_empty() {
            return Err(Refusal::Permissions);
        }
        let found = prefix_in(data).ok_or(Refusal::ParticipantData)?;
        if found != remote {
            return Err(Refusal::OtherParticipant { found, expected: remote });
        }
        let certificate = Certificate::from_pem(without_terminator(id))?;
        if !is_derived(remote, &certificate) {
            return Err(Refusal::Subject { prefix: remote, subject: certificate.subject().into() });
        }
        identity.authority.check(&certificate, time)?;
        let (permissions_document, participant_data) = (permissions.to_vec(), data.to_vec());
        Ok(RemoteIdentity { certificate, permissions_document, participant_data })
    }
}

impl<Value: AsRef<[u8]>> Credentials<Value> {
    pub(super) fn hash(&self) -> [u8; 32] {
        let mut bytes = Vec::new();
        write_binary(&mut Writer::new(&mut bytes, ByteOrder::Big), &self.0);
        Sha256::digest(bytes).into()
    }
}

/// Cyclone DDS sends strings with their terminator.
fn without_terminator(text: &[u8]) -> &[u8] {
    text.strip_suffix(&[0]).unwrap_or(text)
}
