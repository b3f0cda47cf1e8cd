//! Key agreement, by the methods that peers offer.

use p256::ecdh::diffie_hellman;
use p256::elliptic_curve::sec1::ToSec1Point;
use p256::{PublicKey, SecretKey};
use sha2::{Digest, Sha256};
use zeroize::Zeroizing;

use super::modp::Exponent;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Method {
    /// Over the curve P-256, which we offer.
    Ecdh,
    Modp,
}

impl Method {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Ecdh => "ECDH+prime256v1-CEUM",
            Self::Modp => "DH+MODP-2048-256",
        }
    }

    pub(super) fn from_name(name: &[u8]) -> Option<Self> {
        [Self::Ecdh, Self::Modp].into_iter().find(|method| method.name().as_bytes() == name)
    }
}

/// A key pair for a single handshake.
pub(super) enum EphemeralKey {
    Ecdh(SecretKey),
    Modp(Exponent),
}

impl EphemeralKey {
    /// # Panics
    /// Panics if `random` never gives a valid key.
    pub(super) fn generate(method: Method, random: &mut dyn FnMut(&mut [u8])) -> Self {
        if method == Method::Modp {
            return Self::Modp(Exponent::generate(random));
        }
        let mut bytes = Zeroizing::new([0; 32]);
        let valid = (0..100).find_map(|_| {
            random(&mut *bytes);
            SecretKey::from_slice(&*bytes).ok()
        });
        Self::Ecdh(valid.expect("random numbers"))
    }

    /// The public key on the wire: an uncompressed point or a number.
    pub(super) fn public(&self) -> Vec<u8> {
        match self {
            Self::Ecdh(key) => key.public_key().to_sec1_point(false).as_bytes().to_vec(),
            Self::Modp(exponent) => exponent.public(),
        }
    }

    /// Returns the hash of the common key, or `None` if `other` is not a valid public key.
    pub(super) fn agree(&self, other: &[u8]) -> Option<[u8; 32]> {
        let hash = match self {
            Self::Ecdh(key) => {
                let other = PublicKey::from_sec1_bytes(other).ok()?;
                let common = diffie_hellman(key.to_nonzero_scalar(), other.as_affine());
                Sha256::digest(common.raw_secret_bytes())
            }
            Self::Modp(exponent) => Sha256::digest(&*exponent.agree(other)?),
        };
        Some(hash.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_sides_agree_and_other_points_are_refused() {
        let mut random = fuzzing::Random::new(1);
        let mut fill = |bytes: &mut [u8]| bytes.fill_with(|| random.bits() as u8);
        let [a, b] = [(); 2].map(|()| EphemeralKey::generate(Method::Ecdh, &mut fill));
        assert!(a.agree(&b.public()).is_some());
        assert_eq!(a.agree(&b.public()), b.agree(&a.public()));
        let mut not_on_curve = b.public();
        not_on_curve[64] ^= 1;
        let infinity = [&[4][..], &[0; 64]].concat();
        for other in [&not_on_curve[..], &infinity, &[0], &[], &[0; 65], &b.public()[..64]] {
            assert_eq!(a.agree(other), None);
        }
    }
}
