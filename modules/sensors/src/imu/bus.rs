//! An I²C bus as a device whose exchanges are recorded.
//!
//! The kernel ends an exchange on a bus that hangs, by default after a second.

use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Read, Write};
use std::time::{Duration, Instant};

use downbeat_device::Device;
use downbeat_executor::Time;
use downbeat_files::FileKind;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_servos::servo_emulator::{Fault, FaultSchedule};
use parking_lot::Mutex;
use std::sync::{Arc, Weak};

use crate::exchange::{self, Counted};
use crate::kernel;
use crate::memory::{NameInUse, Registry, is_memory};

/// What a module asks of its bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Open it, after closing it if it is open.
    Open,
    /// Write these bytes to the chip at an address: the number of a register and values for it and those
    /// after it.
    Write {
        /// Seven bits.
        address: u8,
        /// The register and the values.
        bytes: Vec<u8>,
    },
    /// Read registers of the chip at an address.
    Read {
        /// Seven bits.
        address: u8,
        /// The first register.
        register: u8,
        /// How many.
        length: u8,
    },
    /// Close it.
    Close,
}

/// An I²C bus: `/dev/i2c-N`, or an emulated one in memory.
pub struct I2cDevice {
    buses: EmulatedBuses,
    path: String,
    open: Option<Open>,
    exchanges: Counted,
}

enum Open {
    Bus { file: File, address: Option<u8> },
    Memory(EmulatedBus),
}

impl I2cDevice {
    /// A closed bus that can be one of these in memory.
    #[must_use]
    pub fn new(buses: EmulatedBuses) -> Self {
        Self { buses, path: String::new(), open: None, exchanges: Counted::default() }
    }

    /// Sets which bus [`Request::Open`] opens.
    pub fn configure(&mut self, path: &str) {
        path.clone_into(&mut self.path);
    }

    fn attempt(&mut self, request: &Request, now: Time) -> Result<Vec<u8>, String> {
        match (request, &mut self.open) {
            (Request::Open, _) => {
                self.open = None;
                self.open = Some(open(&self.path, &self.buses)?);
                Ok(Vec::new())
            }
            (Request::Close, _) => {
                self.open = None;
                Ok(Vec::new())
            }
            (_, None) => Err("the bus is not open".to_owned()),
            (Request::Write { address, bytes }, Some(Open::Bus { file, address: selected })) => {
                let done = select(file, selected, *address).and_then(|()| file.write_all(bytes));
                done.map(|()| Vec::new()).map_err(|error| silent(&self.path, *address, &error))
            }
            (Request::Read { address, register, length }, Some(Open::Bus { file, address: selected })) => {
                let mut bytes = vec![0; usize::from(*length)];
                let done = select(file, selected, *address)
                    .and_then(|()| file.write_all(&[*register]))
                    .and_then(|()| file.read_exact(&mut bytes));
                done.map(|()| bytes).map_err(|error| silent(&self.path, *address, &error))
            }
            (Request::Write { address, bytes }, Some(Open::Memory(bus))) => {
                let written = bus.at(now, |emulated| emulated.write(*address, bytes));
                written.map(|()| Vec::new()).ok_or_else(|| no_answer(&self.path, *address))
            }
            (Request::Read { address, register, length }, Some(Open::Memory(bus))) => {
                let read = bus.at(now, |emulated| emulated.read(*address, *register, *length));
                read.ok_or_else(|| no_answer(&self.path, *address))
            }
        }
    }
}

/// Directs reads and writes of the file to the chip at this address.
fn select(file: &File, selected: &mut Option<u8>, address: u8) -> io::Result<()> {
    if *selected != Some(address) {
        kernel::i2c::select(file, address)?;
        *selected = Some(address);
    }
    Ok(())
}

/// Why a chip does not answer.
fn silent(path: &str, address: u8, error: &io::Error) -> String {
    match kernel::is_foreign(error) {
        true => format!("{path} is no I²C bus: set \"bus\" to a device such as /dev/i2c-1"),
        false => format!("{} ({error})", no_answer(path, address)),
    }
}

