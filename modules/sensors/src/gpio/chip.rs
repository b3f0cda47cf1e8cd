//! GPIO chips by their character devices, version 2 of the interface (since Linux 5.10).
//!
//! # References
//! "GPIO Character Device Userspace API" of the Linux documentation; `linux/gpio.h`.

use std::fs::{self, File};
use std::io::{self, ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::lines::{Bias, Drive, Line, Use};
use super::source::{Edge, Source};
use crate::kernel::{self, gpio, put, put_u32, put_u64, text_at, u32_at, u64_at};

/// How long a request for changes waits for the first one.
const WAIT: Duration = Duration::from_millis(5);
/// The length of a change of the kernel.
const EVENT: usize = 48;
/// The most changes of one line that are read at once.
const MOST_EVENTS: usize = 16;
/// The most lines of a chip that are searched for a name.
const MOST_SEARCHED: u32 = 4_096;

/// Flags of `linux/gpio.h`.
const USED: u64 = 1;
const ACTIVE_LOW: u64 = 2;
const INPUT: u64 = 4;
const OUTPUT: u64 = 8;
const BOTH_EDGES: u64 = 0x10 | 0x20;
const OPEN_DRAIN: u64 = 0x40;
const OPEN_SOURCE: u64 = 0x80;
const PULL_UP: u64 = 0x100;
const PULL_DOWN: u64 = 0x200;
const BIAS_DISABLED: u64 = 0x400;
const ATTRIBUTE_VALUES: u32 = 2;
const ATTRIBUTE_DEBOUNCE: u32 = 3;
const RISING: u32 = 1;

/// A GPIO chip of this machine.
#[derive(Default)]
pub struct Chip {
    requested: Vec<Requested>,
}

/// A line that is this program's.
struct Requested {
    file: File,
    is_input: bool,
    last_number: u32,
}

impl Source for Chip {
    fn open(&mut self, chip: &str, lines: &[Line]) -> Result<Vec<bool>, String> {
        self.close();
        let path = path_of(chip)?;
        let at = path.display();
        let file = kernel::open_device(&path, true, "GPIO chip", "gpio")?;
        let mut about = [0; 68];
        kernel::request(&file, gpio::CHIP_INFO, &mut about).map_err(|error| {
            match kernel::is_foreign(&error) {
                true => format!("{at} is no GPIO chip"),
                false => format!("{at}: asking what it is: {error}"),
            }
        })?;
        let count = u32_at(&about, 64);
        let mut values = Vec::with_capacity(lines.len());
        for line in lines {
            let offset = offset_of(&file, &path, line, count)?;
            let requested = gpio::request_line(&file, &mut request_of(line, offset));
            let requested = requested.map_err(|error| refused(&file, &path, line, offset, &error))?;
            let mut value = [0; 16];
            put_u64(&mut value, 8, 1);
            kernel::request(&requested, gpio::GET_VALUES, &mut value).map_err(|error| lost(&error))?;
            values.push(u64_at(&value, 0) & 1 == 1);
            let is_input = matches!(line.purpose, Use::Input { .. });
            self.requested.push(Requested { file: requested, is_input, last_number: 0 });
        }
        Ok(values)
    }

    fn edges(&mut self) -> Result<Vec<Edge>, String> {
        let inputs: Vec<_> =
            self.requested.iter().filter(|line| line.is_input).map(|line| &line.file).collect();
        if inputs.is_empty() || !kernel::wait_for_any(&inputs, WAIT).map_err(|error| lost(&error))? {
            return Ok(Vec::new());
        }
        let mut edges = Vec::new();
        for (index, line) in self.requested.iter_mut().enumerate().filter(|(_, line)| line.is_input) {
            let mut bytes = [0; EVENT * MOST_EVENTS];
            if !kernel::wait(&line.file, Duration::ZERO).map_err(|error| lost(&error))? {
                continue; // reading would wait
            }
            let length = match line.file.read(&mut bytes) {
                Ok(length) => length,
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => 0,
                Err(error) => return Err(lost(&error)),
            };
            let read = bytes.get(..length).unwrap_or_default();
            edges.extend(read.chunks_exact(EVENT).map(|event| line.edge(index, event)));
        }
        // The oldest first.
        edges.sort_by_key(|edge| std::cmp::Reverse(edge.age_ns));
        Ok(edges)
    }

    fn set(&mut self, line: usize, is_true: bool) -> Result<(), String> {
        let requested = self.requested.get(line).ok_or("the lines are not requested")?;
        let mut values = [0; 16];
        put_u64(&mut values, 0, is_true.into());
        put_u64(&mut values, 8, 1);
        kernel::request(&requested.file, gpio::SET_VALUES, &mut values).map_err(|error| lost(&error))
    }

    fn close(&mut self) {
        self.requested.clear();
    }
}

impl Requested {
    /// A change, by its `gpio_v2_line_event`.
    fn edge(&mut self, index: usize, event: &[u8]) -> Edge {
        let (time, kind, number) = (u64_at(event, 0), u32_at(event, 8), u32_at(event, 20));
        let age = kernel::age(time / 1_000_000_000, time % 1_000_000_000).unwrap_or_default();
        let lost = number.wrapping_sub(self.last_number).saturating_sub(1);
        self.last_number = number;
        Edge {
            age_ns: age.as_nanos().try_into().unwrap_or_default(),
            line: index.try_into().unwrap_or(u16::MAX),
            is_true: kind == RISING,
            lost,
        }
    }
}

fn lost(error: &io::Error) -> String {
    match kernel::is_gone(error) {
        true => "the GPIO chip is gone; plug it in again".to_owned(),
        false => format!("the GPIO chip does not answer: {error}"),
    }
}

/// The device file of a chip that is named by its path or its label.
fn path_of(chip: &str) -> Result<PathBuf, String> {
    if chip.starts_with('/') {
        return Ok(PathBuf::from(chip));
    }
    let mut all = Vec::new();
    let entries = fs::read_dir("/dev").into_iter().flatten().flatten();
    let is_chip = |name: &str| {
        name.strip_prefix("gpiochip").is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit()))
    };
    for entry in entries.filter(|entry| entry.file_name().to_str().is_some_and(is_chip)) {
        let mut about = [0; 68];
        let label = kernel::open_device(&entry.path(), true, "GPIO chip", "gpio").ok().and_then(|file| {
            kernel::request(&file, gpio::CHIP_INFO, &mut about).ok()?;
            Some(text_at(&about, 32, 32))
        });
        if label.as_deref() == Some(chip) {
            return Ok(entry.path());
        }
        all.push(format!("{} \"{}\"", entry.path().display(), label.unwrap_or_default()));
    }
    all.sort();
    if kernel::is_file(chip) {
        return Ok(PathBuf::from(chip));
    }
    match all.is_empty() {
        true => Err(format!("there is no GPIO chip \"{chip}\", nor any other")),
        false => Err(format!("there is no GPIO chip \"{chip}\"; there are {}", all.join(", "))),
    }
}

