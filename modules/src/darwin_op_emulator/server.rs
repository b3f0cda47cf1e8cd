//! The thread that serves the port.

use super::EmulatorError;
use super::emulator::EmulatorOptions;
use super::fault_schedule::FaultSchedule;
use super::pseudo_terminal::PseudoTerminal;
use super::robot::Robot;
use super::wire::{Bundle, Timing, Wire};
use crate::darwin_op::protocol::{Packet, Receiver};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// How often the idle thread checks whether to stop or whether a fault starts.
const LOOK: Duration = Duration::from_millis(10);

/// State shared between the thread and the handles of the emulator.
pub(super) struct Shared {
    pub(super) is_stopping: AtomicBool,
    world: Mutex<World>,
}

/// The mutable state.
pub(super) struct World {
    pub(super) robot: Robot,
    pub(super) faults: FaultSchedule,
    /// The device file; empty while the port is closed.
    pub(super) device: PathBuf,
    wire: Wire,
    timing: Timing,
    started: Instant,
    /// The total time during which the port was closed.
    closed_for: Duration,
}

impl Shared {
    pub(super) fn new(options: &EmulatorOptions, terminal: &PseudoTerminal) -> Self {
        let world = World {
            robot: Robot::new(options.seed, options.timing == Timing::Immediate),
            faults: FaultSchedule::new(options.faults.clone(), options.seed),
            device: terminal.path().to_owned(),
            wire: Wire::new(options.seed),
            timing: options.timing,
            started: Instant::now(),
            closed_for: Duration::ZERO,
        };
        Self { is_stopping: AtomicBool::new(false), world: Mutex::new(world) }
    }

    pub(super) fn world(&self) -> MutexGuard<'_, World> {
        self.world.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl World {
    /// The time inside the emulator.
    pub(super) fn now(&self) -> Duration {
        match self.timing {
            Timing::Measured => self.started.elapsed(),
            Timing::Immediate => self.wire.free_at() + self.closed_for,
        }
    }

    fn catch_up(&mut self) -> Duration {
        let now = self.now();
        self.robot.set_dead(|id| self.faults.is_dead(id, now));
        self.robot.advance_to(now);
        now
    }

    pub(super) fn answer(&mut self, packet: &Packet<&[u8]>) -> Vec<Bundle> {
        let now = self.catch_up();
        let faults = &mut self.faults;
        let mut answers = self.robot.answer(packet, &mut || faults.loses_answer(now));
        for answer in &mut answers {
            self.faults.flip(&mut answer.packet, now);
        }
        self.wire.carry(now.saturating_sub(self.closed_for), packet.as_bytes().len(), &answers)
    }
}

/// Serves the port until stopped. The first port is already open, so that its name is known after the start.
pub(super) fn serve(shared: &Shared, options: &EmulatorOptions, terminal: PseudoTerminal) {
    let mut terminal = Some(terminal);
    let mut receiver = Receiver::new();
    let mut buffer = [0; 1024];
    while !shared.is_stopping.load(Ordering::Acquire) {
        if let Err(error) = plug(shared, options, &mut terminal) {
            tracing::warn!("the emulator cannot reopen its port, retrying: {error}");
        }
        let Some(open) = &mut terminal else {
            wait_closed(shared);
            receiver = Receiver::new();
            continue;
        };
        let served = open.receive(&mut buffer, LOOK).and_then(|bytes| {
            receiver.push(bytes);
            while let Some(packet) = receiver.next_packet() {
                let bundles = shared.world().answer(&packet);
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
