//! GUIDs that are bound to the subject of a certificate (section 9.3.3).

use downbeat_rtps::wire::{EntityId, Guid, GuidPrefix};
use sha2::{Digest, Sha256};

use crate::pki::Certificate;

const PARTICIPANT_GUID: u16 = 0x0050;
const SENTINEL: u16 = 0x0001;

/// Derives the prefix that a participant with this certificate must have: a one bit, 47 bits from the subject
/// and 48 from the `candidate`.
pub fn derive_prefix(certificate: &Certificate, candidate: GuidPrefix) -> GuidPrefix {
    let [a, b, c, d, e, f] = subject_bits(certificate);
    let [g, h, i, j, k, l, ..] = sha256(&Guid::new(candidate, EntityId::PARTICIPANT).to_bytes());
    GuidPrefix([a, b, c, d, e, f, g, h, i, j, k, l])
}

/// Returns whether a participant with this certificate may have this prefix.
pub(super) fn is_derived(prefix: GuidPrefix, certificate: &Certificate) -> bool {
    prefix.0.starts_with(&subject_bits(certificate))
}

/// The first six bytes of the prefix.
fn subject_bits(certificate: &Certificate) -> [u8; 6] {
    let [a, b, c, d, e, f, ..] = sha256(certificate.subject_der());
    let bits = u64::from_be_bytes([a, b, c, d, e, f, 0, 0]);
    let [a, b, c, d, e, f, ..] = (1 << 63 | bits >> 1).to_be_bytes();
    [a, b, c, d, e, f]
}

fn sha256(bytes: &[u8]) -> [u8; 32] {
    Sha256::digest(bytes).into()
}

/// Finds the participant's GUID prefix in a big-endian parameter list without encapsulation. The rest of the
/// list is not looked at: Cyclone DDS writes wrong lengths after it, and no entity id.
pub(super) fn prefix_in(participant_data: &[u8]) -> Option<GuidPrefix> {
    let mut rest = participant_data;
    loop {
        let (&[a, b, c, d], after) = rest.split_first_chunk()?;
        let (id, length) = (u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d]));
        match id {
            PARTICIPANT_GUID if length == 16 => return after.first_chunk().copied().map(GuidPrefix),
            PARTICIPANT_GUID | SENTINEL => return None,
            _ => rest = after.get(usize::from(length).next_multiple_of(4)..)?,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_prefix_is_found_among_other_parameters() {
        let guid = [9; 12];
        let data = [&[0, 0x15, 0, 4, 2, 3, 0, 0, 0, 0x50, 0, 16][..], &guid, &[0; 4], &[0, 1, 0, 0]].concat();
        assert_eq!(prefix_in(&data), Some(GuidPrefix(guid)));
        for length in 0..12 + 12 {
            assert_eq!(prefix_in(&data[..length]), None);
        }
        assert_eq!(prefix_in(&[0, 1, 0, 0, 0, 0x50, 0, 16]), None);
        assert_eq!(prefix_in(&[0, 0x50, 0, 12, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]), None);
        assert_eq!(prefix_in(&[0, 0x15, 0xff, 0xff, 0, 0]), None);
    }
}
