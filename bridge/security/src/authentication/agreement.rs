//! Key agreement by elliptic curve Diffie-Hellman over P-256.

use p256::ecdh::diffie_hellman;
use p256::elliptic_curve::sec1::ToSec1Point;
use p256::{PublicKey, SecretKey};
use sha2::{Digest, Sha256};
use zeroize::Zeroizing;

/// A public key on the wire: an uncompressed point.
pub(super) type Point = [u8; 65];

/// A key pair for a single handshake.
pub(super) struct EphemeralKey(SecretKey);

impl EphemeralKey {
    /// # Panics
    /// Panics if `random` never gives a valid key, which holds for nearly all numbers.
    pub(super) fn generate(random: &mut dyn FnMut(&mut [u8])) -> Self {
        let mut bytes = Zeroizing::new([0; 32]);
        let valid = (0..100).find_map(|_| {
            random(&mut *bytes);
            SecretKey::from_slice(&*bytes).ok()
        });
        Self(valid.expect("random numbers"))
    }

    pub(super) fn public(&self) -> Point {
        let point = self.0.public_key().to_sec1_point(false);
        point.as_bytes().try_into().expect("an uncompressed point of P-256 has 65 bytes")
    }

    /// Returns the hash of the common key, or `None` if `other` is not a point of the curve.
    pub(super) fn agree(&self, other: &Point) -> Option<[u8; 32]> {
        let other = PublicKey::from_sec1_bytes(other).ok()?;
        let common = diffie_hellman(self.0.to_nonzero_scalar(), other.as_affine());
        Some(Sha256::digest(common.raw_secret_bytes()).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_sides_agree_and_other_points_are_refused() {
        let mut random = fuzzing::Random::new(1);
        let mut fill = |bytes: &mut [u8]| bytes.fill_with(|| random.bits() as u8);
        let (a, b) = (EphemeralKey::generate(&mut fill), EphemeralKey::generate(&mut fill));
        assert!(a.agree(&b.public()).is_some());
        assert_eq!(a.agree(&b.public()), b.agree(&a.public()));
        let mut not_on_curve = b.public();
        not_on_curve[64] ^= 1;
        assert_eq!(a.agree(&not_on_curve), None);
        assert_eq!(a.agree(&[0; 65]), None);
        let mut infinity = [0; 65];
        infinity[0] = 4;
        assert_eq!(a.agree(&infinity), None);
    }
}
