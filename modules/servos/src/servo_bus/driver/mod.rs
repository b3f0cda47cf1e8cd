//! The cycle of the hardware: opens the port, brings the devices into service, then writes goals and reads
//! all devices.
//!
//! It does one step per call and only waits for answers. Its behaviour depends only on the given time, its
//! plan, the wanted joint positions and torques, and the answers from the bus.

mod cycle;

use super::bus::{Bus, Exchange, LATE, Outcome};
use super::description::BusPlan;
use super::fault_text::{closed_port, lost_port, named, place, silent, unusable};
use super::joint::{Drive, Joint};
use super::line::{ECHO, Line, Trouble};
use super::models::Register;
use super::preparation::{PrepareError, Prepared, prepare, prepare_device};
use super::protocol::{Id, Protocol, WriteEntry, echo_end};
use super::reading::{Reading, Unit};
use super::servo::{Link, Service, Servo};
use downbeat_device::counted::Counted;
use downbeat_executor::Time;
use std::collections::VecDeque;
use std::time::Duration;

/// The number of attempts to reach a device before the cycle starts.
const ATTEMPTS_TO_PREPARE: u32 = 3;

/// The time between attempts to reach a device out of service. Polling a silent one takes 5 ms, more than the
/// idle time of a cycle.
const RETRY_UNIT: Duration = Duration::from_secs(1);
/// At most one device out of service is polled in this time, however many there are.
const RETRY_ANY: Duration = Duration::from_millis(250);
/// The time between attempts to reach a silent board that switches the power.
const RETRY_BOARD: Duration = Duration::from_millis(500);
/// The first and the longest time between attempts to open a failed port.
const RETRY_PORT: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(2)];

/// The phase of the driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// The port is closed and will be opened at `retry_at`.
    Closed { retry_at: Time },
    /// The port is open, the servos have no power. The board will be instructed to switch them on at
    /// `retry_at`.
    Open { retry_at: Time },
    /// The servos have power and are starting up.
    PowerOn { until: Time },
    /// The devices are being brought into service; `next` is the next one.
    Preparing { next: usize },
    /// All devices that answer are in service.
    Running,
}

/// Counts of faults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Troubles {
    /// Exchanges with a missing or corrupt answer.
    pub(crate) timeouts: Counted,
    /// Answers that arrived after their time-out.
    pub(crate) late: Counted,
    /// How often the port was lost.
    pub(crate) lost_ports: Counted,
    /// How often it could not be opened.
    pub(crate) refused_ports: Counted,
    /// How often the board that switches the power did not answer.
    pub(crate) silent_board: Counted,
    /// Cycles that began at least half a cycle late.
    pub(crate) late_cycles: Counted,
    /// Instructions that the adapter sent back.
    pub(crate) echoes: Counted,
    /// How often a servo did not take its torque.
    pub(crate) refused_torque: Counted,
}

/// A device beside servos.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct DeviceUnit {
    pub(crate) link: Link,
    /// What was last read of it.
    pub(crate) last: Option<Vec<u8>>,
}

/// The state of the cycle.
pub(crate) struct Driver {
    pub(crate) phase: Phase,
    /// In the order of the plan.
    pub(crate) servos: Vec<Servo>,
    /// In the order of the plan.
    pub(crate) devices: Vec<DeviceUnit>,
    pub(crate) troubles: Troubles,
    /// The number of exchanges.
    pub(crate) exchanges: u64,
    /// When an answer was last missing or corrupt.
    pub(crate) last_timeout_at: Option<Time>,
    /// When an answer was last late.
    pub(crate) last_late_at: Option<Time>,
    /// When a cycle was last late.
    pub(crate) last_late_cycle_at: Option<Time>,
    /// When the adapter last sent an instruction back.
    pub(crate) last_echo_at: Option<Time>,
    /// Writes to devices beside servos, of which one is done in each cycle.
    pub(crate) to_write: VecDeque<WriteEntry>,
    last_step_at: Option<Time>,
    board_misses: u32,
    /// Whether a device that comes back is fresh before its first answer.
    comes_back_fresh: bool,
    port_wait: Duration,
    retry_any_at: Time,
}

