//! The handle of a running emulator.

use super::board::Button;
#[cfg(test)]
use super::direct::DirectBus;
use super::fault::Fault;
use super::pseudo_terminal::PseudoTerminal;
use super::server::{Shared, serve};
use super::wire::Timing;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Options of the emulator.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EmulatorOptions {
    /// A symbolic link to the port, whose path stays the same when the port changes.
    pub link: Option<PathBuf>,
    /// The same seed gives the same starting pose, noise and faults.
    pub seed: u64,
    /// Whether the timing of the bus is emulated.
    pub timing: Timing,
    /// Faults, with times relative to the start.
    pub faults: Vec<Fault>,
}

/// Why the emulator could not be started.
#[derive(Debug, thiserror::Error)]
pub enum EmulatorError {
    /// No pseudo terminal is available.
    #[error("the emulator cannot open a pseudo terminal: {source}; is /dev/pts mounted?")]
    PseudoTerminal {
        /// The error of the operating system.
        source: io::Error,
    },
    /// The link cannot be created.
    #[error("linking {} to the emulator's port: {source}; choose an unused path", link.display())]
    Link {
        /// The path of the link.
        link: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// An existing link was not created by an emulator.
    #[error("{} is a link to {} that was not created by an emulator; choose an unused path", link.display(), target.display())]
    OtherLink {
        /// The path of the link.
        link: PathBuf,
        /// Its target.
        target: PathBuf,
    },
    /// Another emulator uses the link.
    #[error(
        "{} links to {}, which is in use by another emulator; stop it, choose another link, or remove this one",
        link.display(),
        target.display()
    )]
    LinkInUse {
        /// The path of the link.
        link: PathBuf,
        /// The port of the other one.
        target: PathBuf,
    },
    /// The thread cannot be started.
    #[error("the emulator cannot start a thread: {source}")]
    Thread {
        /// The error of the operating system.
        source: io::Error,
    },
}

/// A running emulator. It stops when it is dropped.
pub struct Emulator {
    shared: Arc<Shared>,
    link: Option<PathBuf>,
    thread: Option<JoinHandle<()>>,
}

impl Emulator {
    /// Opens the port and starts to serve it.
    ///
    /// # Errors
    /// If there is no pseudo terminal, or the link cannot be created.
    pub fn start(options: EmulatorOptions) -> Result<Self, EmulatorError> {
        let terminal = PseudoTerminal::open(options.link.as_deref())?;
        let shared = Arc::new(Shared::new(&options, &terminal));
        let link = options.link.clone();
        let served = Arc::clone(&shared);
        let thread = thread::Builder::new()
            .name("darwin_op_emulator".to_owned())
            .spawn(move || serve(&served, &options, terminal))
            .map_err(|source| EmulatorError::Thread { source })?;
        Ok(Self { shared, link, thread: Some(thread) })
    }

    /// The path to open: the link, or the device file, which changes with every new port and is empty while
    /// the port is closed.
    #[must_use]
    pub fn port_path(&self) -> PathBuf {
        self.link.clone().unwrap_or_else(|| self.shared.world().device.clone())
    }

    /// Whether the port is open. A fault may have closed it.
    #[must_use]
    pub fn is_port_open(&self) -> bool {
        !self.shared.world().device.as_os_str().is_empty()
    }

    /// Direct access to the devices, without the port.
    #[cfg(test)]
    pub(crate) fn bus(&self) -> DirectBus {
        DirectBus::new(Arc::clone(&self.shared))
    }

    /// The time inside the emulator.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        self.shared.world().now()
    }

    /// Injects a fault, with times relative to now.
    pub fn inject(&self, fault: Fault) {
        let mut world = self.shared.world();
        let now = world.now();
        world.faults.inject(fault, now);
    }

    /// Holds a button down for a while.
    pub fn press_button(&self, button: Button, held: Duration) {
        self.shared.world().robot.press(button, held);
    }

    /// Stops the emulator: the port is closed and the link removed when this returns.
    pub fn stop(mut self) {
        self.end();
    }

    fn end(&mut self) {
        self.shared.is_stopping.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the emulator's thread panicked");
        }
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        self.end();
    }
}
