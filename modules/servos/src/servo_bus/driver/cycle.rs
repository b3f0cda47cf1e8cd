//! What is written to the devices and read from them in a cycle of a running robot.

use super::{Driver, Phase, PortFailed, RETRY_PORT, power_switch, units, write};
use crate::servo_bus::description::BusPlan;
use crate::servo_bus::fault_text::{place, without_torque};
use crate::servo_bus::joint::Joint;
use crate::servo_bus::line::{ECHO, Line, Trouble};
use crate::servo_bus::models::{Access, Register};
use crate::servo_bus::protocol::{Instruction, Protocol, WriteEntry};
use crate::servo_bus::reading::{Answer, Answered, Reading, Unit, requests, understand};
use downbeat_executor::Time;

/// The number of consecutive missing answers before a device is taken out of service.
const MISSES_OF_A_UNIT: u32 = 2;
/// The same for corrupt answers: the connection is bad, but other devices are not affected.
const CORRUPT_OF_A_UNIT: u32 = 10;
/// The number of cycles without answers from the board that switches the power before the port is reopened.
const MISSES_OF_THE_BOARD: u32 = 10;
/// The size of the packets that write to several devices: the buffer of an MX-28 has 143 bytes.
const WRITE_LENGTH: usize = 143;

impl Driver {
    pub(super) fn cycle(
        &mut self,
        now: Time,
        plan: &BusPlan,
        line: &mut Line<'_>,
    ) -> Result<Reading, PortFailed> {
        let off = self.ended_torques(now, plan);
        self.write_softness(plan, line)?;
        self.write_all(line, off)?;
        self.engage_one(now, plan, line)?;
        let goals = self.goals(now, plan);
        self.write_all(line, goals)?;
        if let Some(entry) = self.to_write.pop_front()
            && line.write(entry.id, entry.address, &entry.data) == Err(Trouble::PortFailed)
        {
            return Err(PortFailed);
        }
        let reading = self.read_all(now, plan, line)?;
        self.retry_one(now, plan, line)?;
        Ok(reading)
    }

    /// Gives torque to one of the servos that are to have it: reads its position, makes that its goal, and
    /// waits for each acknowledgement, as an instruction without one may be lost and the old goal remain.
    fn engage_one(&mut self, now: Time, plan: &BusPlan, line: &mut Line<'_>) -> Result<(), PortFailed> {
        let Some(index) = self.servos.iter().position(|servo| servo.is_to_engage(now)) else { return Ok(()) };
        let joint = &plan.joints[index];
        self.servos[index].begin_to_engage(now);
        let refusal = match self.engage(index, joint, line) {
            Ok(()) => return self.write_softness(plan, line),
            Err(Trouble::PortFailed) => return Err(PortFailed),
            Err(Trouble::Silent) => "it does not answer; check its power and plugs".to_owned(),
            Err(Trouble::Refused(error)) => format!("it answers: {error}; {}", error.remedy()),
            Err(Trouble::Echo) => ECHO.to_owned(),
        };
        if self.troubles.refused_torque.is_worth_a_line() {
            let (refusal, count) =
                (without_torque(plan, Unit::Joint(index), &refusal), self.troubles.refused_torque.count());
            tracing::warn!("{refusal} ({count} times so far)");
        }
        Ok(())
    }

    fn engage(&mut self, index: usize, joint: &Joint, line: &mut Line<'_>) -> Result<(), Trouble> {
        let (servo, protocol) = (&mut self.servos[index], line.protocol);
        let (position, error) = line.read_position(joint)?;
        servo.note_position(position, error);
        if servo.limp(joint).is_some() {
            servo.report_limp(joint);
            return Ok(());
        }
        let (goal, torque) = (joint.goal_register(), &joint.registers.torque);
        let raw = if joint.drive.is_some() { 0 } else { position };
        line.write(joint.id, goal.address, &goal.bytes(protocol, raw))?;
        line.write(joint.id, torque.address, &torque.bytes(protocol, 1))?;
        servo.engage(position);
        Ok(())
    }