impl Driver {
    /// The driver of a bus with these numbers of joints and devices.
    pub(crate) fn new(joints: usize, devices: usize) -> Self {
        let device = DeviceUnit { link: Link::new(), last: None };
        Self {
            phase: Phase::Closed { retry_at: Time::ZERO },
            servos: (0..joints).map(|_| Servo::new()).collect(),
            devices: vec![device; devices],
            troubles: Troubles::default(),
            exchanges: 0,
            last_timeout_at: None,
            last_late_at: None,
            last_late_cycle_at: None,
            last_echo_at: None,
            to_write: VecDeque::new(),
            last_step_at: None,
            board_misses: 0,
            comes_back_fresh: false,
            port_wait: RETRY_PORT[0],
            retry_any_at: Time::ZERO,
        }
    }

    /// Shows the last measurement of a servo that comes back as fresh for one cycle, as recorded bags of the
    /// Darwin OP do.
    pub(crate) fn with_recorded_freshness(self) -> Self {
        Self { comes_back_fresh: true, ..self }
    }

    /// Does one step. Returns the reading if the robot is running.
    pub(crate) fn step(
        &mut self,
        now: Time,
        plan: &BusPlan,
        bus: &mut dyn Bus,
        exchanges: &mut Vec<Exchange>,
    ) -> Option<Reading> {
        let is_live = !bus.is_recorded();
        self.notice_late_cycle(now, plan, is_live);
        bus.begin_step(now);
        let before = exchanges.len();
        let mut line = Line { bus, protocol: plan.line.protocol, exchanges };
        let done = match self.phase {
            Phase::Closed { retry_at } if now >= retry_at => self.open(now, plan, &mut line).map(|()| None),
            Phase::Open { retry_at } if now >= retry_at => self.power_on(now, plan, &mut line).map(|()| None),
            Phase::PowerOn { until } if now >= until => {
                self.phase = Phase::Preparing { next: 0 };
                Ok(None)
            }
            Phase::Preparing { next } => self.prepare_next(next, now, plan, &mut line).map(|()| None),
            Phase::Running => self.cycle(now, plan, &mut line).map(Some),
            Phase::Closed { .. } | Phase::Open { .. } | Phase::PowerOn { .. } => Ok(None),
        };
        let reading = done.unwrap_or_else(|PortFailed| {
            self.lose_port(now, plan, &mut line);
            None
        });
        self.count(now, plan, is_live, &exchanges[before..]);
        reading
    }

    /// The module is active again: devices may have been switched off or turned meanwhile, and are brought
    /// into service anew.
    pub(crate) fn resume(&mut self) {
        if !matches!(self.phase, Phase::Closed { .. }) {
            self.forget_units();
            self.phase = Phase::Open { retry_at: Time::ZERO };
        }
    }

    /// Returns whether nothing may move, because a servo was not the declared one at the start and is not
    /// exchanged yet: then the description is that of another robot, or its ids are mixed up.
    pub(crate) fn is_held(&self) -> bool {
        self.servos.iter().any(|servo| servo.misfit.is_some())
    }

    /// Says why nothing may move, with the remedy.
    pub(crate) fn misfit(&self, plan: &BusPlan) -> Option<String> {
        let mut servos = self.servos.iter().zip(&plan.joints);
        let (reason, joint) = servos.find_map(|(servo, joint)| Some((servo.misfit.as_ref()?, joint)))?;
        let at = joint.declared_at.as_ref().map_or(String::new(), |at| format!("{at}: "));
        let Joint { id, name, .. } = joint;
        Some(format!(
            "nothing moves: {at}servo {id} ({name}) is not the declared one, {reason}; correct its model or exchange it"
        ))
    }

    /// Stops the joints that are driven by velocities or efforts. The others hold their position.
    pub(crate) fn rest(
        &mut self,
        now: Time,
        plan: &BusPlan,
        bus: &mut dyn Bus,
        exchanges: &mut Vec<Exchange>,
    ) {
        bus.begin_step(now);
        let mut line = Line { bus, protocol: plan.line.protocol, exchanges };
        let driven = self.servos.iter().zip(&plan.joints);
        let driven = driven.filter(|(servo, joint)| servo.link.is_active() && joint.drive.is_some());
        let rest =
            driven.map(|(_, joint)| write(joint.id, joint.goal_register(), line.protocol, 0)).collect();
        // Ignores whether the port works: nothing else can be done here.
        let _ = self.write_all(&mut line, rest);
    }

