//! Emulated devices, and ports in memory that lead to them.

use std::collections::VecDeque;
use std::sync::{Arc, Weak};
use std::time::Duration;

use downbeat_executor::Time;
use downbeat_servos::servo_emulator::{Fault, FaultSchedule};
use parking_lot::Mutex;

use crate::memory::{NameInUse, Registry, is_memory};

/// How many bytes wait for a computer that does not read; older ones are lost, as in a driver.
const MOST_WAITING: usize = 64 * 1024;

/// A device at the other end of a serial line, emulated.
///
/// What it sends depends on the calls only. Times are since the device was powered, and never go back.
pub trait EmulatedDevice: Send + 'static {
    /// The device receives bytes. It answers in [`advance_to`](Self::advance_to).
    fn receive(&mut self, bytes: &[u8]) {
        let _ = bytes;
    }

    /// Passes each packet that the device sends until `now` to `send`.
    fn advance_to(&mut self, now: Duration, send: &mut dyn FnMut(Vec<u8>));
}

/// An emulated device with the faults of its line.
pub(super) struct Emulated {
    device: Box<dyn EmulatedDevice>,
    faults: FaultSchedule,
    /// When a module opened it first.
    start: Option<Time>,
    now: Duration,
    waiting: VecDeque<u8>,
}

impl Emulated {
    pub(super) fn new(device: Box<dyn EmulatedDevice>, faults: Vec<Fault>, seed: u64) -> Self {
        let faults = FaultSchedule::new(faults, seed);
        Self { device, faults, start: None, now: Duration::ZERO, waiting: VecDeque::new() }
    }

    /// Brings the device to this time. Returns whether the port is open then; what is sent while it is closed
    /// is lost.
    pub(super) fn advance_to(&mut self, now: Duration) -> bool {
        self.now = self.now.max(now);
        let (now, faults, waiting) = (self.now, &mut self.faults, &mut self.waiting);
        let is_open = !faults.is_port_closed(now);
        self.device.advance_to(now, &mut |mut packet| {
            if is_open && !faults.loses_answer(now) {
                faults.flip(&mut packet, now);
                waiting.extend(packet);
            }
        });
        if !is_open {
            waiting.clear();
        }
        waiting.drain(..waiting.len().saturating_sub(MOST_WAITING));
        is_open
    }

    pub(super) fn send(&mut self, bytes: &[u8]) {
        self.device.receive(bytes);
    }

    pub(super) fn take(&mut self, most: usize) -> Vec<u8> {
        let count = self.waiting.len().min(most);
        self.waiting.drain(..count).collect()
    }
}

/// Emulated devices of this process, which modules open by names that start with `memory:` as they open a
/// port by its path. Clones share them.
///
/// The time of a device is that of the module that reads it, so it runs as fast as the module does, with the
/// same bytes in each run.
#[derive(Clone, Default)]
pub struct EmulatedPorts(Registry<Emulated>);

/// A device in memory, as long as the caller keeps it.
pub(super) type Offered = Arc<Mutex<Emulated>>;

impl EmulatedPorts {
    /// Returns whether this names a port in memory.
    #[must_use]
    pub fn is_memory(port: &str) -> bool {
        is_memory(port)
    }

    pub(super) fn offer(&self, port: &str, emulated: Emulated) -> Result<Offered, NameInUse> {
        self.0.offer(port, emulated)
    }

    pub(super) fn open(&self, port: &str) -> Option<EmulatedPort> {
        Some(EmulatedPort { device: self.0.find(port)? })
    }
}

/// An open port in memory.
pub(super) struct EmulatedPort {
    device: Weak<Mutex<Emulated>>,
}

/// How many bytes an exchange in memory returns at most.
const MOST: usize = 16 * 1024;

impl EmulatedPort {
    /// Returns whether a fault leaves the port open.
    pub(super) fn is_open(&self, now: Time) -> bool {
        self.at(now, |_| ()).is_some()
    }

    /// What has come since the last call; `None` if the port was closed.
    pub(super) fn receive(&self, now: Time) -> Option<Vec<u8>> {
        self.at(now, |emulated| emulated.take(MOST))
    }

    /// Returns false if the port was closed.
    pub(super) fn send(&self, bytes: &[u8], now: Time) -> bool {
        self.at(now, |emulated| emulated.send(bytes)).is_some()
    }

    fn at<T>(&self, now: Time, act: impl FnOnce(&mut Emulated) -> T) -> Option<T> {
        let device = self.device.upgrade()?;
        let mut emulated = device.lock();
        let start = *emulated.start.get_or_insert(now);
        emulated.advance_to(now.saturating_since(start)).then(|| act(&mut emulated))
    }
}
