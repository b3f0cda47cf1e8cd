//! Zstandard in both directions, without C: the content of compressed chunks.
//!
//! # References
//! The format is RFC 8878, "Zstandard Compression and the 'application/zstd' Media Type".

mod entropy;
mod fast;

use std::io::{self, BufRead, Read, Write};

use ruzstd::decoding::errors::{FrameDecoderError, ReadFrameHeaderError};
use ruzstd::decoding::{BlockDecodingStrategy, FrameDecoder};
use ruzstd::encoding::{CompressionLevel, compress_to_vec};

/// The maximum window of a frame: the default limit of the reference implementation.
const LARGEST_WINDOW: u64 = 128 * 1024 * 1024;

/// The maximum decompressed size, whatever a header declares, against small files designed to exhaust memory.
/// Typical data compresses to about a tenth, empty images to less.
pub(crate) fn most_from(compressed: u64) -> u64 {
    const LARGEST_RATIO: u64 = 100;
    const ALWAYS: u64 = 64 * 1024 * 1024;
    const EVER: u64 = 1 << 30;
    compressed.saturating_mul(LARGEST_RATIO).saturating_add(ALWAYS).min(EVER)
}

/// Compresses to one frame without a checksum, optimised for speed.
pub(crate) fn compress_fast(content: &[u8]) -> Vec<u8> {
    if u32::try_from(content.len()).is_err() {
        return compress(content);
    }
    fast::compress(content)
}

/// Compresses to one frame with a checksum, at the only level of `ruzstd`.
pub(crate) fn compress(content: &[u8]) -> Vec<u8> {
    compress_to_vec(content, CompressionLevel::Fastest)
}

/// Decompresses the frames in `compressed` up to the first damaged block, and to about `limit` bytes. Returns
/// the content, and the problem, as the end of a sentence about the chunk.
///
/// The lengths in the frames are not trusted: memory grows with the decompressed data, and exceeds `limit` by
/// at most a block (128 KiB) and a window.
pub(crate) fn decompress_prefix(compressed: &[u8], limit: u64) -> (Vec<u8>, Option<String>) {
    /// Most content is not larger than this, so that its memory does not have to grow.
    const USUAL_RATIO: usize = 16;
    let usual = compressed.len().saturating_mul(USUAL_RATIO);
    let mut content = Vec::with_capacity(usize::try_from(limit).unwrap_or(usize::MAX).min(usual));
    let mut rest = compressed;
    let too_many = || format!("it decompresses to more than {limit} bytes");
    let Err(problem) = unpack(&mut rest, &mut content, limit, too_many) else { return (content, None) };
    let mut whole = Vec::new();
    let mut rest = compressed;
    // The decoder keeps a window of a frame until its end, which a damaged frame does not reach: its intact
    // blocks are decoded again, followed by an empty last one.
    while let Some(blocks) = intact_blocks(rest, limit) {
        let mut frames = rest;
        let is_ended = finish_after(&mut frames, blocks, &mut whole);
        if !is_ended || whole.len() as u64 >= limit {
            break;
        }
        rest = frames;
    }
    // The checksum of a frame is verified after its content.
    if whole.len() > content.len() {
        content = whole;
    }
    (content, Some(problem))
}

/// The number of blocks of the first frame that can be decoded; `None` if it has no valid header.
fn intact_blocks(frame: &[u8], limit: u64) -> Option<usize> {
    let mut decoder = FrameDecoder::new();
    decoder.set_max_window_size(LARGEST_WINDOW);
    let mut source = frame;
    decoder.reset(&mut source).ok()?;
    let (mut blocks, mut written) = (0, 0);
    while !decoder.is_finished()
        && written < limit
        && decoder.decode_blocks(&mut source, BlockDecodingStrategy::UptoBlocks(1)).is_ok()
    {
        written += decoder.collect_to_writer(io::sink()).ok()? as u64;
        blocks += 1;
    }
    Some(blocks)
}

/// Decodes that many blocks of a frame; returns whether they include its last one.
fn finish_after(source: &mut &[u8], blocks: usize, content: &mut Vec<u8>) -> bool {
    /// An empty raw block, marked as the last one, and a checksum, which is not compared.
    const END: [u8; 7] = [1, 0, 0, 0, 0, 0, 0];
    let mut decoder = FrameDecoder::new();
    decoder.set_max_window_size(LARGEST_WINDOW);
    if decoder.reset(&mut *source).is_err() {
        return false;
    }
    for _ in 0..blocks {
        if decoder.decode_blocks(&mut *source, BlockDecodingStrategy::UptoBlocks(1)).is_err() {
            return false;
        }
    }
    let is_ended = decoder.is_finished();
    let end = is_ended || decoder.decode_blocks(END.as_slice(), BlockDecodingStrategy::UptoBlocks(1)).is_ok();
    end && decoder.collect_to_writer(content).is_ok() && is_ended
}

