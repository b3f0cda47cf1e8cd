//! Finds packets in a stream of bytes.

use super::Protocol;
use super::packet::{HEADER_1, HEADER_2, Packet, PacketError};

/// Finds packets in bytes that arrive in pieces of any size and may contain garbage.
///
/// Bytes before a header are dropped. If a header is followed by a wrong checksum or an impossible length,
/// its bytes are dropped and the search continues after them, so that a valid packet within the range of
/// the invalid one is found. Incomplete packets are kept.
#[derive(Clone, Debug)]
pub struct Receiver {
    protocol: Protocol,
    buffer: Vec<u8>,
    /// Everything before this has been returned or dropped.
    start: usize,
    longest: usize,
    ended: bool,
    dropped: u64,
    corrupt: u64,
}

/// No instruction and no answer is longer: a length beyond this is corrupt.
const LONGEST: usize = 4096;

impl Receiver {
    /// An empty receiver.
    #[must_use]
    pub fn new(protocol: Protocol) -> Self {
        Self::with_longest(protocol, LONGEST)
    }

    /// A receiver that treats packets of more than `longest` bytes, including the header, as corrupt.
    ///
    /// If the expected answers are known, this avoids waiting for the bytes of a corrupt length.
    #[must_use]
    pub fn with_longest(protocol: Protocol, longest: usize) -> Self {
        Self { protocol, buffer: Vec::new(), start: 0, longest, ended: false, dropped: 0, corrupt: 0 }
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
    pub fn next_packet(&mut self) -> Option<Packet<'_>> {
        let found = self.find()?;
        // Found by the same check, so it is valid.
        Packet::new_checked(self.protocol, &self.buffer[found]).ok()
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
            if !self.ended && rest.len() < self.shortest() {
                return None;
            }
            match Packet::new_checked(self.protocol, rest) {
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
                Err(PacketError::Id { found: 0xFF }) if self.protocol != Protocol::Dynamixel2 => {
                    self.drop_bytes(1);
                }
                Ok(_) | Err(_) => {
                    self.corrupt += 1;
                    self.drop_bytes(self.header().len().min(rest.len()));
                }
            }
        }
    }

    fn drop_until_header(&mut self) {
        let rest = &self.buffer[self.start..];
        let header = self.header();
        let found = rest.windows(header.len()).position(|bytes| bytes == header);
        let skip = found.unwrap_or_else(|| {
            // The last bytes may be the beginning of a header.
            let kept = (1..header.len()).rev().find(|length| rest.ends_with(&header[..*length]));
            rest.len() - kept.filter(|_| !self.ended).unwrap_or(0)
        });
        self.drop_bytes(skip);
    }

    fn header(&self) -> &'static [u8] {
        match self.protocol {
            Protocol::Dynamixel2 => &HEADER_2,
            _ => &HEADER_1,
        }
    }

    /// The number of bytes up to the length.
    fn shortest(&self) -> usize {
        match self.protocol {
            Protocol::Dynamixel2 => 7,
            _ => 4,
        }
    }

    fn drop_bytes(&mut self, count: usize) {
        self.start += count;
        self.dropped += count as u64;
    }
}

#[cfg(test)]
#[path = "receiver_tests.rs"]
mod tests;
