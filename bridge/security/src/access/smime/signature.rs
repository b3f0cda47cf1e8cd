//! Detached signatures (RFC 5652, SignedData), as far as keystores use them: ECDSA with SHA-256.

use std::time::SystemTime;

use der::oid::ObjectIdentifier;
use sha2::{Digest, Sha256};

use super::SmimeError;
use crate::asn1::{
    self, CONTEXT_0, ECDSA_WITH_SHA256, Element, INTEGER, OCTET_STRING, SEQUENCE, SET, SHA256,
};
use crate::pki::{Certificate, PrivateKey};

const DATA: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.113549.1.7.1");
const SIGNED_DATA: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.113549.1.7.2");
const CONTENT_TYPE: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.113549.1.9.3");
const MESSAGE_DIGEST: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.113549.1.9.4");
const SIGNING_TIME: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.113549.1.9.5");

/// Checks that one of the signatures is by `signer`. Certificates in the signature are ignored, so it does
/// not matter who signed them.
pub(super) fn verify(signature: &[u8], text: &[u8], signer: &Certificate) -> Result<(), SmimeError> {
    let signers = signers(signature).ok_or(SmimeError::SignedData)?;
    let mut refusal = SmimeError::NoSignature;
    for info in signers {
        let info = SignerInfo::read(info).ok_or(SmimeError::SignedData)?;
        match info.verify(text, signer) {
            Ok(()) => return Ok(()),
            Err(error) => refusal = error,
        }
    }
    Err(refusal)
}

/// The signers of a detached signature.
fn signers(signature: &[u8]) -> Option<Vec<Element<'_>>> {
    let content_info = single(&asn1::elements(signature)?)?.elements(SEQUENCE)?;
    let [kind, content] = content_info[..] else { return None };
    if kind.oid()? != SIGNED_DATA {
        return None;
    }
    let signed_data = single(&content.elements(CONTEXT_0)?)?.elements(SEQUENCE)?;
    let [_version, _digests, content, ..] = signed_data[..] else { return None };
    // Detached: the type of the content stands alone.
    if single(&content.elements(SEQUENCE)?)?.oid()? != DATA {
        return None;
    }
    signed_data.last()?.elements(SET)
}

fn single<'a>(elements: &[Element<'a>]) -> Option<Element<'a>> {
    let [element] = elements else { return None };
    Some(*element)
}

struct SignerInfo<'a> {
    /// The names of the issuer and the serial number of the signer's certificate.
    signer: Element<'a>,
    digest: ObjectIdentifier,
    attributes: Option<Element<'a>>,
    algorithm: ObjectIdentifier,
    signature: &'a [u8],
}

impl<'a> SignerInfo<'a> {
    fn read(info: Element<'a>) -> Option<Self> {
        let fields = info.elements(SEQUENCE)?;
        let (attributes, rest) = match fields.get(3..)? {
            [attributes, rest @ ..] if attributes.tag() == Some(CONTEXT_0) => (Some(*attributes), rest),
            rest => (None, rest),
        };
        let ([_version, signer, digest, ..], [algorithm, signature, ..]) = (&fields[..], rest) else {
            return None;
        };
        Some(Self {
            signer: *signer,
            digest: digest.algorithm()?,
            attributes,
            algorithm: algorithm.algorithm()?,
            signature: signature.with_tag(OCTET_STRING)?,
        })
    }

    fn verify(&self, text: &[u8], signer: &Certificate) -> Result<(), SmimeError> {
        if self.digest != SHA256 {
            return Err(SmimeError::Digest(self.digest.to_string()));
        }
        if self.algorithm != ECDSA_WITH_SHA256 {
            return Err(SmimeError::Algorithm(self.algorithm.to_string()));
        }
        let is_signed = match self.attributes {
            None => signer.verify(text, self.signature),
            Some(attributes) => {
                check_attributes(attributes, text)?;
                // What is signed is the set, which has another tag in its place here.
                let mut set = attributes.der.to_vec();
                set.first_mut().into_iter().for_each(|tag| *tag = SET);
                signer.verify(&set, self.signature)
            }
        };
        let signer_name = || signer.subject().to_owned();
        match is_signed {
            true => Ok(()),
            false if self.signer.der == identifier(signer) => Err(SmimeError::Signature(signer_name())),
            false => Err(SmimeError::OtherSigner(signer_name())),
        }
    }
}

/// The attributes name the type and the digest of the text, each once.
fn check_attributes(attributes: Element, text: &[u8]) -> Result<(), SmimeError> {
    let attributes = attributes.elements(CONTEXT_0).ok_or(SmimeError::SignedData)?;
    let value = |kind: ObjectIdentifier| -> Option<Element> {
        let mut values = attributes.iter().filter_map(|attribute| {
            let [of, values] = attribute.elements(SEQUENCE)?[..] else { return None };
            (of.oid()? == kind).then_some(values)
        });
        let first = values.next()?.elements(SET)?;
        values.next().is_none().then(|| single(&first))?
    };
    if value(CONTENT_TYPE).and_then(Element::oid) != Some(DATA) {
        return Err(SmimeError::SignedData);
    }
    let digest = value(MESSAGE_DIGEST).and_then(|value| value.with_tag(OCTET_STRING));
    match digest.ok_or(SmimeError::SignedData)? == Sha256::digest(text).as_slice() {
        true => Ok(()),
        false => Err(SmimeError::Changed),
    }
}

/// Signs a text; the certificate becomes part of the signature, since some peers look for it there.
pub(super) fn sign(text: &[u8], certificate: &Certificate, key: &PrivateKey, now: SystemTime) -> Vec<u8> {
    let attribute = |kind, value: &[u8]| asn1::sequence(&[&asn1::oid(kind), &asn1::element(SET, &[value])]);
    let digest = asn1::element(OCTET_STRING, &[&Sha256::digest(text)]);
    let mut attributes = [
        attribute(CONTENT_TYPE, &asn1::oid(DATA)),
        attribute(SIGNING_TIME, &asn1::time(now)),
        attribute(MESSAGE_DIGEST, &digest),
    ];
    attributes.sort(); // the order of sets in DER
    let attributes = attributes.concat();
    let signature = key.sign(&asn1::element(SET, &[&attributes]));

    let version = asn1::element(INTEGER, &[&[1]]);
    let sha256 = asn1::sequence(&[&asn1::oid(SHA256)]);
    let info = asn1::sequence(&[
        &version,
        &identifier(certificate),
        &sha256,
        &asn1::element(CONTEXT_0, &[&attributes]),
        &asn1::sequence(&[&asn1::oid(ECDSA_WITH_SHA256)]),
        &asn1::element(OCTET_STRING, &[&signature]),
    ]);
    let signed_data = asn1::sequence(&[
        &version,
        &asn1::element(SET, &[&sha256]),
        &asn1::sequence(&[&asn1::oid(DATA)]),
        &asn1::element(CONTEXT_0, &[certificate.der()]),
        &asn1::element(SET, &[&info]),
    ]);
    asn1::sequence(&[&asn1::oid(SIGNED_DATA), &asn1::element(CONTEXT_0, &[&signed_data])])
}

/// How a signature names a certificate.
fn identifier(certificate: &Certificate) -> Vec<u8> {
    asn1::sequence(&[certificate.issuer_der(), &asn1::element(INTEGER, &[certificate.serial()])])
}
