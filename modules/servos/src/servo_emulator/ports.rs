//! Emulators in memory by the names of their ports.

use super::emulator::Emulator;
use super::memory::MemoryBus;
use super::shared::Shared;
use crate::servo_bus::bus::{Bus, Exchange, ExchangeKind, ExpectedStatus, LineSettings, Outcome, SerialBus};
use downbeat_executor::Time;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::{Arc, Weak};

/// What the names of ports in memory start with.
const PREFIX: &str = "memory:";

/// Emulators in memory that a hardware module opens by a name that starts with `memory:`, as it opens a
/// serial port by its path. Clones share them.
#[derive(Clone, Default)]
pub struct MemoryPorts {
    emulators: Arc<Mutex<BTreeMap<String, Weak<Shared>>>>,
}

/// Another running emulator has the name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("\"{0}\" is in use by another emulator; choose another name")]
pub struct NameInUse(String);

impl MemoryPorts {
    /// Returns whether this names a port in memory.
    #[must_use]
    pub fn is_memory(port: &str) -> bool {
        port.starts_with(PREFIX)
    }

    /// Lets hardware modules open this emulator, as long as it exists.
    ///
    /// # Errors
    /// If the name is in use.
    pub fn offer(&self, port: &str, emulator: &Emulator) -> Result<(), NameInUse> {
        let mut emulators = self.emulators.lock();
        emulators.retain(|_, shared| shared.strong_count() > 0);
        if emulators.contains_key(port) {
            return Err(NameInUse(port.to_owned()));
        }
        emulators.insert(port.to_owned(), Arc::downgrade(emulator.shared()));
        Ok(())
    }

    /// A bus that opens these emulators by their names, and anything else as a serial port.
    #[must_use]
    pub fn bus(&self) -> PortBus {
        PortBus { ports: self.clone(), serial: SerialBus::new(), memory: None, now: Time::ZERO }
    }
}

/// A bus behind a serial port, or that of an emulator in memory: which one is decided when it is opened.
pub struct PortBus {
    ports: MemoryPorts,
    serial: SerialBus,
    memory: Option<MemoryBus>,
    now: Time,
}

impl PortBus {
    fn chosen(&mut self) -> &mut dyn Bus {
        match &mut self.memory {
            Some(bus) => bus,
            None => &mut self.serial,
        }
    }
}

impl Bus for PortBus {
    fn begin_step(&mut self, now: Time) {
        self.now = now;
        self.chosen().begin_step(now);
    }

    fn set_line(&mut self, line: LineSettings) {
        // Emulators in memory have no speed.
        self.serial.set_line(line);
    }

    fn open(&mut self, port: &str) -> Exchange {
        if !MemoryPorts::is_memory(port) {
            self.memory = None;
            self.serial.begin_step(self.now);
            return self.serial.open(port);
        }
        let found = self.ports.emulators.lock().get(port).and_then(Weak::upgrade);
        let Some(shared) = found else {
            let error =
                format!("no module emulates \"{port}\": add one with that \"link\" to the robot file");
            let exchange = self.chosen().close();
            return Exchange { kind: ExchangeKind::Open, outcome: Outcome::Failed, error, ..exchange };
        };
        let is_same = self.memory.as_ref().is_some_and(|bus| bus.is_of(&shared));
        if !is_same {
            self.memory = Some(MemoryBus::new(shared));
        }
        self.begin_step(self.now);
        self.chosen().open(port)
    }

    fn exchange(&mut self, instruction: &[u8], expected: &[ExpectedStatus]) -> Exchange {
        self.chosen().exchange(instruction, expected)
    }

    fn close(&mut self) -> Exchange {
        self.chosen().close()
    }
}
