//! Negotiation with a driver, and the stream of its pictures.

use std::io::{self, ErrorKind};
use std::time::Duration;

use super::super::source::{Captured, Format, Frame, Granted, LONGEST_SIDE, Wanted};
use super::driver::Driver;
use crate::kernel::{
    self, BufferRequest, CAPTURE, MAPPED, i32_at, put, put_u32, text_at, u32_at, u64_at, video,
};

/// How many pictures the driver may have ready.
const BUFFERS: u32 = 4;
/// The largest picture, in bytes.
const MOST_BYTES: u32 = 256 << 20;
/// The wait for a picture is twice the time between pictures, within these bounds.
const WAIT: [Duration; 2] = [Duration::from_millis(50), Duration::from_millis(500)];
/// A stamp of the driver that is older is not believed.
const OLDEST: Duration = Duration::from_secs(10);
/// Most controls and formats that are listed.
const MOST_LISTED: u32 = 256;

const MJPG: u32 = u32::from_le_bytes(*b"MJPG");
const JPEG: u32 = u32::from_le_bytes(*b"JPEG");
const YUYV: u32 = u32::from_le_bytes(*b"YUYV");

/// Flags of `linux/videodev2.h`.
const CAP_VIDEO_CAPTURE: u32 = 1;
const CAP_STREAMING: u32 = 0x0400_0000;
const CAP_DEVICE_CAPS: u32 = 0x8000_0000;
const CAP_TIMEPERFRAME: u32 = 0x1000;
const BUF_FLAG_ERROR: u32 = 0x40;
const BUF_FLAG_TIMESTAMP_MASK: u32 = 0xe000;
const BUF_FLAG_TIMESTAMP_MONOTONIC: u32 = 0x2000;
const CTRL_FLAG_NEXT: u32 = 0x8000_0000;
const CTRL_FLAG_DISABLED: u32 = 1;
const FIELD_NONE: u32 = 1;

/// A camera that runs.
pub(super) struct Capture<D> {
    driver: D,
    patience: Duration,
    /// The length of each buffer, which bounds what is copied of it.
    lengths: Vec<u32>,
    /// Name and number of each control, asked for when they are first needed.
    controls: Option<Vec<(String, u32)>>,
}

impl<D: Driver> Capture<D> {
    /// Negotiates with the driver and starts the camera. `path` is for errors.
    pub(super) fn start(mut driver: D, path: &str, wanted: &Wanted) -> Result<(Self, Granted), String> {
        let name = capability(&mut driver, path)?;
        let mut granted = negotiate(&mut driver, path, wanted)?;
        granted.name = format!("{path} \"{name}\"");
        granted.rate_hz = negotiate_rate(&mut driver, wanted.rate_hz);
        let failed = |what: &str, error: &io::Error| match error.kind() {
            ErrorKind::ResourceBusy => {
                format!("{path} is in use by another program; end that one")
            }
            _ => format!("{path}: {what}: {error}"),
        };
        let mut buffers = [0; 20];
        put_u32(&mut buffers, 0, BUFFERS);
        put_u32(&mut buffers, 4, CAPTURE);
        put_u32(&mut buffers, 8, MAPPED);
        driver
            .request(video::REQBUFS, &mut buffers)
            .map_err(|error| failed("the driver gives no buffers", &error))?;
        let mut lengths = Vec::new();
        for index in 0..u32_at(&buffers, 0).min(32) {
            let about = driver
                .buffer(BufferRequest::Query, index)
                .map_err(|error| failed("asking for a buffer", &error))?;
            let (length, offset) = (u32_at(&about, 72), u32_at(&about, 64));
            if length == 0 || length > MOST_BYTES {
                return Err(format!(
                    "{path}: the driver has a buffer of {length} bytes, which no picture has"
                ));
            }
            driver.map(length as usize, offset.into()).map_err(|error| failed("mapping a buffer", &error))?;
            driver
                .buffer(BufferRequest::Queue, index)
                .map_err(|error| failed("queueing a buffer", &error))?;
            lengths.push(length);
        }
        if lengths.is_empty() {
            return Err(format!("{path}: the driver gives no buffers"));
        }
        let mut kind = CAPTURE.to_ne_bytes();
        driver.request(video::STREAMON, &mut kind).map_err(|error| {
            failed("the camera does not start; has its USB port power and bandwidth?", &error)
        })?;
        let rate_hz = if granted.rate_hz > 0.0 { granted.rate_hz } else { wanted.rate_hz };
        let patience = Duration::try_from_secs_f64(2.0 / rate_hz).unwrap_or(WAIT[1]).clamp(WAIT[0], WAIT[1]);
        Ok((Self { driver, patience, lengths, controls: None }, granted))
    }

