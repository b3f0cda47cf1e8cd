//! A keystore for secured contestants, as `ros2 security` makes it.

use std::path::{Path, PathBuf};
use std::time::SystemTime;

use anyhow::Context;
use downbeat_bridge::middleware::SecurityOptions;
use downbeat_security::access::smime;
use downbeat_security::keystore::Keystore;
use downbeat_security::pki::{Certificate, PrivateKey};

/// The enclaves: of ends that answer or count, and of ends that send.
pub const ENCLAVES: [&str; 2] = ["/far", "/near"];

/// A keystore in a folder of its own, removed when dropped.
pub struct LocalKeystore(tempfile::TempDir);

impl LocalKeystore {
    /// With the governance of `ros2 security`: everything encrypted, and messages signed.
    pub fn create(domain: u16) -> anyhow::Result<Self> {
        let folder = tempfile::tempdir()?;
        let mut random = |bytes: &mut [u8]| getrandom::fill(bytes).expect("random numbers of the system");
        let now = SystemTime::now();
        let keystore = Keystore::create(folder.path(), domain.into(), now, &mut random)?;
        for enclave in ENCLAVES {
            let path = keystore.create_enclave(enclave, domain.into(), now, &mut random)?;
            allow_all_topics(folder.path(), &path)?;
        }
        Ok(Self(folder))
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }
}

/// Replaces the permissions of an enclave by some that allow topics and partitions outside ROS 2 too, those
/// of `ddsperf`.
fn allow_all_topics(keystore: &Path, enclave: &Path) -> anyhow::Result<()> {
    let read = |path: PathBuf| std::fs::read(&path).with_context(|| path.display().to_string());
    let permissions = String::from_utf8(read(enclave.join("permissions.xml"))?)?;
    let permissions = permissions.replace("<topic>rt/*</topic>", "<topic>*</topic>").replace(
        "</topics>",
        "</topics><partitions><partition></partition><partition>*</partition></partitions>",
    );
    let authority = Certificate::from_pem(&read(keystore.join("public/permissions_ca.cert.pem"))?)?;
    let key = PrivateKey::from_pem(&read(keystore.join("private/permissions_ca.key.pem"))?)?;
    let signed = smime::sign(permissions.as_bytes(), &authority, &key, SystemTime::now());
    Ok(std::fs::write(enclave.join("permissions.p7s"), signed)?)
}

/// How a participant with an enclave is protected.
pub fn options(keystore: &Path, enclave: &str) -> SecurityOptions {
    SecurityOptions {
        keystore: Some(keystore.to_owned()),
        enclave: enclave.to_owned(),
        enclave_override: None,
        is_enforced: true,
    }
}