    /// Writes gains and torque limits that have changed, of servos with torque: those of the others follow
    /// when they get it.
    fn write_softness(&mut self, plan: &BusPlan, line: &mut Line<'_>) -> Result<(), PortFailed> {
        let protocol = plan.line.protocol;
        let (mut gains, mut limits) = (Vec::new(), Vec::new());
        for (servo, joint) in self
            .servos
            .iter_mut()
            .zip(&plan.joints)
            .filter(|(servo, _)| servo.link.is_active() && servo.has_torque())
        {
            let wanted = servo.softness(joint);
            if wanted == servo.written {
                continue;
            }
            let known: Vec<(&Register, i64)> = joint
                .registers
                .gains
                .iter()
                .zip(wanted.gains)
                .filter_map(|(register, gain)| register.as_ref().zip(gain))
                // Gains that outlive the power are written only when the servo comes into service.
                .filter(|(register, _)| register.access == Access::Ram)
                .collect();
            if wanted.gains != servo.written.gains {
                // Neighbours in all models.
                if let Some((first, _)) = known.iter().min_by_key(|(register, _)| register.address) {
                    let mut in_order = known.clone();
                    in_order.sort_by_key(|(register, _)| register.address);
                    let data = in_order
                        .iter()
                        .flat_map(|(register, gain)| register.bytes(protocol, *gain))
                        .collect();
                    gains.push(WriteEntry { id: joint.id, address: first.address, data });
                }
            }
            if wanted.torque_limit != servo.written.torque_limit
                && let Some((register, limit)) =
                    joint.registers.torque_limit.as_ref().zip(wanted.torque_limit)
            {
                limits.push(write(joint.id, register, protocol, limit));
            }
            servo.written = wanted;
        }
        self.write_all(line, gains)?;
        self.write_all(line, limits)
    }

    /// What ends the torque of servos that should have none.
    fn ended_torques(&mut self, now: Time, plan: &BusPlan) -> Vec<WriteEntry> {
        let active = self.servos.iter_mut().zip(&plan.joints).filter(|(servo, _)| servo.link.is_active());
        active
            .filter_map(|(servo, joint)| {
                servo.rest(joint, now);
                servo.ends_torque().then(|| write(joint.id, &joint.registers.torque, plan.line.protocol, 0))
            })
            .collect()
    }

    /// The goals of all servos that hold one. Devices do not acknowledge, so goals are written in every
    /// cycle.
    fn goals(&mut self, now: Time, plan: &BusPlan) -> Vec<WriteEntry> {
        let is_held = self.is_held();
        let driven = self.servos.iter_mut().zip(&plan.joints);
        driven
            .filter(|(servo, _)| servo.link.is_active() && servo.has_torque())
            .map(|(servo, joint)| {
                let goal = match &joint.drive {
                    Some(_) if is_held => 0,
                    Some(drive) => servo.next_driven_goal(joint, drive, now),
                    None if is_held => servo.hold(),
                    None => servo.next_goal(joint.approach_steps),
                };
                write(joint.id, joint.goal_register(), plan.line.protocol, goal)
            })
            .collect()
    }

    /// Writes to several devices at once: by one instruction if all have the same range, or the protocol
    /// permits.
    pub(super) fn write_all(
        &mut self,
        line: &mut Line<'_>,
        mut entries: Vec<WriteEntry>,
    ) -> Result<(), PortFailed> {
        let protocol = line.protocol;
        let mut send = |instruction: &Instruction| match line.exchange(instruction, &[]) {
            Err(Trouble::PortFailed) => Err(PortFailed),
            _ => Ok(()),
        };
        while let Some(first) = entries.first() {
            let (address, length) = (first.address, first.data.len());
            let is_same = |entry: &WriteEntry| entry.address == address && entry.data.len() == length;
            let most = ((WRITE_LENGTH - 8) / (length + 1)).max(1);
            if protocol == Protocol::Dynamixel2 {
                // Devices of protocol 2.0 have larger buffers.
                if entries.iter().all(is_same) {
                    let entries = entries.into_iter().map(|entry| (entry.id, entry.data)).collect();
                    return send(&Instruction::SyncWrite { address, length: length as u16, entries });
                }
                return send(&Instruction::BulkWrite { entries });
            }
            let (same, others): (Vec<_>, Vec<_>) = entries.into_iter().partition(is_same);
            for chunk in same.chunks(most) {
                let entries = chunk.iter().map(|entry| (entry.id, entry.data.clone())).collect();
                send(&Instruction::SyncWrite { address, length: length as u16, entries })?;
            }
            entries = others;
        }
        Ok(())
    }

