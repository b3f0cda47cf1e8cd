//! The handle of a running emulator.

use super::fault::{Fault, FaultSchedule};
use super::memory::MemoryBus;
use super::pseudo_terminal::PseudoTerminal;
use super::wire::{Answer, Bundle, Timing, Wire};
use crate::servo_bus::protocol::{Id, Packet, Protocol, Receiver};
use downbeat_executor::Time;
use parking_lot::{Mutex, MutexGuard};
use std::io;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// The devices behind the port of an emulator.
///
/// What they answer depends only on the calls, so that the same instructions at the same times get the same
/// answers.
pub trait Devices: Send {
    /// The protocol that they speak.
    fn protocol(&self) -> Protocol;

    /// The speed of their bus, in bit/s.
    fn baud(&self) -> u32;

    /// Sets the speed at which the computer sends, in bit/s.
    fn set_line_speed(&mut self, baud: u32) {
        let _ = baud;
    }

    /// Advances to this time since the start.
    fn advance_to(&mut self, now: Duration);

    /// A step of the owner of the bus begins: see [`MemoryBus`].
    fn begin_step(&mut self);

    /// Sets which devices are dead: without power, as if disconnected.
    fn set_dead(&mut self, is_dead: &dyn Fn(Id) -> bool);

    /// Executes an instruction.
    ///
    /// `is_lost` is called before each answer; a lost answer has the same effect as a silent device, also for
    /// the devices after it.
    fn answer(&mut self, packet: &Packet<'_>, is_lost: &mut dyn FnMut() -> bool) -> Vec<Answer>;

    /// Holds a button down for a while; `number` is its position on the robot. Devices without buttons ignore
    /// it.
    fn press(&mut self, number: usize, held: Duration) {
        let _ = (number, held);
    }
}

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

/// State shared between the thread and the handles of the emulator.
pub(super) struct Shared {
    pub(super) is_stopping: AtomicBool,
    lead: OnceLock<Box<Lead>>,
    world: Mutex<World>,
}

type Lead = dyn Fn(Time) + Send + Sync;

/// The mutable state.
pub(super) struct World {
    pub(super) devices: Box<dyn Devices>,
    pub(super) faults: FaultSchedule,
    /// The device file; empty while the port is closed.
    pub(super) device: PathBuf,
    wire: Wire,
    timing: Timing,
    started: Instant,
    /// The times of the first and the last step of the bus's owner.
    steps: Option<[Time; 2]>,
    /// The total time during which the port was closed.
    closed_for: Duration,
}

impl Shared {
    pub(super) fn new(options: &EmulatorOptions, device: PathBuf, devices: Box<dyn Devices>) -> Self {
        let world = World {
            faults: FaultSchedule::new(options.faults.clone(), options.seed),
            device,
            wire: Wire::new(options.seed, devices.baud()),
            devices,
            timing: options.timing,
            started: Instant::now(),
            steps: None,
            closed_for: Duration::ZERO,
        };
        Self { is_stopping: AtomicBool::new(false), lead: OnceLock::new(), world: Mutex::new(world) }
    }

    /// Brings the world that others share to this time. Not while the own part of it is locked.
    pub(super) fn lead(&self, now: Time) {
        if let Some(lead) = self.lead.get() {
            lead(now);
        }
    }

    pub(super) fn world(&self) -> MutexGuard<'_, World> {
        self.world.lock()
    }
}

impl World {
    /// The time inside the emulator.
    pub(super) fn now(&self) -> Duration {
        match self.timing {
            Timing::Measured => self.started.elapsed(),
            Timing::Immediate => self.wire.free_at() + self.closed_for,
            Timing::Stepped => self.wire.free_at().max(self.stepped()),
        }
    }

    /// The time of the current step, since the first one.
    fn stepped(&self) -> Duration {
        self.steps.map_or(Duration::ZERO, |[first, last]| last.saturating_since(first))
    }

    /// Begins a step of the owner of the bus, unless one has begun at this time.
    pub(super) fn begin_step(&mut self, now: Time) {
        let [first, last] = *self.steps.get_or_insert([now, Time::from_nanos(i64::MIN)]);
        if last < now {
            self.steps = Some([first, now]);
            self.catch_up();
            self.devices.begin_step();
        }
    }

    fn catch_up(&mut self) -> Duration {
        let now = self.now();
        let faults = &self.faults;
        self.devices.set_dead(&|id| faults.is_dead(id, now));
        self.devices.advance_to(now);
        now
    }

    pub(super) fn answer(&mut self, packet: &Packet<'_>) -> Vec<Bundle> {
        let now = self.catch_up();
        let faults = &mut self.faults;
        let mut answers = self.devices.answer(packet, &mut || faults.loses_answer(now));
        for answer in &mut answers {
            self.faults.flip(&mut answer.packet, now);
        }
        self.wire.carry(now.saturating_sub(self.closed_for), packet.as_bytes().len(), &answers)
    }
}

/// Serves the port until stopped. The first port is already open, so that its name is known after the start.
pub(super) fn serve(shared: &Shared, options: &EmulatorOptions, terminal: PseudoTerminal) {
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
