//! Whom a keystore trusts: certificates that its authority signed and has not revoked.

use std::collections::BTreeSet;
use std::fmt;
use std::time::SystemTime;

use der::{Decode, Encode};
use x509_cert::certificate::Rfc5280;
use x509_cert::crl::TbsCertList;

use super::certificate::{Signed, check_critical};
use super::{Certificate, PkiError, pem};

/// The authority of a keystore, for identities or for permissions.
#[derive(Clone, Debug)]
pub struct Authority {
    certificate: Certificate,
    crl: Option<Crl>,
}

/// A list of revoked certificates.
#[derive(Clone)]
pub struct Crl {
    signed: Signed,
    issuer_der: Vec<u8>,
    this_update: SystemTime,
    next_update: Option<SystemTime>,
    revoked: BTreeSet<Vec<u8>>,
}

/// Why a certificate is not trusted.
#[allow(missing_docs)] // the texts say it
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Distrust {
    #[error("the certificate of \"{subject}\" may not sign others, so it is not that of an authority")]
    NotAuthority { subject: String },
    #[error("the certificate of \"{subject}\" is that of the authority itself; each enclave needs its own")]
    AuthorityItself { subject: String },
    #[error("the certificate of \"{subject}\" is by \"{issuer}\", but this keystore trusts \"{trusted}\"")]
    OtherAuthority { subject: String, issuer: String, trusted: String },
    #[error(
        "the certificate of \"{subject}\" names \"{issuer}\" as its authority, but was not signed by its key"
    )]
    Signature { subject: String, issuer: String },
    #[error("the certificate of \"{subject}\" is not for signatures")]
    Usage { subject: String },
    #[error("the certificate of \"{subject}\" is not valid before {begin}; check the clocks")]
    NotYetValid { subject: String, begin: Date },
    #[error("the certificate of \"{subject}\" expired on {end}; issue a new one")]
    Expired { subject: String, end: Date },
    #[error("the certificate of \"{subject}\" was revoked by its authority")]
    Revoked { subject: String },
    #[error("the revocation list is not by \"{trusted}\"")]
    CrlOfOther { trusted: String },
    #[error("the revocation list of \"{trusted}\" is not valid before {begin}; check the clocks")]
    CrlNotYetValid { trusted: String, begin: Date },
    #[error("the revocation list of \"{trusted}\" had to be replaced before {end}; issue a new one")]
    CrlExpired { trusted: String, end: Date },
}

/// A time of day of the calendar, shown in UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Date(pub SystemTime);

impl fmt::Display for Date {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match der::DateTime::from_system_time(self.0) {
            Ok(date) => date.fmt(f),
            Err(_) => f.write_str("an unknown date"),
        }
    }
}

impl Authority {
    /// Trusts `certificate`, and what it signs.
    ///
    /// # Errors
    /// Returns an error if `certificate` may not sign others, or if it did not sign `crl`.
    pub fn new(certificate: Certificate, crl: Option<Crl>) -> Result<Self, Distrust> {
        if !certificate.is_authority() {
            return Err(Distrust::NotAuthority { subject: certificate.subject().into() });
        }
        let is_own = |crl: &Crl| {
            crl.issuer_der == certificate.subject_der()
                && certificate.may_sign_crls()
                && crl.signed.is_by(&certificate)
        };
        if crl.as_ref().is_some_and(|crl| !is_own(crl)) {
            return Err(Distrust::CrlOfOther { trusted: certificate.subject().into() });
        }
        Ok(Self { certificate, crl })
    }

    /// The certificate that signs all others.
    pub fn certificate(&self) -> &Certificate {
        &self.certificate
    }

    /// When its revocation list has to be replaced, if it has one that says so.
    pub fn crl_ends(&self) -> Option<SystemTime> {
        self.crl.as_ref()?.next_update
    }

