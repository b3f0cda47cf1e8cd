//! Pictures of data sets: files of JPEG or PNG as a camera sent them, and PNG of what came as pixels.

use std::borrow::Cow;
use std::io::Cursor;

use bytes::Bytes;
use downbeat_msgs::sensor_msgs::msg::{CompressedImage, Image};
use downbeat_pictures::Picture;
use downbeat_pictures::jpeg::{self, Head};

/// A picture as a file in memory.
pub(super) struct PictureFile {
    pub(super) bytes: Bytes,
    /// Width and height.
    pub(super) size: [usize; 2],
    /// Red, green, blue, if the picture came so.
    rgb: Option<Vec<u8>>,
}

/// What a picture may take when it is decoded.
const MOST_BYTES: usize = 256 << 20;

impl PictureFile {
    /// Encodes pixels.
    pub(super) fn of_pixels(image: &Image) -> Result<Self, String> {
        let picture = Picture::of(image).map_err(|error| error.to_string())?;
        let (size, rgb) = ([picture.width(), picture.height()], picture.to_rgb());
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, image.width, image.height);
        encoder.set_color(png::ColorType::Rgb);
        // A data set is read more often than written, but it is pictures of cameras: noise.
        encoder.set_compression(png::Compression::Fast);
        let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(&rgb));
        written.map_err(|error| error.to_string())?;
        Ok(Self { bytes: bytes.into(), size, rgb: Some(rgb) })
    }

    /// Takes over a file.
    pub(super) fn of_file(image: CompressedImage) -> Result<Self, String> {
        let size = size(&image.data)?;
        Ok(Self { bytes: image.data.into(), size, rgb: None })
    }

    /// Red, green and blue of each pixel, row by row.
    pub(super) fn rgb(&self) -> Result<Cow<'_, [u8]>, String> {
        match &self.rgb {
            Some(rgb) => Ok(Cow::Borrowed(rgb)),
            None if is_png(&self.bytes) => decode_png(&self.bytes).map(Cow::Owned),
            None => jpeg::decode(&self.bytes, &Head::of(&self.bytes)?).map(Cow::Owned),
        }
    }
}

/// The name of the format of a file, for `sensor_msgs/CompressedImage`.
pub(super) fn format(file: &[u8]) -> &'static str {
    if is_png(file) { "png" } else { "jpeg" }
}

fn is_png(file: &[u8]) -> bool {
    file.starts_with(b"\x89PNG")
}

fn size(file: &[u8]) -> Result<[usize; 2], String> {
    let (width, height) = if is_png(file) {
        let reader = png::Decoder::new(Cursor::new(file)).read_info().map_err(|error| error.to_string())?;
        reader.info().size()
    } else {
        let head = Head::of(file).map_err(|_| "it is neither JPEG nor PNG".to_owned())?;
        (head.width, head.height)
    };
    if u64::from(width) * u64::from(height) * 3 > MOST_BYTES as u64 {
        return Err(format!("a picture of {width} x {height} pixels is too large"));
    }
    Ok([width as usize, height as usize])
}

fn decode_png(file: &[u8]) -> Result<Vec<u8>, String> {
    let decode = || {
        let limits = png::Limits { bytes: MOST_BYTES };
        let mut decoder = png::Decoder::new_with_limits(Cursor::new(file), limits);
        decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
        let mut reader = decoder.read_info()?;
        let size = reader.output_buffer_size().filter(|size| *size <= MOST_BYTES);
        let mut pixels = vec![0; size.ok_or(png::DecodingError::LimitsExceeded)?];
        let info = reader.next_frame(&mut pixels)?;
        pixels.truncate(info.buffer_size());
        Ok((info.color_type, pixels))
    };
    let (colour, pixels) = decode().map_err(|error: png::DecodingError| error.to_string())?;
    let every = |size: usize| pixels.chunks_exact(size).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]);
    Ok(match colour {
        png::ColorType::Rgb => pixels,
        png::ColorType::Rgba => every(4).collect(),
        // With or without how opaque it is.
        grey => pixels.chunks_exact(grey.samples()).flat_map(|pixel| [pixel[0]; 3]).collect(),
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use downbeat_pictures::pattern;

    #[test]
    fn pixels_become_a_png_of_the_same_pixels() {
        let data = pattern::yuyv(64, 32, 3);
        let image =
            Image { width: 64, height: 32, encoding: "yuyv".into(), step: 128, data, ..Image::default() };
        let file = PictureFile::of_pixels(&image).unwrap();
        assert_eq!((file.size, format(&file.bytes)), ([64, 32], "png"));
        let compressed = CompressedImage { data: file.bytes.to_vec(), ..CompressedImage::default() };
        let read = PictureFile::of_file(compressed).unwrap();
        assert_eq!((read.size, &*read.rgb().unwrap()), (file.size, &*file.rgb().unwrap()));
    }

    #[test]
    fn a_jpeg_stays_as_it_is_and_other_files_are_refused() {
        let jpeg = pattern::jpeg(64, 32, 3);
        let file = |data: &[u8]| CompressedImage { data: data.to_vec(), ..CompressedImage::default() };
        let read = PictureFile::of_file(file(&jpeg)).unwrap();
        assert_eq!((&read.bytes[..], read.size, format(&jpeg)), (&jpeg[..], [64, 32], "jpeg"));
        assert_eq!(read.rgb().unwrap().len(), 64 * 32 * 3);
        assert_eq!(PictureFile::of_file(file(b"GIF89a")).err().unwrap(), "it is neither JPEG nor PNG");
        assert!(PictureFile::of_file(file(b"\x89PNG\r\n")).is_err());
        // Height and width stand behind the marker of the frame.
        let at = jpeg.windows(2).position(|pair| pair == [0xff, 0xc0]).unwrap() + 5;
        let mut huge = jpeg;
        huge[at..at + 4].fill(0xff);
        assert_eq!(
            PictureFile::of_file(file(&huge)).err().unwrap(),
            "a picture of 65535 x 65535 pixels is too large"
        );
    }
}
