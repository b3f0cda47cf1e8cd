//! A CAN bus as a device whose exchanges are recorded, and the sockets of Linux for it.

use std::fs::{self, File};
use std::io::{ErrorKind, Read, Write};
use std::path::Path;
use std::time::{Duration, Instant};

use downbeat_device::Device;
use downbeat_executor::Time;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;

use super::frame::{Filter, LENGTH};
use crate::exchange;
use crate::kernel::{self, name_of};

/// How long a request for frames waits for the first one.
const WAIT: Duration = Duration::from_millis(5);
/// The most frames of one request.
pub(super) const MOST_FRAMES: usize = 64;

/// Which bus, and what is heard of it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// The interface, such as `can0`; of an emulated bus a log of `candump`.
    pub interface: String,
    /// Which frames; all if there is none.
    pub filters: Vec<Filter>,
    /// Whether frames that are sent here come back.
    pub receives_own: bool,
}

/// What became of a frame that was to be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// It is with the driver.
    Yes,
    /// The queue of the driver is full; it can be tried again.
    Full,
}

/// Where frames come from and go to. Failures are sentences with what to do.
pub trait Source: Send {
    /// Opens a bus.
    ///
    /// # Errors
    /// If there is no such bus, or it cannot be used.
    fn open(&mut self, wanted: &Wanted) -> Result<(), String>;

    /// The bytes of frames that have come. Waits for a bounded time if none has.
    ///
    /// # Errors
    /// If the bus is lost. It has to be opened again.
    fn receive(&mut self, now: Time) -> Result<Vec<u8>, String>;

    /// Sends a frame, without waiting.
    ///
    /// # Errors
    /// If the bus is lost.
    fn send(&mut self, frame: &[u8; LENGTH]) -> Result<Sent, String>;

    /// Closes the bus.
    fn close(&mut self);
}

/// A request of the module.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Open the bus.
    Open(Wanted),
    /// Give the frames that have come.
    Receive,
    /// Send this frame.
    Send([u8; LENGTH]),
    /// Close the bus.
    Close,
}

/// A CAN bus: a [`Source`] of which everything is recorded.
pub struct CanDevice {
    source: Box<dyn Source>,
}

impl CanDevice {
    /// A bus that is reached like this.
    #[must_use]
    pub fn new(source: impl Source + 'static) -> Self {
        Self { source: Box::new(source) }
    }
}

impl Device for CanDevice {
    type Request = Request;
    type Exchange = BusExchange;
    const TOPIC: &'static str = "can/exchanges";

    fn exchange(&mut self, request: &Request, now: Time) -> BusExchange {
        let started = Instant::now();
        let outcome = match request {
            Request::Open(wanted) => self.source.open(wanted).map(|()| Some(Vec::new())),
            Request::Receive => {
                self.source.receive(now).map(|frames| Some(frames).filter(|frames| !frames.is_empty()))
            }
            Request::Send(frame) => self.source.send(frame).map(|sent| (sent == Sent::Yes).then(Vec::new)),
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
        Request::Open(Wanted { interface, filters, receives_own }) => {
            let filters = filters.iter().map(|Filter { id, mask }| format!(" {id:08x}:{mask:08x}"));
            let interface = name_of(interface);
            let own = if *receives_own { " own" } else { "" };
            let text = format!("{interface}{own}{}", filters.collect::<String>());
            (BusExchange::OPEN, text.into_bytes())
        }
        Request::Receive => (BusExchange::TRANSFER, Vec::new()),
        Request::Send(frame) => (BusExchange::TRANSFER, frame.to_vec()),
        Request::Close => (BusExchange::CLOSE, Vec::new()),
    };
    exchange::begin(kind, instruction, now)
}

/// CAN interfaces of this machine (SocketCAN).
#[derive(Default)]
pub struct SocketCan {
    open: Option<(File, String)>,
}

/// Where the kernel lists network interfaces.
const CLASS: &str = "/sys/class/net";
/// The kind of an interface that is a CAN bus (`ARPHRD_CAN`).
const CAN: &str = "280";
/// An interface that is up (`IFF_UP`).
const UP: u32 = 1;

impl Source for SocketCan {
    fn open(&mut self, wanted: &Wanted) -> Result<(), String> {
        self.close();
        let interface = &wanted.interface;
        let index = index_of(Path::new(CLASS), interface)?;
        let failed = |error: std::io::Error| match error.kind() {
            ErrorKind::NotFound => format!("{interface} is gone; plug it in again"),
            _ => format!("opening {interface}: {error}"),
        };
        let filters: Vec<_> = wanted.filters.iter().map(|filter| (filter.id, filter.mask)).collect();
        let socket = kernel::can_socket(index, &filters, wanted.receives_own).map_err(failed)?;
        self.open = Some((socket, interface.clone()));
        Ok(())
    }

