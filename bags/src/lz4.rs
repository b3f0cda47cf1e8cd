//! LZ4 frames, without C: the content of compressed chunks.

use std::io::Read;

use lz4_flex::frame::FrameDecoder;

/// Decompresses all frames in `compressed`, which must come to `expected` bytes. Memory grows with what comes out.
///
/// # Errors
/// What is wrong, as the end of a sentence about the chunk.
pub(crate) fn decompress(compressed: &[u8], expected: u64) -> Result<Vec<u8>, String> {
    let mut content = Vec::new();
    FrameDecoder::new(compressed)
        .take(expected.saturating_add(1))
        .read_to_end(&mut content)
        .map_err(|error| format!("its LZ4 data is not as it should be ({error})"))?;
    match content.len() as u64 {
        length if length == expected => Ok(content),
        length if length > expected => {
            Err(format!("its header tells {expected} bytes of uncompressed content, more came out"))
        }
        length => {
            Err(format!("its header tells {expected} bytes of uncompressed content, {length} came out"))
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
    fn content_comes_back_and_a_wrong_length_is_told() {
        let content: Vec<u8> = (0..200_000_u32).map(|n| (n / 7) as u8).collect();
        let mut encoder = FrameEncoder::new(Vec::new());
        encoder.write_all(&content).unwrap();
        let compressed = encoder.finish().unwrap();
        assert!(compressed.len() < content.len() / 4);
        assert_eq!(decompress(&compressed, 200_000).unwrap(), content);
        assert!(decompress(&compressed, 199_999).unwrap_err().contains("more came out"));
        assert!(decompress(&compressed, u64::MAX).unwrap_err().contains("200000 came out"));
        assert!(decompress(&compressed[..1000], 200_000).is_err());
    }
}
