//! LZ4 frames, without C: the content of compressed chunks.

use std::io::Read;

use lz4_flex::frame::FrameDecoder;

/// Decompresses all frames in `compressed`, which must contain `expected` bytes. Memory grows with the
/// output.
///
/// # Errors
/// The problem, as the end of a sentence about the chunk.
pub(crate) fn decompress(compressed: &[u8], expected: u64) -> Result<Vec<u8>, String> {
    let mut content = Vec::new();
    FrameDecoder::new(compressed)
        .take(expected.saturating_add(1))
        .read_to_end(&mut content)
        .map_err(|error| format!("its LZ4 data is invalid ({error})"))?;
    match content.len() as u64 {
        length if length == expected => Ok(content),
        length if length > expected => {
            Err(format!("its header declares {expected} bytes of uncompressed content, found more"))
        }
        length => {
            Err(format!("its header declares {expected} bytes of uncompressed content, found {length}"))
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::io::Write;

    use lz4_flex::frame::FrameEncoder;

    use super::*;

    #[test]
    fn content_round_trips_and_a_wrong_length_is_reported() {
        let content: Vec<u8> = (0..200_000_u32).map(|n| (n / 7) as u8).collect();
        let mut encoder = FrameEncoder::new(Vec::new());
        encoder.write_all(&content).unwrap();
        let compressed = encoder.finish().unwrap();
        assert!(compressed.len() < content.len() / 4);
        assert_eq!(decompress(&compressed, 200_000).unwrap(), content);
        assert!(decompress(&compressed, 199_999).unwrap_err().contains("found more"));
        assert!(decompress(&compressed, u64::MAX).unwrap_err().contains("found 200000"));
        assert!(decompress(&compressed[..1000], 200_000).is_err());
    }
}
