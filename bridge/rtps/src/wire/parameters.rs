//! Parameter lists, in front of samples and in discovery data (section 9.4.2.11).

use super::bytes::{Cursor, Encoder};
use super::{ByteOrder, Malformed};

/// Ids of parameters (sections 9.6.3 and 9.6.4). Those from 0x8000 on depend on the vendor.
pub(super) mod pid {
    pub(in crate::wire) const PAD: u16 = 0x0000;
    pub(in crate::wire) const SENTINEL: u16 = 0x0001;
    pub(in crate::wire) const PARTICIPANT_LEASE_DURATION: u16 = 0x0002;
    pub(in crate::wire) const TOPIC_NAME: u16 = 0x0005;
    pub(in crate::wire) const TYPE_NAME: u16 = 0x0007;
    pub(in crate::wire) const DOMAIN_ID: u16 = 0x000f;
    pub(in crate::wire) const PROTOCOL_VERSION: u16 = 0x0015;
    pub(in crate::wire) const VENDOR_ID: u16 = 0x0016;
    pub(in crate::wire) const RELIABILITY: u16 = 0x001a;
    pub(in crate::wire) const LIVELINESS: u16 = 0x001b;
    pub(in crate::wire) const DURABILITY: u16 = 0x001d;
    pub(in crate::wire) const OWNERSHIP: u16 = 0x001f;
    pub(in crate::wire) const PRESENTATION: u16 = 0x0021;
    pub(in crate::wire) const DEADLINE: u16 = 0x0023;
    pub(in crate::wire) const DESTINATION_ORDER: u16 = 0x0025;
    pub(in crate::wire) const LATENCY_BUDGET: u16 = 0x0027;
    pub(in crate::wire) const PARTITION: u16 = 0x0029;
    pub(in crate::wire) const LIFESPAN: u16 = 0x002b;
    pub(in crate::wire) const USER_DATA: u16 = 0x002c;
    pub(in crate::wire) const UNICAST_LOCATOR: u16 = 0x002f;
    pub(in crate::wire) const MULTICAST_LOCATOR: u16 = 0x0030;
    pub(in crate::wire) const DEFAULT_UNICAST_LOCATOR: u16 = 0x0031;
    pub(in crate::wire) const METATRAFFIC_UNICAST_LOCATOR: u16 = 0x0032;
    pub(in crate::wire) const METATRAFFIC_MULTICAST_LOCATOR: u16 = 0x0033;
    pub(in crate::wire) const HISTORY: u16 = 0x0040;
    pub(in crate::wire) const EXPECTS_INLINE_QOS: u16 = 0x0043;
    pub(in crate::wire) const DEFAULT_MULTICAST_LOCATOR: u16 = 0x0048;
    pub(in crate::wire) const PARTICIPANT_GUID: u16 = 0x0050;
    pub(in crate::wire) const BUILTIN_ENDPOINT_SET: u16 = 0x0058;
    pub(in crate::wire) const ENDPOINT_GUID: u16 = 0x005a;
    pub(in crate::wire) const ENTITY_NAME: u16 = 0x0062;
    pub(in crate::wire) const KEY_HASH: u16 = 0x0070;
    pub(in crate::wire) const STATUS_INFO: u16 = 0x0071;
    pub(in crate::wire) const DATA_REPRESENTATION: u16 = 0x0073;
    pub(in crate::wire) const RELATED_SAMPLE_IDENTITY: u16 = 0x0083;
    /// From here on: DDS Security 1.1, section 7.4.1.3.
    pub(in crate::wire) const IDENTITY_TOKEN: u16 = 0x1001;
    pub(in crate::wire) const PERMISSIONS_TOKEN: u16 = 0x1002;
    pub(in crate::wire) const ENDPOINT_SECURITY_INFO: u16 = 0x1004;
    pub(in crate::wire) const PARTICIPANT_SECURITY_INFO: u16 = 0x1005;
    pub(in crate::wire) const DOMAIN_TAG: u16 = 0x4014;
    /// Used by Fast DDS and RTI Connext before the standard assigned 0x0083.
    pub(in crate::wire) const LEGACY_RELATED_SAMPLE_IDENTITY: u16 = 0x800f;
    /// Specific to this engine: bytes of the receive buffer for user data.
    pub(in crate::wire) const OUR_RECEIVE_BUFFER: u16 = 0x8044;
}

