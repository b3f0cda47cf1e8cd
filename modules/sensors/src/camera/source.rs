//! A camera as a device whose exchanges are recorded: what is asked of it, and who answers.

use std::fmt::Write;
use std::str::FromStr;
use std::time::{Duration, Instant};

use downbeat_device::Device;
use downbeat_executor::Time;
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;

use crate::exchange;
use crate::kernel::name_of;

/// How pictures come from the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Format {
    /// Each picture a JPEG.
    #[default]
    Mjpeg,
    /// Two pixels in four bytes: Y, U, Y, V.
    Yuyv,
}

impl Format {
    /// The name in settings.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Mjpeg => "mjpeg",
            Self::Yuyv => "yuyv",
        }
    }
}

impl FromStr for Format {
    type Err = ();

    fn from_str(name: &str) -> Result<Self, ()> {
        [Self::Mjpeg, Self::Yuyv].into_iter().find(|format| format.name() == name).ok_or(())
    }
}

/// What a camera is asked for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Wanted {
    /// A device file, or a camera's name; of an emulated camera a picture, or a folder of pictures.
    pub device: String,
    /// How pictures come.
    pub format: Format,
    /// In pixels.
    pub width: u32,
    /// In pixels.
    pub height: u32,
    /// Pictures per second.
    pub rate_hz: f64,
}

/// What the camera gives.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Granted {
    /// How pictures come.
    pub format: Format,
    /// In pixels.
    pub width: u32,
    /// In pixels.
    pub height: u32,
    /// From one row to the next, of [`Format::Yuyv`].
    pub bytes_per_line: u32,
    /// Pictures per second; 0 if the camera does not say.
    pub rate_hz: f64,
    /// The device file and the name of the camera.
    pub name: String,
}

/// The longest side of a picture, in pixels.
pub const LONGEST_SIDE: u32 = 16_384;

impl Granted {
    /// As a text, in the recording of a camera.
    fn to_text(&self) -> String {
        let Self { format, width, height, bytes_per_line, rate_hz, name } = self;
        let format = format.name();
        format!("{format} {width}x{height} bytes_per_line={bytes_per_line} rate_hz={rate_hz} {name}")
    }

    /// Reads such a text, which may be of a damaged recording.
    fn from_text(text: &str) -> Option<Self> {
        let mut parts = text.splitn(5, ' ');
        let format = parts.next()?.parse().ok()?;
        let (width, height) = parts.next()?.split_once('x')?;
        let bytes_per_line = parts.next()?.strip_prefix("bytes_per_line=")?.parse().ok()?;
        let rate_hz: f64 = parts.next()?.strip_prefix("rate_hz=")?.parse().ok()?;
        let name = parts.next()?.to_owned();
        let side = |text: &str| text.parse().ok().filter(|side| (1..=LONGEST_SIDE).contains(side));
        let (width, height) = (side(width)?, side(height)?);
        rate_hz.is_finite().then_some(Self { format, width, height, bytes_per_line, rate_hz, name })
    }
}

/// A picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// As the camera sent it.
    pub bytes: Vec<u8>,
    /// The number that the driver gave it: numbers that are missing are pictures that were lost.
    pub number: u32,
    /// When it was taken.
    pub captured: Captured,
    /// The driver says that bytes are missing or wrong.
    pub is_damaged: bool,
}

/// When a picture was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Captured {
    /// That long ago.
    Ago(Duration),
    /// At this time of the core.
    At(Time),
}

/// Where pictures come from. Failures are sentences with what to do.
pub trait Source: Send {
    /// Opens the camera and starts it.
    ///
    /// # Errors
    /// If there is no such camera, or it cannot be used.
    fn open(&mut self, wanted: &Wanted) -> Result<Granted, String>;

    /// The newest picture that was not taken yet. Waits for a bounded time; `None` if none came.
    ///
    /// # Errors
    /// If the camera is lost. It has to be opened again.
    fn frame(&mut self, now: Time) -> Result<Option<Frame>, String>;

    /// Sets a control, such as the gain.
    ///
    /// # Errors
    /// If the camera has no such control, or refuses the value.
    fn control(&mut self, name: &str, value: i32) -> Result<(), String>;

    /// Stops the camera and closes it.
    fn close(&mut self);
}

/// A request of the module.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// Open the camera.
    Open(Wanted),
    /// Give the newest picture.
    Frame,
    /// Set a control.
    Control(String, i32),
    /// Close the camera.
    Close,
}