/// Decompresses all frames in `compressed`, which must not contain more than `limit` bytes.
///
/// # Errors
/// The problem, as the end of a sentence about the content.
pub(crate) fn decompress_within(compressed: &[u8], limit: u64) -> Result<Vec<u8>, String> {
    let mut content = Vec::new();
    let mut rest = compressed;
    unpack(&mut rest, &mut content, limit, || format!("it decompresses to more than {limit} bytes"))?;
    Ok(content)
}

/// Decompresses all frames of `source` into `content`, in bounded memory.
///
/// # Errors
/// See [`decompress_within`]. Data decompressed before the error is in `content`.
pub(crate) fn unpack(
    source: &mut impl BufRead,
    content: &mut impl Write,
    limit: u64,
    too_many: impl Fn() -> String,
) -> Result<u64, String> {
    let mut decoder = FrameDecoder::new();
    decoder.set_max_window_size(LARGEST_WINDOW);
    let mut written = 0;
    while !source.fill_buf().map_err(|error| error.to_string())?.is_empty() {
        match decoder.reset(&mut *source) {
            Ok(()) => written = decode_frame(&mut decoder, source, content, written, limit, &too_many)?,
            Err(FrameDecoderError::ReadFrameHeaderError(ReadFrameHeaderError::SkipFrame {
                length, ..
            })) => {
                let length = u64::from(length);
                let skipped = io::copy(&mut source.by_ref().take(length), &mut io::sink());
                if skipped.map_err(|error| error.to_string())? < length {
                    return Err("it ends within a skippable frame".to_owned());
                }
            }
            Err(error) => return Err(damaged(&error)),
        }
    }
    Ok(written)
}

/// Returns the number of bytes written so far.
fn decode_frame(
    decoder: &mut FrameDecoder,
    source: &mut impl BufRead,
    content: &mut impl Write,
    mut written: u64,
    limit: u64,
    too_many: impl Fn() -> String,
) -> Result<u64, String> {
    while !decoder.is_finished() {
        decoder
            .decode_blocks(&mut *source, BlockDecodingStrategy::UptoBlocks(1))
            .map_err(|error| damaged(&error))?;
        if written + decoder.can_collect() as u64 > limit {
            return Err(too_many());
        }
        let collected = decoder.collect_to_writer(&mut *content).map_err(|error| error.to_string())?;
        written += collected as u64;
    }
    match decoder.get_checksum_from_data() {
        Some(stored) if decoder.get_calculated_checksum() != Some(stored) => {
            Err("the checksum of its Zstandard frame is wrong".to_owned())
        }
        _ => Ok(written),
    }
}

