//! X.509 certificates with P-256 keys (RFC 5280).

use std::fmt;
use std::time::SystemTime;

use der::oid::{AssociatedOid, ObjectIdentifier};
use der::{Decode, Reader, SliceReader, Tag};
use p256::ecdsa::signature::Verifier;
use p256::ecdsa::{DerSignature, VerifyingKey};
use x509_cert::ext::Extension;
use x509_cert::ext::pkix::{BasicConstraints, KeyUsage};
use x509_cert::spki::{AlgorithmIdentifierOwned, SubjectPublicKeyInfoOwned};
use x509_cert::{TbsCertificate, Version};

use super::{PkiError, name, pem};

const ECDSA_WITH_SHA256: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.10045.4.3.2");
const EC_PUBLIC_KEY: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.10045.2.1");
const RSA: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.113549.1.1.1");
const PRIME256V1: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.10045.3.1.7");

/// A certificate, well-formed and with a key of a supported kind. Whether to trust it decides
/// [`Authority::check`](super::Authority::check).
#[derive(Clone)]
pub struct Certificate {
    pem: Vec<u8>,
    der: Vec<u8>,
    signed: Signed,
    subject: String,
    subject_der: Vec<u8>,
    issuer: String,
    issuer_der: Vec<u8>,
    serial: Vec<u8>,
    validity: (SystemTime, SystemTime),
    key: VerifyingKey,
    constraints: Option<BasicConstraints>,
    usage: Option<KeyUsage>,
}

impl Certificate {
    /// Reads a certificate from a file or a message, which holds no other.
    ///
    /// # Errors
    /// Returns an error if it is malformed, or if the kind of its key or signature or one of its critical
    /// extensions is not supported.
    pub fn from_pem(pem: &[u8]) -> Result<Self, PkiError> {
        let block = pem::find(pem, &["CERTIFICATE"])?;
        let der = block.der()?;
        let malformed = |error: der::Error| PkiError::Certificate(error.to_string());
        let signed = Signed::read(&der).map_err(malformed)?;
        let content = TbsCertificate::from_der(&signed.content).map_err(malformed)?;
        signed.check_algorithm(content.signature())?;
        let extensions = content.extensions().map(Vec::as_slice).unwrap_or_default();
        if !extensions.is_empty() && content.version() != Version::V3 {
            return Err(PkiError::Certificate("it has extensions, but is not of version 3".into()));
        }
        check_critical(extensions, &[BasicConstraints::OID, KeyUsage::OID])?;
        let (issuer_der, subject_der) = names(&signed.content).map_err(malformed)?;
        let validity = content.validity();
        Ok(Self {
            pem: block.text().to_vec(),
            subject: name::text(content.subject()),
            subject_der,
            issuer: name::text(content.issuer()),
            issuer_der,
            serial: content.serial_number().as_bytes().to_vec(),
            validity: (validity.not_before.to_system_time(), validity.not_after.to_system_time()),
            key: public_key(content.subject_public_key_info())?,
            constraints: extension(extensions)?,
            usage: extension(extensions)?,
            der: der.to_vec(),
            signed,
        })
    }

    /// The PEM block, byte for byte as read.
    pub fn pem(&self) -> &[u8] {
        &self.pem
    }

    pub(crate) fn der(&self) -> &[u8] {
        &self.der
    }

    /// The name of the holder (RFC 2253, as OpenSSL prints it), for example `CN=/talker`.
    pub fn subject(&self) -> &str {
        &self.subject
    }

    /// The name of the holder as it is encoded in the certificate, from which GUIDs are derived.
    pub fn subject_der(&self) -> &[u8] {
        &self.subject_der
    }

    /// The name of the authority that signed, in the form of [`Self::subject`].
    pub fn issuer(&self) -> &str {
        &self.issuer
    }

    pub(crate) fn issuer_der(&self) -> &[u8] {
        &self.issuer_der
    }

    /// The first and the last time at which the certificate is valid.
    pub fn validity(&self) -> (SystemTime, SystemTime) {
        self.validity
    }