/// A checked list: it has an end, and all values lie within it.
#[derive(Clone, Copy, Debug)]
pub(super) struct ParameterList<'a> {
    /// Without the sentinel.
    bytes: &'a [u8],
    order: ByteOrder,
}

impl<'a> ParameterList<'a> {
    /// Reads a list including its sentinel.
    pub(super) fn read(cursor: &mut Cursor<'a>) -> Result<Self, Malformed> {
        let mut ahead = *cursor;
        let length = loop {
            let before = ahead.position();
            let (id, length) = (ahead.u16()?, ahead.u16()?);
            if id == pid::SENTINEL {
                break before - cursor.position();
            }
            if length % 4 != 0 {
                return Err(Malformed::ParameterList);
            }
            ahead.take(length.into())?;
        };
        let bytes = cursor.take(length)?;
        *cursor = ahead;
        Ok(Self { bytes, order: cursor.order() })
    }

    /// Reads a payload that is a parameter list.
    pub(super) fn from_payload(payload: &'a [u8]) -> Result<Self, Malformed> {
        let order = match payload {
            [0x00, 0x02, ..] => ByteOrder::Big,
            [0x00, 0x03, ..] => ByteOrder::Little,
            _ => return Err(Malformed::Encapsulation),
        };
        let mut cursor = Cursor::new(payload, order);
        cursor.u32()?;
        Self::read(&mut cursor)
    }

    pub(super) fn iter(self) -> impl Iterator<Item = Parameter<'a>> {
        let mut cursor = Cursor::new(self.bytes, self.order);
        let parameters = std::iter::from_fn(move || {
            let id = cursor.u16().ok()?;
            let length = cursor.u16().ok()?;
            Some(Parameter { id, value: Cursor::new(cursor.take(length.into()).ok()?, self.order) })
        });
        parameters.filter(|parameter| parameter.id != pid::PAD)
    }
}

/// One entry of a list.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parameter<'a> {
    pub(super) id: u16,
    value: Cursor<'a>,
}

impl<'a> Parameter<'a> {
    /// Reads the value with `read`, which returns `None` if it is invalid.
    pub(super) fn get<T>(mut self, read: impl FnOnce(&mut Cursor<'a>) -> Option<T>) -> Result<T, Malformed> {
        read(&mut self.value).ok_or(Malformed::Parameter(self.id))
    }

    /// The order of the bytes of its numbers.
    pub(super) fn order(&self) -> ByteOrder {
        self.value.order()
    }

    /// The whole value, uninterpreted.
    pub(super) fn bytes(self) -> &'a [u8] {
        self.value.rest()
    }

    /// Skips an unknown parameter.
    ///
    /// # Errors
    /// Returns an error if its sender requires that it is understood. In the vendor-specific range the
    /// requirement only applies to products of the vendor.
    pub(super) fn skip(self) -> Result<(), Malformed> {
        const MUST_UNDERSTAND: u16 = 0x4000;
        const OF_VENDOR: u16 = 0x8000;
        match self.id & (MUST_UNDERSTAND | OF_VENDOR) {
            MUST_UNDERSTAND => Err(Malformed::MustUnderstand(self.id)),
            _ => Ok(()),
        }
    }
}

