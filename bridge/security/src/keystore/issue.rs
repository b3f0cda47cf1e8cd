//! New certificates, as sros2 issues them.

use std::time::{Duration, SystemTime};

use der::oid::ObjectIdentifier;
use der::pem::{LineEnding, encode_string};

use crate::asn1::{self, CONTEXT_0, ECDSA_WITH_SHA256, INTEGER, OCTET_STRING, SET};
use crate::pki::{Certificate, PkiError, PrivateKey};

const COMMON_NAME: ObjectIdentifier = ObjectIdentifier::new_unwrap("2.5.4.3");
const BASIC_CONSTRAINTS: ObjectIdentifier = ObjectIdentifier::new_unwrap("2.5.29.19");
const BOOLEAN: u8 = 0x01;
const BIT_STRING: u8 = 0x03;
const UTF8_STRING: u8 = 0x0c;
const CONTEXT_3: u8 = 0xa3;

const DAY: Duration = Duration::from_secs(24 * 3600);
/// Some peers refuse what begins at this moment.
const BEFORE: Duration = DAY;
const VALID: Duration = Duration::from_secs(3650 * 24 * 3600);

/// Who signs a certificate.
pub(super) enum Issuer<'a> {
    /// The holder, who becomes an authority.
    Itself,
    /// An authority, for an enclave.
    Authority(&'a Certificate, &'a PrivateKey),
}

/// Issues a certificate for ten years. `name` becomes the common name of the holder.
pub(super) fn certificate(
    name: &str,
    holder: &PrivateKey,
    issuer: &Issuer,
    now: SystemTime,
    random: &mut dyn FnMut(&mut [u8]),
) -> Result<Certificate, PkiError> {
    let subject = common_name(name);
    let (issuer_name, signer) = match issuer {
        Issuer::Itself => (subject.as_slice(), holder),
        Issuer::Authority(authority, key) => (authority.subject_der(), *key),
    };
    let algorithm = asn1::sequence(&[&asn1::oid(ECDSA_WITH_SHA256)]);
    let begin = now.checked_sub(BEFORE).unwrap_or(SystemTime::UNIX_EPOCH);
    let end = now.checked_add(VALID).unwrap_or(now);
    let content = asn1::sequence(&[
        &asn1::element(CONTEXT_0, &[&asn1::element(INTEGER, &[&[2]])]), // version 3
        &asn1::element(INTEGER, &[&serial(random)]),
        &algorithm,
        issuer_name,
        &asn1::sequence(&[&asn1::time(begin), &asn1::time(end)]),
        &subject,
        &holder.public_der(),
        &asn1::element(CONTEXT_3, &[&asn1::sequence(&[&constraints(issuer)])]),
    ]);
    let signature = asn1::element(BIT_STRING, &[&[0], &signer.sign(&content)]);
    let der = asn1::sequence(&[&content, &algorithm, &signature]);
    let pem = encode_string("CERTIFICATE", LineEnding::LF, &der).expect("a certificate is short");
    Certificate::from_pem(pem.as_bytes())
}

/// A name with this only attribute.
fn common_name(text: &str) -> Vec<u8> {
    let text = asn1::element(UTF8_STRING, &[text.as_bytes()]);
    asn1::sequence(&[&asn1::element(SET, &[&asn1::sequence(&[&asn1::oid(COMMON_NAME), &text])])])
}

/// A positive number of 20 bytes, which is the most that a serial number may have.
fn serial(random: &mut dyn FnMut(&mut [u8])) -> [u8; 20] {
    let mut serial = [0; 20];
    random(&mut serial);
    let [first, ..] = &mut serial;
    // Without the sign bit, and with another one so that no zero has to be left out.
    *first = *first & 0x7f | 0x40;
    serial
}

/// An authority may sign one more level, an enclave none.
fn constraints(issuer: &Issuer) -> Vec<u8> {
    let kind = asn1::oid(BASIC_CONSTRAINTS);
    let yes = asn1::element(BOOLEAN, &[&[0xff]]);
    match issuer {
        Issuer::Itself => {
            let content = asn1::sequence(&[&yes, &asn1::element(INTEGER, &[&[1]])]);
            asn1::sequence(&[&kind, &yes, &asn1::element(OCTET_STRING, &[&content])])
        }
        Issuer::Authority(..) => {
            asn1::sequence(&[&kind, &asn1::element(OCTET_STRING, &[&asn1::sequence(&[])])])
        }
    }
}