fn no_answer(path: &str, address: u8) -> String {
    format!(
        "no answer from address {address:#04x} on {path}: check the wires, the power and the setting \"address\" (i2cdetect -y N lists \
         addresses)"
    )
}

fn open(path: &str, buses: &EmulatedBuses) -> Result<Open, String> {
    if is_memory(path) {
        let bus = buses.open(path).map(Open::Memory);
        return bus.ok_or_else(|| {
            format!("no module emulates \"{path}\": add one with that \"link\" to the robot file")
        });
    }
    if path.is_empty() {
        return Err("no I²C bus is given: set \"bus\" to a device such as /dev/i2c-1".to_owned());
    }
    kernel::i2c::check_supported().map_err(|error| error.to_string())?;
    match fs::metadata(path) {
        Ok(metadata) if FileKind::of(&metadata) != FileKind::CharacterDevice => {
            return Err(format!(
                "{path} is {}, not an I²C bus: set \"bus\" to a device such as /dev/i2c-1",
                FileKind::of(&metadata)
            ));
        }
        Err(error) => return Err(remedy(path, &error)),
        Ok(_) => {}
    }
    let opened = OpenOptions::new().read(true).write(true).open(path);
    opened.map(|file| Open::Bus { file, address: None }).map_err(|error| remedy(path, &error))
}

/// Why a bus cannot be opened, and what to do.
fn remedy(path: &str, error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::NotFound => format!(
            "{path} does not exist: load the driver (sudo modprobe i2c-dev), and enable the bus (on a Raspberry Pi: sudo raspi-config \
             nonint do_i2c 0); ls /dev/i2c-* lists the buses"
        ),
        ErrorKind::PermissionDenied => format!(
            "no permission to open {path}: add the user to the group i2c (sudo usermod -aG i2c $USER) and log in again"
        ),
        _ => format!("opening {path}: {error}"),
    }
}

impl Device for I2cDevice {
    type Request = Request;
    type Exchange = BusExchange;
    const TOPIC: &'static str = "imu/exchanges";

    fn exchange(&mut self, request: &Request, now: Time) -> BusExchange {
        let started = Instant::now();
        let outcome = self.attempt(request, now).map(Some);
        self.exchanges.end(exchange_of(request, now), outcome, started, &self.path)
    }

    fn answers(exchange: &BusExchange, request: &Request) -> bool {
        exchange::has_same_request(exchange, &exchange_of(request, Time::ZERO))
    }

    fn failed(request: &Request, now: Time, reason: &str) -> BusExchange {
        exchange::fail(exchange_of(request, now), reason)
    }
}

/// The instruction of an exchange is the address, how many bytes are read (0: none), and the bytes that are
/// written.
fn exchange_of(request: &Request, now: Time) -> BusExchange {
    let (kind, instruction) = match request {
        Request::Open => (BusExchange::OPEN, Vec::new()),
        Request::Write { address, bytes } => (BusExchange::TRANSFER, [&[*address, 0], &bytes[..]].concat()),
        Request::Read { address, register, length } => {
            (BusExchange::TRANSFER, vec![*address, *length, *register])
        }
        Request::Close => (BusExchange::CLOSE, Vec::new()),
    };
    exchange::begin(kind, instruction, now)
}

/// A chip with registers, emulated. What it answers depends on the calls only; times are since it was
/// powered.
pub trait EmulatedChip: Send + 'static {
    /// Writes a register of the chip at this address. Returns false if there is none.
    fn write(&mut self, address: u8, register: u8, value: u8, now: Duration) -> bool;

    /// Reads a register. `None` if no chip has this address.
    fn read(&mut self, address: u8, register: u8, now: Duration) -> Option<u8>;
}

/// Emulated buses of this process, which modules open by names that start with `memory:`. Clones share them.
///
/// The time of a chip is that of the module that reads it.
#[derive(Clone, Default)]
pub struct EmulatedBuses(Registry<Emulated>);

/// A chip with the faults of its bus.
pub(super) struct Emulated {
    chip: Box<dyn EmulatedChip>,
    faults: FaultSchedule,
    /// When a module used it first.
    start: Option<Time>,
    now: Duration,
}

