//! A serial port as a device whose exchanges are recorded.

use std::fs::{self, FileType};
use std::io::{self, ErrorKind, Write};
use std::marker::PhantomData;
use std::os::unix::fs::FileTypeExt;
use std::time::{Duration, Instant};

use downbeat_device::Device;
use downbeat_executor::Time;
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use serialport::{DataBits, FlowControl, Parity, SerialPort, StopBits};

use super::emulated::{EmulatedPort, EmulatedPorts};

/// How long a module waits for the first byte.
const WAIT: Duration = Duration::from_millis(50);
/// How long it collects bytes after the first one: their arrival is known so exactly.
const COLLECT: Duration = Duration::from_millis(4);
/// How long the operating system may take to accept bytes.
const WRITE_TIMEOUT: Duration = Duration::from_millis(20);
/// How many bytes one exchange returns at most. The rest waits in the port.
const MOST: usize = 16 * 1024;

/// What the devices on a port are for: it decides the topic of the exchanges.
pub trait Role: Send + 'static {
    /// See [`Device::TOPIC`].
    const TOPIC: &'static str;
}

/// Which port, and how it is opened: 8 data bits, no parity, one stop bit, no flow control.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PortSettings {
    /// The path, or the name of an emulated port in memory.
    pub path: String,
    /// The speed, in bit/s.
    pub baud: u32,
    /// What the line DTR is set to while the port is open; it is inverted before the port is closed. `None` leaves it alone. Pseudo
    /// terminals have no such line.
    pub data_terminal_ready: Option<bool>,
}

/// What a module asks of its port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Open it, after closing it if it is open.
    Open,
    /// Return the bytes that have come, or wait for the first one for a bounded time.
    Receive,
    /// Send these bytes.
    Send(Vec<u8>),
    /// Close it.
    Close,
}

/// A serial port, or an emulated one in memory.
///
/// An exchange takes 50 ms at most; one in memory takes no time.
pub struct SerialDevice<R> {
    ports: EmulatedPorts,
    settings: PortSettings,
    open: Option<Open>,
    sequence: u64,
    role: PhantomData<fn() -> R>,
}

enum Open {
    Port(Box<dyn SerialPort>),
    Memory(EmulatedPort),
}

/// Why an exchange gives nothing.
enum Failure {
    /// No byte has come.
    Silent,
    /// The port does not work.
    Broken(String),
}

impl<R: Role> SerialDevice<R> {
    /// A closed port that can be one of these in memory.
    #[must_use]
    pub fn new(ports: EmulatedPorts) -> Self {
        Self { ports, settings: PortSettings::default(), open: None, sequence: 0, role: PhantomData }
    }

    /// Sets which port [`Request::Open`] opens.
    pub fn configure(&mut self, settings: PortSettings) {
        self.settings = settings;
    }

    fn attempt(&mut self, request: &Request, now: Time) -> Result<Vec<u8>, Failure> {
        match (request, &mut self.open) {
            (Request::Open, _) => {
                self.close();
                self.open = Some(open(&self.settings, &self.ports, now).map_err(Failure::Broken)?);
                Ok(Vec::new())
            }
            (Request::Close, _) => {
                self.close();
                Ok(Vec::new())
            }
            (_, None) => Err(Failure::Broken("the port is not open".to_owned())),
            (Request::Receive, Some(Open::Port(port))) => receive(&mut **port),
            (Request::Receive, Some(Open::Memory(port))) => match port.receive(now) {
                Some(bytes) if bytes.is_empty() => Err(Failure::Silent),
                Some(bytes) => Ok(bytes),
                None => Err(closed(&self.settings.path)),
            },
            (Request::Send(bytes), Some(Open::Port(port))) => {
                let sent = port.set_timeout(WRITE_TIMEOUT).map_err(io::Error::from);
                match sent.and_then(|()| port.write_all(bytes)) {
                    Ok(()) => Ok(Vec::new()),
                    Err(error) => Err(Failure::Broken(format!("sending: {error}"))),
                }
            }
            (Request::Send(bytes), Some(Open::Memory(port))) => match port.send(bytes, now) {
                true => Ok(Vec::new()),
                false => Err(closed(&self.settings.path)),
            },
        }
    }

