//! Private keys of enclaves.

use std::fmt;

use der::Decode;
use p256::SecretKey;
use p256::ecdsa::signature::Signer;
use p256::ecdsa::{DerSignature, SigningKey};
use p256::pkcs8::{EncodePrivateKey, EncodePublicKey, LineEnding, PrivateKeyInfoRef};
use zeroize::Zeroizing;

use super::certificate::check_key_algorithm;
use super::{Certificate, PkiError, pem};

/// A P-256 key that signs. It is wiped from memory when dropped, and not shown by `Debug`.
#[derive(Clone)]
pub struct PrivateKey(SigningKey);

impl PrivateKey {
    /// Reads a key as PKCS#8 (`PRIVATE KEY`) or SEC1 (`EC PRIVATE KEY`), without a password.
    ///
    /// # Errors
    /// Returns an error if the file holds no key, a damaged one, one with a password or one of another kind
    /// than P-256.
    pub fn from_pem(pem: &[u8]) -> Result<Self, PkiError> {
        const LABELS: [&str; 4] =
            ["PRIVATE KEY", "EC PRIVATE KEY", "ENCRYPTED PRIVATE KEY", "RSA PRIVATE KEY"];
        let block = pem::find(pem, &LABELS)?;
        let secret = match block.label {
            "PRIVATE KEY" => {
                let der = block.der()?;
                let info = PrivateKeyInfoRef::from_der(&der).map_err(|_| PkiError::Key)?;
                let curve = info.algorithm.parameters.and_then(|any| any.decode_as().ok());
                check_key_algorithm(info.algorithm.oid, curve)?;
                SecretKey::try_from(info).map_err(|_| PkiError::Key)?
            }
            // With `Proc-Type: 4,ENCRYPTED`, the base64 text has headers and is refused as damaged.
            "EC PRIVATE KEY" => SecretKey::from_sec1_der(&block.der()?).map_err(|_| PkiError::Key)?,
            "ENCRYPTED PRIVATE KEY" => return Err(PkiError::EncryptedKey),
            _ => return Err(PkiError::NotP256 { found: "RSA".into() }),
        };
        Ok(Self(SigningKey::from(secret)))
    }

    /// Makes a key of random numbers, which `random` must fill as a cryptographic generator does.
    pub fn generate(random: &mut dyn FnMut(&mut [u8])) -> Self {
        let mut bytes = Zeroizing::new([0; 32]);
        loop {
            random(bytes.as_mut_slice());
            // Almost all numbers of this length are keys.
            if let Ok(secret) = SecretKey::from_slice(bytes.as_slice()) {
                return Self(SigningKey::from(secret));
            }
        }
    }

    /// Writes the key as PKCS#8, without a password.
    pub fn to_pem(&self) -> Zeroizing<String> {
        self.0.to_pkcs8_pem(LineEnding::LF).expect("a key of this size is encoded")
    }

    /// The public key as certificates hold it.
    pub(crate) fn public_der(&self) -> Vec<u8> {
        self.0.verifying_key().to_public_key_der().expect("a key of this size is encoded").into_vec()
    }

    /// Signs with ECDSA and SHA-256 (deterministic, RFC 6979) and returns the ASN.1 sequence of the two
    /// numbers.
    pub fn sign(&self, message: &[u8]) -> Vec<u8> {
        let signature: DerSignature = self.0.sign(message);
        signature.as_bytes().to_vec()
    }

    /// Returns whether `certificate` is about this key.
    pub fn matches(&self, certificate: &Certificate) -> bool {
        self.0.verifying_key() == certificate.key()
    }
}

