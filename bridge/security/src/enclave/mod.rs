//! The files of an enclave: who a node is, whom it trusts, and what it may do.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use zeroize::Zeroizing;

use crate::access::smime::{self, SmimeError};
use crate::access::{Action, Decision, DomainRule, Governance, Grant, Permissions};
use crate::document::DocumentError;
use crate::pki::{Authority, Certificate, Crl, Date, Distrust, PkiError, PrivateKey, check_validity};

const MAX_BYTES: u64 = 1 << 20;
/// A certificate or grant that ends sooner is worth a warning.
const SOON: Duration = Duration::from_secs(30 * 24 * 3600);

/// What the folder of an enclave holds, read and checked against each other.
#[derive(Debug)]
pub struct Enclave {
    /// The authority that signs the certificates of all participants, and what it revoked.
    pub authority: Authority,
    /// The certificate of this enclave.
    pub certificate: Certificate,
    /// Its key.
    pub key: PrivateKey,
    /// The certificate of the authority that signs governance and permissions.
    pub permissions_ca: Certificate,
    /// How each domain is protected.
    pub governance: Governance,
    /// What this enclave may do, perhaps among others.
    pub permissions: Permissions,
    /// The signed permissions as the file has them, which are sent to others.
    pub permissions_document: Vec<u8>,
    /// What should be mended, but prevents nothing.
    pub warnings: Vec<String>,
    folder: PathBuf,
}

/// Why an enclave cannot be used.
#[allow(missing_docs)] // the texts say it
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EnclaveError {
    #[error("there is no enclave in {}, which is no folder; `downbeat security create-enclave` or `ros2 security create_enclave` makes one", path.display())]
    NoFolder { path: PathBuf },
    #[error("{} is missing; an enclave has the files {}", path.display(), FILES.join(", "))]
    Missing { path: PathBuf },
    #[error(
        "{} is a link to {}, which does not exist; copy the whole keystore, or the files behind the links (`cp -L`)",
        path.display(), target.display()
    )]
    BrokenLink { path: PathBuf, target: PathBuf },
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("{} is no regular file of at most {MAX_BYTES} bytes", path.display())]
    NotAFile { path: PathBuf },
    #[error(
        "{} is in DER form; convert it to PEM, with `openssl x509 -inform der` or `openssl pkcs8 -inform der \
         -topk8 -nocrypt`",
        path.display()
    )]
    Der { path: PathBuf },
    #[error("{}: {source}", path.display())]
    Pki { path: PathBuf, source: PkiError },
    #[error("{}: {source}", path.display())]
    Distrust { path: PathBuf, source: Distrust },
    #[error("{} is not the key of {}; they must be made together", path.display(), certificate.display())]
    OtherKey { path: PathBuf, certificate: PathBuf },
    #[error("{}: {source}", path.display())]
    Signed { path: PathBuf, source: SmimeError },
    #[error("the signed text of {} is not UTF-8", path.display())]
    NotText { path: PathBuf },
    #[error("{}, in the signed text: {source}", path.display())]
    Document { path: PathBuf, source: DocumentError },
    #[error(
        "{} has no grant for \"{subject}\", the subject of the certificate, but for {found}; sign permissions \
         for it",
        path.display()
    )]
    NoGrant { path: PathBuf, subject: String, found: String },
    #[error(
        "the grant for \"{subject}\" in {} is valid from {from} to {to}, not now; sign new permissions or set \
         the clock",
        path.display()
    )]
    GrantNotValid { path: PathBuf, subject: String, from: Date, to: Date },
    #[error(
        "{} has no rule for domain {domain_id}; set ROS_DOMAIN_ID to a domain that it names, or sign a new one",
        path.display()
    )]
    NoRule { path: PathBuf, domain_id: u32 },
}

/// The files that every enclave has.
pub const FILES: [&str; 6] = [
    "identity_ca.cert.pem",
    "cert.pem",
    "key.pem",
    "permissions_ca.cert.pem",
    "governance.p7s",
    "permissions.p7s",
];

