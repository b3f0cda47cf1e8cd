//! Pictures as they come from cameras.

use downbeat_msgs::sensor_msgs::msg::Image;

/// How a pixel is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// Red, green, blue.
    Rgb8,
    /// Blue, green, red.
    Bgr8,
    /// Two pixels in four bytes: U Y V Y (`yuv422`, `uyvy`).
    Uyvy,
    /// Two pixels in four bytes: Y U Y V (`yuv422_yuy2`, `yuyv`).
    Yuyv,
    /// Red, green, blue, and how opaque it is.
    Rgba8,
    /// Blue, green, red, and how opaque it is.
    Bgra8,
    /// Brightness.
    Mono8,
}

/// Why a picture is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PictureError {
    /// Its encoding is not supported.
    #[error("the encoding \"{0}\" is not supported; set the camera to rgb8, bgr8, yuv422 or yuv422_yuy2")]
    Encoding(String),
    /// It has no colours.
    #[error(
        "the picture has no colours (mono8); what is looked for is found by its colour: set the camera to rgb8 or yuv422_yuy2"
    )]
    Mono,
    /// Its size is not possible.
    #[error(
        "a picture of {0} x {1} pixels; 16 x 16 to 4096 x 4096 are possible, and an even width for yuv422"
    )]
    Size(u32, u32),
    /// It has fewer bytes than its header says.
    #[error("the picture has {found} bytes, its header declares {declared}: the camera driver cuts it off")]
    Short {
        /// Its bytes.
        found: usize,
        /// What step and height need.
        declared: usize,
    },
}

/// A picture whose size and bytes agree.
#[derive(Clone, Copy, Debug)]
pub struct Picture<'a> {
    width: usize,
    height: usize,
    step: usize,
    encoding: Encoding,
    data: &'a [u8],
}

impl<'a> Picture<'a> {
    /// A picture, row by row from the top; `step` is the number of bytes from row to row.
    ///
    /// # Errors
    /// [`PictureError::Size`] and [`PictureError::Short`].
    pub fn new(
        size: [u32; 2],
        step: usize,
        encoding: Encoding,
        data: &'a [u8],
    ) -> Result<Self, PictureError> {
        let [width, height] = size;
        let is_odd = matches!(encoding, Encoding::Uyvy | Encoding::Yuyv) && width % 2 == 1;
        if !(16..=4096).contains(&width) || !(16..=4096).contains(&height) || is_odd {
            return Err(PictureError::Size(width, height));
        }
        let (width, height) = (width as usize, height as usize);
        let row = width * encoding.bytes();
        let declared = step.max(row).saturating_mul(height);
        if step < row || data.len() < declared {
            return Err(PictureError::Short { found: data.len(), declared });
        }
        Ok(Self { width, height, step, encoding, data })
    }

    /// The picture of a message.
    ///
    /// # Errors
    /// [`PictureError`].
    pub fn of(image: &'a Image) -> Result<Self, PictureError> {
        let encoding = match image.encoding.to_ascii_lowercase().as_str() {
            "rgb8" => Encoding::Rgb8,
            "bgr8" => Encoding::Bgr8,
            "rgba8" => Encoding::Rgba8,
            "bgra8" => Encoding::Bgra8,
            "mono8" | "8uc1" => Encoding::Mono8,
            "yuv422" | "uyvy" => Encoding::Uyvy,
            "yuv422_yuy2" | "yuyv" => Encoding::Yuyv,
            _ => return Err(PictureError::Encoding(image.encoding.chars().take(32).collect())),
        };
        Self::new([image.width, image.height], image.step as usize, encoding, &image.data)
    }

    /// The picture, if it has colours.
    ///
    /// # Errors
    /// [`PictureError::Mono`].
    pub fn with_colours(self) -> Result<Self, PictureError> {
        if self.encoding == Encoding::Mono8 { Err(PictureError::Mono) } else { Ok(self) }
    }

    /// Columns.
    #[must_use]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[must_use]
    pub fn height(&self) -> usize {
        self.height
    }

    /// All pixels, row by row: red, green, blue.
    #[must_use]
    pub fn to_rgb(&self) -> Vec<u8> {
        let mut rgb = Vec::with_capacity(3 * self.width * self.height);
        self.each_pixel(|_, pixel| rgb.extend(pixel));
        rgb
    }