    fn read_all(&mut self, now: Time, plan: &BusPlan, line: &mut Line<'_>) -> Result<Reading, PortFailed> {
        let board = power_switch(plan).map(|_| Unit::Device(0));
        let active: Vec<Unit> = board
            .into_iter()
            .chain(units(plan).into_iter().filter(|unit| self.link(*unit).is_active()))
            .collect();
        let mut reading = Reading { sent: now, has_joints: false, devices: vec![None; plan.devices.len()] };
        let mut is_first = true;
        for request in requests(plan, &active) {
            let exchange = match line.exchange(&request.instruction, &request.expected) {
                Ok(exchange) => exchange,
                Err(Trouble::PortFailed) => return Err(PortFailed),
                Err(_) => continue,
            };
            if std::mem::take(&mut is_first) {
                reading.sent = exchange.sent;
            }
            let answered = understand(plan, &request, exchange);
            self.blame(&answered, board, now, plan);
            if self.board_misses > MISSES_OF_THE_BOARD {
                if self.troubles.silent_board.is_worth_a_line() {
                    let count = self.troubles.silent_board.count();
                    let name = plan.devices.first().map_or("", |device| &device.name);
                    tracing::warn!(
                        "the {name} does not answer on {} ({count} times so far), reopening the port; is it on?",
                        place(plan)
                    );
                }
                return Err(PortFailed);
            }
            self.take(answered, &mut reading, now, plan);
        }
        self.check_power(&reading, now, plan);
        Ok(reading)
    }

    /// Determines which device caused missing answers. After a silent device no other answers a read of
    /// several, so only the first missing one is at fault; if others answered after it, its answer was
    /// corrupt.
    fn blame(&mut self, answered: &Answered, board: Option<Unit>, now: Time, plan: &BusPlan) {
        let is_silent = answered.first_missing.is_some() && !answered.chain_went_on;
        for (position, (unit, answer)) in answered.units.iter().enumerate() {
            if Some(*unit) == board {
                self.board_misses = if answer.is_none() && is_silent { self.board_misses + 1 } else { 0 };
                continue;
            }
            let link = self.link(*unit);
            if answer.is_some() {
                (link.misses, link.unheard) = (0, 0);
                continue;
            }
            link.missed += 1;
            link.unheard = link.unheard.saturating_add(1);
            let is_first = answered.first_missing == Some(position);
            if is_first || answered.chain_went_on {
                link.misses += 1;
                let limit = if is_silent { MISSES_OF_A_UNIT } else { CORRUPT_OF_A_UNIT };
                if link.misses >= limit {
                    self.silence(*unit, now, plan);
                }
            }
        }
    }

    fn take(&mut self, answered: Answered, reading: &mut Reading, now: Time, plan: &BusPlan) {
        for (unit, answer) in answered.units {
            match (unit, answer) {
                (Unit::Joint(index), Some(Answer::Joint(measurement, status))) => {
                    self.servos[index].link.error = status.error;
                    self.servos[index].take(measurement, &plan.joints[index], now);
                    reading.has_joints = true;
                }
                (Unit::Device(index), Some(Answer::Device(status))) => {
                    self.devices[index].link.error = status.error;
                    self.devices[index].last = Some(status.parameters.clone());
                    reading.devices[index] = Some(status.parameters);
                }
                _ => {}
            }
        }
    }

    fn check_power(&mut self, reading: &Reading, now: Time, plan: &BusPlan) {
        let Some((board, power)) = power_switch(plan) else {
            if reading.has_joints {
                self.port_wait = RETRY_PORT[0];
            }
            return;
        };
        let Some(Some(piece)) = reading.devices.first() else { return };
        self.port_wait = RETRY_PORT[0];
        let gives_power = power.register.raw_in(plan.line.protocol, piece, board.span().0) == Some(1);
        if !gives_power {
            tracing::warn!("the {} has switched the servos off, switching them on again", board.name);
            self.forget_units();
            self.phase = Phase::Open { retry_at: now };
        }
    }
}
