//! Compresses the content of a chunk if that reduces its size.

use std::io::{self, Write};

use lz4_flex::frame::{BlockSize, FrameEncoder, FrameInfo};

use super::{Compression, CompressionLevel, McapOptions};
use crate::zstd;

/// Smaller content is not compressed, nor content that shrinks by less: the limits of the MCAP C++ library
/// (`McapWriter::writeChunk`).
const SMALLEST: usize = 1024;
const LEAST_RATIO: f64 = 1.02;

/// Returns the name of the compression, empty for none, and the compressed content, if any.
pub(super) fn compress(content: &[u8], options: &McapOptions) -> io::Result<(&'static str, Option<Vec<u8>>)> {
    if content.len() < SMALLEST && !options.is_compression_forced {
        return Ok(("", None));
    }
    let (name, compressed) = match options.compression {
        Compression::None => return Ok(("", None)),
        Compression::Lz4 => ("lz4", lz4(content)?),
        Compression::Zstd => ("zstd", zstd(content, options.level)),
    };
    let ratio = content.len() as f64 / compressed.len().max(1) as f64;
    if ratio < LEAST_RATIO && !options.is_compression_forced {
        return Ok(("", None));
    }
    Ok((name, Some(compressed)))
}

fn lz4(content: &[u8]) -> io::Result<Vec<u8>> {
    let frame = FrameInfo::new().block_size(BlockSize::Auto).content_size(Some(content.len() as u64));
    let mut encoder = FrameEncoder::with_frame_info(frame, Vec::with_capacity(content.len() / 2));
    encoder.write_all(content)?;
    encoder.finish().map_err(io::Error::other)
}

fn zstd(content: &[u8], level: CompressionLevel) -> Vec<u8> {
    match level {
        CompressionLevel::Fastest | CompressionLevel::Fast => zstd::compress_fast(content),
        CompressionLevel::Default => zstd::compress(content),
        // One has better coding and the other a larger window: which is better depends on the content.
        CompressionLevel::Slow | CompressionLevel::Slowest => {
            let (coded, repeated) = (zstd::compress(content), zstd::compress_fast(content));
            if repeated.len() < coded.len() { repeated } else { coded }
        }
    }
}