/// Appends an encapsulated parameter list, whose parameters `write` appends.
pub(super) fn write_payload(out: &mut Vec<u8>, order: ByteOrder, write: impl FnOnce(&mut Encoder<'_>)) {
    out.extend(match order {
        ByteOrder::Big => [0x00, 0x02, 0x00, 0x00],
        ByteOrder::Little => [0x00, 0x03, 0x00, 0x00],
    });
    let mut out = Encoder::new(out, order);
    write(&mut out);
    write_end(&mut out);
}

/// Appends one parameter, whose value `write` appends.
///
/// # Panics
/// Panics if the value is longer than 64 kB.
pub(super) fn write_parameter(out: &mut Encoder<'_>, id: u16, write: impl FnOnce(&mut Encoder<'_>)) {
    out.u16(id);
    out.u16(0);
    let start = out.len();
    write(out);
    out.align(start);
    out.set_u16(start - 2, u16::try_from(out.len() - start).expect("a parameter below 64 kB"));
}

/// Appends the sentinel, which ends a list.
pub(super) fn write_end(out: &mut Encoder<'_>) {
    out.u16(pid::SENTINEL);
    out.u16(0);
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    fn ids(payload: &[u8]) -> Result<Vec<u16>, Malformed> {
        Ok(ParameterList::from_payload(payload)?.iter().map(|parameter| parameter.id).collect())
    }

    #[test]
    fn both_byte_orders_are_read() {
        for order in [ByteOrder::Big, ByteOrder::Little] {
            let mut payload = Vec::new();
            write_payload(&mut payload, order, |out| {
                write_parameter(out, pid::DOMAIN_ID, |out| out.u32(7));
                write_parameter(out, pid::PROTOCOL_VERSION, |out| out.bytes(&[2, 3]));
            });
            let list = ParameterList::from_payload(&payload).unwrap();
            assert_eq!(ids(&payload), Ok(vec![pid::DOMAIN_ID, pid::PROTOCOL_VERSION]));
            assert_eq!(list.iter().next().unwrap().get(|value| value.u32().ok()), Ok(7));
            assert_eq!(payload.len() % 4, 0);
        }
    }

    #[test]
    fn padding_is_skipped_and_the_rest_after_the_end_is_not_read() {
        let payload = [0, 2, 0, 0, 0, 0, 0, 4, 9, 9, 9, 9, 0, 0x0f, 0, 0, 0, 1, 0xff, 0xff, 1, 2, 3];
        assert_eq!(ids(&payload), Ok(vec![0x0f]));
    }

    #[test]
    fn a_list_without_end_is_malformed() {
        assert_eq!(ids(&[0, 2, 0, 0]), Err(Malformed::Truncated));
        assert_eq!(ids(&[0, 2, 0, 0, 0, 0x0f, 0, 4, 0, 0, 0, 7]), Err(Malformed::Truncated));
        assert_eq!(ids(&[0, 2, 0, 0, 0, 1]), Err(Malformed::Truncated));
    }

    #[test]
    fn a_parameter_that_reaches_beyond_the_list_is_malformed() {
        assert_eq!(ids(&[0, 2, 0, 0, 0, 0x0f, 0xff, 0xfc, 0, 1, 0, 0]), Err(Malformed::Truncated));
    }

    #[test]
    fn a_length_that_is_not_a_multiple_of_four_is_malformed() {
        assert_eq!(ids(&[0, 2, 0, 0, 0, 0x0f, 0, 3, 0, 0, 0, 0, 1, 0, 0]), Err(Malformed::ParameterList));
    }

    #[test]
    fn only_parameter_lists_are_read_as_such() {
        for payload in [&[][..], &[0], &[0, 1, 0, 0, 0, 1, 0, 0], &[1, 2, 0, 0, 0, 1, 0, 0]] {
            assert_eq!(ids(payload), Err(Malformed::Encapsulation));
        }
    }

    #[test]
    fn a_parameter_that_must_be_understood_is_not_skipped() {
        let skip = |id| Parameter { id, value: Cursor::new(&[], ByteOrder::Big) }.skip();
        assert_eq!(skip(0x3fff), Ok(()));
        assert_eq!(skip(0x4001), Err(Malformed::MustUnderstand(0x4001)));
        assert_eq!(skip(0xc001), Ok(()));
    }
}