    fn receive(&mut self, _now: Time) -> Result<Vec<u8>, String> {
        let (socket, interface) = self.open.as_mut().ok_or("the bus is not open")?;
        let lost = |error: std::io::Error| lost(interface, &error);
        let mut frames = Vec::new();
        if !kernel::wait(socket, WAIT).map_err(lost)? {
            return Ok(frames);
        }
        while frames.len() < MOST_FRAMES * LENGTH {
            let mut frame = [0; LENGTH];
            match socket.read(&mut frame) {
                Ok(LENGTH) => frames.extend(frame),
                // Frames of other lengths are not asked for.
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) if !frames.is_empty() => break, // it is found again
                Err(error) => return Err(lost(error)),
            }
        }
        Ok(frames)
    }

    fn send(&mut self, frame: &[u8; LENGTH]) -> Result<Sent, String> {
        let (socket, interface) = self.open.as_mut().ok_or("the bus is not open")?;
        match socket.write(frame) {
            Ok(_) => Ok(Sent::Yes),
            Err(error) if error.kind() == ErrorKind::WouldBlock || kernel::is_full(&error) => Ok(Sent::Full),
            Err(error) => Err(lost(interface, &error)),
        }
    }

    fn close(&mut self) {
        self.open = None;
    }
}

fn lost(interface: &str, error: &std::io::Error) -> String {
    match error.kind() {
        ErrorKind::NetworkDown => format!("{interface} is down: sudo ip link set {interface} up"),
        _ if kernel::is_gone(error) => format!("{interface} is gone; plug it in again"),
        _ => format!("{interface}: {error}"),
    }
}

/// The number of an interface that is a CAN bus and up.
fn index_of(class: &Path, interface: &str) -> Result<u32, String> {
    let is_name =
        (1..16).contains(&interface.len()) && !interface.contains(['/', ' ']) && !interface.starts_with('.');
    let folder = class.join(interface);
    let read = |name: &str| fs::read_to_string(folder.join(name)).map(|text| text.trim().to_owned()).ok();
    let Some(index) = read("ifindex").filter(|_| is_name).and_then(|index| index.parse().ok()) else {
        let mut all: Vec<String> = fs::read_dir(class)
            .into_iter()
            .flatten()
            .flatten()
            .filter(|entry| {
                fs::read_to_string(entry.path().join("type")).is_ok_and(|kind| kind.trim() == CAN)
            })
            .filter_map(|entry| entry.file_name().into_string().ok())
            .collect();
        all.sort();
        let others = match all.is_empty() {
            true => "; is the adapter plugged in, and its driver loaded?".to_owned(),
            false => format!("; there are {}", all.join(", ")),
        };
        return Err(match interface {
            "" => format!("no interface is given{others}"),
            _ => format!("there is no interface {interface}{others}"),
        });
    };
    if read("type").as_deref() != Some(CAN) {
        return Err(format!("{interface} is no CAN interface"));
    }
    let flags = read("flags").unwrap_or_default();
    let flags = u32::from_str_radix(flags.trim_start_matches("0x"), 16).unwrap_or(UP);
    if flags & UP == 0 {
        return Err(format!("{interface} is down: sudo ip link set {interface} up type can bitrate 500000"));
    }
    Ok(index)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn an_interface_that_cannot_be_used_is_told_with_the_remedy() {
        let class = tempfile::tempdir().unwrap();
        for (name, index, kind, flags) in
            [("can0", "7", CAN, "0x40081"), ("can1", "8", CAN, "0x40080"), ("eth0", "2", "1", "0x1003")]
        {
            let folder = class.path().join(name);
            fs::create_dir(&folder).unwrap();
            for (file, text) in [("ifindex", index), ("type", kind), ("flags", flags)] {
                fs::write(folder.join(file), format!("{text}\n")).unwrap();
            }
        }
        let find = |interface| index_of(class.path(), interface);
        assert_eq!(find("can0"), Ok(7));
        assert_eq!(
            find("can1").unwrap_err(),
            "can1 is down: sudo ip link set can1 up type can bitrate 500000"
        );
        assert_eq!(find("eth0").unwrap_err(), "eth0 is no CAN interface");
        assert_eq!(find("can2").unwrap_err(), "there is no interface can2; there are can0, can1");
        assert!(find("../can0").unwrap_err().starts_with("there is no interface ../can0"));
        let none = index_of(Path::new("/nowhere"), "can0").unwrap_err();
        assert!(none.ends_with("is the adapter plugged in, and its driver loaded?"), "{none}");
        let wanted = Wanted { interface: "lo".into(), ..Wanted::default() };
        assert!(SocketCan::default().open(&wanted).is_err());
    }
}
