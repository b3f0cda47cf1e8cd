//! A serial port as a device whose exchanges are recorded.

use std::io::{self, ErrorKind, Write};
use std::marker::PhantomData;
use std::time::{Duration, Instant};

use downbeat_device::Device;
use downbeat_device::serial_port::{check_port, port_refusal};
use downbeat_executor::Time;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use serialport::{DataBits, FlowControl, Parity, SerialPort, StopBits};

use crate::exchange::{self, Counted};

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
    /// What the line DTR is set to while the port is open; it is inverted before the port is closed. `None`
    /// leaves it alone. Pseudo terminals have no such line.
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
    exchanges: Counted,
    role: PhantomData<fn() -> R>,
}

enum Open {
    Port(Box<dyn SerialPort>),
    Memory(EmulatedPort),
}

impl<R: Role> SerialDevice<R> {
    /// A closed port that can be one of these in memory.
    #[must_use]
    pub fn new(ports: EmulatedPorts) -> Self {
        let (settings, exchanges) = Default::default();
        Self { ports, settings, open: None, exchanges, role: PhantomData }
    }

    /// Sets which port [`Request::Open`] opens.
    pub fn configure(&mut self, settings: PortSettings) {
        self.settings = settings;
    }

    /// `None` if no byte has come.
    fn attempt(&mut self, request: &Request, now: Time) -> Result<Option<Vec<u8>>, String> {
        match (request, &mut self.open) {
            (Request::Open, _) => {
                self.close();
                self.open = Some(open(&self.settings, &self.ports, now)?);
                Ok(Some(Vec::new()))
            }
            (Request::Close, _) => {
                self.close();
                Ok(Some(Vec::new()))
            }
            (_, None) => Err("the port is not open".to_owned()),
            (Request::Receive, Some(Open::Port(port))) => receive(&mut **port),
            (Request::Receive, Some(Open::Memory(port))) => match port.receive(now) {
                Some(bytes) => Ok(Some(bytes).filter(|bytes| !bytes.is_empty())),
                None => Err(closed(&self.settings.path)),
            },
            (Request::Send(bytes), Some(Open::Port(port))) => {
                let sent = port.set_timeout(WRITE_TIMEOUT).map_err(io::Error::from);
                match sent.and_then(|()| port.write_all(bytes)) {
                    Ok(()) => Ok(Some(Vec::new())),
                    Err(error) => Err(format!("sending: {error}")),
                }
            }
            (Request::Send(bytes), Some(Open::Memory(port))) => match port.send(bytes, now) {
                true => Ok(Some(Vec::new())),
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

fn closed(path: &str) -> String {
    format!("{path} was closed by its emulator")
}

fn receive(port: &mut dyn SerialPort) -> Result<Option<Vec<u8>>, String> {
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
            return Err(format!("receiving: {error}; is the device plugged in?"));
        }
        break;
    }
    Ok(Some(bytes).filter(|bytes| !bytes.is_empty()))
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
    check_port(path)?;
    let mut builder = serialport::new(path, settings.baud)
        .data_bits(DataBits::Eight)
        .parity(Parity::None)
        .stop_bits(StopBits::One)
        .flow_control(FlowControl::None);
    if let Some(level) = settings.data_terminal_ready {
        builder = builder.dtr_on_open(level);
    }
    builder.open().map(Open::Port).map_err(|error| port_refusal(path, &error.into()))
}

impl<R: Role> Device for SerialDevice<R> {
    type Request = Request;
    type Exchange = BusExchange;
    const TOPIC: &'static str = R::TOPIC;

    fn exchange(&mut self, request: &Request, now: Time) -> BusExchange {
        let started = Instant::now();
        let outcome = self.attempt(request, now);
        self.exchanges.end(exchange_of(request, now), outcome, started, &self.settings.path)
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
        Request::Open => (BusExchange::OPEN, Vec::new()),
        Request::Receive => (BusExchange::TRANSFER, Vec::new()),
        Request::Send(bytes) => (BusExchange::TRANSFER, bytes.clone()),
        Request::Close => (BusExchange::CLOSE, Vec::new()),
    };
    exchange::begin(kind, instruction, now)
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
        std::fs::write(&file, "data").unwrap();
        let error = |path: &str| opened(path).1.error;
        assert!(
            error(file.to_str().unwrap()).contains("is a regular file, not a serial port: name a device")
        );
        assert!(error(folder.path().to_str().unwrap()).contains("is a folder"));
        assert!(error("/dev/no-such-port").contains("/dev/no-such-port does not exist: plug the device in"));
        assert!(error("/dev/null").contains("/dev/null is a device, but not a serial port: "));
        assert!(error("").contains("no serial port is given: name one"));
        assert!(error("memory:nobody").contains("no module emulates \"memory:nobody\""));
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
