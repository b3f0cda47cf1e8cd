//! Fast Zstandard compression, like the negative levels of the reference implementation.
//!
//! Matches are found with a single hash table and one attempt per position; literals are stored raw, and
//! sequences are coded with the predefined distributions, so that no statistics are needed.
//!
//! # References
//! RFC 8878. The search is that of LZ4 (Collet): the step grows while no match is found.

use super::entropy::{BitWriter, LITERALS, MATCHES, OFFSETS, literals_code, match_code, offset_code};

/// The maximum size of a block.
const BLOCK: usize = 128 * 1024;
/// The window size as a power of two; stored in the frame.
const WINDOW_LOG: u32 = 20;
const WINDOW: usize = 1 << WINDOW_LOG;
const HASH_LOG: u32 = 15;
/// The minimum match length: the number of hashed bytes.
const LEAST_MATCH: usize = 5;
/// After this many bytes without a match, as a power of two, the step grows by one.
const PATIENCE_LOG: usize = 5;

/// Compresses to one frame without a checksum. The content must be smaller than 4 GiB.
pub(super) fn compress(content: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(content.len() / 2 + 64);
    out.extend_from_slice(&0xFD2F_B528_u32.to_le_bytes());
    // A content size of 8 bytes, a window, no checksum, no dictionary.
    out.push(0xC0);
    out.push(((WINDOW_LOG - 10) << 3) as u8);
    out.extend_from_slice(&(content.len() as u64).to_le_bytes());
    if content.is_empty() {
        block_header(&mut out, Kind::Raw, 0, true);
        return out;
    }
    let mut compressor = Compressor {
        content,
        hashes: vec![0; 1 << HASH_LOG],
        last_offset: 0,
        sequences: Vec::new(),
        literals: Vec::with_capacity(BLOCK),
        block: Vec::with_capacity(BLOCK),
    };
    let mut start = 0;
    while start < content.len() {
        let end = (start + BLOCK).min(content.len());
        compressor.compress_block(start, end, &mut out);
        start = end;
    }
    out
}

#[derive(Clone, Copy)]
enum Kind {
    Raw = 0,
    RunLength = 1,
    Compressed = 2,
}

fn block_header(out: &mut Vec<u8>, kind: Kind, size: usize, is_last: bool) {
    let header = (size as u32) << 3 | (kind as u32) << 1 | u32::from(is_last);
    out.extend(header.to_le_bytes().into_iter().take(3));
}

struct Compressor<'a> {
    content: &'a [u8],
    /// The last position of each hash.
    hashes: Vec<u32>,
    /// The offset of the last match, 0 before the first.
    last_offset: u32,
    sequences: Vec<Sequence>,
    literals: Vec<u8>,
    block: Vec<u8>,
}

struct Sequence {
    literals: u32,
    length: u32,
    /// As it is stored.
    offset: u32,
}

impl Compressor<'_> {
    fn compress_block(&mut self, start: usize, end: usize, out: &mut Vec<u8>) {
        let is_last = end == self.content.len();
        let Some(bytes) = self.content.get(start..end) else { return };
        if let Some((first, rest)) = bytes.split_first()
            && rest.iter().all(|byte| byte == first)
        {
            block_header(out, Kind::RunLength, bytes.len(), is_last);
            out.push(*first);
            return;
        }
        let offset_before = self.last_offset;
        self.find_matches(start, end);
        self.block.clear();
        emit_literals(&mut self.block, &self.literals);
        emit_sequences(&mut self.block, &self.sequences);
        if self.block.len() < bytes.len() {
            block_header(out, Kind::Compressed, self.block.len(), is_last);
            out.extend_from_slice(&self.block);
        } else {
            // The decoder sees no offsets in such a block.
            self.last_offset = offset_before;
            block_header(out, Kind::Raw, bytes.len(), is_last);
            out.extend_from_slice(bytes);
        }
    }

    fn find_matches(&mut self, start: usize, end: usize) {
        self.sequences.clear();
        self.literals.clear();
        let content = self.content;
        let mut anchor = start;
        let mut position = start;
        while let Some(bytes) = eight_bytes(content, position, end) {
            let hash = hash(bytes);
            let Some(slot) = self.hashes.get_mut(hash) else { break };
            let candidate = *slot as usize;
            *slot = position as u32;
            let is_near = candidate < position && position - candidate < WINDOW;
            let length = if is_near { common(content, candidate, position, end) } else { 0 };
            if length < LEAST_MATCH {
                position += 1 + ((position - anchor) >> PATIENCE_LOG);
                continue;
            }
            // Extends the match backwards, since steps may have been long.
            let (mut from, mut to, mut length) = (candidate, position, length);
            while to > anchor && from > 0 && content.get(from - 1) == content.get(to - 1) {
                (from, to, length) = (from - 1, to - 1, length + 1);
            }
            self.literals.extend_from_slice(content.get(anchor..to).unwrap_or_default());
            let (literals, offset) = ((to - anchor) as u32, (to - from) as u32);
            // 1 means the last offset only if there are literals before.
            let is_repeated = offset == self.last_offset && literals > 0;
            self.last_offset = offset;
            let offset = if is_repeated { 1 } else { offset + 3 };
            self.sequences.push(Sequence { literals, length: length as u32, offset });
            position = to + length;
            anchor = position;
            // Bytes within the match are likely to repeat.
            if let Some(passed) = position.checked_sub(2)
                && let Some(bytes) = eight_bytes(content, passed, end)
                && let Some(slot) = self.hashes.get_mut(self::hash(bytes))
            {
                *slot = passed as u32;
            }
        }
        self.literals.extend_from_slice(content.get(anchor..end).unwrap_or_default());
    }
}

