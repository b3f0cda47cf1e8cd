//! The handle of a running emulator.

use super::devices::Devices;
use super::error::EmulatorError;
use super::fault::Fault;
use super::memory::MemoryBus;
use super::options::EmulatorOptions;
use super::pseudo_terminal::PseudoTerminal;
use super::shared::Shared;
use super::wire::{Bundle, Timing};
use crate::servo_bus::protocol::Receiver;
use downbeat_executor::Time;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// A running emulator. It stops when it is dropped.
pub struct Emulator {
    shared: Arc<Shared>,
    link: Option<PathBuf>,
    thread: Option<JoinHandle<()>>,
}

impl Emulator {
    /// Without a port, for its [`MemoryBus`]. The link is ignored.
    #[must_use]
    pub fn of(devices: Box<dyn Devices>, options: &EmulatorOptions) -> Self {
        Self { shared: Arc::new(Shared::new(options, PathBuf::new(), devices)), link: None, thread: None }
    }

    /// Opens the port and starts to serve it.
    ///
    /// # Errors
    /// Returns an error if there is no pseudo terminal, or the link cannot be created.
    pub fn serve(devices: Box<dyn Devices>, options: EmulatorOptions) -> Result<Self, EmulatorError> {
        let terminal = PseudoTerminal::open(options.link.as_deref())?;
        let shared = Arc::new(Shared::new(&options, terminal.path().to_owned(), devices));
        let link = options.link.clone();
        let served = Arc::clone(&shared);
        let thread = thread::Builder::new()
            .name("servo_emulator".to_owned())
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

    /// Returns whether the port is open. A fault may have closed it.
    #[must_use]
    pub fn is_port_open(&self) -> bool {
        !self.shared.world().device.as_os_str().is_empty()
    }

    /// Direct access to the devices, without the port.
    #[must_use]
    pub fn bus(&self) -> MemoryBus {
        MemoryBus::new(Arc::clone(&self.shared))
    }

    pub(super) fn shared(&self) -> &Arc<Shared> {
        &self.shared
    }

    /// Begins a step at this time of the owner of the bus, as its [`MemoryBus`] does: the one that comes
    /// first with a later time advances the robot. With another timing than [`Timing::Stepped`] only what
    /// others ask of the body takes effect.
    pub fn begin_step(&self, now: Time) {
        self.shared.world().begin_step(now);
    }

    /// Calls this before each step of a [`MemoryBus`] of this emulator, with the time of the step: for
    /// several emulators that share a world and have to be brought to that time together. Only the first call
    /// counts.
    pub fn lead_by(&self, lead: impl Fn(Time) + Send + Sync + 'static) {
        let _ = self.shared.lead.set(Box::new(lead));
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

    /// Holds the button at this position down for a while.
    pub fn press(&self, number: usize, held: Duration) {
        self.shared.world().devices.press(number, held);
    }

    /// Turns a joint to this angle by hand, in rad, unless its servo holds it. Returns false if there is no
    /// such joint.
    pub fn turn_by_hand(&self, joint: &str, angle: f64) -> bool {
        self.shared.world().devices.turn_by_hand(joint, angle)
    }

    /// Whether a joint is being turned by hand, which ends at its angle or when its servo holds it.
    #[must_use]
    pub fn is_in_hand(&self, joint: &str) -> bool {
        self.shared.world().devices.is_in_hand(joint)
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

/// How often the idle thread checks whether to stop or whether a fault starts.
const LOOK: Duration = Duration::from_millis(10);

/// Serves the port until stopped. The first port is already open, so that its name is known after the start.
fn serve(shared: &Shared, options: &EmulatorOptions, terminal: PseudoTerminal) {
    let mut terminal = Some(terminal);
    let protocol = shared.world().devices.protocol();
    let mut receiver = Receiver::new(protocol);
    let mut buffer = [0; 1024];
    while !shared.is_stopping.load(Ordering::Acquire) {
        if let Err(error) = plug(shared, options, &mut terminal) {
            tracing::warn!("the emulator cannot reopen its port, retrying: {error}");
        }
        let Some(open) = &mut terminal else {
            wait_closed(shared);
            receiver = Receiver::new(protocol);
            continue;
        };
        let served = open.receive(&mut buffer, LOOK).and_then(|(bytes, line_speed)| {
            receiver.push(bytes);
            while let Some(packet) = receiver.next_packet() {
                let bundles = {
                    let mut world = shared.world();
                    if let Some(baud) = line_speed {
                        world.devices.set_line_speed(baud);
                    }
                    world.answer(&packet)
                };
                deliver(shared, options.timing, open, &bundles)?;
            }
            Ok(())
        });
        if let Err(error) = served {
            tracing::warn!("the emulator's port broke, opening another: {error}");
            terminal = None;
        }
    }
}

/// Opens or closes the port according to the faults.
fn plug(
    shared: &Shared,
    options: &EmulatorOptions,
    terminal: &mut Option<PseudoTerminal>,
) -> Result<(), EmulatorError> {
    let mut world = shared.world();
    let now = world.catch_up();
    match (world.faults.is_port_closed(now), terminal.is_some()) {
        (true, true) => {
            *terminal = None;
            world.device = PathBuf::new();
        }
        (false, false) => {
            let opened = PseudoTerminal::open(options.link.as_deref())?;
            world.device = opened.path().to_owned();
            *terminal = Some(opened);
        }
        _ => {}
    }
    Ok(())
}

fn wait_closed(shared: &Shared) {
    thread::sleep(LOOK);
    let mut world = shared.world();
    if world.timing == Timing::Immediate {
        world.closed_for += LOOK;
    }
}

fn deliver(
    shared: &Shared,
    timing: Timing,
    port: &mut PseudoTerminal,
    bundles: &[Bundle],
) -> std::io::Result<()> {
    for bundle in bundles {
        if timing == Timing::Measured {
            let now = shared.world().now();
            thread::sleep(bundle.at.saturating_sub(now));
        }
        port.send(&bundle.bytes)?;
    }
    Ok(())
}