    /// The number that the authority gave, big-endian, with a leading zero where DER needs one.
    pub fn serial(&self) -> &[u8] {
        &self.serial
    }

    /// Returns whether the holder signed `message` with ECDSA and SHA-256. `signature_der` is the ASN.1
    /// sequence of the two numbers.
    pub fn verify(&self, message: &[u8], signature_der: &[u8]) -> bool {
        DerSignature::from_bytes(signature_der)
            .is_ok_and(|signature| self.key.verify(message, &signature).is_ok())
    }

    /// Whether an authority may sign certificates with this one.
    pub(super) fn is_authority(&self) -> bool {
        self.constraints.as_ref().is_some_and(|constraints| constraints.ca)
            && self.usage.is_none_or(|usage| usage.key_cert_sign())
    }

    /// Whether the key may sign handshakes.
    pub(super) fn may_sign(&self) -> bool {
        self.usage.is_none_or(|usage| usage.digital_signature())
    }

    pub(super) fn may_sign_crls(&self) -> bool {
        self.usage.is_none_or(|usage| usage.crl_sign())
    }

    pub(super) fn is_signed_by(&self, issuer: &Self) -> bool {
        self.signed.is_by(issuer)
    }

    pub(super) fn key(&self) -> &VerifyingKey {
        &self.key
    }
}

impl PartialEq for Certificate {
    fn eq(&self, other: &Self) -> bool {
        self.der == other.der
    }
}

impl Eq for Certificate {}

impl fmt::Debug for Certificate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Certificate").field("subject", &self.subject).finish_non_exhaustive()
    }
}

/// The form that certificates and revocation lists share: a content, the algorithm and a signature.
#[derive(Clone)]
pub(super) struct Signed {
    /// Exactly the bytes that were signed, which a second encoding might not give.
    pub(super) content: Vec<u8>,
    algorithm: AlgorithmIdentifierOwned,
    signature: Vec<u8>,
}

impl Signed {
    pub(super) fn read(der: &[u8]) -> Result<Self, der::Error> {
        let mut reader = SliceReader::new(der)?;
        let signed = reader.sequence(|fields| {
            let content = fields.tlv_bytes()?.to_vec();
            let algorithm = AlgorithmIdentifierOwned::decode(fields)?;
            let signature = der::asn1::BitStringRef::decode(fields)?;
            let signature = signature.as_bytes().unwrap_or_default().to_vec();
            Ok::<_, der::Error>(Self { content, algorithm, signature })
        })?;
        reader.finish()?;
        Ok(signed)
    }

    /// `repeated` is the algorithm that the content names, which an attacker could not change.
    pub(super) fn check_algorithm(&self, repeated: &AlgorithmIdentifierOwned) -> Result<(), PkiError> {
        for algorithm in [&self.algorithm, repeated] {
            if algorithm.oid != ECDSA_WITH_SHA256 {
                return Err(PkiError::SignatureAlgorithm { found: algorithm.oid.to_string() });
            }
        }
        Ok(())
    }

    pub(super) fn is_by(&self, issuer: &Certificate) -> bool {
        issuer.verify(&self.content, &self.signature)
    }
}

/// An extension that this crate does not know and whose author wants it understood makes the whole
/// certificate or list unusable.
pub(super) fn check_critical(
    extensions: &[Extension],
    understood: &[ObjectIdentifier],
) -> Result<(), PkiError> {
    match extensions.iter().find(|extension| extension.critical && !understood.contains(&extension.extn_id)) {
        Some(unknown) => Err(PkiError::CriticalExtension { oid: unknown.extn_id.to_string() }),
        None => Ok(()),
    }
}

fn extension<T>(extensions: &[Extension]) -> Result<Option<T>, PkiError>
where
    T: AssociatedOid + for<'a> Decode<'a, Error = der::Error>,
{
    let mut values = extensions.iter().filter(|extension| extension.extn_id == T::OID);
    match (values.next(), values.next()) {
        (None, _) => Ok(None),
        (Some(value), None) => T::from_der(value.extn_value.as_bytes())
            .map(Some)
            .map_err(|error| PkiError::Certificate(format!("extension {}: {error}", T::OID))),
        _ => Err(PkiError::Certificate(format!("extension {} occurs twice", T::OID))),
    }
}