impl Emulated {
    pub(super) fn new(chip: Box<dyn EmulatedChip>, faults: Vec<Fault>, seed: u64) -> Self {
        Self { chip, faults: FaultSchedule::new(faults, seed), start: None, now: Duration::ZERO }
    }

    fn write(&mut self, address: u8, bytes: &[u8]) -> Option<()> {
        let (register, values) = bytes.split_first()?;
        let mut registers = (*register..=u8::MAX).zip(values);
        registers.all(|(register, value)| self.chip.write(address, register, *value, self.now)).then_some(())
    }

    fn read(&mut self, address: u8, register: u8, length: u8) -> Option<Vec<u8>> {
        let registers = (0..length).map(|offset| register.wrapping_add(offset));
        let read = registers.map(|register| self.chip.read(address, register, self.now));
        let mut bytes = read.collect::<Option<Vec<u8>>>()?;
        self.faults.flip(&mut bytes, self.now);
        Some(bytes)
    }
}

impl EmulatedBuses {
    pub(super) fn offer(&self, name: &str, emulated: Emulated) -> Result<Arc<Mutex<Emulated>>, NameInUse> {
        self.0.offer(name, emulated)
    }

    fn open(&self, name: &str) -> Option<EmulatedBus> {
        Some(EmulatedBus { device: self.0.find(name)? })
    }
}

/// An open bus in memory.
struct EmulatedBus {
    device: Weak<Mutex<Emulated>>,
}

impl EmulatedBus {
    /// `None` if nothing answers.
    fn at<T>(&self, now: Time, act: impl FnOnce(&mut Emulated) -> Option<T>) -> Option<T> {
        let device = self.device.upgrade()?;
        let mut emulated = device.lock();
        let start = *emulated.start.get_or_insert(now);
        emulated.now = emulated.now.max(now.saturating_since(start));
        let now = emulated.now;
        let is_lost = emulated.faults.is_port_closed(now) || emulated.faults.loses_answer(now);
        if is_lost { None } else { act(&mut emulated) }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_path_that_is_no_bus_is_refused_with_the_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("bus");
        fs::write(&file, "data").unwrap();
        let error = |path: &str| {
            let mut device = I2cDevice::new(EmulatedBuses::default());
            device.configure(path);
            let opened = device.exchange(&Request::Open, Time::ZERO);
            let read =
                device.exchange(&Request::Read { address: 0x68, register: 0x75, length: 1 }, Time::ZERO);
            if opened.outcome == BusExchange::OK { read.error } else { opened.error }
        };
        assert!(error(file.to_str().unwrap()).contains("is a regular file, not an I²C bus: set \"bus\""));
        assert!(error("").starts_with("no I²C bus is given"));
        assert!(error(folder.path().to_str().unwrap()).contains("is a folder"));
        assert!(
            error("/dev/i2c-no-such-bus").contains("does not exist: load the driver (sudo modprobe i2c-dev)")
        );
        assert!(error("/dev/null").contains("/dev/null is no I²C bus"), "{}", error("/dev/null"));
        assert!(error("memory:nobody").contains("no module emulates \"memory:nobody\""));
        let denied = remedy("/dev/i2c-1", &ErrorKind::PermissionDenied.into());
        assert!(denied.contains("/dev/i2c-1: add the user to the group i2c"), "{denied}");
    }

    #[test]
    fn exchanges_are_told_apart_by_all_that_they_ask() {
        let read = |address, register, length| Request::Read { address, register, length };
        let exchange = exchange_of(&read(0x68, 0x3B, 14), Time::ZERO);
        assert_eq!(exchange.instruction, [0x68, 14, 0x3B]);
        for other in [read(0x69, 0x3B, 14), read(0x68, 0x3C, 14), read(0x68, 0x3B, 13)] {
            assert!(!I2cDevice::answers(&exchange, &other));
        }
        let write = Request::Write { address: 0x68, bytes: vec![0x3B, 14] };
        assert!(
            !I2cDevice::answers(&exchange, &write) && I2cDevice::answers(&exchange, &read(0x68, 0x3B, 14))
        );
    }
}