impl Enclave {
    /// Reads the files of an enclave: those of [`FILES`], and `crl.pem` if it is there. Links are followed.
    ///
    /// # Errors
    /// If a file is missing, malformed or of another kind, or if the files do not belong together: an
    /// authority did not sign what it should have, the key is another one, or something is not valid at
    /// `now`.
    pub fn load(folder: &Path, now: SystemTime) -> Result<Self, EnclaveError> {
        if !folder.is_dir() {
            return Err(EnclaveError::NoFolder { path: folder.to_owned() });
        }
        let path = |name: &str| folder.join(name);
        let identity_ca = read_pki(&path("identity_ca.cert.pem"), Certificate::from_pem)?;
        let certificate = read_pki(&path("cert.pem"), Certificate::from_pem)?;
        let key = read_pki(&path("key.pem"), PrivateKey::from_pem)?;
        let permissions_ca = read_pki(&path("permissions_ca.cert.pem"), Certificate::from_pem)?;
        let crl_path = path("crl.pem");
        // A link that leads nowhere is no permission to go without the list.
        let is_absent =
            crl_path.symlink_metadata().is_err_and(|error| error.kind() == io::ErrorKind::NotFound);
        let crl = if is_absent { None } else { Some(read_pki(&crl_path, Crl::from_pem)?) };

        let of = |name: &str| {
            let path = path(name);
            |source| EnclaveError::Distrust { path, source }
        };
        let authority = Authority::new(identity_ca, None).map_err(of("identity_ca.cert.pem"))?;
        let authority = match crl {
            Some(_) => Authority::new(authority.certificate().clone(), crl).map_err(of("crl.pem"))?,
            None => authority,
        };
        authority.check(&certificate, now).map_err(of("cert.pem"))?;
        if !key.matches(&certificate) {
            return Err(EnclaveError::OtherKey { path: path("key.pem"), certificate: path("cert.pem") });
        }
        check_validity(&permissions_ca, now).map_err(of("permissions_ca.cert.pem"))?;

        let (_, governance) = read_signed(&path("governance.p7s"), &permissions_ca, Governance::parse)?;
        let (permissions_document, permissions) =
            read_signed(&path("permissions.p7s"), &permissions_ca, Permissions::parse)?;
        let mut enclave = Self {
            authority,
            certificate,
            key,
            permissions_ca,
            governance,
            permissions,
            permissions_document,
            warnings: Vec::new(),
            folder: folder.to_owned(),
        };
        let grant = enclave.grant(now)?.validity;
        enclave.warnings = enclave.find_warnings(grant, now);
        Ok(enclave)
    }

    /// The grant for the certificate of this enclave.
    ///
    /// # Errors
    /// If there is none that is valid at `now`.
    pub fn grant(&self, now: SystemTime) -> Result<&Grant, EnclaveError> {
        let subject = self.certificate.subject();
        if let Some(grant) = self.permissions.valid_grant(subject, now) {
            return Ok(grant);
        }
        let path = self.folder.join("permissions.p7s");
        let subject = subject.to_owned();
        Err(match self.permissions.grant(&subject) {
            Some(grant) => {
                let (from, to) = grant.validity;
                EnclaveError::GrantNotValid { path, subject, from: Date(from), to: Date(to) }
            }
            None => {
                let found: Vec<String> =
                    self.permissions.subjects().map(|subject| format!("{subject:?}")).collect();
                EnclaveError::NoGrant { path, subject, found: found.join(", ") }
            }
        })
    }

    /// How a domain is protected.
    ///
    /// # Errors
    /// If the governance has no rule for it.
    pub fn for_domain(&self, domain_id: u32) -> Result<&DomainRule, EnclaveError> {
        let missing = || EnclaveError::NoRule { path: self.folder.join("governance.p7s"), domain_id };
        self.governance.domain(domain_id).ok_or_else(missing)
    }

