//! Finds packets in a stream of bytes.

use super::packet::{HEADER, Packet, PacketError};

/// Finds packets in bytes that arrive in pieces of any size and may contain garbage.
///
/// Bytes before a header are dropped. If a header is followed by a wrong checksum or an impossible length,
/// its two bytes are dropped and the search continues after them, so that a valid packet within the range of
/// the invalid one is found. Incomplete packets are kept.
#[derive(Clone, Debug)]
pub struct Receiver {
    buffer: Vec<u8>,
    /// Everything before this has been returned or dropped.
    start: usize,
    longest: usize,
    ended: bool,
    dropped: u64,
    corrupt: u64,
}

impl Default for Receiver {
    fn default() -> Self {
        Self::new()
    }
}

impl Receiver {
    /// An empty receiver.
    #[must_use]
    pub fn new() -> Self {
        Self::with_longest(usize::MAX)
    }

    /// A receiver that treats packets of more than `longest` bytes, including the header, as corrupt.
    ///
    /// If the expected answers are known, this avoids waiting for the bytes of a corrupt length.
    #[must_use]
    pub fn with_longest(longest: usize) -> Self {
        Self { buffer: Vec::new(), start: 0, longest, ended: false, dropped: 0, corrupt: 0 }
    }

    /// Adds received bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.start);
        self.start = 0;
        self.buffer.extend_from_slice(bytes);
    }

    /// Marks the end of the stream, so that an incomplete packet is garbage.
    pub fn end(&mut self) {
        self.ended = true;
    }

    /// The next complete and valid packet, or `None` until more bytes arrive.
    pub fn next_packet(&mut self) -> Option<Packet<&[u8]>> {
        let found = self.find()?;
        // Found by the same check, so it is valid.
        Packet::new_checked(&self.buffer[found]).ok()
    }

    /// The bytes that may be the start of a packet.
    #[must_use]
    pub fn pending(&self) -> &[u8] {
        &self.buffer[self.start..]
    }

    /// The number of dropped bytes that were not part of a packet.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// The number of headers without a valid packet.
    #[must_use]
    pub fn corrupt(&self) -> u64 {
        self.corrupt
    }

    fn find(&mut self) -> Option<std::ops::Range<usize>> {
        loop {
            self.drop_until_header();
            let rest = &self.buffer[self.start..];
            if !self.ended && rest.len() < 4 {
                return None;
            }
            match Packet::new_checked(rest) {
                Ok(packet) if packet.as_bytes().len() <= self.longest => {
                    let begin = self.start;
                    self.start += packet.as_bytes().len();
                    return Some(begin..self.start);
                }
                Err(PacketError::Truncated { needed, .. }) if !self.ended && needed <= self.longest => {
                    return None;
                }
                Err(_) if rest.is_empty() => return None,
                // FF FF FF: the header may start one byte later.
                Err(PacketError::Id) => self.drop_bytes(1),
                Ok(_) | Err(_) => {
                    self.corrupt += 1;
                    self.drop_bytes(HEADER.len().min(rest.len()));
                }
            }
        }
    }

    fn drop_until_header(&mut self) {
        let rest = &self.buffer[self.start..];
        let header = rest.windows(2).position(|pair| pair == HEADER);
        let skip = header.unwrap_or_else(|| {
            // A final FF may be the first half of a header.
            let keep = usize::from(!self.ended && rest.last() == Some(&0xFF));
            rest.len() - keep
        });
        self.drop_bytes(skip);
    }

    fn drop_bytes(&mut self, count: usize) {
        self.start += count;
        self.dropped += count as u64;
    }
}

#[cfg(test)]
#[path = "receiver_tests.rs"]
mod tests;