    fn close(&mut self) {
        if let (Some(Open::Port(mut port)), Some(level)) =
            (self.open.take(), self.settings.data_terminal_ready)
        {
            // Without the line, or with the cable out, there is nothing to set.
            let _ = port.write_data_terminal_ready(!level);
        }
    }
}

fn closed(path: &str) -> Failure {
    Failure::Broken(format!("{path} was closed by its emulator"))
}

fn receive(port: &mut dyn SerialPort) -> Result<Vec<u8>, Failure> {
    let mut bytes = Vec::new();
    let mut buffer = [0; 1024];
    let mut until = Instant::now() + WAIT;
    while bytes.len() < MOST {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            break;
        }
        let error =
            match port.set_timeout(left).map_err(io::Error::from).and_then(|()| port.read(&mut buffer)) {
                Ok(0) => "it was closed at the other end".to_owned(),
                Ok(count) => {
                    if bytes.is_empty() {
                        until = until.min(Instant::now() + COLLECT);
                    }
                    bytes.extend(buffer.get(..count).unwrap_or_default());
                    continue;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) if error.kind() == ErrorKind::TimedOut => break,
                Err(error) => error.to_string(),
            };
        // What came before is not lost; the next attempt reports the error.
        if bytes.is_empty() {
            return Err(Failure::Broken(format!("receiving: {error}; is the device plugged in?")));
        }
        break;
    }
    if bytes.is_empty() { Err(Failure::Silent) } else { Ok(bytes) }
}

/// Opens a port.
///
/// # Errors
/// In words that say what to do.
fn open(settings: &PortSettings, ports: &EmulatedPorts, now: Time) -> Result<Open, String> {
    let path = &settings.path;
    if EmulatedPorts::is_memory(path) {
        let missing =
            || format!("no module emulates \"{path}\": add one with that \"link\" to the robot file");
        let port = ports.open(path).ok_or_else(missing)?;
        let closed = || format!("{path} is closed by its emulator");
        return port.is_open(now).then_some(Open::Memory(port)).ok_or_else(closed);
    }
    match fs::metadata(path) {
        Ok(metadata) if !metadata.file_type().is_char_device() => {
            return Err(format!(
                "{path} is {}, not a serial port: set \"port\" to a device such as /dev/ttyUSB0",
                kind_of(metadata.file_type())
            ));
        }
        Err(error) => return Err(remedy(path, &error)),
        Ok(_) => {}
    }
    let mut builder = serialport::new(path, settings.baud)
        .data_bits(DataBits::Eight)
        .parity(Parity::None)
        .stop_bits(StopBits::One)
        .flow_control(FlowControl::None);
    if let Some(level) = settings.data_terminal_ready {
        builder = builder.dtr_on_open(level);
    }
    builder.open().map(Open::Port).map_err(|error| remedy(path, &error.into()))
}

fn kind_of(kind: FileType) -> &'static str {
    match kind {
        kind if kind.is_dir() => "a folder",
        kind if kind.is_file() => "a regular file",
        kind if kind.is_block_device() => "a disk",
        _ => "a socket or pipe",
    }
}

/// Why a port cannot be opened, and what to do.
fn remedy(path: &str, error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::NotFound => format!(
            "{path} does not exist: plug the device in, or set \"port\" to the path of another (ls /dev/serial/by-id)"
        ),
        ErrorKind::PermissionDenied => format!(
            "no permission to open {path}: add the user to the group dialout (sudo usermod -aG dialout $USER) and log in again"
        ),
        _ => format!("opening {path}: {error}; is it a serial port, and does no other program use it?"),
    }
}

impl<R: Role> Device for SerialDevice<R> {
    type Request = Request;
    type Exchange = BusExchange;
    const TOPIC: &'static str = R::TOPIC;

