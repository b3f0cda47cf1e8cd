//! What secured ends need.

use std::path::Path;

use downbeat_bridge::middleware::SecurityOptions;
use downbeat_security::cryptography::{KeyId, KeyMaterial, Opener, Sealer, TransformKind};

use super::End;
use crate::keystore::{self, ENCLAVES};

/// Processor time in seconds of the ciphers alone for samples that one end sends and the other receives: with
/// the governance of `ros2 security` each byte is encrypted twice and signed once, and the reverse.
pub fn cipher_time(size: usize, count: u64) -> anyhow::Result<f64> {
    /// As on one host.
    const FRAGMENT: usize = 32_768;
    let mut random = |bytes: &mut [u8]| bytes.fill(7);
    let mut pair = |kind, id| {
        let material = KeyMaterial::generate(kind, KeyId([0, 0, 0, id]), &mut random);
        (Sealer::new(material.clone(), &mut random), Opener::new(material))
    };
    let mut encrypting = [pair(TransformKind::Aes256Gcm, 1), pair(TransformKind::Aes256Gcm, 2)];
    let (mut signer, mut checker) = pair(TransformKind::Aes256Gmac, 3);
    let fragment = vec![0x5a; FRAGMENT.min(size)];
    let start = super::processor_time("self")?;
    for _ in 0..count * size.div_ceil(FRAGMENT) as u64 {
        for (sealer, opener) in &mut encrypting {
            std::hint::black_box(opener.payload(&sealer.payload(&fragment)?)?);
        }
        std::hint::black_box(checker.payload(&signer.payload(&fragment)?)?);
    }
    Ok(super::processor_time("self")? - start)
}

fn enclave(end: End) -> &'static str {
    match end {
        End::Echo | End::Count => ENCLAVES[0],
        End::Ping | End::Flood | End::Camera => ENCLAVES[1],
    }
}

/// How an end is protected.
pub fn options(keystore: &str, end: End) -> SecurityOptions {
    keystore::options(Path::new(keystore), enclave(end))
}

/// The configuration of an end of Cyclone DDS: that of one without security, protected.
pub fn cyclone(unprotected: &str, keystore: &Path, end: End) -> String {
    // Debian's package libddsc0debian.
    let plugin = |name: &str, functions: &str| {
        let path = format!("/usr/lib/x86_64-linux-gnu/libddsc0debian/libdds_security_{name}.so");
        format!(
            "<Library path=\"{path}\" initFunction=\"init_{functions}\" finalizeFunction=\"finalize_{functions}\"/>"
        )
    };
    let folder = keystore.join("enclaves").join(enclave(end).trim_start_matches('/'));
    let file =
        |element: &str, name: &str| format!("<{element}>file:{}</{element}>", folder.join(name).display());
    let security = [
        "<Security><Authentication>".to_owned(),
        plugin("auth", "authentication"),
        file("IdentityCA", "identity_ca.cert.pem"),
        file("IdentityCertificate", "cert.pem"),
        file("PrivateKey", "key.pem"),
        "</Authentication><AccessControl>".to_owned(),
        plugin("ac", "access_control"),
        file("PermissionsCA", "permissions_ca.cert.pem"),
        file("Governance", "governance.p7s"),
        file("Permissions", "permissions.p7s"),
        "</AccessControl><Cryptographic>".to_owned(),
        plugin("crypto", "crypto"),
        "</Cryptographic></Security></Domain>".to_owned(),
    ];
    unprotected.replace("</Domain>", &security.concat())
}