    /// Calls back with the index of each pixel, row by row, and its red, green and blue.
    pub fn each_pixel(&self, mut take: impl FnMut(usize, [u8; 3])) {
        let width = self.width;
        for (row, bytes) in self.data.chunks_exact(self.step).take(self.height).enumerate() {
            let first = row * width;
            match self.encoding {
                Encoding::Rgb8 => {
                    for (column, pixel) in bytes.chunks_exact(3).take(width).enumerate() {
                        take(first + column, [pixel[0], pixel[1], pixel[2]]);
                    }
                }
                Encoding::Bgr8 => {
                    for (column, pixel) in bytes.chunks_exact(3).take(width).enumerate() {
                        take(first + column, [pixel[2], pixel[1], pixel[0]]);
                    }
                }
                Encoding::Rgba8 => {
                    for (column, pixel) in bytes.chunks_exact(4).take(width).enumerate() {
                        take(first + column, [pixel[0], pixel[1], pixel[2]]);
                    }
                }
                Encoding::Bgra8 => {
                    for (column, pixel) in bytes.chunks_exact(4).take(width).enumerate() {
                        take(first + column, [pixel[2], pixel[1], pixel[0]]);
                    }
                }
                Encoding::Mono8 => {
                    for (column, level) in bytes.iter().take(width).enumerate() {
                        take(first + column, [*level; 3]);
                    }
                }
                Encoding::Uyvy | Encoding::Yuyv => {
                    for (pair, four) in bytes.chunks_exact(4).take(width / 2).enumerate() {
                        let [left, right, u, v] = match self.encoding {
                            Encoding::Uyvy => [four[1], four[3], four[0], four[2]],
                            _ => [four[0], four[2], four[1], four[3]],
                        };
                        take(first + 2 * pair, rgb(left, u, v));
                        take(first + 2 * pair + 1, rgb(right, u, v));
                    }
                }
            }
        }
    }
}

impl Encoding {
    fn bytes(self) -> usize {
        match self {
            Self::Rgb8 | Self::Bgr8 => 3,
            Self::Uyvy | Self::Yuyv => 2,
            Self::Rgba8 | Self::Bgra8 => 4,
            Self::Mono8 => 1,
        }
    }
}

/// BT.601 with the full range, as webcams send it.
fn rgb(y: u8, u: u8, v: u8) -> [u8; 3] {
    let (y, u, v) = (i32::from(y) << 10, i32::from(u) - 128, i32::from(v) - 128);
    [y + 1436 * v, y - 352 * u - 731 * v, y + 1815 * u].map(|part| (part >> 10).clamp(0, 255) as u8)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn encodings_give_the_same_colours() {
        let orange = [230_u8, 90, 20];
        let (r, g, b) = (230.0, 90.0, 20.0);
        let y = 0.299 * r + 0.587 * g + 0.114 * b;
        let (u, v) = ((b - y) / 1.772 + 128.0, (r - y) / 1.402 + 128.0);
        let [y, u, v] = [y, u, v].map(|part: f64| part.round() as u8);
        for (encoding, group) in [
            (Encoding::Rgb8, orange.repeat(2)),
            (Encoding::Bgr8, [20, 90, 230].repeat(2)),
            (Encoding::Uyvy, vec![u, y, v, y]),
            (Encoding::Yuyv, vec![y, u, y, v]),
            (Encoding::Rgba8, [230, 90, 20, 255].repeat(2)),
            (Encoding::Bgra8, [20, 90, 230, 7].repeat(2)),
        ] {
            let data = group.repeat(8 * 16);
            let picture = Picture::new([16, 16], data.len() / 16, encoding, &data).unwrap();
            let mut count = 0;
            picture.each_pixel(|index, found| {
                assert_eq!(index, count);
                count += 1;
                assert!(found.iter().zip(orange).all(|(one, other)| one.abs_diff(other) <= 3), "{found:?}");
            });
            assert_eq!(count, 256);
        }
    }

    #[test]
    fn pictures_that_contradict_their_header_are_refused() {
        let image = |encoding: &str, width, height, step, bytes| Image {
            encoding: encoding.to_owned(),
            width,
            height,
            step,
            data: vec![0; bytes],
            ..Image::default()
        };
        let refused = |image: &Image| Picture::of(image).err().unwrap().to_string();
        let grey = image("mono8", 320, 240, 320, 76_800);
        let problem = Picture::of(&grey).unwrap().with_colours().unwrap_err();
        assert!(problem.to_string().contains("set the camera to rgb8"));
        assert!(refused(&image("32FC1", 320, 240, 1280, 1)).contains("not supported"));
        assert!(refused(&image("rgb8", u32::MAX, u32::MAX, u32::MAX, 3)).contains("4096"));
        assert!(refused(&image("rgb8", 320, 240, 960, 100)).contains("has 100 bytes"));
        assert!(refused(&image("rgb8", 320, 240, 3, 960 * 240)).contains("declares"));
        assert!(refused(&image("yuv422", 321, 240, 642, 642 * 240)).contains("even width"));
    }
}