    /// Closes the port, after this write to a device. The servos hold their position: without torque the
    /// robot would collapse.
    pub(crate) fn stop(
        &mut self,
        now: Time,
        plan: &BusPlan,
        last_write: Option<(Id, &[u8], u16)>,
        bus: &mut dyn Bus,
        exchanges: &mut Vec<Exchange>,
    ) {
        if matches!(self.phase, Phase::Closed { .. }) {
            return;
        }
        self.rest(now, plan, bus, exchanges);
        let mut line = Line { bus, protocol: plan.line.protocol, exchanges };
        if let Some((id, data, address)) = last_write {
            // Ignores whether the device obeys.
            let _ = line.write(id, address, data);
        }
        line.close();
        self.phase = Phase::Closed { retry_at: Time::MAX };
    }

    fn open(&mut self, now: Time, plan: &BusPlan, line: &mut Line<'_>) -> Result<(), PortFailed> {
        if line.open(&plan.port) {
            return self.power_on(now, plan, line);
        }
        if self.troubles.refused_ports.is_worth_a_line() {
            let count = self.troubles.refused_ports.count();
            let error = line.exchanges.last().map_or("", |exchange| &exchange.error);
            tracing::warn!("{error}; {} (failed {count} times so far)", closed_port(plan));
        }
        self.wait_for_port(now);
        Ok(())
    }

    fn power_on(&mut self, now: Time, plan: &BusPlan, line: &mut Line<'_>) -> Result<(), PortFailed> {
        let Some((board, power)) = power_switch(plan) else {
            self.phase = Phase::Preparing { next: 0 };
            return Ok(());
        };
        let register = &power.register;
        match line.write(board.id, register.address, &register.bytes(plan.line.protocol, 1)) {
            Ok(()) => self.phase = Phase::PowerOn { until: now + power.wait },
            Err(Trouble::PortFailed) => return Err(PortFailed),
            Err(Trouble::Silent | Trouble::Refused(_) | Trouble::Echo) => {
                if self.troubles.silent_board.is_worth_a_line() {
                    let (count, name) = (self.troubles.silent_board.count(), &board.name);
                    tracing::warn!(
                        "the {name} (id {}) on {} did not switch the servos on ({count} times so far); is it on?",
                        board.id,
                        place(plan)
                    );
                }
                self.phase = Phase::Open { retry_at: now + RETRY_BOARD };
            }
        }
        Ok(())
    }

    fn prepare_next(
        &mut self,
        next: usize,
        now: Time,
        plan: &BusPlan,
        line: &mut Line<'_>,
    ) -> Result<(), PortFailed> {
        let units = units(plan);
        if let Some(unit) = units.get(next) {
            self.prepare(*unit, now, plan, line)?;
        }
        self.phase =
            if next + 1 < units.len() { Phase::Preparing { next: next + 1 } } else { Phase::Running };
        Ok(())
    }

