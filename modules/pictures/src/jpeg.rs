//! JPEGs of cameras: whether a picture is whole, and its pixels.
//!
//! # References
//! ITU-T T.81: markers in annex B, the typical Huffman tables in annex K.3.

use std::borrow::Cow;

use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Lengths of the codes and values of a Huffman table.
pub(crate) type Huffman = ([u8; 16], &'static [u8]);

/// The tables of K.3: DC and AC of luminance, DC and AC of chrominance.
pub(crate) const TABLES: [Huffman; 4] = [
    ([0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0], &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]),
    (
        [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 0x7d],
        &[
            0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51, 0x61, 0x07,
            0x22, 0x71, 0x14, 0x32, 0x81, 0x91, 0xa1, 0x08, 0x23, 0x42, 0xb1, 0xc1, 0x15, 0x52, 0xd1, 0xf0,
            0x24, 0x33, 0x62, 0x72, 0x82, 0x09, 0x0a, 0x16, 0x17, 0x18, 0x19, 0x1a, 0x25, 0x26, 0x27, 0x28,
            0x29, 0x2a, 0x34, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49,
            0x4a, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69,
            0x6a, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89,
            0x8a, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7,
            0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3, 0xc4, 0xc5,
            0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda, 0xe1, 0xe2,
            0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf1, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8,
            0xf9, 0xfa,
        ],
    ),
    ([0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0], &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]),
    (
        [0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 0x77],
        &[
            0x00, 0x01, 0x02, 0x03, 0x11, 0x04, 0x05, 0x21, 0x31, 0x06, 0x12, 0x41, 0x51, 0x07, 0x61, 0x71,
            0x13, 0x22, 0x32, 0x81, 0x08, 0x14, 0x42, 0x91, 0xa1, 0xb1, 0xc1, 0x09, 0x23, 0x33, 0x52, 0xf0,
            0x15, 0x62, 0x72, 0xd1, 0x0a, 0x16, 0x24, 0x34, 0xe1, 0x25, 0xf1, 0x17, 0x18, 0x19, 0x1a, 0x26,
            0x27, 0x28, 0x29, 0x2a, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48,
            0x49, 0x4a, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68,
            0x69, 0x6a, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87,
            0x88, 0x89, 0x8a, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5,
            0xa6, 0xa7, 0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3,
            0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda,
            0xe2, 0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8,
            0xf9, 0xfa,
        ],
    ),
];

/// The classes and numbers of [`TABLES`] in a segment of them.
pub(crate) const TABLE_NUMBERS: [u8; 4] = [0x00, 0x10, 0x01, 0x11];

const START: u8 = 0xd8;
const END: u8 = 0xd9;
const HUFFMAN: u8 = 0xc4;
const SCAN: u8 = 0xda;

/// What stands before the pixels of a JPEG.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    has_tables: bool,
    /// Where the first scan begins, with its marker.
    scan_at: usize,
}

impl Head {
    /// Reads the segments before the first scan.
    ///
    /// # Errors
    /// What is wrong with the picture.
    pub fn of(jpeg: &[u8]) -> Result<Self, &'static str> {
        const CUT: &str = "it is cut off";
        if jpeg.get(..2) != Some(&[0xff, START]) {
            return Err("it is no JPEG");
        }
        let (mut at, mut size, mut has_tables) = (2, None, false);
        loop {
            let &[mark, marker] = jpeg.get(at..).and_then(|rest| rest.first_chunk()).ok_or(CUT)?;
            match (mark, marker) {
                (0xff, 0xff) => {
                    at += 1; // a byte to fill
                    continue;
                }
                (0xff, SCAN) => {
                    let (width, height) = size.ok_or("it has no size")?;
                    return Ok(Self { width, height, has_tables, scan_at: at });
                }
                (0xff, HUFFMAN) => has_tables = true,
                (0xff, 0xc0..=0xcf) if marker != 0xc8 && marker != 0xcc => {
                    let &[_, _, _, h1, h2, w1, w2] =
                        jpeg.get(at + 2..).and_then(|rest| rest.first_chunk()).ok_or(CUT)?;
                    size = Some((u16::from_be_bytes([w1, w2]).into(), u16::from_be_bytes([h1, h2]).into()));
                }
                (0xff, END) => return Err("it has no pixels"),
                (0xff, _) => {}
                _ => return Err("bytes between its segments are wrong"),
            }
            let length = jpeg.get(at + 2..).and_then(|rest| rest.first_chunk()).ok_or(CUT)?;
            let length = usize::from(u16::from_be_bytes(*length));
            if length < 2 {
                return Err("the length of a segment is wrong");
            }
            at += 2 + length;
        }
    }

    /// Whether the end of the picture is there. Cameras may fill up what follows it.
    #[must_use]
    pub fn has_end(&self, jpeg: &[u8]) -> bool {
        let pixels = jpeg.get(self.scan_at..).unwrap_or_default();
        pixels.windows(2).any(|pair| pair == [0xff, END])
    }
}

/// The pixels of a whole picture as RGB, row by row. Nothing is allocated for a picture of another size than
/// that of `head`.
///
/// # Errors
/// What is wrong with the picture.
pub fn decode(jpeg: &[u8], head: &Head) -> Result<Vec<u8>, String> {
    let (width, height) = (head.width as usize, head.height as usize);
    let options = DecoderOptions::default()
        .set_max_width(width)
        .set_max_height(height)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let complete = with_tables(jpeg, head);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(&*complete), options);
    let failed = |error| format!("{error:?}");
    decoder.decode_headers().map_err(failed)?;
    let size = width.checked_mul(height).and_then(|pixels| pixels.checked_mul(3));
    if decoder.output_buffer_size() != size {
        return Err("its headers contradict each other".to_owned());
    }
    decoder.decode().map_err(failed)
}

