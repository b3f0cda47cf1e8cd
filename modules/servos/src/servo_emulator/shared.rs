//! What the handles of an emulator, its thread and its buses share: the devices in their time.

use super::devices::Devices;
use super::fault::FaultSchedule;
use super::options::EmulatorOptions;
use super::wire::{Bundle, Timing, Wire};
use crate::servo_bus::protocol::Packet;
use downbeat_executor::Time;
use parking_lot::{Mutex, MutexGuard};
use std::path::PathBuf;
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// State shared between the thread and the handles of the emulator.
pub(super) struct Shared {
    pub(super) is_stopping: AtomicBool,
    pub(super) lead: OnceLock<Box<Lead>>,
    world: Mutex<World>,
}

pub(super) type Lead = dyn Fn(Time) + Send + Sync;

/// The mutable state.
pub(super) struct World {
    pub(super) devices: Box<dyn Devices>,
    pub(super) faults: FaultSchedule,
    /// The device file; empty while the port is closed.
    pub(super) device: PathBuf,
    wire: Wire,
    pub(super) timing: Timing,
    started: Instant,
    /// The times of the first and the last step of the bus's owner.
    steps: Option<[Time; 2]>,
    /// The total time during which the port was closed.
    pub(super) closed_for: Duration,
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

    pub(super) fn catch_up(&mut self) -> Duration {
        let now = self.now();
        let faults = &self.faults;
        self.devices.set_dead(&|id| faults.is_dead(id, now));
        self.devices.disturb(faults.disturbance(now));
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
