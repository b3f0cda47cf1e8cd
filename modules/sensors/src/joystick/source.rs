//! A joystick as a device whose exchanges are recorded, and the joysticks of this machine.

use std::fs::{self, File};
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use downbeat_device::Device;
use downbeat_executor::Time;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;

use super::events::{Axis, Button, LENGTH, Layout};
use crate::exchange;
use crate::kernel::{self, i32_at, input, name_of, text_at};

/// The most bytes that one request reads.
const MOST_BYTES: usize = 256 * LENGTH;
/// The wait for an event, unless the module sets a shorter one.
const WAIT: Duration = Duration::from_millis(40);

/// Where events come from. Failures are sentences with what to do.
pub trait Source: Send {
    /// Opens a device by its path or its name; the first joystick if that is empty.
    ///
    /// # Errors
    /// If there is no such device, or it cannot be used.
    fn open(&mut self, device: &str) -> Result<(), String>;

    /// What the open device has, and where everything stands.
    ///
    /// # Errors
    /// If the device is lost.
    fn layout(&mut self) -> Result<Layout, String>;

    /// The bytes of events that have come. Waits for `most` at most if none has.
    ///
    /// # Errors
    /// If the device is lost. It has to be opened again.
    fn read(&mut self, now: Time, most: Duration) -> Result<Vec<u8>, String>;

    /// Closes the device.
    fn close(&mut self);
}

/// A request of the module.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Open a device and tell what it has.
    Open(String),
    /// Tell where everything stands: events were lost.
    Layout,
    /// Give the events that have come.
    Read,
    /// Close the device.
    Close,
}

/// A joystick: a [`Source`] of which everything is recorded.
pub struct InputDevice {
    source: Box<dyn Source>,
    wait: Duration,
}

impl InputDevice {
    /// A joystick whose events come from there.
    #[must_use]
    pub fn new(source: impl Source + 'static) -> Self {
        Self { source: Box::new(source), wait: WAIT }
    }

    /// Sets how long a request for events waits, at most 40 ms.
    pub fn set_wait(&mut self, wait: Duration) {
        self.wait = wait.min(WAIT);
    }
}

impl Device for InputDevice {
    type Request = Request;
    type Exchange = BusExchange;
    const TOPIC: &'static str = "joystick/exchanges";

    fn exchange(&mut self, request: &Request, now: Time) -> BusExchange {
        let started = Instant::now();
        let outcome = match request {
            Request::Open(device) => {
                let opened = self.source.open(device).and_then(|()| self.source.layout());
                opened.map(|layout| Some(layout.to_text().into_bytes()))
            }
            Request::Layout => self.source.layout().map(|layout| Some(layout.to_text().into_bytes())),
            Request::Read => self
                .source
                .read(now, self.wait)
                .map(|events| Some(events).filter(|events| !events.is_empty())),
            Request::Close => {
                self.source.close();
                Ok(Some(Vec::new()))
            }
        };
        exchange::end(exchange_of(request, now), outcome, started)
    }

    fn answers(exchange: &BusExchange, request: &Request) -> bool {
        exchange::has_same_request(exchange, &exchange_of(request, Time::ZERO))
    }

    fn failed(request: &Request, now: Time, reason: &str) -> BusExchange {
        exchange::fail(exchange_of(request, now), reason)
    }
}

fn exchange_of(request: &Request, now: Time) -> BusExchange {
    let (kind, instruction) = match request {
        Request::Open(device) => (BusExchange::OPEN, name_of(device).as_bytes()),
        Request::Layout => (BusExchange::TRANSFER, &b"layout"[..]),
        Request::Read => (BusExchange::TRANSFER, &[][..]),
        Request::Close => (BusExchange::CLOSE, &[][..]),
    };
    exchange::begin(kind, instruction, now)
}

/// Joysticks of this machine, by the event devices of Linux.
#[derive(Default)]
pub struct Evdev {
    open: Option<File>,
}

/// Where the kernel lists input devices.
const CLASS: &str = "/sys/class/input";
const CLOSED: &str = "the joystick is not open";

impl Source for Evdev {
    fn open(&mut self, device: &str) -> Result<(), String> {
        self.close();
        let is_path = device.starts_with('/');
        let all = if is_path { Vec::new() } else { joysticks(Path::new(CLASS)) };
        let found = all.iter().find(|(_, name)| device.is_empty() || name == device);
        let path = if is_path || (found.is_none() && kernel::is_file(device)) {
            PathBuf::from(device)
        } else {
            let found = found.ok_or_else(|| {
                let names: Vec<_> = all.iter().map(|(_, name)| format!("\"{name}\"")).collect();
                match (device, &names[..]) {
                    ("", _) => "there is no joystick; is it plugged in, or paired?".to_owned(),
                    (device, []) => {
                        format!("there is no joystick \"{device}\"; is it plugged in, or paired?")
                    }
                    (device, _) => {
                        format!("there is no joystick \"{device}\"; there are {}", names.join(", "))
                    }
                }
            })?;
            found.0.clone()
        };
        self.open = Some(kernel::open_device(&path, false, "joystick", "input")?);
        Ok(())
    }