/// A JPEG with Huffman tables: many cameras leave out the typical ones.
fn with_tables<'a>(jpeg: &'a [u8], head: &Head) -> Cow<'a, [u8]> {
    let (true, Some((before, scan))) = (!head.has_tables, jpeg.split_at_checked(head.scan_at)) else {
        return Cow::Borrowed(jpeg);
    };
    Cow::Owned([before, &tables(), scan].concat())
}

/// The segment with the typical tables.
pub(crate) fn tables() -> Vec<u8> {
    let length: usize = TABLES.iter().map(|(lengths, values)| 1 + lengths.len() + values.len()).sum();
    let mut segment = vec![0xff, HUFFMAN];
    segment.extend(u16::try_from(length + 2).unwrap_or_default().to_be_bytes());
    for (number, (lengths, values)) in TABLE_NUMBERS.iter().zip(TABLES) {
        segment.push(*number);
        segment.extend(lengths);
        segment.extend(values);
    }
    segment
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::pattern;
    use fuzzing::{Random, rounds};

    fn picture() -> Vec<u8> {
        pattern::jpeg(64, 32, 3)
    }

    /// The colours are those of the pattern, up to the rounding of the decoder.
    #[test]
    fn a_picture_has_the_colours_of_its_pattern_with_and_without_its_tables() {
        let jpeg = picture();
        let head = Head::of(&jpeg).unwrap();
        assert_eq!((head.width, head.height, head.has_tables), (64, 32, true));
        let pixels = decode(&jpeg, &head).unwrap();
        assert_eq!(pixels.len(), 64 * 32 * 3);
        let tables_at = jpeg.windows(2).position(|pair| pair == [0xff, HUFFMAN]).unwrap();
        let without = [&jpeg[..tables_at], &jpeg[tables_at + tables().len()..]].concat();
        let head = Head::of(&without).unwrap();
        assert!(!head.has_tables && head.has_end(&without));
        assert_eq!(decode(&without, &head).unwrap(), pixels);
        // Compared in the middle of blocks: decoders blend the colours of neighbours.
        let yuyv = pattern::yuyv(64, 32, 3);
        let same = yuyv_to_rgb_full(&yuyv);
        for (row, column) in [(4, 4), (4, 20), (12, 36), (28, 52)] {
            let at = (row * 64 + column) * 3;
            let near = (0..3).all(|colour| pixels[at + colour].abs_diff(same[at + colour]) <= 3);
            assert!(near, "{row} {column}: {:?} {:?}", &pixels[at..at + 3], &same[at..at + 3]);
        }
    }

    /// JPEGs use the range 0 to 255.
    fn yuyv_to_rgb_full(yuyv: &[u8]) -> Vec<u8> {
        let pair = |pair: &[u8]| {
            let [y0, u, y1, v] = [0, 1, 2, 3].map(|at| f64::from(pair[at]));
            let (u, v) = (u - 128.0, v - 128.0);
            [y0, y1].map(|y| [y + 1.402 * v, y - 0.344_14 * u - 0.714_14 * v, y + 1.772 * u]).concat()
        };
        let colours = yuyv.chunks_exact(4).flat_map(pair);
        colours.map(|colour| colour.round().clamp(0.0, 255.0) as u8).collect()
    }

    #[test]
    fn half_a_picture_is_told_from_a_whole_one() {
        let jpeg = picture();
        let head = Head::of(&jpeg).unwrap();
        assert!(head.has_end(&[&jpeg[..], &[0; 50]].concat()), "bytes to fill");
        assert!(!head.has_end(&jpeg[..jpeg.len() - 1]));
        assert_eq!(Head::of(&jpeg[..20]), Err("it is cut off"));
        assert_eq!(Head::of(b""), Err("it is no JPEG"));
        assert_eq!(Head::of(&[0xff, START, 0xff, END]), Err("it has no pixels"));
        assert_eq!(Head::of(&[0xff, START, 0xff, SCAN]), Err("it has no size"));
        assert_eq!(Head::of(&[0xff, START, 0xff, 0xe0, 0, 1]), Err("the length of a segment is wrong"));
        assert_eq!(Head::of(&[0xff, START, 7, 7]), Err("bytes between its segments are wrong"));
    }

    #[test]
    fn damaged_pictures_are_errors_or_pictures_of_the_same_size_and_take_no_memory_of_their_own_choice() {
        let jpeg = picture();
        let mut random = Random::new(17);
        for _ in rounds(2_000) {
            let mut damaged = jpeg.clone();
            for _ in 0..=random.below(4) {
                let at = random.below(damaged.len());
                damaged[at] = random.below(256) as u8;
            }
            damaged.truncate(damaged.len() - random.below(3) * random.below(200));
            let (memory, ()) = fuzzing::most_in(|| {
                let Ok(head) = Head::of(&damaged) else { return };
                if (head.width, head.height) == (64, 32)
                    && let Ok(pixels) = decode(&damaged, &head)
                {
                    assert_eq!(pixels.len(), 64 * 32 * 3);
                }
            });
            assert!(memory < 4 << 20, "{memory} bytes");
        }
    }

    /// The size stands twice: what is decoded is never larger than what was announced first.
    #[test]
    fn a_second_size_is_refused() {
        let jpeg = picture();
        let head = Head::of(&jpeg).unwrap();
        let other = Head { width: 32, ..head };
        assert!(decode(&jpeg, &other).is_err());
    }
}
