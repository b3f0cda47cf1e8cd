//! Keystores of SROS2: a folder with an authority, and one folder for each enclave. They are the same, file
//! by file, as those of `ros2 security`.

mod files;
mod issue;
mod name;

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use crate::access::{Governance, smime};
use crate::document::DocumentError;
use crate::enclave::{EnclaveError, read_signed};
use crate::pki::{Certificate, PkiError, PrivateKey};
use crate::policy::Policy;
use issue::Issuer;

const AUTHORITY: &str = "sros2CA";
const GOVERNANCE: &str = include_str!("governance.xml");

/// A keystore, with the keys of its authorities.
#[derive(Debug)]
pub struct Keystore {
    path: PathBuf,
}

/// Why a keystore, or something in it, cannot be made or read.
#[allow(missing_docs)] // the texts say it
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeystoreError {
    #[error("{} is no keystore: it has no {missing}", path.display())]
    NotAKeystore { path: PathBuf, missing: &'static str },
    #[error("{} is a keystore already", path.display())]
    Exists { path: PathBuf },
    #[error(
        "\"{name}\" is no name of an enclave: {problem}; a name is, for example, /talker_listener/talker"
    )]
    Name { name: String, problem: &'static str },
    #[error("{} has no enclave {name}; create it first", path.display())]
    NoEnclave { path: PathBuf, name: String },
    #[error("the policy has no enclave {name}, but {found}")]
    NotInPolicy { name: String, found: String },
    #[error("cannot {attempt} {}: {source}", path.display())]
    File { attempt: &'static str, path: PathBuf, source: std::io::Error },
    #[error("{}: {source}", path.display())]
    Pki { path: PathBuf, source: PkiError },
    #[error("{}: {source}", path.display())]
    Governance { path: PathBuf, source: DocumentError },
    #[error(transparent)]
    Enclave(#[from] EnclaveError),
    #[error("{} is not the key of {}", key.display(), certificate.display())]
    OtherKey { key: PathBuf, certificate: PathBuf },
}

/// The files that make a folder a keystore.
const REQUIRED: [&str; 5] = [
    "public/permissions_ca.cert.pem",
    "public/identity_ca.cert.pem",
    "private/permissions_ca.key.pem",
    "private/identity_ca.key.pem",
    SIGNED_GOVERNANCE,
];
const SIGNED_GOVERNANCE: &str = "enclaves/governance.p7s";

impl Keystore {
    /// Makes a keystore with a new authority, and a governance that encrypts everything in a domain. If the
    /// folder holds certificates and keys of authorities or a `governance.xml` already, they are used.
    /// `random` must fill as a cryptographic generator does.
    ///
    /// # Errors
    /// If it is there already, or a file cannot be written. No key is overwritten.
    pub fn create(
        path: &Path,
        domain_id: u32,
        now: SystemTime,
        random: &mut dyn FnMut(&mut [u8]),
    ) -> Result<Self, KeystoreError> {
        let keystore = Self { path: path.to_owned() };
        if keystore.missing().is_none() {
            return Err(KeystoreError::Exists { path: path.to_owned() });
        }
        for folder in ["public", "private", "enclaves"] {
            files::make_folder(&path.join(folder))?;
        }
        if keystore.missing().is_some_and(|missing| missing != SIGNED_GOVERNANCE) {
            keystore.create_authority(now, random)?;
        }
        let text_path = path.join("enclaves/governance.xml");
        if !text_path.exists() {
            let text = GOVERNANCE.replace("<id>0</id>", &format!("<id>{domain_id}</id>"));
            files::write(&text_path, text.as_bytes())?;
        }
        let text = files::read_text(&text_path)?;
        let governance = String::from_utf8_lossy(&text);
        let governance = Governance::parse(&governance)
            .map_err(|source| KeystoreError::Governance { path: text_path.clone(), source })?;
        if governance.domain(domain_id).is_none() {
            return Err(EnclaveError::NoRule { path: text_path, domain_id }.into());
        }
        let (ca, ca_key) = keystore.authority("permissions_ca")?;
        let signed = smime::sign(&text, &ca, &ca_key, now);
        files::write(&path.join(SIGNED_GOVERNANCE), &signed)?;
        Ok(keystore)
    }

    /// Opens a keystore that is there.
    ///
    /// # Errors
    /// If one of its files is missing.
    pub fn open(path: &Path) -> Result<Self, KeystoreError> {
        let keystore = Self { path: path.to_owned() };
        match keystore.missing() {
            Some(missing) => Err(KeystoreError::NotAKeystore { path: path.to_owned(), missing }),
            None => Ok(keystore),
        }
    }

    /// Makes an enclave, which may do everything in a domain, and returns its folder. What is there already
    /// stays: an enclave keeps its key and its permissions.
    ///
    /// # Errors
    /// If the name is none of an enclave, the governance has no rule for the domain, or a file cannot be read
    /// or written.
    pub fn create_enclave(
        &self,
        name: &str,
        domain_id: u32,
        now: SystemTime,
        random: &mut dyn FnMut(&mut [u8]),
    ) -> Result<PathBuf, KeystoreError> {
        let folder = self.folder(name)?;
        self.check_domain(domain_id)?;
        files::make_folder(&folder)?;
        let depth = name.split('/').filter(|part| !part.is_empty()).count();
        let up = "../".repeat(depth);
        for certificate in ["identity_ca.cert.pem", "permissions_ca.cert.pem"] {
            files::link(&folder.join(certificate), Path::new(&format!("{up}../public/{certificate}")))?;
        }
        // The enclave `/` is the folder with the governance itself.
        if depth > 0 {
            files::link(&folder.join("governance.p7s"), Path::new(&format!("{up}governance.p7s")))?;
        }
        let (certificate_path, key_path) = (folder.join("cert.pem"), folder.join("key.pem"));
        if !(certificate_path.exists() && key_path.exists()) {
            let (ca, ca_key) = self.authority("identity_ca")?;
            let key = PrivateKey::generate(random);
            let certificate =
                issue::certificate(name, &key, &Issuer::Authority(&ca, &ca_key), now, random)
                    .map_err(|source| KeystoreError::Pki { path: certificate_path.clone(), source })?;
            files::write_key(&key_path, &key)?;
            files::write_new(&certificate_path, certificate.pem())?;
        }
        if !folder.join("permissions.p7s").exists() {
            self.create_permissions(name, &Policy::everything(name), domain_id, now)?;
        }
        Ok(folder)
    }

    /// Writes and signs the permissions that a policy gives to an enclave in a domain, for as long as its
    /// certificate is valid.
    ///
    /// # Errors
    /// If the keystore or the policy has no such enclave, the governance has no rule for the domain, or a
    /// file cannot be read or written.
    pub fn create_permissions(
        &self,
        name: &str,
        policy: &Policy,
        domain_id: u32,
        now: SystemTime,
    ) -> Result<(), KeystoreError> {
        let folder = self.folder(name)?;
        let certificate_path = folder.join("cert.pem");
        if !certificate_path.exists() {
            return Err(KeystoreError::NoEnclave { path: self.path.clone(), name: name.to_owned() });
        }
        let certificate = files::read_certificate(&certificate_path)?;
        let permissions = policy.permissions(name, domain_id, certificate.validity()).ok_or_else(|| {
            let found: Vec<&str> = policy.enclaves().collect();
            KeystoreError::NotInPolicy { name: name.to_owned(), found: found.join(", ") }
        })?;
        self.check_domain(domain_id)?;
        let (ca, ca_key) = self.authority("permissions_ca")?;
        let signed = smime::sign(permissions.as_bytes(), &ca, &ca_key, now);
        files::write(&folder.join("permissions.xml"), permissions.as_bytes())?;
        files::write(&folder.join("permissions.p7s"), &signed)
    }

    /// The names of all enclaves, in alphabetical order.
    ///
    /// # Errors
    /// If a folder cannot be read.
    pub fn enclaves(&self) -> Result<Vec<String>, KeystoreError> {
        let mut names = Vec::new();
        files::find_enclaves(&self.path.join("enclaves"), "", &mut names)?;
        names.sort();
        Ok(names)
    }

    /// The folder of an enclave, which may not be there yet.
    ///
    /// # Errors
    /// If the name is none of an enclave.
    pub fn folder(&self, name: &str) -> Result<PathBuf, KeystoreError> {
        Self::check_name(name)?;
        Ok(self.path.join("enclaves").join(name.trim_start_matches('/')))
    }

    /// Checks that a text can be the name of an enclave.
    ///
    /// # Errors
    /// If it cannot.
    pub fn check_name(name: &str) -> Result<(), KeystoreError> {
        let refused = |problem| KeystoreError::Name { name: name.to_owned(), problem };
        name::problem(name).map_or(Ok(()), |problem| Err(refused(problem)))
    }

    /// Checks that the governance has a rule for a domain.
    fn check_domain(&self, domain_id: u32) -> Result<(), KeystoreError> {
        let path = self.path.join(SIGNED_GOVERNANCE);
        let (ca, _) = self.authority("permissions_ca")?;
        let (_, governance) = read_signed(&path, &ca, Governance::parse)?;
        let missing = || EnclaveError::NoRule { path, domain_id };
        Ok(governance.domain(domain_id).map(drop).ok_or_else(missing)?)
    }

    /// Makes an authority for both purposes.
    fn create_authority(
        &self,
        now: SystemTime,
        random: &mut dyn FnMut(&mut [u8]),
    ) -> Result<(), KeystoreError> {
        let key = PrivateKey::generate(random);
        let path = self.path.join("public/ca.cert.pem");
        let certificate = issue::certificate(AUTHORITY, &key, &Issuer::Itself, now, random)
            .map_err(|source| KeystoreError::Pki { path: path.clone(), source })?;
        files::write_key(&self.path.join("private/ca.key.pem"), &key)?;
        files::write_new(&path, certificate.pem())?;
        for kind in ["identity_ca", "permissions_ca"] {
            files::link(&self.path.join(format!("public/{kind}.cert.pem")), Path::new("ca.cert.pem"))?;
            files::link(&self.path.join(format!("private/{kind}.key.pem")), Path::new("ca.key.pem"))?;
        }
        Ok(())
    }

    fn authority(&self, kind: &str) -> Result<(Certificate, PrivateKey), KeystoreError> {
        let certificate_path = self.path.join(format!("public/{kind}.cert.pem"));
        let key_path = self.path.join(format!("private/{kind}.key.pem"));
        let (certificate, key) = (files::read_certificate(&certificate_path)?, files::read_key(&key_path)?);
        if !key.matches(&certificate) {
            return Err(KeystoreError::OtherKey { key: key_path, certificate: certificate_path });
        }
        Ok((certificate, key))
    }

    fn missing(&self) -> Option<&'static str> {
        REQUIRED.into_iter().find(|name| !self.path.join(name).is_file())
    }
}

#[cfg(test)]
mod tests;