    fn prepare(
        &mut self,
        unit: Unit,
        now: Time,
        plan: &BusPlan,
        line: &mut Line<'_>,
    ) -> Result<(), PortFailed> {
        let was_out = self.link(unit).retry_at().is_some();
        let mut attempt = || match unit {
            Unit::Joint(index) => {
                let (servo, joint) = (&self.servos[index], &plan.joints[index]);
                prepare(line, joint, servo.softness(joint), servo.wants_torque()).map(Some)
            }
            Unit::Device(index) => {
                let device = &plan.devices[index];
                let wanted: Vec<(&Register, i64)> =
                    device.model.at_start.iter().map(|(register, value)| (register, *value)).collect();
                prepare_device(line, device.id, &device.model, &wanted).map(|_| None)
            }
        };
        let mut prepared = attempt();
        if matches!(self.phase, Phase::Preparing { .. }) {
            // No cycle is waiting yet, and a servo left out now joins a second later.
            for _ in 1..ATTEMPTS_TO_PREPARE {
                if prepared != Err(PrepareError::Trouble(Trouble::Silent)) {
                    break;
                }
                prepared = attempt();
            }
        }
        let is_other = matches!(prepared, Err(PrepareError::OtherModel(_)));
        match prepared {
            Ok(prepared) => {
                if let Unit::Joint(index) = unit
                    && self.servos[index].misfit.take().is_some()
                    && !self.is_held()
                {
                    tracing::info!("all servos are the declared ones: commands are followed again");
                }
                if was_out {
                    let missed = self.link(unit).missed;
                    tracing::info!("{} is back; it missed {missed} answers so far", named(plan, unit));
                }
                if let (Unit::Joint(index), Some(prepared)) = (unit, prepared) {
                    self.join(index, &prepared, plan);
                } else {
                    self.link(unit).join();
                }
                if self.comes_back_fresh {
                    self.link(unit).unheard = 0;
                }
            }
            Err(PrepareError::Trouble(Trouble::PortFailed)) => return Err(PortFailed),
            Err(PrepareError::Trouble(_)) => self.silence(unit, now, plan),
            Err(PrepareError::OtherModel(reason) | PrepareError::Unsuitable(reason)) => {
                if !was_out {
                    tracing::warn!("{}", unusable(plan, unit, &reason));
                }
                if let (Unit::Joint(index), Phase::Preparing { .. }, true) = (unit, self.phase, is_other) {
                    self.servos[index].misfit = Some(reason.clone());
                    tracing::error!("{}", self.misfit(plan).unwrap_or_default());
                }
                self.link(unit).service = Service::Unsuitable { reason, retry_at: now + RETRY_UNIT };
            }
        }
        Ok(())
    }

    fn join(&mut self, index: usize, prepared: &Prepared, plan: &BusPlan) {
        let (servo, joint) = (&mut self.servos[index], &plan.joints[index]);
        let softness = servo.softness(joint);
        servo.join(prepared, softness);
        servo.report_limp(joint);
        self.arm_watchdog(joint, plan.line.protocol);
    }

    /// Has a driven servo stop by itself if it hears nothing for as long as a command is valid. Done in one
    /// of the next cycles: it expects instructions from then on. After it has stopped it takes no goals until
    /// the watchdog is cleared.
    fn arm_watchdog(&mut self, joint: &Joint, protocol: Protocol) {
        let Some((watchdog, Drive { timeout, .. })) =
            joint.model.register("bus_watchdog").zip(joint.drive.as_ref())
        else {
            return;
        };
        for value in [0, watchdog.from_si(timeout.as_secs_f64()).max(1)] {
            self.to_write.push_back(write(joint.id, watchdog, protocol, value));
        }
    }

    /// Polls one of the devices out of service.
    fn retry_one(&mut self, now: Time, plan: &BusPlan, line: &mut Line<'_>) -> Result<(), PortFailed> {
        if now < self.retry_any_at || self.phase != Phase::Running {
            return Ok(());
        }
        let waiting = units(plan).into_iter().filter_map(|unit| Some((self.link(unit).retry_at()?, unit)));
        match waiting.min() {
            Some((retry_at, unit)) if retry_at <= now => {
                self.retry_any_at = now + RETRY_ANY;
                self.prepare(unit, now, plan, line)
            }
            _ => Ok(()),
        }
    }

    fn lose_port(&mut self, now: Time, plan: &BusPlan, line: &mut Line<'_>) {
        if self.troubles.lost_ports.is_worth_a_line() {
            let count = self.troubles.lost_ports.count();
            let error = line.exchanges.last().map_or("", |exchange| &exchange.error);
            tracing::warn!("{} ({count} times so far): {error}", lost_port(plan));
        }
        line.close();
        self.forget_units();
        self.board_misses = 0;
        self.wait_for_port(now);
    }

    fn wait_for_port(&mut self, now: Time) {
        self.phase = Phase::Closed { retry_at: now + self.port_wait };
        self.port_wait = (self.port_wait * 2).min(RETRY_PORT[1]);
    }