impl fmt::Debug for PrivateKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("PrivateKey(..)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pki::openssl::{Folder, Subject};

    fn pkcs8_key(folder: &Folder) -> PrivateKey {
        folder.self_signed("own", &Subject::default());
        PrivateKey::from_pem(&folder.read("own.key")).unwrap()
    }

    #[test]
    fn openssl_verifies_a_signature_and_ours_verifies_its() {
        let Some(folder) = Folder::new() else { return };
        let key = pkcs8_key(&folder);
        let certificate = Certificate::from_pem(&folder.read("own.pem")).unwrap();
        assert!(key.matches(&certificate));
        folder.write("message", b"robot");
        folder.write("signature", &key.sign(b"robot"));
        folder.run(&["x509", "-in", "own.pem", "-noout", "-pubkey", "-out", "own.pub"]);
        folder.run(&["dgst", "-sha256", "-verify", "own.pub", "-signature", "signature", "message"]);
        folder.run(&["dgst", "-sha256", "-sign", "own.key", "-out", "theirs", "message"]);
        let mut theirs = folder.read("theirs");
        assert!(certificate.verify(b"robot", &theirs));
        assert!(!certificate.verify(b"robots", &theirs));
        theirs[10] ^= 1;
        assert!(!certificate.verify(b"robot", &theirs));
        assert!(!certificate.verify(b"robot", b""));
    }

    #[test]
    fn a_key_that_is_made_here_is_written_as_openssl_writes_it() {
        let Some(folder) = Folder::new() else { return };
        let mut random = fuzzing::Random::new(1);
        let key = PrivateKey::generate(&mut |bytes| bytes.fill_with(|| random.bits() as u8));
        folder.write("own.key", key.to_pem().as_bytes());
        let written = folder.run(&["pkcs8", "-topk8", "-nocrypt", "-in", "own.key"]);
        assert_eq!(String::from_utf8(written).unwrap(), *key.to_pem());
        assert_eq!(PrivateKey::from_pem(key.to_pem().as_bytes()).unwrap().sign(b"a"), key.sign(b"a"));
        let public = folder.run(&["pkey", "-in", "own.key", "-pubout", "-outform", "der"]);
        assert_eq!(public, key.public_der());
    }

    #[test]
    fn numbers_that_are_no_key_are_drawn_again() {
        let mut draws = [[0xff; 32], [0; 32], [7; 32]].into_iter();
        PrivateKey::generate(&mut |bytes| bytes.copy_from_slice(&draws.next().unwrap()));
        assert_eq!(draws.next(), None);
    }

    #[test]
    fn keys_as_sec1_with_curve_parameters_in_front_are_read() {
        let Some(folder) = Folder::new() else { return };
        folder.run(&["ecparam", "-name", "prime256v1", "-genkey", "-out", "sec1.key"]);
        let sec1 = PrivateKey::from_pem(&folder.read("sec1.key")).unwrap();
        folder.run(&["pkcs8", "-topk8", "-nocrypt", "-in", "sec1.key", "-out", "pkcs8.key"]);
        let pkcs8 = PrivateKey::from_pem(&folder.read("pkcs8.key")).unwrap();
        assert_eq!(sec1.sign(b"a"), pkcs8.sign(b"a"));
    }

    #[test]
    fn keys_of_other_kinds_and_keys_with_a_password_are_refused_by_name() {
        let Some(folder) = Folder::new() else { return };
        folder.run(&["genpkey", "-algorithm", "RSA", "-pkeyopt", "rsa_keygen_bits:1024", "-out", "rsa.key"]);
        folder.run(&["rsa", "-traditional", "-in", "rsa.key", "-out", "pkcs1.key"]);
        folder.run(&["genpkey", "-algorithm", "ED25519", "-out", "ed25519.key"]);
        folder.run(&["ecparam", "-name", "secp384r1", "-genkey", "-noout", "-out", "p384.key"]);
        folder.run(&["pkcs8", "-topk8", "-nocrypt", "-in", "p384.key", "-out", "p384_pkcs8.key"]);
        pkcs8_key(&folder);
        let protect = ["pkcs8", "-topk8", "-in", "own.key", "-passout", "pass:secret", "-out"];
        folder.run(&[&protect[..], &["protected.key"]].concat());
        let not_p256 = |found: &str| PkiError::NotP256 { found: found.into() };
        let expected = [
            ("rsa.key", not_p256("RSA")),
            ("pkcs1.key", not_p256("RSA")),
            ("ed25519.key", not_p256("1.3.101.112")),
            ("p384.key", PkiError::Key),
            ("p384_pkcs8.key", not_p256("elliptic curve 1.3.132.0.34")),
            ("protected.key", PkiError::EncryptedKey),
            ("own.pem", PkiError::NoBlock { expected: "PRIVATE KEY" }),
        ];
        for (file, error) in expected {
            assert_eq!(PrivateKey::from_pem(&folder.read(file)).unwrap_err(), error, "{file}");
        }
    }

    #[test]
    fn a_key_that_is_cut_or_doubled_is_refused() {
        let Some(folder) = Folder::new() else { return };
        pkcs8_key(&folder);
        let key = folder.read("own.key");
        for length in 0..key.len() - 2 {
            assert!(PrivateKey::from_pem(&key[..length]).is_err(), "{length}");
        }
        let second = PkiError::SecondBlock { label: "PRIVATE KEY", line: 6 };
        assert_eq!(PrivateKey::from_pem(&key.repeat(2)).unwrap_err(), second);
    }

    #[test]
    fn debug_output_shows_no_key() {
        let Some(folder) = Folder::new() else { return };
        assert_eq!(format!("{:?}", pkcs8_key(&folder)), "PrivateKey(..)");
    }
}