/// A camera: a [`Source`] of which everything is recorded.
pub struct VideoDevice {
    source: Box<dyn Source>,
}

impl VideoDevice {
    /// A camera that takes its pictures from there.
    #[must_use]
    pub fn new(source: impl Source + 'static) -> Self {
        Self { source: Box::new(source) }
    }
}

impl Device for VideoDevice {
    type Request = Request;
    type Exchange = BusExchange;
    const TOPIC: &'static str = "camera/exchanges";

    fn exchange(&mut self, request: &Request, now: Time) -> BusExchange {
        let started = Instant::now();
        let exchange = exchange_of(request, now);
        let mut exchange = match request {
            Request::Open(wanted) => match self.source.open(wanted) {
                Ok(granted) => BusExchange { reply: granted.to_text().into_bytes(), ..exchange },
                Err(reason) => exchange::fail(exchange, reason),
            },
            Request::Frame => match self.source.frame(now) {
                Ok(Some(frame)) => {
                    let stamp = match frame.captured {
                        Captured::Ago(age) => {
                            let since = i64::try_from(started.elapsed().as_nanos()).unwrap_or_default();
                            let age = i64::try_from(age.as_nanos()).unwrap_or_default();
                            now.as_nanos().saturating_add(since).saturating_sub(age)
                        }
                        Captured::At(time) => time.as_nanos(),
                    };
                    let (outcome, error) = match frame.is_damaged {
                        true => (BusExchange::TIMEOUT, "the driver marks this picture as damaged".to_owned()),
                        false => (BusExchange::OK, String::new()),
                    };
                    let (stamp, sequence) = (Stamp::from_nanos(stamp), frame.number.into());
                    BusExchange { stamp, sequence, outcome, error, reply: frame.bytes, ..exchange }
                }
                Ok(None) => BusExchange { outcome: BusExchange::TIMEOUT, ..exchange },
                Err(reason) => exchange::fail(exchange, reason),
            },
            Request::Control(name, value) => match self.source.control(name, *value) {
                Ok(()) => exchange,
                Err(reason) => exchange::fail(exchange, reason),
            },
            Request::Close => {
                self.source.close();
                exchange
            }
        };
        exchange.duration_us = exchange::microseconds_since(started);
        exchange
    }

    fn answers(exchange: &BusExchange, request: &Request) -> bool {
        exchange::has_same_request(exchange, &exchange_of(request, Time::ZERO))
    }

    fn failed(request: &Request, now: Time, reason: &str) -> BusExchange {
        exchange::fail(exchange_of(request, now), reason)
    }
}

fn exchange_of(request: &Request, now: Time) -> BusExchange {
    let mut instruction = String::new();
    let kind = match request {
        Request::Open(Wanted { device, format, width, height, rate_hz }) => {
            let (format, device) = (format.name(), name_of(device));
            // Writing to a string does not fail.
            let _ = write!(instruction, "{format} {width}x{height} rate_hz={rate_hz} {device}");
            BusExchange::OPEN
        }
        Request::Frame => BusExchange::TRANSFER,
        Request::Control(name, value) => {
            let _ = write!(instruction, "{name}={value}");
            BusExchange::TRANSFER
        }
        Request::Close => BusExchange::CLOSE,
    };
    exchange::begin(kind, instruction, now)
}

/// What the answer to [`Request::Open`] says.
pub(super) fn granted(exchange: &BusExchange) -> Result<Granted, String> {
    if exchange.outcome != BusExchange::OK {
        return Err(exchange.error.clone());
    }
    let text = std::str::from_utf8(&exchange.reply).ok().and_then(Granted::from_text);
    text.ok_or_else(|| "the recording has no valid answer to the request for a format".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_granted_survives_being_recorded_and_damage_is_an_error() {
        let all = Granted {
            format: Format::Yuyv,
            width: 640,
            height: 480,
            bytes_per_line: 1_280,
            rate_hz: 7.5,
            name: "/dev/video2 \"A  Camera\"".to_owned(),
        };
        let text = all.to_text();
        assert_eq!(text, "yuyv 640x480 bytes_per_line=1280 rate_hz=7.5 /dev/video2 \"A  Camera\"");
        assert_eq!(Granted::from_text(&text), Some(all));
        for damaged in ["", "yuyv", "yuyv 0x480 bytes_per_line=0 rate_hz=0 x", &text.replace("640", "90000")]
        {
            assert_eq!(Granted::from_text(damaged), None, "{damaged}");
        }
        assert_eq!(Granted::from_text(&text.replace("7.5", "NaN")), None);
    }
}