    /// The newest picture.
    pub(super) fn frame(&mut self) -> Result<Option<Frame>, String> {
        let lost = |error: io::Error| match kernel::is_gone(&error) {
            true => "the camera is gone; plug it in again".to_owned(),
            false => format!("the camera stopped: {error}"),
        };
        if !self.driver.wait(self.patience).map_err(lost)? {
            return Ok(None);
        }
        let mut newest = None;
        // As many as can be ready at once, so that this ends however fast the camera is.
        for _ in 0..self.lengths.len() {
            let filled = match self.driver.buffer(BufferRequest::Dequeue, 0) {
                Ok(filled) => filled,
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) => return Err(lost(error)),
            };
            let index = u32_at(&filled, 0);
            newest = Some(self.taken(&filled));
            self.driver.buffer(BufferRequest::Queue, index).map_err(lost)?;
        }
        Ok(newest)
    }

    /// The picture in a buffer.
    fn taken(&self, filled: &[u8; 88]) -> Frame {
        let (index, used, flags) = (u32_at(filled, 0) as usize, u32_at(filled, 8), u32_at(filled, 12));
        let length = self.lengths.get(index).map_or(0, |length| used.min(*length));
        let is_monotonic = flags & BUF_FLAG_TIMESTAMP_MASK == BUF_FLAG_TIMESTAMP_MONOTONIC;
        let (seconds, microseconds) = (u64_at(filled, 24), u64_at(filled, 32));
        let age = kernel::age(seconds, microseconds.saturating_mul(1_000));
        let age = age.filter(|age| is_monotonic && *age < OLDEST).unwrap_or_default();
        Frame {
            bytes: self.driver.copy(index, length as usize),
            number: u32_at(filled, 56),
            captured: Captured::Ago(age),
            is_damaged: flags & BUF_FLAG_ERROR != 0,
        }
    }

    /// Sets a control.
    pub(super) fn control(&mut self, name: &str, value: i32) -> Result<(), String> {
        let controls = match self.controls.take() {
            Some(controls) => controls,
            None => controls(&mut self.driver),
        };
        let number = controls.iter().find(|(known, _)| known == name).map(|(_, number)| *number);
        let names: Vec<_> = controls.iter().map(|(known, _)| &**known).collect();
        let known = names.join(", ");
        let refused = match number {
            None => Some(format!("the camera has no control \"{name}\"; it has {known}")),
            Some(number) => {
                let mut bytes = [0; 8];
                put_u32(&mut bytes, 0, number);
                put(&mut bytes, 4, &value.to_ne_bytes());
                let set = self.driver.request(video::S_CTRL, &mut bytes);
                set.err().map(|error| match error.kind() {
                    ErrorKind::ResourceBusy | ErrorKind::PermissionDenied => format!(
                        "the camera does not take \"{name}\" now: {error}; an automatic control may have to be switched off first"
                    ),
                    _ => format!("the camera refuses {value} for \"{name}\": {error}"),
                })
            }
        };
        self.controls = Some(controls);
        refused.map_or(Ok(()), Err)
    }
}

/// Whether it is a camera that streams, and its name.
fn capability(driver: &mut impl Driver, path: &str) -> Result<String, String> {
    let mut bytes = [0; 104];
    driver.request(video::QUERYCAP, &mut bytes).map_err(|error| {
        if kernel::is_foreign(&error) || error.kind() == ErrorKind::InvalidInput {
            format!("{path} is no video device")
        } else {
            format!("{path}: asking what it is: {error}")
        }
    })?;
    let (all, own) = (u32_at(&bytes, 84), u32_at(&bytes, 88));
    let capabilities = if all & CAP_DEVICE_CAPS != 0 { own } else { all };
    let name = text_at(&bytes, 16, 32);
    if capabilities & CAP_VIDEO_CAPTURE == 0 {
        return Err(format!(
            "{path} \"{name}\" gives no pictures: a camera often has a second device file for metadata"
        ));
    }
    if capabilities & CAP_STREAMING == 0 {
        return Err(format!("{path} \"{name}\" cannot stream, as USB cameras do"));
    }
    Ok(name)
}