/// The number of a line on its chip.
fn offset_of(chip: &File, path: &Path, line: &Line, count: u32) -> Result<u32, String> {
    let at = path.display();
    if let Ok(number) = line.line.parse::<u32>() {
        return match number < count {
            true => Ok(number),
            false => Err(format!(
                "{at} has the lines 0 to {}, and {} is line {number}",
                count.saturating_sub(1),
                line.name
            )),
        };
    }
    let named = (0..count.min(MOST_SEARCHED))
        .find(|offset| info(chip, *offset).is_some_and(|(name, ..)| name == line.line));
    named.ok_or_else(|| {
        format!("{at} has no line \"{}\", which {} is; gpioinfo lists them", line.line, line.name)
    })
}

/// Name, flags and user of a line.
fn info(chip: &File, offset: u32) -> Option<(String, u64, String)> {
    let mut bytes = [0; 256];
    put_u32(&mut bytes, 64, offset);
    kernel::request(chip, gpio::LINE_INFO, &mut bytes).ok()?;
    Some((text_at(&bytes, 0, 32), u64_at(&bytes, 72), text_at(&bytes, 32, 32)))
}

fn refused(chip: &File, path: &Path, line: &Line, offset: u32, error: &io::Error) -> String {
    let (name, at) = (&line.name, path.display());
    let user = info(chip, offset).filter(|(_, flags, _)| flags & USED != 0).map(|(.., user)| user);
    match (error.kind(), user) {
        (ErrorKind::ResourceBusy, user) => {
            let user = user.unwrap_or_default();
            format!(
                "line {offset} of {at}, {name}, is in use by \"{user}\"; end that, or choose another line"
            )
        }
        (ErrorKind::InvalidInput, _) => {
            format!(
                "{at} cannot use line {offset}, {name}, like this: it may lack the bias or the drive that is asked for"
            )
        }
        _ => format!("line {offset} of {at}, {name}: {error}"),
    }
}

