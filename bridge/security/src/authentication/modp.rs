//! Key agreement in the multiplicative group of RFC 5114, section 2.3 (`DH+MODP-2048-256`), which Fast DDS
//! offers unless its configuration says otherwise.

use p256::elliptic_curve::bigint::modular::{FixedMontyForm, FixedMontyParams};
use p256::elliptic_curve::bigint::{Odd, U256, U2048};
use zeroize::Zeroizing;

/// The prime.
const P: &str = "87a8e61db4b6663cffbbd19c651959998ceef608660dd0f25d2ceed4435e3b00e00df8f1d61957d4faf7df4561b2aa30\
     16c3d91134096faa3bf4296d830e9a7c209e0c6497517abd5a8a9d306bcf67ed91f9e6725b4758c022e0b1ef4275bf7b\
     6c5bfc11d45f9088b941f54eb1e59bb8bc39a0bf12307f5c4fdb70c581b23f76b63acae1caa6b7902d52526735488a0e\
     f13c6d9a51bfa4ab3ad8347796524d8ef6a167b5a41825d967e144e5140564251ccacb83e6b486f6b3ca3f7971506026\
     c0b857f689962856ded4010abd0be621c3a3960a54e710c375f26375d7014103a4b54330c198af126116d2276e11715f\
     693877fad7ef09cadb094ae91e1a1597";

/// The generator, of order [`Q`].
const G: &str = "3fb32c9b73134d0b2e77506660edbd484ca7b18f21ef205407f4793a1a0ba12510dbc15077be463fff4fed4aac0bb555\
     be3a6c1b0c6b47b1bc3773bf7e8c6f62901228f8c28cbb18a55ae31341000a650196f931c77a57f2ddf463e5e9ec144b\
     777de62aaab8a8628ac376d282d6ed3864e67982428ebc831d14348f6f2f9193b5045af2767164e1dfc967c1fb3f2e55\
     a4bd1bffe83b9c80d052b985d182ea0adb2a3b7313d3fe14c8484b1e052588b9b7d2bbd2df016199ecd06e1557cd0915\
     b3353bbb64e0ec377fd028370df92b52c7891428cdc67eb6184b523d1db246c32f63078490f00ef8d647d148d4795451\
     5e2327cfef98c582664b4c0f6cc41659";

const Q: &str = "8cf83642a709a097b447997640129da299b1a47d1eb3750ba308b0fe64f5fbd3";

const LEN: usize = 256;

type Residue = FixedMontyForm<{ U2048::LIMBS }>;

/// A private key: an exponent below the order of the generator.
pub(super) struct Exponent(Zeroizing<U256>);

impl Exponent {
    /// # Panics
    /// Panics if `random` never gives a valid key, which holds for about half of all numbers.
    pub(super) fn generate(random: &mut dyn FnMut(&mut [u8])) -> Self {
        let order = U256::from_be_hex(Q);
        let mut bytes = Zeroizing::new([0; 32]);
        let valid = (0..1000).find_map(|_| {
            random(&mut *bytes);
            let exponent = U256::from_be_slice(&*bytes);
            (exponent > U256::ONE && exponent < order).then_some(exponent)
        });
        Self(Zeroizing::new(valid.expect("random numbers")))
    }

    pub(super) fn public(&self) -> Vec<u8> {
        residue(&U2048::from_be_hex(G)).pow(&self.0).retrieve().to_be_bytes().as_ref().to_vec()
    }

    /// Returns the common number, without leading zeros as OpenSSL has it, or `None` if `other` is not in the
    /// group that the generator spans.
    pub(super) fn agree(&self, other: &[u8]) -> Option<Zeroizing<Vec<u8>>> {
        // Fast DDS leaves out leading zeros.
        let padding = LEN.checked_sub(other.len())?;
        let mut padded = [0; LEN];
        padded.get_mut(padding..)?.copy_from_slice(other);
        let other = U2048::from_be_slice(&padded);
        if other <= U2048::ONE || other >= U2048::from_be_hex(P) {
            return None;
        }
        let other = residue(&other);
        if other.pow_vartime(&U256::from_be_hex(Q)).retrieve() != U2048::ONE {
            return None;
        }
        let common = Zeroizing::new(other.pow(&self.0).retrieve());
        let common = Zeroizing::new(common.to_be_bytes().as_ref().to_vec());
        let zeros = common.iter().take_while(|byte| **byte == 0).count();
        Some(Zeroizing::new(common.get(zeros..)?.to_vec()))
    }
}

fn residue(number: &U2048) -> Residue {
    let modulus = Odd::<U2048>::from_be_hex(P);
    Residue::new(number, &FixedMontyParams::new_vartime(modulus))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fill(seed: u64) -> impl FnMut(&mut [u8]) {
        let mut random = fuzzing::Random::new(seed);
        move |bytes| bytes.fill_with(|| random.bits() as u8)
    }

    #[test]
    fn both_sides_agree() {
        let (a, b) = (Exponent::generate(&mut fill(1)), Exponent::generate(&mut fill(2)));
        let common = a.agree(&b.public()).unwrap();
        assert_eq!(common.len(), LEN);
        assert_eq!(a.agree(&b.public()), b.agree(&a.public()));
    }

    #[test]
    fn numbers_outside_the_group_are_refused() {
        let key = Exponent::generate(&mut fill(1));
        let prime = U2048::from_be_hex(P);
        let minus_one = prime.wrapping_sub(&U2048::ONE);
        for other in [U2048::ZERO, U2048::ONE, U2048::from(2u8), minus_one, prime, U2048::MAX] {
            assert_eq!(key.agree(other.to_be_bytes().as_ref()), None);
        }
        assert_eq!(key.agree(&[]), None);
        assert_eq!(key.agree(&[1; LEN + 1]), None);
    }
}