/// Agrees on a format and a size.
fn negotiate(driver: &mut impl Driver, path: &str, wanted: &Wanted) -> Result<Granted, String> {
    let mut bytes = [0; 208];
    put_u32(&mut bytes, 0, CAPTURE);
    put_u32(&mut bytes, 8, wanted.width);
    put_u32(&mut bytes, 12, wanted.height);
    let code = match wanted.format {
        Format::Mjpeg => MJPG,
        Format::Yuyv => YUYV,
    };
    put_u32(&mut bytes, 16, code);
    put_u32(&mut bytes, 20, FIELD_NONE);
    driver.request(video::S_FMT, &mut bytes).map_err(|error| match error.kind() {
        ErrorKind::ResourceBusy => format!("{path} is in use by another program; end that one"),
        _ => format!("{path}: the driver refuses any format: {error}"),
    })?;
    let format = match u32_at(&bytes, 16) {
        MJPG | JPEG => Format::Mjpeg,
        YUYV => Format::Yuyv,
        other => {
            let offered = formats(driver).join(", ");
            let other = fourcc(other);
            return Err(format!(
                "{path} gives pictures as {other}, neither MJPG nor YUYV; it offers {offered}"
            ));
        }
    };
    let (width, height, mut bytes_per_line) = (u32_at(&bytes, 8), u32_at(&bytes, 12), u32_at(&bytes, 24));
    let size = u32_at(&bytes, 28);
    let is_side = |side| (1..=LONGEST_SIDE).contains(&side);
    if !is_side(width) || !is_side(height) || size > MOST_BYTES {
        return Err(format!("{path} offers pictures of {width}x{height} pixels in {size} bytes"));
    }
    match format {
        Format::Mjpeg => bytes_per_line = 0,
        Format::Yuyv => {
            if width % 2 != 0 {
                return Err(format!("{path} offers YUYV in {width} columns, which is an odd number"));
            }
            bytes_per_line = bytes_per_line.clamp(2 * width, 4 * LONGEST_SIDE);
        }
    }
    Ok(Granted { format, width, height, bytes_per_line, ..Granted::default() })
}

/// Agrees on a rate, if the driver has one; 0 if it does not say.
fn negotiate_rate(driver: &mut impl Driver, rate_hz: f64) -> f64 {
    let mut bytes = [0; 204];
    put_u32(&mut bytes, 0, CAPTURE);
    // In thousandths, so that 29.97 can be asked for.
    put_u32(&mut bytes, 12, 1_000);
    put_u32(&mut bytes, 16, (rate_hz * 1_000.0).round() as u32);
    if driver.request(video::S_PARM, &mut bytes).is_err() || u32_at(&bytes, 4) & CAP_TIMEPERFRAME == 0 {
        return 0.0;
    }
    let (numerator, denominator) = (u32_at(&bytes, 12), u32_at(&bytes, 16));
    if numerator == 0 { 0.0 } else { f64::from(denominator) / f64::from(numerator) }
}

/// The formats that the driver offers.
fn formats(driver: &mut impl Driver) -> Vec<String> {
    let all = (0..MOST_LISTED).map_while(|index| {
        let mut bytes = [0; 64];
        put_u32(&mut bytes, 0, index);
        put_u32(&mut bytes, 4, CAPTURE);
        driver.request(video::ENUM_FMT, &mut bytes).ok()?;
        Some(format!("{} ({})", fourcc(u32_at(&bytes, 44)), text_at(&bytes, 12, 32)))
    });
    all.collect()
}

fn fourcc(code: u32) -> String {
    String::from_utf8_lossy(&code.to_le_bytes()).trim().to_owned()
}

/// Name and number of each control of the driver.
fn controls(driver: &mut impl Driver) -> Vec<(String, u32)> {
    let (mut all, mut last) = (Vec::new(), 0);
    for _ in 0..MOST_LISTED {
        let mut bytes = [0; 68];
        put_u32(&mut bytes, 0, last | CTRL_FLAG_NEXT);
        let next = driver.request(video::QUERYCTRL, &mut bytes).map(|()| u32_at(&bytes, 0));
        match next {
            Ok(number) if number > last => last = number,
            _ => break,
        }
        let is_disabled = u32_at(&bytes, 56) & CTRL_FLAG_DISABLED != 0;
        // Titles of groups have neither a range nor a value.
        let has_range = i32_at(&bytes, 44) > i32_at(&bytes, 40);
        if !is_disabled && has_range {
            all.push((name_of_control(&text_at(&bytes, 8, 32)), last));
        }
    }
    all
}

/// The name as `v4l2-ctl` writes it: "White Balance, Automatic" is `white_balance_automatic`.
fn name_of_control(title: &str) -> String {
    let mut name = String::new();
    for c in title.chars() {
        if c.is_ascii_alphanumeric() {
            name.push(c.to_ascii_lowercase());
        } else if !name.is_empty() && !name.ends_with('_') {
            name.push('_');
        }
    }
    name.trim_end_matches('_').to_owned()
}

#[cfg(test)]
#[path = "capture_tests.rs"]
mod tests;