fn eight_bytes(content: &[u8], at: usize, end: usize) -> Option<u64> {
    let bytes = content.get(at..at + 8)?;
    if at + 8 > end {
        return None;
    }
    Some(u64::from_le_bytes(bytes.try_into().ok()?))
}

/// Hashes the first five bytes.
fn hash(bytes: u64) -> usize {
    const PRIME: u64 = 889_523_592_379;
    ((bytes << 24).wrapping_mul(PRIME) >> (64 - HASH_LOG)) as usize
}

/// The number of equal bytes at both positions, up to `end`.
fn common(content: &[u8], earlier: usize, later: usize, end: usize) -> usize {
    let (Some(a), Some(b)) = (content.get(earlier..), content.get(later..end)) else { return 0 };
    let mut length = 0;
    for (a, b) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        let word = |bytes: &[u8]| bytes.try_into().map_or(0, u64::from_le_bytes);
        let difference = word(a) ^ word(b);
        if difference != 0 {
            return length + (difference.trailing_zeros() / 8) as usize;
        }
        length += 8;
    }
    let (a, b) = (a.get(length..).unwrap_or_default(), b.get(length..).unwrap_or_default());
    length + a.iter().zip(b).take_while(|(a, b)| a == b).count()
}

/// RFC 8878, section 3.1.1.3.1: raw literals.
fn emit_literals(out: &mut Vec<u8>, literals: &[u8]) {
    let size = literals.len() as u32;
    match size {
        0..32 => out.push((size << 3) as u8),
        32..4096 => out.extend_from_slice(&((size << 4 | 1 << 2) as u16).to_le_bytes()),
        _ => out.extend((size << 4 | 3 << 2).to_le_bytes().into_iter().take(3)),
    }
    out.extend_from_slice(literals);
}

/// RFC 8878, section 3.1.1.3.2.
fn emit_sequences(out: &mut Vec<u8>, sequences: &[Sequence]) {
    let count = sequences.len();
    match count {
        0..128 => out.push(count as u8),
        128..0x7F00 => out.extend_from_slice(&[(count >> 8) as u8 + 128, count as u8]),
        _ => {
            out.push(255);
            out.extend_from_slice(&((count - 0x7F00) as u16).to_le_bytes());
        }
    }
    let Some((last, others)) = sequences.split_last() else { return };
    out.push(0); // the default distributions
    let (literals, matches, offsets) = (&*LITERALS, &*MATCHES, &*OFFSETS);
    let codes = |sequence: &Sequence| {
        (literals_code(sequence.literals), match_code(sequence.length), offset_code(sequence.offset))
    };
    let mut bits = BitWriter::default();
    let (literal, matched, offset) = codes(last);
    let mut match_state = matches.begin(matched.symbol);
    let mut offset_state = offsets.begin(offset.symbol);
    let mut literal_state = literals.begin(literal.symbol);
    for code in [literal, matched, offset] {
        bits.add(out, code.extra, code.bits);
    }
    for sequence in others.iter().rev() {
        let (literal, matched, offset) = codes(sequence);
        offsets.encode(&mut bits, out, &mut offset_state, offset.symbol);
        matches.encode(&mut bits, out, &mut match_state, matched.symbol);
        literals.encode(&mut bits, out, &mut literal_state, literal.symbol);
        for code in [literal, matched, offset] {
            bits.add(out, code.extra, code.bits);
        }
    }
    matches.finish(&mut bits, out, match_state);
    offsets.finish(&mut bits, out, offset_state);
    literals.finish(&mut bits, out, literal_state);
    bits.finish(out);
}