    /// Decides whether `certificate` is that of an enclave of this keystore. The cheap checks come first, the
    /// signature last.
    ///
    /// # Errors
    /// Returns the first reason not to trust it.
    pub fn check(&self, certificate: &Certificate, now: SystemTime) -> Result<(), Distrust> {
        let subject = || certificate.subject().to_owned();
        let trusted = || self.certificate.subject().to_owned();
        if certificate.key() == self.certificate.key() {
            return Err(Distrust::AuthorityItself { subject: subject() });
        }
        if certificate.issuer_der() != self.certificate.subject_der() {
            let issuer = certificate.issuer().to_owned();
            return Err(Distrust::OtherAuthority { subject: subject(), issuer, trusted: trusted() });
        }
        check_validity(&self.certificate, now)?;
        check_validity(certificate, now)?;
        if !certificate.may_sign() {
            return Err(Distrust::Usage { subject: subject() });
        }
        if let Some(crl) = &self.crl {
            if now < crl.this_update {
                return Err(Distrust::CrlNotYetValid { trusted: trusted(), begin: Date(crl.this_update) });
            }
            if let Some(end) = crl.next_update.filter(|end| *end < now) {
                return Err(Distrust::CrlExpired { trusted: trusted(), end: Date(end) });
            }
            if crl.revoked.contains(certificate.serial()) {
                return Err(Distrust::Revoked { subject: subject() });
            }
        }
        if !certificate.is_signed_by(&self.certificate) {
            let issuer = certificate.issuer().to_owned();
            return Err(Distrust::Signature { subject: subject(), issuer });
        }
        Ok(())
    }
}

/// Whether a certificate is valid at a time.
pub(crate) fn check_validity(certificate: &Certificate, now: SystemTime) -> Result<(), Distrust> {
    let (begin, end) = certificate.validity();
    let subject = certificate.subject().to_owned();
    if now < begin {
        return Err(Distrust::NotYetValid { subject, begin: Date(begin) });
    }
    if now > end {
        return Err(Distrust::Expired { subject, end: Date(end) });
    }
    Ok(())
}

impl Crl {
    /// Reads a list as `openssl ca -gencrl` writes it.
    ///
    /// # Errors
    /// Returns an error if it is malformed, or if its algorithm or one of its critical extensions is not
    /// supported.
    pub fn from_pem(pem: &[u8]) -> Result<Self, PkiError> {
        let malformed = |error: der::Error| PkiError::Crl(error.to_string());
        let der = pem::find(pem, &["X509 CRL"])?.der()?;
        let signed = Signed::read(&der).map_err(malformed)?;
        let list = TbsCertList::<Rfc5280>::from_der(&signed.content).map_err(malformed)?;
        signed.check_algorithm(&list.signature)?;
        check_critical(list.crl_extensions.as_deref().unwrap_or_default(), &[])?;
        let revoked = list.revoked_certificates.unwrap_or_default();
        for entry in &revoked {
            check_critical(entry.crl_entry_extensions.as_deref().unwrap_or_default(), &[])?;
        }
        Ok(Self {
            issuer_der: list.issuer.to_der().map_err(malformed)?,
            this_update: list.this_update.to_system_time(),
            next_update: list.next_update.map(|time| time.to_system_time()),
            revoked: revoked.iter().map(|entry| entry.serial_number.as_bytes().to_vec()).collect(),
            signed,
        })
    }
}