fn damaged(error: &FrameDecoderError) -> String {
    format!("its Zstandard data is invalid ({error})")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    /// The content, which must have that length.
    fn decompress(compressed: &[u8], expected: u64) -> Result<Vec<u8>, String> {
        match decompress_prefix(compressed, expected) {
            (content, None) if content.len() as u64 == expected => Ok(content),
            (content, problem) => Err(problem.unwrap_or_else(|| format!("found {}", content.len()))),
        }
    }

    /// A frame that decodes to `blocks` times 128 KiB of zeros: RFC 8878 section 3.1.1, run-length blocks.
    fn frame_of_runs(blocks: u32) -> Vec<u8> {
        // The magic number, no checksum and no length, a window of 128 KiB.
        let mut frame = vec![0x28, 0xb5, 0x2f, 0xfd, 0x00, 7 << 3];
        for block in 1..=blocks {
            let header = (128 * 1024_u32) << 3 | 1 << 1 | u32::from(block == blocks);
            frame.extend_from_slice(&header.to_le_bytes()[..3]);
            frame.push(0);
        }
        frame
    }

    /// Bytes that are neither repetitive nor random, like the fields of messages.
    fn mixed(length: usize) -> Vec<u8> {
        let mut state = 1_u32;
        let mut byte = |n: usize| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            if n % 40 < 30 { (n % 40) as u8 } else { (state >> (24 + n / 5000 % 8)) as u8 }
        };
        (0..length).map(&mut byte).collect()
    }

    #[test]
    fn content_of_any_length_round_trips() {
        for length in (0..300).chain([4095, 131_071, 131_072, 131_073, 400_000]) {
            for content in [mixed(length), vec![7; length]] {
                for compressed in [compress(&content), compress_fast(&content)] {
                    assert_eq!(decompress(&compressed, length as u64).as_ref(), Ok(&content), "{length}");
                }
            }
        }
        assert!(compress_fast(&mixed(400_000)).len() < 250_000);
        assert!(compress(&mixed(400_000)).len() < 200_000);
    }

    /// Long and short matches, near and far, runs, and unique bytes, in a pseudo-random order.
    fn patchwork(seed: u32, length: usize) -> Vec<u8> {
        let mut state = seed;
        let mut random = |below: usize| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as usize % below.max(1)
        };
        let mut content: Vec<u8> = Vec::new();
        while content.len() < length {
            let most = [3, 30, 300, 3000, 200_000][random(5)];
            let size = 1 + random(most);
            match random(3) {
                0 => content.extend((0..size).map(|_| random(256) as u8)),
                1 => {
                    let byte = random(256) as u8;
                    content.extend(std::iter::repeat_n(byte, size));
                }
                _ => {
                    let from = random(content.len());
                    for position in from..from + size.min(content.len()) {
                        content.push(content[position]);
                    }
                }
            }
        }
        content
    }

    #[test]
    fn content_compressed_fast_round_trips() {
        for seed in 0..300 {
            let content = patchwork(seed, 1 << (seed % 22));
            let compressed = compress_fast(&content);
            let read = decompress(&compressed, content.len() as u64);
            assert!(read.as_ref() == Ok(&content), "seed {seed}: {:?}", read.err());
        }
    }

    #[test]
    fn several_frames_and_skippable_ones_are_read_as_one_content() {
        let mut compressed = compress(b"one ");
        compressed.extend_from_slice(&[0x50, 0x2a, 0x4d, 0x18, 3, 0, 0, 0, 1, 2, 3]);
        compressed.extend_from_slice(&compress(b"two"));
        assert_eq!(decompress(&compressed, 7).unwrap(), b"one two");
        compressed.extend_from_slice(&[0x50, 0x2a, 0x4d, 0x18, 0xff, 0xff, 0xff, 0xff]);
        assert!(decompress(&compressed, 7).unwrap_err().contains("within a skippable frame"));
    }

    #[test]
    fn a_decompression_bomb_is_stopped_where_it_exceeds_the_declared_size() {
        let whole = frame_of_runs(3);
        assert_eq!(decompress(&whole, 3 * 128 * 1024).unwrap(), vec![0; 3 * 128 * 1024]);
        // 131 GB if it were decompressed, and no last block.
        let mut bomb = frame_of_runs(1000);
        let last = bomb.len() - 4;
        bomb[last] &= !1;
        let blocks = bomb[6..].repeat(1000);
        bomb.extend_from_slice(&blocks);
        let error = decompress(&bomb, 1_000_000).unwrap_err();
        assert!(error.contains("it decompresses to more than 1000000 bytes"), "{error}");
    }

    #[test]
    fn the_blocks_before_damage_are_kept() {
        let content = mixed(600_000);
        for compressed in [compress(&content), compress_fast(&content)] {
            for damaged in [compressed.len() * 3 / 10, compressed.len() / 2, compressed.len() - 20] {
                let (kept, problem) = decompress_prefix(&compressed[..damaged], 600_000);
                assert!(problem.is_some());
                assert!(kept.len() >= 128 * 1024 && content.starts_with(&kept), "{damaged}: {}", kept.len());
            }
        }
        // After a complete frame too.
        let two = [compress(b"one"), compress(&content)].concat();
        let (kept, _) = decompress_prefix(&two[..two.len() / 2], 600_003);
        assert!(kept.len() > 128 * 1024 && kept[3..] == content[..kept.len() - 3]);
    }

    #[test]
    fn a_window_larger_than_the_limit_is_refused_before_memory_is_allocated() {
        // Window exponent 31: 2 TiB.
        let error = decompress(&[0x28, 0xb5, 0x2f, 0xfd, 0x00, 31 << 3, 1, 0, 0], 0).unwrap_err();
        assert!(error.contains("window"), "{error}");
    }

    #[test]
    fn damaged_frames_give_errors_and_no_other_content() {
        let content = mixed(3000);
        let compressed = compress(&content);
        for position in 0..compressed.len() {
            for change in [0x01, 0x80, 0xff] {
                let mut altered = compressed.clone();
                altered[position] ^= change;
                if let Ok(read) = decompress(&altered, 3000) {
                    assert_eq!(
                        read, content,
                        "byte {position}: the checksum detects what the format does not"
                    );
                }
            }
        }
        for length in 1..compressed.len() {
            assert!(decompress(&compressed[..length], 3000).is_err(), "truncated to {length}");
        }
    }
}
