//! LZ4 frames, without C: the content of compressed chunks.

use std::io::Read;

use lz4_flex::frame::FrameDecoder;

/// Decompresses all frames in `compressed` up to the first error, and to at most `limit` bytes and one more. Returns
/// the content, and the problem, as the end of a sentence about the chunk. Memory grows with the output.
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
}
