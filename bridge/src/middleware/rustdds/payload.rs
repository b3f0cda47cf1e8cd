//! Serialized payloads as rustdds takes and gives them: the encapsulation identifier apart from the body.

use crate::middleware::WriteError;
use bytes::{Bytes, BytesMut};
use rustdds::RepresentationIdentifier;
use rustdds::no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter};
use std::convert::Infallible;

/// Identifier (2 bytes) and options (2 bytes) before the body.
const HEADER_LENGTH: usize = 4;
/// The header of little-endian CDR without options, which rustdds is configured to send.
const CDR_LE_HEADER: [u8; HEADER_LENGTH] = [0x00, 0x01, 0x00, 0x00];

/// Every encapsulation a ROS 2 peer may send: CDR and its extensible versions 1 and 2.
const ENCAPSULATIONS: [RepresentationIdentifier; 12] = [
    RepresentationIdentifier::CDR_BE,
    RepresentationIdentifier::CDR_LE,
    RepresentationIdentifier::PL_CDR_BE,
    RepresentationIdentifier::PL_CDR_LE,
    RepresentationIdentifier::CDR2_BE,
    RepresentationIdentifier::CDR2_LE,
    RepresentationIdentifier::XCDR2_BE,
    RepresentationIdentifier::XCDR2_LE,
    RepresentationIdentifier::D_CDR_BE,
    RepresentationIdentifier::D_CDR_LE,
    RepresentationIdentifier::D_CDR2_BE,
    RepresentationIdentifier::D_CDR2_LE,
];

/// The body of a little-endian payload on its way out. Costs a reference count.
pub(super) struct OutgoingBody(Bytes);

impl OutgoingBody {
    /// Splits the header off.
    pub(super) fn from_cdr(mut cdr: Bytes) -> Result<Self, WriteError> {
        if !cdr.starts_with(&CDR_LE_HEADER) {
            return Err(WriteError::Encapsulation { found: cdr[..cdr.len().min(HEADER_LENGTH)].to_vec() });
        }
        Ok(Self(cdr.split_off(HEADER_LENGTH)))
    }
}

/// Gives rustdds the body of an [`OutgoingBody`].
pub(super) struct SendLittleEndian;

impl SerializerAdapter<OutgoingBody> for SendLittleEndian {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(body: &OutgoingBody) -> Result<Bytes, Self::Error> {
        Ok(body.0.clone())
    }
}

/// A received payload, header and body put together again. Costs one copy.
pub(super) struct ReceivedCdr(pub(super) Bytes);

/// Takes received payloads of any encapsulation from rustdds.
pub(super) struct ReceiveAny;

impl DeserializerAdapter<ReceivedCdr> for ReceiveAny {
    type Error = Infallible;
    type Decoded = ReceivedCdr;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &ENCAPSULATIONS
    }

    fn transform_decoded(decoded: Self::Decoded) -> ReceivedCdr {
        decoded
    }
}

impl DefaultDecoder<ReceivedCdr> for ReceiveAny {
    type Decoder = PutTogether;
    const DECODER: PutTogether = PutTogether;
}

/// Writes the header back in front of the body.
#[derive(Clone)]
pub(super) struct PutTogether;

impl Decode<'_, ReceivedCdr> for PutTogether {
    type Error = Infallible;

    fn decode_bytes(
        self,
        body: &[u8],
        encoding: RepresentationIdentifier,
    ) -> Result<ReceivedCdr, Infallible> {
        let mut cdr = BytesMut::with_capacity(HEADER_LENGTH + body.len());
        cdr.extend_from_slice(&encoding.to_bytes());
        // The receiver ignores the options (RTPS 2.5, section 10), and rustdds does not show them.
        cdr.extend_from_slice(&[0, 0]);
        cdr.extend_from_slice(body);
        Ok(ReceivedCdr(cdr.freeze()))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_little_endian_payload_leaves_without_its_header() {
        let body = OutgoingBody::from_cdr(Bytes::from_static(&[0, 1, 0, 0, 7, 8])).unwrap();
        assert_eq!(SendLittleEndian::to_bytes(&body).unwrap(), Bytes::from_static(&[7, 8]));
    }

    #[test]
    fn a_payload_of_another_encapsulation_is_refused() {
        for wrong in [&[0, 0, 0, 0, 7][..], &[0, 1], &[]] {
            let error = OutgoingBody::from_cdr(Bytes::from_static(wrong)).err().unwrap();
            assert_eq!(error, WriteError::Encapsulation { found: wrong[..wrong.len().min(4)].to_vec() });
        }
    }

    #[test]
    fn a_received_payload_gets_the_header_it_came_with() {
        let received = |encoding| PutTogether.decode_bytes(&[7, 8], encoding).unwrap().0;
        assert_eq!(received(RepresentationIdentifier::CDR_BE)[..], [0, 0, 0, 0, 7, 8]);
        assert_eq!(received(RepresentationIdentifier::CDR_LE)[..], [0, 1, 0, 0, 7, 8]);
        assert_eq!(received(RepresentationIdentifier::CDR2_LE)[..], [0, 0x11, 0, 0, 7, 8]);
    }
}