    fn exchange(&mut self, request: &Request, now: Time) -> BusExchange {
        let started = Instant::now();
        let outcome = self.attempt(request, now);
        // The time of a device in memory is that of the core.
        let duration =
            if EmulatedPorts::is_memory(&self.settings.path) { Duration::ZERO } else { started.elapsed() };
        let duration_us = u32::try_from(duration.as_micros()).unwrap_or(u32::MAX);
        let sequence = self.sequence;
        self.sequence += 1;
        let exchange = BusExchange { duration_us, sequence, ..exchange_of(request, now) };
        match outcome {
            Ok(reply) => BusExchange { reply, ..exchange },
            Err(Failure::Silent) => BusExchange { outcome: BusExchange::TIMEOUT, ..exchange },
            Err(Failure::Broken(error)) => BusExchange { outcome: BusExchange::FAILED, error, ..exchange },
        }
    }

    fn answers(exchange: &BusExchange, request: &Request) -> bool {
        let expected = exchange_of(request, Time::ZERO);
        exchange.kind == expected.kind && exchange.instruction == expected.instruction
    }

    fn failed(request: &Request, now: Time, reason: &str) -> BusExchange {
        BusExchange { outcome: BusExchange::FAILED, error: reason.to_owned(), ..exchange_of(request, now) }
    }
}

fn exchange_of(request: &Request, now: Time) -> BusExchange {
    let (kind, instruction) = match request {
        Request::Open => (BusExchange::OPEN, Vec::new()),
        Request::Receive => (BusExchange::TRANSFER, Vec::new()),
        Request::Send(bytes) => (BusExchange::TRANSFER, bytes.clone()),
        Request::Close => (BusExchange::CLOSE, Vec::new()),
    };
    let stamp = Stamp::from_nanos(now.as_nanos());
    BusExchange { stamp, kind, instruction, ..BusExchange::default() }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use serialport::TTYPort;

    struct Test;

    impl Role for Test {
        const TOPIC: &'static str = "test/exchanges";
    }

    fn opened(path: &str) -> (SerialDevice<Test>, BusExchange) {
        let mut device = SerialDevice::new(EmulatedPorts::default());
        let settings = PortSettings { path: path.to_owned(), baud: 9600, data_terminal_ready: Some(false) };
        device.configure(settings);
        let exchange = device.exchange(&Request::Open, Time::ZERO);
        (device, exchange)
    }

    #[test]
    fn a_path_that_is_no_port_is_refused_with_the_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("scan.bin");
        fs::write(&file, "data").unwrap();
        let error = |path: &str| opened(path).1.error;
        assert!(error(file.to_str().unwrap()).contains("is a regular file, not a serial port: set \"port\""));
        assert!(error(folder.path().to_str().unwrap()).contains("is a folder"));
        assert!(error("/dev/no-such-port").contains("/dev/no-such-port does not exist: plug the device in"));
        assert!(error("/dev/null").contains("opening /dev/null: "));
        assert!(error("memory:nobody").contains("no module emulates \"memory:nobody\""));
        let denied = remedy("/dev/ttyUSB0", &ErrorKind::PermissionDenied.into());
        assert!(denied.contains("/dev/ttyUSB0: add the user to the group dialout"), "{denied}");
    }

    #[test]
    fn bytes_come_as_they_were_sent_and_a_cable_that_is_out_is_an_error() {
        let (mut theirs, port) = TTYPort::pair().unwrap();
        let path = port.name().unwrap();
        let (mut device, exchange) = opened(&path);
        assert_eq!(
            (exchange.kind, exchange.outcome),
            (BusExchange::OPEN, BusExchange::OK),
            "{}",
            exchange.error
        );
        let mut ask = |request: &Request| device.exchange(request, Time::ZERO);
        assert_eq!(ask(&Request::Receive).outcome, BusExchange::TIMEOUT);
        theirs.write_all(&[0, 10, 13, 255]).unwrap();
        assert_eq!(ask(&Request::Receive).reply, [0, 10, 13, 255]);
        assert_eq!(ask(&Request::Send(vec![1, 2])).outcome, BusExchange::OK);
        drop(port);
        drop(theirs);
        assert_eq!(ask(&Request::Receive).outcome, BusExchange::FAILED);
        assert_eq!(ask(&Request::Close).outcome, BusExchange::OK);
        assert!(ask(&Request::Receive).error.contains("not open"));
    }
}
