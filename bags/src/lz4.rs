//! LZ4 frames, without C: the content of compressed chunks.

use std::io::Read;
use std::ops::Range;

use lz4_flex::frame::FrameDecoder;

/// Decompresses all frames in `compressed` up to the first error, and to at most `limit` bytes and one more.
/// Returns the content, and the problem, as the end of a sentence about the chunk. Memory grows with the
/// output.
pub(crate) fn decompress_prefix(compressed: &[u8], limit: u64) -> (Vec<u8>, Option<String>) {
    let mut content = Vec::new();
    let read = FrameDecoder::new(compressed).take(limit.saturating_add(1)).read_to_end(&mut content);
    let problem = match read {
        Err(error) => Some(format!("its LZ4 data is invalid ({error})")),
        Ok(length) if length as u64 > limit => Some(format!("it decompresses to more than {limit} bytes")),
        Ok(_) => None,
    };
    (content, problem)
}

/// Decompresses what is whole in damaged frames, whose blocks are decompressed one by one. Returns the
/// content and the ranges of it that are missing: these are filled with zeros, as long as the damaged blocks
/// should be if all of the content has `declared` bytes.
///
/// Reads no frame whose blocks refer to each other (without `B.Indep`): behind a damaged block their content
/// could be wrong unnoticed.
pub(crate) fn decompress_whole_blocks(
    compressed: &[u8],
    declared: u64,
    limit: u64,
) -> (Vec<u8>, Vec<Range<usize>>) {
    let mut blocks = Vec::new();
    let (mut rest, mut length) = (compressed, 0);
    while let Some(header) = FrameHeader::parse(rest).filter(|header| header.is_independent) {
        let (frame, mut at) = (rest, header.length);
        while let Some(block) = header.block(frame, at).filter(|_| length <= limit) {
            let content = header.decompress(frame, block.clone());
            length += content.as_ref().map_or(header.largest, Vec::len) as u64;
            blocks.push(content.ok_or(header.largest));
            at = block.end;
        }
        // The frame ends with an empty block, perhaps with a checksum.
        rest = match frame.get(at..) {
            Some([0, 0, 0, 0, rest @ ..]) => rest.get(header.checksum..).unwrap_or_default(),
            _ => &[],
        };
    }
    // What blocks decompress to is as long as it can be, except the last one of a frame.
    let surplus = usize::try_from(length.saturating_sub(declared)).unwrap_or(usize::MAX);
    if let Some(Err(missing)) = blocks.iter_mut().rfind(|block| block.is_err()) {
        *missing = missing.saturating_sub(surplus);
    }
    let (mut content, mut holes) = (Vec::new(), Vec::new());
    for block in blocks {
        match block {
            Ok(block) => content.extend(block),
            Err(missing) => {
                holes.push(content.len()..content.len() + missing);
                content.resize(content.len() + missing, 0);
            }
        }
    }
    (content, holes)
}

/// The header of a frame; see `lz4_Frame_format.md` of github.com/lz4/lz4.
struct FrameHeader<'a> {
    bytes: &'a [u8],
    length: usize,
    is_independent: bool,
    /// Bytes after each block.
    block_checksum: usize,
    /// Bytes after the last block.
    checksum: usize,
    /// The most that a block decompresses to.
    largest: usize,
}

impl<'a> FrameHeader<'a> {
    fn parse(frame: &'a [u8]) -> Option<Self> {
        let [0x04, 0x22, 0x4d, 0x18, flags, sizes, ..] = *frame else { return None };
        let has = |bit: u8| flags & bit != 0;
        let length = 7 + if has(0x08) { 8 } else { 0 } + if has(0x01) { 4 } else { 0 };
        let largest = match (sizes >> 4) & 7 {
            size @ 4..=7 => 1 << (8 + 2 * size),
            _ => return None,
        };
        let checksum = |has: bool| if has { 4 } else { 0 };
        Some(Self {
            bytes: frame.get(..length)?,
            length,
            is_independent: has(0x20),
            block_checksum: checksum(has(0x10)),
            checksum: checksum(has(0x04)),
            largest,
        })
    }

