//! Finds packets in a stream of bytes.

use super::packet::{HEADER, Packet, PacketError};

/// Finds packets in bytes that come in pieces of any size and may hold garbage.
///
/// Bytes before a header are dropped. Where a header leads to a wrong checksum or an impossible length, its two
/// bytes are dropped and the search goes on behind them, so that a sound packet hidden in what the bad one
/// claimed is found. A packet whose end has not come yet is kept.
#[derive(Clone, Debug)]
pub struct Receiver {
    buffer: Vec<u8>,
    /// Everything before this has been given out or dropped.
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
    /// A receiver that has seen nothing.
    #[must_use]
    pub fn new() -> Self {
        Self::with_longest(usize::MAX)
    }

    /// A receiver that takes a packet of more than `longest` bytes, header included, for a corrupt one.
    ///
    /// Who knows what answers to expect need not wait for the bytes that a corrupt length asks for.
    #[must_use]
    pub fn with_longest(longest: usize) -> Self {
        Self { buffer: Vec::new(), start: 0, longest, ended: false, dropped: 0, corrupt: 0 }
    }

    /// Takes the next bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.start);
        self.start = 0;
        self.buffer.extend_from_slice(bytes);
    }

    /// Says that no more bytes come, so that a packet without an end is garbage and not worth keeping.
    pub fn end(&mut self) {
        self.ended = true;
    }

    /// The next whole and sound packet, or `None` until more bytes come.
    pub fn next_packet(&mut self) -> Option<Packet<&[u8]>> {
        let found = self.find()?;
        // Found by the same check, so it is sound.
        Packet::new_checked(&self.buffer[found]).ok()
    }

    /// The bytes that may be the beginning of a packet.
    #[must_use]
    pub fn pending(&self) -> &[u8] {
        &self.buffer[self.start..]
    }

    /// How many bytes were dropped since they were part of no packet.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// How many headers led to no sound packet.
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
                // FF FF FF: the header may begin one byte later.
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
            // A last FF may be the first half of a header.
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
