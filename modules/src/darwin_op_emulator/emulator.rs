//! The emulator as others hold it.

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

/// How to emulate.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EmulatorOptions {
    /// A symbolic link that is made to the port and stays the same when the port changes.
    pub link: Option<PathBuf>,
    /// The same seed gives the same starting pose, noise and faults.
    pub seed: u64,
    /// Whether the bus takes its time.
    pub timing: Timing,
    /// What goes wrong and when, counted from the start.
    pub faults: Vec<Fault>,
}

/// Why there is no emulator.
#[derive(Debug, thiserror::Error)]
pub enum EmulatorError {
    /// The operating system gives no pseudo terminal.
    #[error("the emulator needs a pseudo terminal and got none: {source}; is /dev/pts mounted?")]
    PseudoTerminal {
        /// What it says.
        source: io::Error,
    },
    /// The link cannot be made.
    #[error("linking {} to the emulator's port: {source}; choose a path that is free", link.display())]
    Link {
        /// Where it was to be.
        link: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// The link is not that of an emulator.
    #[error("{} is a link to {}, which no emulator made, and stays; choose a path that is free", link.display(), target.display())]
    OtherLink {
        /// Where it was to be.
        link: PathBuf,
        /// Where it leads.
        target: PathBuf,
    },
    /// Another emulator has the link.
    #[error(
        "{} leads to {}, which is in use: another emulator runs there; stop it, choose another link, or remove this one",
        link.display(),
        target.display()
    )]
    LinkInUse {
        /// Where it was to be.
        link: PathBuf,
        /// The port of the other one.
        target: PathBuf,
    },
    /// The operating system gives no thread.
    #[error("the emulator needs a thread and got none: {source}")]
    Thread {
        /// What it says.
        source: io::Error,
    },
}

/// A running emulator. It ends when it is dropped.
pub struct Emulator {
    shared: Arc<Shared>,
    link: Option<PathBuf>,
    thread: Option<JoinHandle<()>>,
}

impl Emulator {
    /// Opens the port and begins to serve it.
    ///
    /// # Errors
    /// If there is no pseudo terminal, or the link cannot be made.
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

    /// What to open: the link, or the device file, which changes with every new port and is empty while it is closed.
    #[must_use]
    pub fn port_path(&self) -> PathBuf {
        self.link.clone().unwrap_or_else(|| self.shared.world().device.clone())
    }

    /// Whether the port is there. A fault may have closed it.
    #[must_use]
    pub fn is_port_open(&self) -> bool {
        !self.shared.world().device.as_os_str().is_empty()
    }

    /// A way to the devices past the port.
    #[cfg(test)]
    pub(crate) fn bus(&self) -> DirectBus {
        DirectBus::new(Arc::clone(&self.shared))
    }

    /// The time inside the emulator.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        self.shared.world().now()
    }

    /// Makes something go wrong. Its times count from now.
    pub fn inject(&self, fault: Fault) {
        let mut world = self.shared.world();
        let now = world.now();
        world.faults.inject(fault, now);
    }

    /// Holds a button down for a while.
    pub fn press_button(&self, button: Button, held: Duration) {
        self.shared.world().robot.press(button, held);
    }

    /// Ends: the port is closed and the link removed when this returns.
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