/// The `gpio_v2_line_request` of a line.
fn request_of(line: &Line, offset: u32) -> [u8; 592] {
    let mut bytes = [0; 592];
    put_u32(&mut bytes, 0, offset);
    put(&mut bytes, 256, b"downbeat");
    let (flags, attribute) = match line.purpose {
        Use::Input { bias, debounce } => {
            let bias = match bias {
                Bias::AsIs => 0,
                Bias::PullUp => PULL_UP,
                Bias::PullDown => PULL_DOWN,
                Bias::None => BIAS_DISABLED,
            };
            let debounce = u32::try_from(debounce.as_micros()).unwrap_or(u32::MAX);
            (INPUT | BOTH_EDGES | bias, (debounce > 0).then_some((ATTRIBUTE_DEBOUNCE, u64::from(debounce))))
        }
        Use::Output { drive, safe } => {
            let drive = match drive {
                Drive::PushPull => 0,
                Drive::OpenDrain => OPEN_DRAIN,
                Drive::OpenSource => OPEN_SOURCE,
            };
            (OUTPUT | drive, Some((ATTRIBUTE_VALUES, u64::from(safe))))
        }
    };
    let active_low = if line.is_active_low { ACTIVE_LOW } else { 0 };
    put_u64(&mut bytes, 288, flags | active_low);
    if let Some((attribute, value)) = attribute {
        put_u32(&mut bytes, 296, 1);
        put_u32(&mut bytes, 320, attribute);
        match attribute {
            ATTRIBUTE_DEBOUNCE => put_u32(&mut bytes, 328, u32::try_from(value).unwrap_or(u32::MAX)),
            _ => put_u64(&mut bytes, 328, value),
        }
        put_u64(&mut bytes, 336, 1);
    }
    put_u32(&mut bytes, 560, 1);
    bytes
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// By `offsetof` of `struct gpio_v2_line_request` and the structures in it, with the headers of Linux
    /// 6.1.
    #[test]
    fn a_request_has_the_layout_of_the_header() {
        let purpose = Use::Input { bias: Bias::PullUp, debounce: Duration::from_millis(10) };
        let line = Line { name: "button".into(), line: "17".into(), is_active_low: true, purpose };
        let bytes = request_of(&line, 17);
        assert_eq!((u32_at(&bytes, 0), text_at(&bytes, 256, 32)), (17, "downbeat".to_owned()));
        assert_eq!(u64_at(&bytes, 288), 0x2 | 0x4 | 0x10 | 0x20 | 0x100, "flags");
        assert_eq!(
            (u32_at(&bytes, 296), u32_at(&bytes, 320), u32_at(&bytes, 328)),
            (1, 3, 10_000),
            "debounce in us"
        );
        assert_eq!((u64_at(&bytes, 336), u32_at(&bytes, 560)), (1, 1));
        let purpose = Use::Output { drive: Drive::OpenDrain, safe: true };
        let bytes = request_of(&Line { is_active_low: false, purpose, ..line }, 4);
        assert_eq!((u64_at(&bytes, 288), u32_at(&bytes, 320), u64_at(&bytes, 328)), (0x8 | 0x40, 2, 1));
    }

    #[test]
    fn a_change_is_read_by_the_layout_of_the_header_and_lost_ones_are_counted() {
        let file = File::open("/dev/null").unwrap();
        let mut line = Requested { file, is_input: true, last_number: 0 };
        let mut event = [0; EVENT];
        put_u64(&mut event, 0, 1_000_000_000);
        put_u32(&mut event, 8, RISING);
        put_u32(&mut event, 20, 1);
        let edge = line.edge(3, &event);
        assert_eq!((edge.line, edge.is_true, edge.lost), (3, true, 0));
        put_u32(&mut event, 8, 2);
        put_u32(&mut event, 20, 5);
        let edge = line.edge(3, &event);
        assert_eq!((edge.is_true, edge.lost), (false, 3));
    }

    #[test]
    fn what_is_no_chip_is_told_with_the_remedy() {
        let mut chip = Chip::default();
        assert!(chip.open("/dev/gpiochip999", &[]).unwrap_err().contains("there is no /dev/gpiochip999"));
        assert_eq!(chip.open("/dev/null", &[]).unwrap_err(), "/dev/null is no GPIO chip");
        assert!(
            chip.open("no-such-chip", &[]).unwrap_err().starts_with("there is no GPIO chip \"no-such-chip\"")
        );
        let file = chip.open("src", &[]).unwrap_err();
        assert_eq!(file, "src is a folder, not the device file of a GPIO chip");
        assert!(chip.set(0, true).is_err());
    }
}
