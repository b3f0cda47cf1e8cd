//! An emulated camera: pictures of files, or a pattern.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use downbeat_executor::Time;
use downbeat_pictures::jpeg::Head;
use downbeat_pictures::pattern;

use super::source::{Captured, Format, Frame, Granted, LONGEST_SIDE, Source, Wanted};

/// The largest file, in bytes.
const MOST_BYTES: u64 = 64 << 20;

/// An emulated camera that shows a JPEG file, those of a folder in turn, or, without a device, bars of
/// colours with a moving square.
///
/// Which picture it gives depends on the time of the core only. Files are read each time, so that a folder
/// that is moved away is a camera that was unplugged.
#[derive(Debug, Default)]
pub struct Pictures {
    open: Option<Open>,
}

#[derive(Debug)]
struct Open {
    wanted: Wanted,
    granted: Granted,
    /// The time of the first request, from which pictures are counted.
    start: Option<Time>,
    /// The number of the last picture.
    last: Option<u32>,
}

impl Source for Pictures {
    fn open(&mut self, wanted: &Wanted) -> Result<Granted, String> {
        let (width, height) = if wanted.device.is_empty() {
            (wanted.width.clamp(2, LONGEST_SIDE) & !1, wanted.height.clamp(1, LONGEST_SIDE))
        } else {
            if wanted.format != Format::Mjpeg {
                return Err("pictures of files come as \"mjpeg\" only".to_owned());
            }
            let path = picture(&wanted.device, 0)?;
            let head = Head::of(&read(&path)?).map_err(|why| format!("{}: {why}", path.display()))?;
            (head.width, head.height)
        };
        let granted = Granted {
            format: wanted.format,
            width,
            height,
            bytes_per_line: if wanted.format == Format::Yuyv { width * 2 } else { 0 },
            rate_hz: wanted.rate_hz,
            name: match &*wanted.device {
                "" => "a pattern".to_owned(),
                device => device.to_owned(),
            },
        };
        self.open = Some(Open { wanted: wanted.clone(), granted: granted.clone(), start: None, last: None });
        Ok(granted)
    }

    fn frame(&mut self, now: Time) -> Result<Option<Frame>, String> {
        let Some(open) = &mut self.open else { return Err("the camera is not open".to_owned()) };
        let start = *open.start.get_or_insert(now);
        let number = (now.saturating_since(start).as_secs_f64() * open.wanted.rate_hz + 1e-6) as u32;
        if open.last.is_some_and(|last| last >= number) {
            return Ok(None);
        }
        open.last = Some(number);
        let Granted { format, width, height, .. } = open.granted;
        let bytes = match (&*open.wanted.device, format) {
            ("", Format::Mjpeg) => pattern::jpeg(width, height, number),
            ("", Format::Yuyv) => pattern::yuyv(width, height, number),
            (device, _) => read(&picture(device, number as usize)?)?,
        };
        Ok(Some(Frame { bytes, number, captured: Captured::At(now), is_damaged: false }))
    }

    fn control(&mut self, name: &str, _value: i32) -> Result<(), String> {
        Err(format!("an emulated camera has no control \"{name}\""))
    }

    fn close(&mut self) {
        self.open = None;
    }
}

/// The file with the picture `number`: `device` itself, or a file in the folder `device`.
fn picture(device: &str, number: usize) -> Result<PathBuf, String> {
    let path = Path::new(device);
    if !path.is_dir() {
        return Ok(path.to_owned());
    }
    let entries = fs::read_dir(path).map_err(|error| format!("reading {device}: {error}"))?;
    let is_picture = |path: &PathBuf| {
        let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
        ["jpg", "jpeg"].iter().any(|known| extension.eq_ignore_ascii_case(known))
    };
    let mut all: Vec<_> = entries.flatten().map(|entry| entry.path()).filter(is_picture).collect();
    all.sort();
    let count = all.len().max(1);
    let none = || format!("the folder {device} has no picture: no file that ends in .jpg or .jpeg");
    all.into_iter().nth(number % count).ok_or_else(none)
}

fn read(path: &Path) -> Result<Vec<u8>, String> {
    let failed = |error: std::io::Error| format!("reading the picture {}: {error}", path.display());
    let mut bytes = Vec::new();
    File::open(path).map_err(failed)?.take(MOST_BYTES).read_to_end(&mut bytes).map_err(failed)?;
    Ok(bytes)
}
