//! Pieces of DER that certificates and signatures share.

use std::time::SystemTime;

use der::asn1::{AnyRef, GeneralizedTime, UtcTime};
use der::oid::ObjectIdentifier;
use der::{Decode, Encode, Reader, SliceReader};

pub(crate) const INTEGER: u8 = 0x02;
pub(crate) const OCTET_STRING: u8 = 0x04;
pub(crate) const SEQUENCE: u8 = 0x30;
pub(crate) const SET: u8 = 0x31;
/// The first tag of a context, for a constructed element.
pub(crate) const CONTEXT_0: u8 = 0xa0;

pub(crate) const SHA256: ObjectIdentifier = ObjectIdentifier::new_unwrap("2.16.840.1.101.3.4.2.1");
pub(crate) const ECDSA_WITH_SHA256: ObjectIdentifier = ObjectIdentifier::new_unwrap("1.2.840.10045.4.3.2");

/// More elements than any sequence has that is read here.
const MAX_ELEMENTS: usize = 64;

/// An element of a sequence or set.
#[derive(Clone, Copy)]
pub(crate) struct Element<'a> {
    /// With its tag and length.
    pub der: &'a [u8],
    pub value: &'a [u8],
}

impl<'a> Element<'a> {
    pub fn tag(self) -> Option<u8> {
        self.der.first().copied()
    }

    /// The elements of a sequence or set with this tag.
    pub fn elements(self, tag: u8) -> Option<Vec<Self>> {
        if self.tag() != Some(tag) {
            return None;
        }
        elements(self.value)
    }

    /// The value of an element with this tag.
    pub fn with_tag(self, tag: u8) -> Option<&'a [u8]> {
        (self.tag() == Some(tag)).then_some(self.value)
    }

    pub fn oid(self) -> Option<ObjectIdentifier> {
        ObjectIdentifier::from_der(self.der).ok()
    }

    /// The identifier at the head of an algorithm.
    pub fn algorithm(self) -> Option<ObjectIdentifier> {
        self.elements(SEQUENCE)?.first()?.oid()
    }
}

/// The elements that fill `bytes`; `None` if they are no DER, or too many.
pub(crate) fn elements(bytes: &[u8]) -> Option<Vec<Element<'_>>> {
    let mut reader = SliceReader::new(bytes).ok()?;
    let mut elements = Vec::new();
    while !reader.is_finished() {
        if elements.len() == MAX_ELEMENTS {
            return None;
        }
        let der = reader.tlv_bytes().ok()?;
        elements.push(Element { der, value: AnyRef::from_der(der).ok()?.value() });
    }
    Some(elements)
}

/// An element whose value is the parts, one after the other.
pub(crate) fn element(tag: u8, parts: &[&[u8]]) -> Vec<u8> {
    let value = parts.concat();
    let length = value.len().to_be_bytes();
    let length = length.iter().copied().skip_while(|byte| *byte == 0).collect::<Vec<_>>();
    let mut der = vec![tag];
    match *length {
        [] => der.push(0),
        [short @ ..0x80] => der.push(short),
        _ => {
            der.push(0x80 | u8::try_from(length.len()).unwrap_or_default());
            der.extend(&length);
        }
    }
    der.extend(value);
    der
}

pub(crate) fn sequence(parts: &[&[u8]]) -> Vec<u8> {
    element(SEQUENCE, parts)
}

pub(crate) fn oid(oid: ObjectIdentifier) -> Vec<u8> {
    element(0x06, &[oid.as_bytes()])
}

/// A time as certificates and signatures have it: with two digits of the year up to 2049. Times that DER
/// cannot write become the nearest that it can.
pub(crate) fn time(time: SystemTime) -> Vec<u8> {
    let seconds = time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let short = UtcTime::from_unix_duration(seconds).and_then(|time| time.to_der());
    let long = || GeneralizedTime::from_unix_duration(seconds).and_then(|time| time.to_der());
    short.or_else(|_| long()).unwrap_or_else(|_| element(0x18, &[b"99991231235959Z"]))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn lengths_are_written_in_as_few_bytes_as_possible() {
        for length in [0, 1, 0x7f, 0x80, 0xff, 0x100, 0x1_0000] {
            let value = vec![1; length];
            let der = element(OCTET_STRING, &[&value]);
            assert_eq!(der::asn1::OctetString::from_der(&der).unwrap().as_bytes(), value, "{length}");
        }
    }

    #[test]
    fn elements_that_are_cut_off_or_too_many_are_refused() {
        let one = element(INTEGER, &[&[1]]);
        let der = sequence(&[&one, &one]);
        let sequence = elements(&der).unwrap();
        assert_eq!(sequence.first().unwrap().elements(SEQUENCE).unwrap().len(), 2);
        for length in 1..der.len() {
            assert!(elements(der.get(..length).unwrap()).is_none(), "{length}");
        }
        assert!(elements(&one.repeat(MAX_ELEMENTS)).is_some());
        assert!(elements(&one.repeat(MAX_ELEMENTS + 1)).is_none());
    }

    #[test]
    fn years_from_2050_are_written_in_full() {
        let at = |seconds| time(SystemTime::UNIX_EPOCH + Duration::from_secs(seconds));
        assert_eq!(at(2_524_607_999), element(0x17, &[b"491231235959Z"]));
        assert_eq!(at(2_524_608_000), element(0x18, &[b"20500101000000Z"]));
        assert_eq!(at(u64::from(u32::MAX) * 100), element(0x18, &[b"99991231235959Z"]));
    }
}
