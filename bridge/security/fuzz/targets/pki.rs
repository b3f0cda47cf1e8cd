//! Certificates, keys and lists of revoked certificates.

use std::sync::LazyLock;
use std::time::{Duration, SystemTime};

use der::pem::LineEnding;
use downbeat_security::pki::{Authority, Certificate, Crl, PrivateKey};

macro_rules! keystore {
    ($file:literal) => {
        include_bytes!(concat!("../../tests/data/keystores/all_domains/", $file)).as_slice()
    };
}
pub(crate) use keystore;

const CA: &[u8] = keystore!("public/ca.cert.pem");
const CERTIFICATE: &[u8] = keystore!("enclaves/talker/cert.pem");
const KEY: &[u8] = keystore!("enclaves/talker/key.pem");
const CRL: &[u8] = include_bytes!("../../tests/data/crl.pem");

/// The authority of the keystore.
pub static AUTHORITY: LazyLock<Authority> = LazyLock::new(|| {
    Authority::new(Certificate::from_pem(CA).expect("a certificate"), None).expect("an authority")
});
static GENUINE: LazyLock<Certificate> =
    LazyLock::new(|| Certificate::from_pem(CERTIFICATE).expect("a certificate"));

/// When all of them are valid.
pub fn time() -> SystemTime {
    SystemTime::UNIX_EPOCH + Duration::from_secs(1_798_761_600)
}

fn encoded(label: &str, der: &[u8]) -> Vec<u8> {
    der::pem::encode_string(label, LineEnding::LF, der).map(String::into_bytes).unwrap_or_default()
}

fn decoded(pem: &[u8]) -> Vec<u8> {
    let text = std::str::from_utf8(pem).expect("PEM");
    der::Document::from_pem(text).expect("PEM").1.as_bytes().to_vec()
}

/// A certificate in DER.
pub fn certificate(der: &[u8]) -> bool {
    certificate_in(&encoded("CERTIFICATE", der))
}

fn certificate_in(pem: &[u8]) -> bool {
    let Ok(certificate) = Certificate::from_pem(pem) else { return false };
    if AUTHORITY.check(&certificate, time()).is_ok() {
        // Only text around it has changed.
        assert_eq!(certificate, *GENUINE);
    }
    let _ = certificate.verify(b"message", b"signature");
    true
}

pub fn certificates() -> Vec<Vec<u8>> {
    vec![decoded(CERTIFICATE), decoded(CA)]
}

/// A private key in DER.
pub fn key(der: &[u8]) -> bool {
    let kinds = ["PRIVATE KEY", "EC PRIVATE KEY"];
    kinds.into_iter().any(|kind| match PrivateKey::from_pem(&encoded(kind, der)) {
        Ok(key) => {
            let _ = key.matches(&GENUINE);
            true
        }
        Err(_) => false,
    })
}

pub fn keys() -> Vec<Vec<u8>> {
    vec![decoded(KEY)]
}

/// A list of revoked certificates in DER.
pub fn revocations(der: &[u8]) -> bool {
    let Ok(crl) = Crl::from_pem(&encoded("X509 CRL", der)) else { return false };
    if let Ok(authority) = Authority::new(AUTHORITY.certificate().clone(), Some(crl)) {
        // The genuine list, since the authority has signed it.
        assert_eq!(authority.check(&GENUINE, time()), Ok(()));
    }
    true
}

pub fn crls() -> Vec<Vec<u8>> {
    vec![decoded(CRL)]
}

/// A file with any of them.
pub fn pem(text: &[u8]) -> bool {
    let is_certificate = certificate_in(text);
    let is_key = PrivateKey::from_pem(text).is_ok();
    is_certificate || is_key || Crl::from_pem(text).is_ok()
}

pub fn pems() -> Vec<Vec<u8>> {
    [CA, CERTIFICATE, KEY, CRL].map(<[u8]>::to_vec).into()
}