impl fmt::Debug for Crl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Crl").field("revoked", &self.revoked.len()).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::pki::openssl::{Folder, Subject};

    const DAY: Duration = Duration::from_secs(24 * 60 * 60);

    /// Certificates that are made within the next minute are valid.
    fn now() -> SystemTime {
        SystemTime::now() + Duration::from_secs(60)
    }

    fn authority(folder: &Folder, name: &str) -> Certificate {
        Certificate::from_pem(&folder.self_signed(name, &Subject::AUTHORITY)).unwrap()
    }

    fn enclave(folder: &Folder, subject: &Subject<'_>) -> Certificate {
        Certificate::from_pem(&folder.signed("ca", "enclave", subject)).unwrap()
    }

    /// Makes a list by `ca` that revokes the certificates in `revoked`.
    fn crl(folder: &Folder, ca: &str, revoked: &[&str]) -> Crl {
        let configuration = "[ca]\ndefault_ca = own\n[own]\ndatabase = index\ndefault_md = sha256\n\
                             default_crl_days = 30\ncrlnumber = number\n";
        folder.write("configuration", configuration.as_bytes());
        folder.write("index", b"");
        folder.write("number", b"01\n");
        let (certificate, key) = (format!("{ca}.pem"), format!("{ca}.key"));
        let by = ["ca", "-config", "configuration", "-cert", &certificate, "-keyfile", &key];
        for file in revoked {
            folder.run(&[&by[..], &["-revoke", file]].concat());
        }
        folder.run(&[&by[..], &["-gencrl", "-out", "crl.pem"]].concat());
        Crl::from_pem(&folder.read("crl.pem")).unwrap()
    }

    #[test]
    fn a_certificate_of_the_authority_is_trusted_while_it_is_valid() {
        let Some(folder) = Folder::new() else { return };
        let authority = Authority::new(authority(&folder, "ca"), None).unwrap();
        let certificate = enclave(&folder, &Subject { days: "30", ..Subject::default() });
        let now = now();
        assert_eq!(authority.check(&certificate, now), Ok(()));
        let (begin, end) = certificate.validity();
        assert_eq!(end, begin + 30 * DAY);
        let subject = || "CN=/robot".to_owned();
        let later = authority.check(&certificate, now + 31 * DAY);
        assert_eq!(later, Err(Distrust::Expired { subject: subject(), end: Date(end) }));
        // Of the two certificates, that of the authority is named first.
        let earlier = authority.check(&certificate, now - DAY).unwrap_err();
        assert!(matches!(&earlier, Distrust::NotYetValid { subject, .. } if subject == "CN=sros2CA"));
        let text = Distrust::NotYetValid { subject: subject(), begin: Date(SystemTime::UNIX_EPOCH) };
        let expected =
            "the certificate of \"CN=/robot\" is not valid before 1970-01-01T00:00:00Z; check the clocks";
        assert_eq!(text.to_string(), expected);
    }

    #[test]
    fn a_certificate_of_version_1_is_trusted_but_is_no_authority() {
        let Some(folder) = Folder::new() else { return };
        let authority = Authority::new(authority(&folder, "ca"), None).unwrap();
        let certificate = enclave(&folder, &Subject { extensions: &[], ..Subject::default() });
        assert_eq!(authority.check(&certificate, now()), Ok(()));
        let refused = Authority::new(certificate, None).unwrap_err();
        assert_eq!(refused, Distrust::NotAuthority { subject: "CN=/robot".into() });
    }

    #[test]
    fn an_expired_authority_trusts_no_one() {
        let Some(folder) = Folder::new() else { return };
        let short = Subject { days: "1", ..Subject::AUTHORITY };
        let ca = Certificate::from_pem(&folder.self_signed("ca", &short)).unwrap();
        let end = Date(ca.validity().1);
        let certificate = enclave(&folder, &Subject::default());
        let later = Authority::new(ca, None).unwrap().check(&certificate, now() + 2 * DAY);
        assert_eq!(later, Err(Distrust::Expired { subject: "CN=sros2CA".into(), end }));
    }

    #[test]
    fn certificates_of_other_authorities_and_of_impostors_are_refused() {
        let Some(folder) = Folder::new() else { return };
        let trusted = Authority::new(authority(&folder, "ca"), None).unwrap();
        let now = now();
        // Another authority, with another name and then with the same one.
        let other = Subject { name: "/CN=other", ..Subject::AUTHORITY };
        folder.self_signed("other", &other);
        let sign = |by| Certificate::from_pem(&folder.signed(by, "enclave", &Subject::default())).unwrap();
        let (subject, issuer) = ("CN=/robot".to_owned(), "CN=other".to_owned());
        let expected = Distrust::OtherAuthority { subject, issuer, trusted: "CN=sros2CA".into() };
        assert_eq!(trusted.check(&sign("other"), now), Err(expected));
        folder.self_signed("impostor", &Subject::AUTHORITY);
        let expected = Distrust::Signature { subject: "CN=/robot".into(), issuer: "CN=sros2CA".into() };
        assert_eq!(trusted.check(&sign("impostor"), now), Err(expected));
        // A certificate that an enclave signed, and one that signed itself.
        sign("ca");
        let of_enclave =
            folder.signed("enclave", "second", &Subject { name: "/CN=deep", ..Subject::default() });
        let of_enclave = Certificate::from_pem(&of_enclave).unwrap();
        assert!(matches!(trusted.check(&of_enclave, now), Err(Distrust::OtherAuthority { .. })));
        let own = Certificate::from_pem(&folder.self_signed("own", &Subject::default())).unwrap();
        assert!(matches!(trusted.check(&own, now), Err(Distrust::OtherAuthority { .. })));
    }

    #[test]
    fn the_authority_itself_is_not_an_enclave() {
        let Some(folder) = Folder::new() else { return };
        let ca = authority(&folder, "ca");
        let trusted = Authority::new(ca.clone(), None).unwrap();
        let expected = Distrust::AuthorityItself { subject: "CN=sros2CA".into() };
        assert_eq!(trusted.check(&ca, now()), Err(expected));
    }

    #[test]
    fn key_usage_is_respected() {
        let Some(folder) = Folder::new() else { return };
        let now = now();
        let usage = |extensions| Subject { extensions, ..Subject::default() };
        let trusted = Authority::new(authority(&folder, "ca"), None).unwrap();
        let signs = enclave(&folder, &usage(&["keyUsage=critical,digitalSignature"]));
        assert_eq!(trusted.check(&signs, now), Ok(()));
        let encrypts = enclave(&folder, &usage(&["keyUsage=critical,keyEncipherment"]));
        assert_eq!(trusted.check(&encrypts, now), Err(Distrust::Usage { subject: "CN=/robot".into() }));
        let extensions = &["basicConstraints=critical,CA:TRUE", "keyUsage=critical,digitalSignature"];
        let no_authority = folder.self_signed("weak", &Subject { extensions, ..Subject::AUTHORITY });
        let refused = Authority::new(Certificate::from_pem(&no_authority).unwrap(), None).unwrap_err();
        assert_eq!(refused, Distrust::NotAuthority { subject: "CN=sros2CA".into() });
    }

    #[test]
    fn a_revoked_certificate_is_refused_while_others_are_trusted() {
        let Some(folder) = Folder::new() else { return };
        let (ca, now) = (authority(&folder, "ca"), now());
        let other = enclave(&folder, &Subject { serial: "2", ..Subject::default() });
        let lost = enclave(&folder, &Subject { serial: "0x8000000001", ..Subject::default() });
        let crl = crl(&folder, "ca", &["enclave.pem"]);
        let trusted = Authority::new(ca, Some(crl)).unwrap();
        assert_eq!(trusted.check(&other, now), Ok(()));
        assert_eq!(trusted.check(&lost, now), Err(Distrust::Revoked { subject: "CN=/robot".into() }));
        // A list that may lack the latest names is not used.
        let late = trusted.check(&other, now + 31 * DAY).unwrap_err();
        assert!(matches!(&late, Distrust::CrlExpired { trusted, .. } if trusted == "CN=sros2CA"), "{late}");
    }

    #[test]
    fn a_revocation_list_by_another_authority_is_refused() {
        let Some(folder) = Folder::new() else { return };
        let ca = authority(&folder, "ca");
        authority(&folder, "impostor");
        let refused = Authority::new(ca.clone(), Some(crl(&folder, "impostor", &[]))).unwrap_err();
        assert_eq!(refused, Distrust::CrlOfOther { trusted: "CN=sros2CA".into() });
        assert!(Authority::new(ca, Some(crl(&folder, "ca", &[]))).is_ok());
    }

    #[test]
    fn files_that_are_no_revocation_list_are_refused() {
        let Some(folder) = Folder::new() else { return };
        authority(&folder, "ca");
        let refused = Crl::from_pem(&folder.read("ca.pem")).unwrap_err();
        assert_eq!(refused, PkiError::NoBlock { expected: "X509 CRL" });
        let relabelled = String::from_utf8(folder.read("ca.pem")).unwrap().replace("CERTIFICATE", "X509 CRL");
        assert!(matches!(Crl::from_pem(relabelled.as_bytes()), Err(PkiError::Crl(_))));
    }
}