    fn forget_units(&mut self) {
        let devices = self.devices.iter_mut().map(|device| &mut device.link);
        for link in self.servos.iter_mut().map(|servo| &mut servo.link).chain(devices) {
            link.service = Service::Unknown;
        }
    }

    fn link(&mut self, unit: Unit) -> &mut Link {
        match unit {
            Unit::Device(index) => &mut self.devices[index].link,
            Unit::Joint(index) => &mut self.servos[index].link,
        }
    }

    fn silence(&mut self, unit: Unit, now: Time, plan: &BusPlan) {
        let link = self.link(unit);
        if link.retry_at().is_none() && link.outages.is_worth_a_line() {
            let (silent, count) = (silent(plan, unit), link.outages.count());
            tracing::warn!("{silent} ({count} times so far); others continue");
        }
        link.service = Service::Silent { retry_at: now + RETRY_UNIT };
    }

    /// A cycle that begins late is not made up for. It is always counted, but logged only if the bus
    /// `is_live`.
    fn notice_late_cycle(&mut self, now: Time, plan: &BusPlan, is_live: bool) {
        let last = self.last_step_at.replace(now);
        let is_late = last.is_some_and(|last| last + plan.cycle + plan.cycle / 2 <= now);
        if is_late && self.phase == Phase::Running {
            for joint in plan.joints.iter().filter(|joint| {
                joint
                    .drive
                    .as_ref()
                    .is_some_and(|drive| last.is_some_and(|last| last + drive.timeout / 2 <= now))
            }) {
                self.arm_watchdog(joint, plan.line.protocol);
            }
            self.last_late_cycle_at = Some(now);
            if self.troubles.late_cycles.is_worth_a_line() && is_live {
                let (count, cycle) = (self.troubles.late_cycles.count(), plan.cycle);
                tracing::warn!(
                    "a cycle of {cycle:?} began late ({count} times so far): the bus or this machine is too slow"
                );
            }
        }
    }

    fn count(&mut self, now: Time, plan: &BusPlan, is_live: bool, exchanges: &[Exchange]) {
        let (protocol, port) = (plan.line.protocol, &plan.port);
        self.exchanges += exchanges.len() as u64;
        for _ in exchanges.iter().filter(|exchange| exchange.error.contains(LATE)) {
            self.last_late_at = Some(now);
            if self.troubles.late.is_worth_a_line() && is_live {
                let count = self.troubles.late.count();
                tracing::warn!(
                    "this machine is too busy: an answer on the bus arrived after its time-out ({count} times so far)"
                );
            }
        }
        let is_echoed =
            |exchange: &&Exchange| echo_end(protocol, &exchange.instruction, &exchange.reply).is_some();
        for _ in exchanges.iter().filter(is_echoed) {
            self.last_echo_at = Some(now);
            if self.troubles.echoes.is_worth_a_line() {
                let count = self.troubles.echoes.count();
                tracing::error!("{port}: {ECHO} ({count} times so far)");
            }
        }
        for exchange in exchanges.iter().filter(|exchange| exchange.outcome == Outcome::Timeout) {
            self.last_timeout_at = Some(now);
            if self.troubles.timeouts.is_worth_a_line() {
                let count = self.troubles.timeouts.count();
                tracing::warn!("the bus on {port}: {} ({count} times so far)", exchange.error);
            }
        }
    }
}

/// The port does not work; the exchange contains the reason.
struct PortFailed;

/// The device that switches the power of the servos, which is the first one.
fn power_switch(
    plan: &BusPlan,
) -> Option<(&super::description::DevicePlan, &super::description::PowerSwitch)> {
    let board = plan.devices.first()?;
    Some((board, board.power.as_ref()?))
}

/// All devices except the one that switches the power.
fn units(plan: &BusPlan) -> Vec<Unit> {
    let devices = usize::from(power_switch(plan).is_some())..plan.devices.len();
    devices.map(Unit::Device).chain((0..plan.joints.len()).map(Unit::Joint)).collect()
}

fn write(id: Id, register: &Register, protocol: Protocol, value: i64) -> WriteEntry {
    WriteEntry { id, address: register.address, data: register.bytes(protocol, value) }
}