    fn layout(&mut self) -> Result<Layout, String> {
        let file = self.open.as_ref().ok_or(CLOSED)?;
        let lost = |error: std::io::Error| match kernel::is_foreign(&error) {
            true => "the device is no joystick: it has no events of the kernel".to_owned(),
            false => lost(&error),
        };
        let (mut name, mut keys, mut pressed, mut axes) = ([0; 256], [0; 96], [0; 96], [0; 8]);
        kernel::request(file, input::NAME, &mut name).map_err(lost)?;
        kernel::request(file, input::KEYS, &mut keys).map_err(lost)?;
        kernel::request(file, input::PRESSED, &mut pressed).map_err(lost)?;
        kernel::request(file, input::AXES, &mut axes).map_err(lost)?;
        let mut layout = Layout { name: text_at(&name, 0, 256), ..Layout::default() };
        for code in bits(&axes) {
            let mut bytes = [0; 24];
            let request = input::axis(u8::try_from(code).unwrap_or_default());
            kernel::request(file, request, &mut bytes).map_err(lost)?;
            let [value, minimum, maximum] = [0, 4, 8].map(|offset| i32_at(&bytes, offset));
            layout.axes.push(Axis { code, minimum, maximum, value });
        }
        let pressed: Vec<u16> = bits(&pressed).collect();
        // Keys of keyboards are below the buttons of mice and joysticks.
        let buttons = bits(&keys).filter(|code| *code >= 0x100);
        layout.buttons.extend(buttons.map(|code| Button { code, is_pressed: pressed.contains(&code) }));
        layout.sort();
        Ok(layout)
    }

    fn read(&mut self, _now: Time, most: Duration) -> Result<Vec<u8>, String> {
        let file = self.open.as_mut().ok_or(CLOSED)?;
        if !kernel::wait(file, most).map_err(|error| lost(&error))? {
            return Ok(Vec::new());
        }
        let mut bytes = vec![0; MOST_BYTES];
        match file.read(&mut bytes) {
            Ok(length) => bytes.truncate(length),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
                bytes.clear()
            }
            Err(error) => return Err(lost(&error)),
        }
        Ok(bytes)
    }

    fn close(&mut self) {
        self.open = None;
    }
}

fn lost(error: &std::io::Error) -> String {
    match kernel::is_gone(error) {
        true => "the joystick is gone; plug it in again, or wake it".to_owned(),
        false => format!("the joystick does not answer: {error}"),
    }
}

/// The numbers of the bits that are set.
fn bits(bytes: &[u8]) -> impl Iterator<Item = u16> {
    let numbered = (0_u16..).zip(bytes);
    numbered
        .flat_map(|(at, byte)| (0..8).filter(move |bit| byte >> bit & 1 == 1).map(move |bit| at * 8 + bit))
}

/// The joysticks of this machine, by the numbers of their devices: path and name.
fn joysticks(class: &Path) -> Vec<(PathBuf, String)> {
    let entries = fs::read_dir(class).into_iter().flatten().flatten();
    let mut all: Vec<(u32, PathBuf, String)> = entries
        .filter_map(|entry| {
            let number: u32 = entry.file_name().to_str()?.strip_prefix("event")?.parse().ok()?;
            let device = entry.path().join("device");
            let keys = fs::read_to_string(device.join("capabilities/key")).ok()?;
            let name = fs::read_to_string(device.join("name")).ok()?;
            let path = PathBuf::from(format!("/dev/input/event{number}"));
            has_joystick_buttons(&keys).then(|| (number, path, name.trim().to_owned()))
        })
        .collect();
    all.sort();
    all.into_iter().map(|(_, path, name)| (path, name)).collect()
}

/// Whether one of the bits 0x120 to 0x13f is set in words of 64 bits, the highest first: buttons of joysticks
/// and gamepads.
fn has_joystick_buttons(words: &str) -> bool {
    let word = words.split_whitespace().rev().nth(0x120 / 64);
    let word = word.and_then(|word| u64::from_str_radix(word, 16).ok());
    word.is_some_and(|word| word >> (0x120 % 64) & 0xffff_ffff != 0)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn joysticks_are_found_by_their_buttons_and_named_in_refusals() {
        let class = tempfile::tempdir().unwrap();
        let keyboard = "402000000 3803078f800d001 feffffdfffefffff fffffffffffffffe";
        let gamepad = "7cdb000000000000 0 0 0 0";
        for (number, name, keys) in
            [(12, "Pad", gamepad), (3, "Keyboard", keyboard), (5, "Stick\n", "ffff00000000 0 0 0 0")]
        {
            let device = class.path().join(format!("event{number}/device"));
            fs::create_dir_all(device.join("capabilities")).unwrap();
            fs::write(device.join("name"), name).unwrap();
            fs::write(device.join("capabilities/key"), keys).unwrap();
        }
        let expected = [("/dev/input/event5", "Stick"), ("/dev/input/event12", "Pad")];
        assert_eq!(joysticks(class.path()), expected.map(|(path, name)| (path.into(), name.to_owned())));
        assert!(joysticks(Path::new("/nowhere")).is_empty());
    }

    #[test]
    fn bits_are_counted_from_the_lowest_of_each_byte() {
        assert_eq!(bits(&[0b1000_0001, 0, 0b10]).collect::<Vec<_>>(), [0, 7, 17]);
    }

    #[test]
    fn what_is_no_joystick_is_told_with_the_remedy() {
        let mut source = Evdev::default();
        source.open("/dev/null").unwrap();
        assert!(source.layout().unwrap_err().contains("no joystick"));
        let missing = source.open("/dev/input/no-such-device").unwrap_err();
        assert!(missing.contains("is the joystick plugged in?"), "{missing}");
        let unnamed = source.open("No Such Stick").unwrap_err();
        assert!(unnamed.starts_with("there is no joystick \"No Such Stick\"; "), "{unnamed}");
        let file = source.open("Cargo.toml").unwrap_err();
        assert_eq!(file, "Cargo.toml is a regular file, not the device file of a joystick");
        assert_eq!(source.read(Time::ZERO, Duration::ZERO), Err(CLOSED.to_owned()));
    }
}
