//! Pictures in YUYV, which cameras send without compression.

/// The pixels of YUYV as RGB, by ITU-R BT.601 with the range 16 to 235, as UVC cameras have it. `rows` holds
/// whole rows of `bytes_per_line` bytes.
pub(super) fn to_rgb(rows: &[u8], width: usize, bytes_per_line: usize) -> Vec<u8> {
    let mut rgb = Vec::with_capacity(rows.len() / bytes_per_line.max(1) * width * 3);
    for row in rows.chunks_exact(bytes_per_line.max(1)) {
        for pair in row.chunks_exact(4).take(width / 2) {
            let [y0, u, y1, v] = [0, 1, 2, 3].map(|at| i32::from(pair[at]));
            let (u, v) = (u - 128, v - 128);
            for y in [y0, y1] {
                let y = 298 * (y - 16) + 128;
                let colours = [y + 409 * v, y - 100 * u - 208 * v, y + 516 * u];
                rgb.extend(colours.map(|colour| (colour >> 8).clamp(0, 255) as u8));
            }
        }
    }
    rgb
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of ITU-R BT.601: black, white, and the primary colours of 75 % bars.
    #[test]
    fn yuyv_becomes_rgb_by_bt_601_and_lines_may_be_longer_than_pixels() {
        let rows = [16, 128, 235, 128, 9, 9, 65, 100, 65, 212, 9, 9];
        let rgb = to_rgb(&rows, 2, 6);
        assert_eq!(rgb[..6], [0, 0, 0, 255, 255, 255]);
        assert_eq!(rgb[6..9], [191, 0, 1]);
        assert!(to_rgb(&[1, 2, 3], 2, 4).is_empty());
    }
}