    /// Whether this enclave may have an endpoint of a topic, by its name in DDS, in a domain.
    ///
    /// # Errors
    /// If no grant is valid at `now`, or the governance has no rule for the domain.
    pub fn decide(
        &self,
        action: Action,
        domain_id: u32,
        topic: &str,
        now: SystemTime,
    ) -> Result<Decision, EnclaveError> {
        let grant = self.grant(now)?;
        Ok(match self.for_domain(domain_id)?.topic(topic) {
            Some(rule) => rule.decide(grant, action, domain_id, topic, &[]),
            None => {
                Decision { is_allowed: false, rule: "the governance has no rule for this topic".to_owned() }
            }
        })
    }

    fn find_warnings(&self, grant: (SystemTime, SystemTime), now: SystemTime) -> Vec<String> {
        let list = self.authority.crl_ends().map(|end| ("crl.pem", end));
        let ends = [
            ("identity_ca.cert.pem", self.authority.certificate().validity().1),
            ("cert.pem", self.certificate.validity().1),
            ("permissions_ca.cert.pem", self.permissions_ca.validity().1),
            ("permissions.p7s", grant.1),
        ];
        let soon = ends
            .into_iter()
            .chain(list)
            .filter(|(_, end)| end.duration_since(now).is_ok_and(|left| left < SOON));
        let expiring = soon.map(|(name, end)| {
            format!("{} expires on {}; renew it in time", self.folder.join(name).display(), Date(end))
        });
        open_key(&self.folder.join("key.pem")).into_iter().chain(expiring).collect()
    }
}

/// A warning if other users can read a key.
#[cfg(unix)]
fn open_key(path: &Path) -> Option<String> {
    use std::os::unix::fs::PermissionsExt;
    let mode = path.metadata().ok()?.permissions().mode() & 0o777;
    let name = path.display();
    (mode & 0o077 != 0).then(|| format!("{name} is open to other users (mode {mode:o}); `chmod 600 {name}`"))
}

#[cfg(not(unix))]
fn open_key(_: &Path) -> Option<String> {
    None
}

fn read_pki<T>(path: &Path, parse: impl FnOnce(&[u8]) -> Result<T, PkiError>) -> Result<T, EnclaveError> {
    const SEQUENCE: u8 = 0x30;
    let bytes = read(path)?;
    parse(&bytes).map_err(|error| match error {
        PkiError::NoBlock { .. } if bytes.first() == Some(&SEQUENCE) => {
            EnclaveError::Der { path: path.to_owned() }
        }
        source => EnclaveError::Pki { path: path.to_owned(), source },
    })
}

/// A signed document, and its parsed content.
pub(crate) fn read_signed<T>(
    path: &Path,
    ca: &Certificate,
    parse: impl FnOnce(&str) -> Result<T, DocumentError>,
) -> Result<(Vec<u8>, T), EnclaveError> {
    let document = read(path)?.to_vec();
    let content = smime::verify(&document, ca)
        .map_err(|source| EnclaveError::Signed { path: path.to_owned(), source })?;
    let text = String::from_utf8(content).map_err(|_| EnclaveError::NotText { path: path.to_owned() })?;
    let parsed = parse(&text).map_err(|source| EnclaveError::Document { path: path.to_owned(), source })?;
    Ok((document, parsed))
}

/// The content of a file, which may be a key.
fn read(path: &Path) -> Result<Zeroizing<Vec<u8>>, EnclaveError> {
    let failed = |source: io::Error| match (source.kind(), path.read_link()) {
        (io::ErrorKind::NotFound, Ok(target)) => EnclaveError::BrokenLink { path: path.to_owned(), target },
        (io::ErrorKind::NotFound, Err(_)) => EnclaveError::Missing { path: path.to_owned() },
        _ => EnclaveError::Read { path: path.to_owned(), source },
    };
    // Opening a pipe could block forever.
    let metadata = path.metadata().map_err(failed)?;
    if !metadata.is_file() || metadata.len() > MAX_BYTES {
        return Err(EnclaveError::NotAFile { path: path.to_owned() });
    }
    // With its capacity from the start, no copy of a key is left behind by growing.
    let mut bytes = Zeroizing::new(Vec::with_capacity(usize::try_from(metadata.len() + 1).unwrap_or(0)));
    let file = File::open(path).map_err(failed)?;
    file.take(MAX_BYTES).read_to_end(&mut bytes).map_err(failed)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests;
