//! Values of parameters that several kinds of discovery data have in common. Readers return `None` for
//! invalid values.

use std::net::SocketAddrV4;

use super::Locator;
use super::bytes::{Cursor, Encoder};
use super::parameters::write_parameter;

/// Longest string and user data, in bytes. In ROS 2 these hold an enclave or a type hash.
pub(super) const MAX_TEXT: usize = 1024;

/// Locators kept of each list. Hosts with more interfaces are reached by the first ones.
pub(super) const MAX_LOCATORS: usize = 16;

/// Reads a string of at most `max_len` bytes.
pub(super) fn read_string(value: &mut Cursor<'_>, max_len: usize) -> Option<String> {
    let length = value.u32().ok()? as usize;
    let bytes = match value.take(length).ok()? {
        [] => &[], // not valid CDR, but harmless
        [text @ .., 0] => text,
        _ => return None,
    };
    if bytes.len() > max_len || bytes.contains(&0) {
        return None;
    }
    std::str::from_utf8(bytes).ok().map(str::to_owned)
}

pub(super) fn write_string(text: &str, out: &mut Encoder<'_>) {
    write_octets_with(text.len() + 1, out);
    out.bytes(text.as_bytes());
    out.bytes(&[0]);
}

/// Reads octets. If there are more than [`MAX_TEXT`], none are kept: they do not come from ROS 2, and nothing
/// depends on them.
pub(super) fn read_octets(value: &mut Cursor<'_>) -> Option<Vec<u8>> {
    let length = value.u32().ok()? as usize;
    let octets = value.take(length).ok()?;
    Some(if length > MAX_TEXT { Vec::new() } else { octets.to_vec() })
}

pub(super) fn write_octets(octets: &[u8], out: &mut Encoder<'_>) {
    write_octets_with(octets.len(), out);
    out.bytes(octets);
}

fn write_octets_with(length: usize, out: &mut Encoder<'_>) {
    out.u32(u32::try_from(length).expect("configuration below 4 GB"));
}

pub(super) fn read_bool(value: &mut Cursor<'_>) -> Option<bool> {
    value.array::<1>().ok().map(|[byte]| byte != 0)
}

/// Reads a locator and keeps it if it is usable and there is room.
pub(super) fn read_locator(value: &mut Cursor<'_>, kept: &mut Vec<SocketAddrV4>) -> Option<()> {
    let address = Locator::read(value).ok()?.udp_v4();
    kept.extend(address.filter(|_| kept.len() < MAX_LOCATORS));
    Some(())
}

pub(super) fn write_locators(out: &mut Encoder<'_>, id: u16, locators: &[SocketAddrV4]) {
    for locator in locators {
        write_parameter(out, id, |out| Locator::from(*locator).write(out));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::ByteOrder;

    fn string(bytes: &[u8]) -> Option<String> {
        read_string(&mut Cursor::new(bytes, ByteOrder::Big), 5)
    }

    #[test]
    fn a_string_ends_with_a_zero_that_its_length_counts() {
        assert_eq!(string(b"\0\0\0\x03ab\0"), Some("ab".to_owned()));
        assert_eq!(string(b"\0\0\0\x01\0"), Some(String::new()));
        assert_eq!(string(b"\0\0\0\0"), Some(String::new()));
        assert_eq!(string(b"\0\0\0\x06abcde\0"), Some("abcde".to_owned()));
    }

    #[test]
    fn other_strings_are_none() {
        for bytes in [
            &b""[..],
            b"\0\0\0",
            b"\0\0\0\x02ab",         // no zero
            b"\0\0\0\x03a\0\0",      // a zero in between
            b"\0\0\0\x07abcdef\0",   // too long
            b"\0\0\0\x04ab\0",       // cut off
            b"\xff\xff\xff\xffab\0", // far beyond the end
            b"\0\0\0\x03\xff\xfe\0", // no UTF-8
        ] {
            assert_eq!(string(bytes), None, "{bytes:?}");
        }
    }

    #[test]
    fn octets_lie_within_their_parameter_and_too_many_are_not_kept() {
        let octets = |bytes: &[u8]| read_octets(&mut Cursor::new(bytes, ByteOrder::Big));
        assert_eq!(octets(b"\0\0\0\x02ab"), Some(b"ab".to_vec()));
        assert_eq!(octets(b"\0\0\0\x03ab"), None);
        assert_eq!(octets(b"\xff\xff\xff\xffab"), None);
        let long = [&2000_u32.to_be_bytes()[..], &[1; 2000]].concat();
        assert_eq!(octets(&long), Some(Vec::new()));
    }
}