/// The encoded names of the issuer and the subject.
fn names(content: &[u8]) -> Result<(Vec<u8>, Vec<u8>), der::Error> {
    let mut reader = SliceReader::new(content)?;
    reader.sequence(|fields| {
        if Tag::peek(fields)?.is_context_specific() {
            fields.tlv_bytes()?; // the version
        }
        fields.tlv_bytes()?; // the serial number
        fields.tlv_bytes()?; // the algorithm
        let issuer = fields.tlv_bytes()?.to_vec();
        fields.tlv_bytes()?; // the validity
        let subject = fields.tlv_bytes()?.to_vec();
        while !fields.is_finished() {
            fields.tlv_bytes()?;
        }
        Ok((issuer, subject))
    })
}

fn public_key(info: &SubjectPublicKeyInfoOwned) -> Result<VerifyingKey, PkiError> {
    check_key_algorithm(
        info.algorithm.oid,
        info.algorithm.parameters.as_ref().and_then(|any| any.decode_as().ok()),
    )?;
    let point = info.subject_public_key.as_bytes().unwrap_or_default();
    VerifyingKey::from_sec1_bytes(point)
        .map_err(|_| PkiError::Certificate("its public key is not a point of the curve P-256".into()))
}

/// Refuses keys that are not P-256. `curve` is the parameter of an elliptic curve key.
pub(super) fn check_key_algorithm(
    algorithm: ObjectIdentifier,
    curve: Option<ObjectIdentifier>,
) -> Result<(), PkiError> {
    match (algorithm, curve) {
        (EC_PUBLIC_KEY, Some(PRIME256V1)) => Ok(()),
        (EC_PUBLIC_KEY, Some(curve)) => Err(PkiError::NotP256 { found: format!("elliptic curve {curve}") }),
        (RSA, _) => Err(PkiError::NotP256 { found: "RSA".into() }),
        (other, _) => Err(PkiError::NotP256 { found: other.to_string() }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pki::openssl::{Folder, Subject};

    #[test]
    fn text_around_the_certificate_is_left_out() {
        let Some(folder) = Folder::new() else { return };
        let plain = folder.self_signed("own", &Subject { serial: "0xff01", ..Subject::default() });
        let with_text = folder.run(&["x509", "-in", "own.pem", "-text"]);
        assert!(with_text.len() > plain.len());
        let certificate = Certificate::from_pem(&[&with_text[..], b"\0"].concat()).unwrap();
        assert_eq!(certificate, Certificate::from_pem(&plain).unwrap());
        assert_eq!(certificate.pem(), plain);
        assert_eq!((certificate.subject(), certificate.issuer()), ("CN=/robot", "CN=/robot"));
        assert_eq!(certificate.serial(), [0, 0xff, 0x01]);
        // SEQUENCE { SET { SEQUENCE { 2.5.4.3, UTF8String } } }
        let der = b"\x30\x11\x31\x0f\x30\x0d\x06\x03\x55\x04\x03\x0c\x06/robot";
        assert_eq!(certificate.subject_der(), der);
        assert_eq!(certificate.issuer_der(), der);
    }

    #[test]
    fn certificates_of_other_kinds_are_refused_by_name() {
        let Some(folder) = Folder::new() else { return };
        let make = |algorithm: &str, option: &str, digest: &str| {
            let key = ["req", "-x509", "-nodes", "-newkey", algorithm, "-pkeyopt", option, digest];
            folder.run(&[&key[..], &["-keyout", "a.key", "-out", "a.pem", "-subj", "/CN=a"]].concat());
            Certificate::from_pem(&folder.read("a.pem")).unwrap_err()
        };
        let algorithm = |found: &str| PkiError::SignatureAlgorithm { found: found.into() };
        let rsa = make("rsa", "rsa_keygen_bits:1024", "-sha256");
        assert_eq!(rsa, algorithm("1.2.840.113549.1.1.11"));
        let sha512 = make("ec", "ec_paramgen_curve:P-256", "-sha512");
        assert_eq!(sha512, algorithm("1.2.840.10045.4.3.4"));
        let p384 = make("ec", "ec_paramgen_curve:P-384", "-sha256");
        assert_eq!(p384, PkiError::NotP256 { found: "elliptic curve 1.3.132.0.34".into() });
        // An RSA key that a P-256 authority signed.
        folder.self_signed("ca", &Subject::AUTHORITY);
        folder.run(&["req", "-new", "-key", "ca.key", "-subj", "/CN=a", "-out", "a.csr"]);
        folder.run(&["genpkey", "-algorithm", "RSA", "-pkeyopt", "rsa_keygen_bits:1024", "-out", "rsa.key"]);
        folder.run(&["rsa", "-in", "rsa.key", "-pubout", "-out", "rsa.pub"]);
        folder.run(&[
            "x509",
            "-req",
            "-in",
            "a.csr",
            "-force_pubkey",
            "rsa.pub",
            "-CA",
            "ca.pem",
            "-CAkey",
            "ca.key",
            "-out",
            "a.pem",
        ]);
        let rsa = Certificate::from_pem(&folder.read("a.pem")).unwrap_err();
        assert_eq!(rsa, PkiError::NotP256 { found: "RSA".into() });
    }

    #[test]
    fn an_unknown_critical_extension_is_refused_and_an_unknown_other_one_ignored() {
        let Some(folder) = Folder::new() else { return };
        let make = |extensions| {
            Certificate::from_pem(&folder.self_signed("own", &Subject { extensions, ..Subject::default() }))
        };
        let refused = make(&["1.2.3.4=critical,DER:0500"]).unwrap_err();
        assert_eq!(refused, PkiError::CriticalExtension { oid: "1.2.3.4".into() });
        assert!(make(&["1.2.3.4=DER:0500"]).is_ok());
        let damaged = make(&["basicConstraints=DER:0500"]).unwrap_err();
        assert!(damaged.to_string().contains("extension 2.5.29.19"), "{damaged}");
    }

    #[test]
    fn damaged_doubled_and_long_files_are_refused() {
        let Some(folder) = Folder::new() else { return };
        let pem = folder.self_signed("own", &Subject::default());
        for length in 0..pem.len() - 1 {
            assert!(Certificate::from_pem(&pem[..length]).is_err(), "{length}");
        }
        let second = Certificate::from_pem(&pem.repeat(2)).unwrap_err();
        assert!(matches!(second, PkiError::SecondBlock { label: "CERTIFICATE", .. }), "{second}");
        let long = Certificate::from_pem(&pem.repeat(1000)).unwrap_err();
        assert!(matches!(long, PkiError::TooLong { .. }), "{long}");
        let cut = Certificate::from_pem(&pem[..100]).unwrap_err();
        assert_eq!(cut, PkiError::Pem { label: "CERTIFICATE", line: 1 });
        assert_eq!(Certificate::from_pem(b"").unwrap_err(), PkiError::NoBlock { expected: "CERTIFICATE" });
    }

    #[test]
    fn a_certificate_whose_content_was_changed_is_not_signed_by_its_authority() {
        let Some(folder) = Folder::new() else { return };
        let ca = Certificate::from_pem(&folder.self_signed("ca", &Subject::AUTHORITY)).unwrap();
        let pem = folder.signed("ca", "enclave", &Subject::default());
        assert!(Certificate::from_pem(&pem).unwrap().is_signed_by(&ca));
        folder.run(&["x509", "-in", "enclave.pem", "-outform", "der", "-out", "enclave.der"]);
        let mut der = folder.read("enclave.der");
        let at = der.windows(6).position(|bytes| bytes == b"/robot").unwrap();
        der[at..at + 6].copy_from_slice(b"/rover");
        folder.write("forged.der", &der);
        let forged = folder.run(&["x509", "-inform", "der", "-in", "forged.der"]);
        let forged = Certificate::from_pem(&forged).unwrap();
        assert_eq!(forged.subject(), "CN=/rover");
        assert!(!forged.is_signed_by(&ca));
    }
}
