//! What travels next to the payload of each sample, request and reply.

/// The length of an attachment. Peers abort on a shorter one, so that no other length is ever sent.
pub const ATTACHMENT_LENGTH: usize = 33;

/// The length of the identity, which precedes it as a LEB128 number of one byte.
const GID_LENGTH: u8 = 16;

/// The number, time and source of a sample; those of the request in a reply, with the time of the reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// From 1.
    pub sequence_number: i64,
    /// Nanoseconds since the Unix epoch.
    pub source_time_ns: i64,
    /// The endpoint: a publisher, or the client of a service.
    pub gid: [u8; 16],
}

impl Attachment {
    /// The bytes.
    #[must_use]
    pub fn to_bytes(self) -> [u8; ATTACHMENT_LENGTH] {
        let mut bytes = [0; ATTACHMENT_LENGTH];
        bytes[..8].copy_from_slice(&self.sequence_number.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.source_time_ns.to_le_bytes());
        bytes[16] = GID_LENGTH;
        bytes[17..].copy_from_slice(&self.gid);
        bytes
    }

    /// Reads an attachment; `None` if the bytes are not one. Bytes that follow it are ignored.
    #[must_use]
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        let (sequence_number, rest) = bytes.split_first_chunk()?;
        let (source_time_ns, rest) = rest.split_first_chunk()?;
        let (&length, rest) = rest.split_first()?;
        let gid = rest.first_chunk().filter(|_| length == GID_LENGTH)?;
        Some(Self {
            sequence_number: i64::from_le_bytes(*sequence_number),
            source_time_ns: i64::from_le_bytes(*source_time_ns),
            gid: *gid,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_attachment_of_any_other_length_is_none() {
        let whole = Attachment { sequence_number: 7, source_time_ns: -1, gid: [9; 16] };
        let bytes = whole.to_bytes();
        for length in 0..ATTACHMENT_LENGTH {
            assert_eq!(Attachment::parse(&bytes[..length]), None, "{length}");
        }
        assert_eq!(Attachment::parse(&bytes), Some(whole));
        let mut longer = bytes.to_vec();
        longer.extend([1, 2, 3]);
        assert_eq!(Attachment::parse(&longer), Some(whole));
        let mut wrong = bytes;
        wrong[16] = 17;
        assert_eq!(Attachment::parse(&wrong), None);
    }
}
