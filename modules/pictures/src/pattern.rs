//! A picture for emulated cameras: eight bars of colours, over which a white square moves.
//!
//! All pixels of a block of 16 x 8 have one colour, so that a JPEG of it needs no transform.

use crate::jpeg::{TABLE_NUMBERS, TABLES, tables};

/// Columns and rows of a block of one colour: a minimum coded unit of a JPEG with half as many columns of
/// colour as of brightness.
const BLOCK: [usize; 2] = [16, 8];
/// Y, Cb and Cr of the bars: white, yellow, cyan, green, magenta, red, blue, black, of 75 % (ITU-R BT.601 in
/// the full range of JFIF).
const BARS: [[u8; 3]; 8] = [
    [191, 128, 128],
    [169, 32, 143],
    [134, 160, 32],
    [112, 65, 48],
    [79, 191, 208],
    [57, 96, 223],
    [22, 223, 112],
    [0, 128, 128],
];
const WHITE: [u8; 3] = [255, 128, 128];

/// The colour of a block, in a picture of that many blocks in a row.
fn colour(row: usize, column: usize, columns: usize, number: u32) -> [u8; 3] {
    let square = number as usize % columns.max(1);
    match (row, column) {
        (1 | 2, column) if column == square => WHITE,
        _ => BARS.get(column * BARS.len() / columns.max(1)).copied().unwrap_or_default(),
    }
}

/// A picture of the pattern as YUYV, without bytes between its rows. The width is even.
#[must_use]
pub fn yuyv(width: u32, height: u32, number: u32) -> Vec<u8> {
    let (width, height) = (width as usize, height as usize);
    let mut bytes = Vec::with_capacity(width * height * 2);
    for row in 0..height {
        for column in (0..width).step_by(2) {
            let columns = width.div_ceil(BLOCK[0]);
            let [y, u, v] = colour(row / BLOCK[1], column / BLOCK[0], columns, number);
            bytes.extend([y, u, y, v]);
        }
    }
    bytes
}

/// A picture of the pattern as a JPEG, as cameras send it: baseline, 4:2:2.
#[must_use]
pub fn jpeg(width: u32, height: u32, number: u32) -> Vec<u8> {
    let mut jpeg = vec![0xff, 0xd8, 0xff, 0xdb, 0, 67, 0];
    // Steps of 8 make the coefficient of a block of one colour that colour itself.
    jpeg.extend([8; 64]);
    let side = |side: u32| u16::try_from(side).unwrap_or(u16::MAX).to_be_bytes();
    let ([h1, h2], [w1, w2]) = (side(height), side(width));
    jpeg.extend([0xff, 0xc0, 0, 17, 8, h1, h2, w1, w2, 3, 1, 0x21, 0, 2, 0x11, 0, 3, 0x11, 0]);
    jpeg.extend(tables());
    jpeg.extend([0xff, 0xda, 0, 12, 3, 1, 0x00, 2, 0x11, 3, 0x11, 0, 63, 0]);
    let (columns, rows) = (width.div_ceil(16) as usize, height.div_ceil(8) as usize);
    let mut bits = Bits::default();
    let mut last = [0_i32; 3];
    for row in 0..rows {
        for column in 0..columns {
            let colours = colour(row, column, columns, number);
            for (part, blocks) in [(0, 2), (1, 1), (2, 1)] {
                for _ in 0..blocks {
                    let level = i32::from(colours[part]) - 128;
                    bits.block(level - last[part], part > 0);
                    last[part] = level;
                }
            }
        }
    }
    jpeg.extend(bits.end());
    jpeg.extend([0xff, 0xd9]);
    jpeg
}

/// Bits of a scan.
#[derive(Default)]
struct Bits {
    bytes: Vec<u8>,
    waiting: u32,
    count: u32,
}

impl Bits {
    /// A block with this difference of its level, and nothing else.
    fn block(&mut self, difference: i32, is_colour: bool) {
        let category = 32 - difference.unsigned_abs().leading_zeros();
        let table = if is_colour { 2 } else { 0 };
        let (code, length) = code(table, category as u8);
        self.push(code, length);
        // Negative numbers are one less, without their sign.
        let bits = if difference < 0 { difference - 1 } else { difference };
        self.push(bits.cast_unsigned() & ((1 << category) - 1), category);
        let (end, length) = code_of_end(is_colour);
        self.push(end, length);
    }

    fn push(&mut self, bits: u32, length: u32) {
        self.waiting = (self.waiting << length) | bits;
        self.count += length;
        while self.count >= 8 {
            self.count -= 8;
            let byte = (self.waiting >> self.count) as u8;
            self.bytes.push(byte);
            if byte == 0xff {
                self.bytes.push(0); // it is no marker
            }
        }
        self.waiting &= (1 << self.count) - 1;
    }

    fn end(mut self) -> Vec<u8> {
        self.push(0x7f, 7);
        self.bytes
    }
}

fn code_of_end(is_colour: bool) -> (u32, u32) {
    code(if is_colour { 3 } else { 1 }, 0)
}

/// The code of a value in one of the tables, and its length (T.81, annex C).
fn code(table: usize, value: u8) -> (u32, u32) {
    debug_assert!(table < TABLE_NUMBERS.len());
    let (lengths, values) = TABLES[table];
    let (mut code, mut index) = (0, 0);
    for (length, count) in (1..).zip(lengths) {
        for _ in 0..count {
            if values.get(index) == Some(&value) {
                return (code, length);
            }
            code += 1;
            index += 1;
        }
        code <<= 1;
    }
    (0, 0)
}