    /// The range of the block at that place of the frame, with its length and its checksum; `None` at the
    /// end, and if its length is damaged.
    fn block(&self, frame: &[u8], at: usize) -> Option<Range<usize>> {
        let size = u32::from_le_bytes(*frame.get(at..)?.first_chunk()?);
        // The highest bit tells that it is not compressed.
        let size = (size & 0x7fff_ffff) as usize;
        let end = at + 4 + size + self.block_checksum;
        (size > 0 && size <= self.largest && end <= frame.len()).then_some(at..end)
    }

    /// The content of a block, decompressed as a frame of its own.
    fn decompress(&self, frame: &[u8], block: Range<usize>) -> Option<Vec<u8>> {
        let alone = self.bytes.chain(&frame[block]).chain(&[0; 4][..]);
        let mut content = Vec::new();
        // The size and the checksum of the whole frame are not those of one block, which is found after its
        // content.
        let read = FrameDecoder::new(alone).take(self.largest as u64).read_to_end(&mut content);
        (read.is_ok() || !content.is_empty()).then_some(content)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::io::Write;

    use lz4_flex::frame::{BlockSize, FrameEncoder, FrameInfo};

    use super::*;

    #[test]
    fn content_round_trips_and_the_part_before_damage_is_kept() {
        let content: Vec<u8> = (0..200_000_u32).map(|n| (n / 7) as u8).collect();
        let frame = FrameInfo::new().block_size(BlockSize::Max64KB);
        let mut encoder = FrameEncoder::with_frame_info(frame, Vec::new());
        encoder.write_all(&content).unwrap();
        let compressed = encoder.finish().unwrap();
        assert!(compressed.len() < content.len() / 4);
        assert_eq!(decompress_prefix(&compressed, 200_000), (content.clone(), None));
        assert!(decompress_prefix(&compressed, 199_999).1.unwrap().contains("more than 199999 bytes"));
        let (start, problem) = decompress_prefix(&compressed[..compressed.len() / 2], 200_000);
        assert!(problem.is_some());
        assert!(!start.is_empty() && content.starts_with(&start));
    }

    #[test]
    fn blocks_behind_a_damaged_one_are_kept_if_they_do_not_refer_to_it() {
        use lz4_flex::frame::BlockMode::{Independent, Linked};
        let content: Vec<u8> = (0..400_000_u64).map(|n| (n / 7 * n % 251) as u8).collect();
        for (mode, has_checksums) in [(Independent, false), (Independent, true), (Linked, false)] {
            let frame = FrameInfo::new()
                .block_size(BlockSize::Max64KB)
                .block_mode(mode)
                .block_checksums(has_checksums)
                .content_checksum(has_checksums)
                .content_size(has_checksums.then_some(400_000));
            let mut encoder = FrameEncoder::with_frame_info(frame, Vec::new());
            encoder.write_all(&content).unwrap();
            let compressed = encoder.finish().unwrap();
            let whole = decompress_whole_blocks(&compressed, 400_000, 1 << 30);
            if matches!(mode, Linked) {
                assert_eq!(whole, (Vec::new(), Vec::new()));
                continue;
            }
            assert!(whole == (content.clone(), Vec::new()));
            let header = FrameHeader::parse(&compressed).unwrap();
            let blocks = std::iter::successors(header.block(&compressed, header.length), |block| {
                header.block(&compressed, block.end)
            });
            let blocks: Vec<_> = blocks.collect();
            assert_eq!(blocks.len(), 7);
            for damaged in [0, 2, 6] {
                let mut bytes = compressed.clone();
                // A sequence that refers to what is before the block.
                bytes[blocks[damaged].start + 4..][..4].copy_from_slice(&[0x0f, 0xff, 0xff, 0xff]);
                let (read, holes) = decompress_whole_blocks(&bytes, 400_000, 1 << 30);
                let (start, end) = (damaged << 16, (damaged + 1) << 16);
                assert_eq!(holes, [Range { start, end: end.min(400_000) }]);
                assert_eq!(read.len(), 400_000);
                assert!(
                    read[..start] == content[..start] && read[holes[0].clone()].iter().all(|byte| *byte == 0)
                );
                assert!(read[holes[0].end..] == content[holes[0].end..]);
            }
        }
        assert_eq!(decompress_whole_blocks(b"", 5, 5), (Vec::new(), Vec::new()));
    }
}
