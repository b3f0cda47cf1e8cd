//! The two ways in which requests and replies name each other.

use crate::middleware::{Gid, Sample, SampleIdentity};
use bytes::{BufMut, Bytes, BytesMut};

/// The encapsulation header of a payload.
const ENCAPSULATION: usize = 4;
/// The header of `rmw_cyclonedds`: an identity of the client and the number of the request, 8 bytes each
/// (`cdds_request_header_t` in `rmw_cyclonedds_cpp/src/serdata.hpp`, branch jazzy).
const HEADER: usize = 16;

/// The vendor id of Eclipse Cyclone DDS.
const CYCLONE: [u8; 2] = [0x01, 0x10];

/// How a peer names requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mapping {
    /// Beside the payload, as related sample identity: `rmw_fastrtps`, rustdds, and this program in memory.
    RelatedIdentity,
    /// In the first bytes of the payload: `rmw_cyclonedds`.
    PayloadHeader,
}

impl Mapping {
    /// That of peers of a vendor.
    pub(super) fn of(vendor: [u8; 2]) -> Self {
        if vendor == CYCLONE { Self::PayloadHeader } else { Self::RelatedIdentity }
    }
}

/// The header of a payload of `rmw_cyclonedds`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PayloadHeader {
    pub(super) client: u64,
    pub(super) number: i64,
}

impl PayloadHeader {
    /// The header by which a client of this program knows its own request.
    pub(super) fn of(client: Gid, number: i64) -> Self {
        let whole = u128::from_be_bytes(client.0);
        Self { client: (whole >> 64) as u64 ^ whole as u64, number }
    }

    /// Takes the header off a payload of either byte order; nothing if the payload is too short to have one.
    pub(super) fn take_off(cdr: &Bytes) -> Option<(Self, Bytes)> {
        let (encapsulation, rest) = cdr.split_at_checked(ENCAPSULATION)?;
        let (client, rest) = rest.split_first_chunk()?;
        let (number, body) = rest.split_first_chunk()?;
        // The second byte is even for big-endian in every version of CDR (RTPS 2.5, table 10.3).
        let header = if encapsulation[1] & 1 == 0 {
            Self { client: u64::from_be_bytes(*client), number: i64::from_be_bytes(*number) }
        } else {
            Self { client: u64::from_le_bytes(*client), number: i64::from_le_bytes(*number) }
        };
        let mut without = BytesMut::with_capacity(ENCAPSULATION + body.len());
        without.put_slice(encapsulation);
        without.put_slice(body);
        Some((header, without.freeze()))
    }

    /// Puts the header in front of the body of a little-endian payload. It is 16 bytes long, so that the
    /// alignment of what follows stays as it was.
    pub(super) fn put_on(self, cdr: &Bytes) -> Bytes {
        let (encapsulation, body) = cdr.split_at(cdr.len().min(ENCAPSULATION));
        let mut with = BytesMut::with_capacity(cdr.len() + HEADER);
        with.put_slice(encapsulation);
        with.put_u64_le(self.client);
        with.put_i64_le(self.number);
        with.put_slice(body);
        with.freeze()
    }
}

/// The destination and the label of the reply to a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ReturnAddress {
    /// The writer of the request.
    pub(super) client: Gid,
    /// The number of the request there.
    pub(super) number: i64,
    /// The reader that waits, where the request names it.
    pub(super) reader: Option<Gid>,
    pub(super) label: Label,
}

/// How a reply names its request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Label {
    Related(SampleIdentity),
    Header(PayloadHeader),
}

/// The address of a request of a client of a vendor, and its payload without what belongs to the mapping;
/// `None` if the sample is no request.
pub(super) fn request(sample: Sample, vendor: [u8; 2]) -> Option<(ReturnAddress, Bytes)> {
    let Sample { writer, sequence_number, related, cdr, .. } = sample;
    let address = |reader, label| ReturnAddress { client: writer, number: sequence_number, reader, label };
    if Mapping::of(vendor) == Mapping::PayloadHeader {
        let (header, cdr) = PayloadHeader::take_off(&cdr)?;
        return Some((address(None, Label::Header(header)), cdr));
    }
    let own = SampleIdentity { endpoint: writer, number: sequence_number };
    let (identity, reader) = match related.filter(|related| related.endpoint != Gid::default()) {
        None => (own, None),
        // Without a number the related identity names the reader of the client, as rmw_fastrtps does.
        Some(SampleIdentity { endpoint, number: SampleIdentity::UNKNOWN_NUMBER }) => {
            (SampleIdentity { endpoint, ..own }, (endpoint != writer).then_some(endpoint))
        }
        Some(identity) => (identity, None),
    };
    Some((address(reader, Label::Related(identity)), cdr))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const READER: Gid = Gid([1, 15, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 4]);

    fn sample(vendor: [u8; 2], related: Option<SampleIdentity>, cdr: &'static [u8]) -> Sample {
        let mut writer = Gid([0; 16]);
        writer.0[..2].copy_from_slice(&vendor);
        writer.0[15] = 3;
        Sample { cdr: cdr.into(), source_time_ns: None, writer, sequence_number: 7, related }
    }

    #[test]
    fn a_request_of_fast_dds_names_the_reader_that_waits() {
        let related = SampleIdentity { endpoint: READER, number: SampleIdentity::UNKNOWN_NUMBER };
        let (address, cdr) = request(sample([1, 15], Some(related), &[0, 1, 0, 0, 9]), [1, 15]).unwrap();
        assert_eq!(address.reader, Some(READER));
        assert_eq!(address.label, Label::Related(SampleIdentity { endpoint: READER, number: 7 }));
        assert_eq!(cdr[..], [0, 1, 0, 0, 9]);
    }

    #[test]
    fn a_request_that_names_nothing_is_known_by_its_own_identity() {
        let sample = sample([1, 18], None, &[0, 1, 0, 0, 9]);
        let writer = sample.writer;
        let (address, _) = request(sample, [1, 18]).unwrap();
        assert_eq!(address.reader, None);
        assert_eq!(address.label, Label::Related(SampleIdentity { endpoint: writer, number: 7 }));
    }

    #[test]
    fn a_request_of_cyclone_has_a_header_in_either_byte_order() {
        let expected = PayloadHeader { client: 0x0102, number: 5 };
        let little = b"\0\x01\0\0\x02\x01\0\0\0\0\0\0\x05\0\0\0\0\0\0\0body";
        let big = b"\0\0\0\0\0\0\0\0\0\0\x01\x02\0\0\0\0\0\0\0\x05body";
        for (encoded, encapsulation) in [(&little[..], b"\0\x01\0\0"), (&big[..], b"\0\0\0\0")] {
            let (address, cdr) = request(sample(CYCLONE, None, encoded), CYCLONE).unwrap();
            assert_eq!(address.label, Label::Header(expected));
            assert_eq!(cdr[..], [&encapsulation[..], b"body"].concat());
        }
        assert_eq!(expected.put_on(&Bytes::from_static(b"\0\x01\0\0body"))[..], little[..]);
    }

    #[test]
    fn a_request_of_cyclone_that_is_too_short_for_its_header_is_none() {
        for length in 0..20 {
            let cdr = &b"\0\x01\0\0................"[..length];
            assert_eq!(request(sample(CYCLONE, None, cdr), CYCLONE), None);
        }
    }
}
