//! Assertions of the liveliness of writers (sections 8.4.13 and 9.6.3.1).

use super::bytes::{ByteOrder, Cursor, Encoder};
use super::{GuidPrefix, Malformed};

/// The content of a sample of the writer liveliness protocol (WLP).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ParticipantMessage {
    pub prefix: GuidPrefix,
    /// Which of its writers are alive: [`Self::AUTOMATIC`] or [`Self::MANUAL`]. Other values have other
    /// purposes.
    pub kind: u32,
}

impl ParticipantMessage {
    /// Those with [`Liveliness::Automatic`](crate::qos::Liveliness::Automatic).
    pub const AUTOMATIC: u32 = 1;
    /// Those with [`Liveliness::ManualByParticipant`](crate::qos::Liveliness::ManualByParticipant).
    pub const MANUAL: u32 = 2;

    /// Reads the payload of a WLP sample. Data appended by vendors is not read.
    pub fn parse(payload: &[u8]) -> Result<Self, Malformed> {
        let [0x00, 0x00 | 0x01, _, _, content @ ..] = payload else { return Err(Malformed::Encapsulation) };
        let mut cursor = Cursor::new(content, ByteOrder::Big);
        // The kind is four octets, whatever the byte order.
        Ok(Self { prefix: GuidPrefix(cursor.array()?), kind: cursor.u32()? })
    }

    /// Appends the payload of a WLP sample.
    pub fn emit(&self, out: &mut Vec<u8>) {
        out.extend([0x00, 0x01, 0x00, 0x00]);
        out.extend(self.prefix.0);
        out.extend(self.kind.to_be_bytes());
        Encoder::new(out, ByteOrder::Little).u32(0); // octets of the vendor
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MESSAGE: ParticipantMessage =
        ParticipantMessage { prefix: GuidPrefix([7; 12]), kind: ParticipantMessage::MANUAL };

    #[test]
    fn the_message_round_trips() {
        let mut payload = Vec::new();
        MESSAGE.emit(&mut payload);
        assert_eq!(payload.len(), 24);
        assert_eq!(ParticipantMessage::parse(&payload), Ok(MESSAGE));
        payload[1] = 0; // big-endian
        assert_eq!(ParticipantMessage::parse(&payload), Ok(MESSAGE));
    }

    #[test]
    fn truncated_or_invalid_cdr_is_malformed() {
        let mut payload = Vec::new();
        MESSAGE.emit(&mut payload);
        assert_eq!(ParticipantMessage::parse(&payload[..19]), Err(Malformed::Truncated));
        assert_eq!(ParticipantMessage::parse(&payload[..3]), Err(Malformed::Encapsulation));
        payload[1] = 3;
        assert_eq!(ParticipantMessage::parse(&payload), Err(Malformed::Encapsulation));
    }
}
