//! Messages of a broker, as they are recorded.

use bytes::Bytes;

/// A message on its way from or to the broker.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packet {
    /// The topic on the broker.
    pub topic: String,
    /// The content.
    pub payload: Bytes,
    /// 0 (at most once), 1 (at least once) or 2 (exactly once).
    pub qos: u8,
    /// When sending: the broker keeps it for those who come later. When received: it was kept.
    pub is_retained: bool,
}

impl Packet {
    /// As in recordings: a byte with the quality of service in bits 1 and 2 and retention in bit 0, the
    /// length of the topic (two bytes, big endian), the topic, the payload.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let length = u16::try_from(self.topic.len()).unwrap_or(u16::MAX);
        let topic = self.topic.as_bytes().get(..usize::from(length)).unwrap_or_default();
        let head = [self.qos << 1 | u8::from(self.is_retained)];
        [&head[..], &length.to_be_bytes(), topic, &self.payload].concat()
    }

    /// Reads [`to_bytes`](Self::to_bytes); `None` if these bytes are no packet.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let ([head], rest) = bytes.split_first_chunk()?;
        let (length, rest) = rest.split_first_chunk()?;
        let (topic, payload) = rest.split_at_checked(usize::from(u16::from_be_bytes(*length)))?;
        Some(Self {
            topic: std::str::from_utf8(topic).ok()?.to_owned(),
            payload: Bytes::copy_from_slice(payload),
            qos: Some(head >> 1).filter(|qos| *qos <= 2)?,
            is_retained: head & 1 == 1,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packet(length: usize) -> Packet {
        Packet { topic: "é/b".to_owned(), payload: vec![7; length].into(), qos: 2, is_retained: true }
    }

    #[test]
    fn packets_in_recordings_are_read_back_and_others_refused() {
        let bytes = packet(3).to_bytes();
        assert_eq!(Packet::from_bytes(&bytes), Some(packet(3)));
        for end in 0..bytes.len() - 3 {
            assert_eq!(Packet::from_bytes(&bytes[..end]), None, "{end}");
        }
        assert_eq!(Packet::from_bytes(&[7, 0, 0]), None, "there is no quality of service 3");
    }
}
