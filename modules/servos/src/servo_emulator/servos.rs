//! The emulated devices of a described bus.

use super::body::{Body, ImuMotion, JointMotion, ServoCommand};
use super::devices::{Device, Devices, answer};
use super::fault::Disturbance;
use super::random::Random;
use super::wire::Answer;
use crate::servo_bus::bus::LineSettings;
use crate::servo_bus::models::{Access, Model, Register, STANDARD_GRAVITY};
use crate::servo_bus::protocol::{Id, Instruction, Packet, Protocol, Status, StatusError};
use crate::servo_bus::{BusPlan, Joint};
use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Duration;

/// How often servos measure and drive their joints.
const STEP: Duration = Duration::from_millis(2);
/// The drive for each rad to the goal with the initial P gain: that of an MX-28.
const DRIVE_PER_RADIAN: f64 = 2.55;
/// With full drive, at the voltage that the model reports at first.
const NO_LOAD_RAD_S: f64 = 5.0;
const MOTOR_LAG_S: f64 = 0.02;
/// The share of the full drive below which a joint does not move.
const FRICTION: f64 = 0.006;
/// What the register `bus_watchdog` reads once it has stopped the servo. Goals cannot be written until it is
/// 0.
const HAS_STOPPED: i64 = 255;
const STALL_CURRENT_A: f64 = 2.0;
/// Of the velocity control: how much of an error is added to the goal.
const VELOCITY_GAIN: f64 = 2.0;
/// How fast joints are turned by hand.
const HAND_RAD_S: f64 = 2.0;
/// A Dynamixel servo with positions as goals ignores a larger offset, in steps.
const LARGEST_OFFSET: i64 = 1024;
/// By which bits the position of a second servo with the same id differs.
const TWIN_BITS: i64 = 0x155;
/// With full drive, before cooling: heat of the first order, as Urata et al. model motors ("Design of High
/// Torque and High Speed Leg Module for High Power Humanoid", IROS 2010). A stalled MX-28 takes 1.4 A at 12 V
/// (ROBOTIS e-Manual); its 17 W heat half of its 72 g, at 0.9 J/(g K), by so much. The half is inferred.
const HEATING_PER_S: f64 = 0.5;
/// ROBOTIS asks to wait for 20 minutes after an alarm (e-Manual of the XM430-W210): four times as long, after
/// which 2 % of the heat is left.
const COOLING_TIME_S: f64 = 300.0;
const AMBIENT_CELSIUS: f64 = 27.0;

/// The devices of one bus.
pub(super) struct Servos {
    plan: BusPlan,
    time: Duration,
    /// The devices beside servos, then the servos, both in the order of the plan.
    units: Vec<Unit>,
    body: Box<dyn Body>,
    /// The speed at which the computer sends.
    baud: u32,
    disturbance: Disturbance,
}

impl Servos {
    /// The devices of a bus, whose joints are near the middle of their limits, or near 0 if that is within
    /// them.
    pub(super) fn new(plan: &BusPlan, seed: u64, body: Option<Box<dyn Body>>) -> Self {
        let mut random = Random::new(seed, 1);
        let start: Vec<f64> = plan
            .joints
            .iter()
            .map(|joint| {
                let (low, high) = (joint.min_rad + 0.05, joint.max_rad - 0.05);
                let centre = if (low..=high).contains(&0.0) { 0.0 } else { (low + high) / 2.0 };
                (centre + random.within(0.04)).clamp(joint.min_rad, joint.max_rad)
            })
            .collect();
        let body = body.unwrap_or_else(|| Box::new(Joints::at(&start)));
        let line = plan.line;
        let devices = plan.devices.iter().map(|device| Unit::new(&device.model, device.id, line, None));
        let servos = plan.joints.iter().enumerate();
        let servos = servos
            .map(|(index, joint)| Unit::new(&joint.model, joint.id, line, Some((joint.clone(), index))));
        let mut servos = Self {
            plan: plan.clone(),
            time: Duration::ZERO,
            units: devices.chain(servos).collect(),
            body,
            baud: line.baud,
            disturbance: Disturbance::default(),
        };
        servos.switch_power();
        servos
    }

    fn switch_power(&mut self) {
        let power = self.plan.devices.first().and_then(|device| device.power.as_ref());
        let is_on = power.is_none_or(|power| self.units[0].get(&power.register) == 1);
        let body = &self.body;
        for unit in &mut self.units {
            let has_power = !unit.is_dead && (is_on || unit.joint.is_none());
            if has_power && !unit.has_power {
                unit.boot(&**body);
            }
            unit.has_power = has_power;
        }
    }
}

impl Devices for Servos {
    fn protocol(&self) -> Protocol {
        self.plan.line.protocol
    }

    fn baud(&self) -> u32 {
        self.plan.line.baud
    }

    fn set_line_speed(&mut self, baud: u32) {
        self.baud = baud;
    }

    fn advance_to(&mut self, now: Duration) {
        while self.time + STEP <= now {
            self.time += STEP;
            let joints = self.units.iter().filter(|unit| unit.joint.is_some());
            let commands: Vec<ServoCommand> = joints.map(|unit| unit.command(&*self.body)).collect();
            self.body.advance(STEP, &commands);
            for unit in &mut self.units {
                unit.advance(STEP.as_secs_f64(), &*self.body);
            }
        }
    }

    fn begin_step(&mut self) {
        self.body.begin_step();
    }

    fn set_dead(&mut self, is_dead: &dyn Fn(Id) -> bool) {
        for unit in &mut self.units {
            unit.is_dead = is_dead(unit.declared);
        }
        self.switch_power();
    }

    fn turn_by_hand(&mut self, joint: &str, angle: f64) -> bool {
        let index = self.plan.joints.iter().position(|known| known.name == joint);
        if let Some(index) = index {
            self.body.turn_by_hand(index, angle);
        }
        index.is_some()
    }

    fn is_in_hand(&self, joint: &str) -> bool {
        let index = self.plan.joints.iter().position(|known| known.name == joint);
        index.is_some_and(|index| self.body.is_in_hand(index))
    }

    fn disturb(&mut self, disturbance: Disturbance) {
        if disturbance.supply_v != self.disturbance.supply_v {
            for unit in self.units.iter_mut().filter(|unit| unit.joint.is_some()) {
                unit.set_supply(disturbance.supply_v);
            }
        }
        self.disturbance = disturbance;
    }

    fn answer(&mut self, packet: &Packet<'_>, is_lost: &mut dyn FnMut() -> bool) -> Vec<Answer> {
        let imu = self.body.imu();
        for (device, unit) in self.plan.devices.iter().zip(&mut self.units) {
            let Some(plan) = &device.imu else { continue };
            let axes = plan.angular_velocity.iter().zip(imu.angular_velocity);
            for ((sign, register), felt) in
                axes.chain(plan.linear_acceleration.iter().zip(imu.specific_force))
            {
                unit.set(register, register.from_si(sign * felt));
            }
        }
        let (protocol, baud) = (self.plan.line.protocol, self.baud);
        let awake = self.units.iter_mut().filter(|unit| unit.has_power && unit.baud() == baud);
        let mut awake: Vec<&mut dyn Device> = awake
            .map(|unit| {
                unit.unheard_s = 0.0;
                unit as &mut dyn Device
            })
            .collect();
        let mut answers = answer(protocol, &mut awake, packet, is_lost);
        if !self.disturbance.twins.is_empty() {
            let instruction = Instruction::parse(packet).ok();
            let is_twin = |id: Id| self.disturbance.twins.contains(&id);
            for answer in &mut answers {
                // The joined answer to a fast read has that of each device asked.
                let joined = match &instruction {
                    Some(Instruction::FastSyncRead { ids, .. }) => ids.iter().any(|id| is_twin(*id)),
                    Some(Instruction::FastBulkRead { entries }) => {
                        entries.iter().any(|entry| is_twin(entry.id))
                    }
                    _ => false,
                };
                let status = Packet::new_checked(protocol, &answer.packet).ok();
                let own = status.and_then(|packet| Status::parse(&packet).ok()).map(|status| status.id);
                let twin =
                    self.units.iter().find(|unit| Some(unit.declared) == own && is_twin(unit.declared));
                match (&instruction, twin) {
                    (Some(Instruction::Read { address, length, .. }), Some(twin)) => {
                        twin.talk_into(*address, *length, &mut answer.packet);
                    }
                    (_, Some(_)) => talk_late_into(&mut answer.packet),
                    (_, None) if joined => talk_late_into(&mut answer.packet),
                    _ => {}
                }
            }
        }
        self.switch_power();
        answers
    }
}

/// A second servo answers the same a byte later, after another delay: on the line, a 0 of either wins.
fn talk_late_into(packet: &mut [u8]) {
    for place in (1..packet.len()).rev() {
        packet[place] &= packet[place - 1];
    }
}

/// One device and its control table.
pub struct Unit {
    model: Arc<Model>,
    protocol: Protocol,
    /// The id in the description, by which faults name it.
    declared: Id,
    /// The joint that it turns, and the position of that in the body.
    joint: Option<(Joint, usize)>,
    memory: Vec<u8>,
    registered: Option<(u16, Vec<u8>)>,
    is_dead: bool,
    has_power: bool,
    celsius: f64,
    /// The time since the last instruction on the bus, in s.
    unheard_s: f64,
    /// The speed of a bus with models that do not know it.
    bus_baud: u32,
    /// The position in steps, without offset, and the whole turns of it that the servo has forgotten.
    steps: i64,
    forgotten: i64,
}

impl Unit {
    /// A new device with this id, on a bus of this speed.
    #[must_use]
    pub fn new(model: &Arc<Model>, id: Id, line: LineSettings, joint: Option<(Joint, usize)>) -> Self {
        let mut unit = Self {
            model: Arc::clone(model),
            protocol: line.protocol,
            declared: id,
            joint,
            memory: vec![0; usize::from(model.length())],
            registered: None,
            is_dead: false,
            has_power: false,
            celsius: AMBIENT_CELSIUS + 2.0,
            unheard_s: 0.0,
            bus_baud: line.baud,
            steps: 0,
            forgotten: 0,
        };
        for register in &model.registers {
            unit.set(register, register.initial);
        }
        // An offset moves what a servo reads, so the described one is there from the start.
        let described = unit.joint.as_ref().map(|(joint, _)| joint.further.clone()).unwrap_or_default();
        for (register, raw) in described.iter().filter(|(register, _)| register.name == "homing_offset") {
            unit.set(register, *raw);
        }
        unit.set_named("id", i64::from(id.raw()));
        if let Some((value, _)) = model.baud_rates.iter().find(|(_, baud)| *baud == line.baud) {
            unit.set_named("baud_rate", *value);
        }
        unit
    }

    fn get(&self, register: &Register) -> i64 {
        register.raw_in(self.protocol, &self.memory, 0).unwrap_or(0)
    }

    fn get_named(&self, name: &str) -> Option<i64> {
        self.model.register(name).map(|register| self.get(register))
    }

    fn set(&mut self, register: &Register, raw: i64) {
        put(&mut self.memory, self.protocol, register, raw);
    }

    /// Sets a register, if the model has it.
    pub fn set_named(&mut self, name: &str, raw: i64) {
        let model = Arc::clone(&self.model);
        if let Some(register) = model.register(name) {
            self.set(register, raw);
        }
    }

    /// Sets the measured supply; `None` is that of the model.
    fn set_supply(&mut self, volts: Option<f64>) {
        let model = Arc::clone(&self.model);
        if let Some(register) = model.register("present_voltage") {
            let raw = volts.map_or(register.initial, |volts| register.steps(volts).round() as i64);
            self.set(register, raw);
        }
    }

    /// Whether the supply is outside of the limits that the servo has.
    fn has_wrong_supply(&self) -> bool {
        let volts = |name| Some(self.model.register(name)?.to_si(self.get_named(name)?));
        let (Some(supply), Some(min), Some(max)) =
            (volts("present_voltage"), volts("min_voltage_limit"), volts("max_voltage_limit"))
        else {
            return false;
        };
        self.joint.is_some() && !(min..=max).contains(&supply)
    }

    /// A second servo of the same id and another position answers the same read: on the line, a 0 of either
    /// wins.
    fn talk_into(&self, address: u16, length: u16, packet: &mut [u8]) {
        let (Some((joint, _)), Some(id)) = (&self.joint, Id::new(self.id())) else { return };
        let (position, mut memory) = (&joint.registers.position, self.memory.clone());
        put(&mut memory, self.protocol, position, self.get(position) ^ TWIN_BITS);
        let begin = usize::from(address);
        let Some(read) = memory.get(begin..begin + usize::from(length)) else { return };
        let status = Status { id, error: self.error(), parameters: read.to_vec() };
        let mut second = Vec::new();
        if status.emit(self.protocol, &mut second).is_ok() {
            packet.iter_mut().zip(second).for_each(|(byte, second)| *byte &= second);
        }
    }

    fn baud(&self) -> u32 {
        let value = self.get_named("baud_rate");
        let known = self.model.baud_rates.iter().find(|(known, _)| Some(*known) == value);
        known.map_or(self.bus_baud, |(_, baud)| *baud)
    }

    fn is_torque_enabled(&self) -> bool {
        self.get_named("torque_enable") == Some(1)
    }

    /// A Dynamixel servo forgets whole turns when it is switched on, and when it gets its torque with
    /// positions as goals.
    fn forget_turns(&mut self) {
        let Some((joint, _)) = &self.joint else { return };
        let turn = joint.registers.position.steps(TAU).round() as i64;
        if self.protocol == Protocol::Dynamixel2 {
            self.forgotten = self.steps.div_euclid(turn) * turn;
        }
    }

    /// Starts: without power, the RAM was lost.
    fn boot(&mut self, body: &dyn Body) {
        let model = Arc::clone(&self.model);
        for register in model.registers.iter().filter(|register| register.access == Access::Ram) {
            self.set(register, register.initial);
        }
        self.registered = None;
        self.steps = self.joint.as_ref().map_or(0, |(joint, index)| joint.steps(body.joint(*index).position));
        self.forget_turns();
        if let Some((joint, _)) = &self.joint {
            let (goal, position) = (joint.registers.goal.clone(), self.counted(joint, self.steps));
            self.set(&goal, position);
        }
        self.show(body);
    }

    fn command(&self, body: &dyn Body) -> ServoCommand {
        let Some((joint, index)) = &self.joint else { return ServoCommand::OFF };
        if !self.has_power {
            return ServoCommand::OFF;
        }
        let supply =
            self.model.register("present_voltage").map_or(12.0, |register| register.to_si(register.initial));
        if !self.is_torque_enabled() {
            return ServoCommand { supply, ..ServoCommand::OFF };
        }
        let share = |name| match self.model.register(name) {
            Some(register) if register.initial > 0 => self.get(register) as f64 / register.initial as f64,
            _ => 1.0,
        };
        let max_drive = joint
            .registers
            .torque_limit
            .as_ref()
            .map_or(1.0, |limit| self.get(limit) as f64 / limit.max as f64);
        if let Some(drive) = self.driven(joint, body.joint(*index).velocity) {
            // The drive of a servo is that of a position control: here its goal is ahead by as much as gives
            // this drive.
            let goal = body.joint(*index).position + drive / DRIVE_PER_RADIAN;
            return ServoCommand { goal, gain: DRIVE_PER_RADIAN, max_drive, supply };
        }
        let position = joint.steps(body.joint(*index).position);
        let goal = self.get(&joint.registers.goal) + position - self.counted(joint, position);
        ServoCommand { goal: joint.angle(goal), gain: DRIVE_PER_RADIAN * share("p_gain"), max_drive, supply }
    }

    /// The drive of a joint with this velocity, if the operating mode has goals other than positions.
    fn driven(&self, joint: &Joint, velocity: f64) -> Option<f64> {
        let mode = self.get_named("operating_mode")?;
        let goal = |name| {
            let register = self.model.register(name)?;
            Some(joint.sign * register.to_si(self.get(register)))
        };
        if self.model.modes.velocity == Some(mode) {
            let wanted = goal("goal_velocity")? / joint.gear;
            return Some((wanted + VELOCITY_GAIN * (wanted - velocity)) / NO_LOAD_RAD_S);
        }
        if self.model.modes.effort == Some(mode) {
            return Some(goal("goal_current")? / STALL_CURRENT_A);
        }
        None
    }

    /// What the servo reads at this position. With two bytes it counts within one turn. Feetech takes its
    /// offset off; Dynamixel adds it, unless it is large and goals are positions.
    fn counted(&self, joint: &Joint, position: i64) -> i64 {
        let Register { size, max, .. } = joint.registers.goal;
        let offset = self.get_named("homing_offset").unwrap_or(0);
        let is_driven = self.driven(joint, 0.0).is_some();
        let reading = match self.protocol {
            Protocol::FeetechSts | Protocol::FeetechScs => position - offset,
            Protocol::Dynamixel2 if is_driven || offset.abs() <= LARGEST_OFFSET => {
                position - self.forgotten + offset
            }
            Protocol::Dynamixel2 => position - self.forgotten,
            Protocol::Dynamixel1 => position,
        };
        let is_a_turn = joint.registers.position.steps(TAU).round() as i64 == max + 1;
        if size == 2 && (is_a_turn || is_driven) { reading.rem_euclid(max + 1) } else { reading }
    }

    fn advance(&mut self, dt: f64, body: &dyn Body) {
        let Some((_, index)) = &self.joint else { return };
        let drive = body.joint(*index).drive;
        let heating = drive * drive * HEATING_PER_S;
        self.celsius += (heating - (self.celsius - AMBIENT_CELSIUS) / COOLING_TIME_S) * dt;
        self.unheard_s += dt;
        if self.has_power {
            self.watch();
            self.show(body);
        }
    }

    /// The watchdog of the bus: stops a servo that hears no instructions.
    fn watch(&mut self) {
        let model = Arc::clone(&self.model);
        let Some(watchdog) = model.register("bus_watchdog") else { return };
        let raw = self.get(watchdog);
        if (1..=watchdog.max).contains(&raw) && self.unheard_s >= watchdog.to_si(raw) {
            self.set(watchdog, HAS_STOPPED);
            for name in ["goal_velocity", "goal_current"] {
                self.set_named(name, 0);
            }
        }
    }

    /// Updates the readable entries of the table.
    fn show(&mut self, body: &dyn Body) {
        let Some((joint, index)) = &self.joint else { return };
        let JointMotion { position, velocity, drive } = body.joint(*index);
        self.steps = joint.steps(position);
        let position = self.counted(joint, self.steps);
        let (registers, protocol, memory) = (&joint.registers, self.protocol, &mut self.memory);
        put(memory, protocol, &registers.position, position);
        if let Some(register) = &registers.velocity {
            let raw = register.steps(velocity * joint.sign * joint.gear).round() as i64;
            put(memory, protocol, register, raw);
        }
        if let Some(register) = &registers.effort {
            let effort = if register.unit == "A" { drive * STALL_CURRENT_A } else { drive };
            put(memory, protocol, register, register.steps(effort * joint.sign).round() as i64);
        }
        if let Some(register) = &registers.temperature {
            put(memory, protocol, register, register.steps(self.celsius).round() as i64);
        }
    }

    /// Checks the table that a write would leave.
    fn check(&self, after: &[u8], address: u16, data: &[u8]) -> Result<(), StatusError> {
        let after = |register: &Register| register.raw_in(self.protocol, after, 0).unwrap_or(0);
        let written = address..address + data.len() as u16;
        let is_touched =
            |register: &&Register| register.address < written.end && written.start < register.end();
        let is_modern = self.protocol == Protocol::Dynamixel2;
        let locked = if is_modern { self.is_torque_enabled() } else { self.get_named("lock") == Some(1) };
        for register in self.model.registers.iter().filter(is_touched) {
            let value = after(register);
            if register.name.starts_with("goal_") && self.get_named("bus_watchdog") == Some(HAS_STOPPED) {
                return Err(StatusError::RANGE);
            }
            match register.access {
                Access::Read if is_modern => return Err(StatusError::ACCESS),
                Access::Read => return Err(StatusError::RANGE),
                Access::Eeprom if locked && is_modern => return Err(StatusError::ACCESS),
                // Feetech takes it until the power is switched off.
                Access::Eeprom if locked && self.protocol == Protocol::Dynamixel1 => {
                    return Err(StatusError::RANGE);
                }
                _ if !(register.min..=register.max).contains(&value) => return Err(StatusError::RANGE),
                _ => {}
            }
        }
        let limit = |name| self.model.register(name).map(after);
        let limits = (limit("min_position_limit"), limit("max_position_limit"));
        if let (Some((joint, _)), (Some(min), Some(max))) = (&self.joint, limits) {
            let goal = after(&joint.registers.goal);
            let changed = goal != self.get(&joint.registers.goal);
            if changed && min < max && !(min..=max).contains(&goal) {
                return Err(StatusError::ANGLE_LIMIT);
            }
        }
        Ok(())
    }
}

/// Sets a register of a table.
fn put(memory: &mut [u8], protocol: Protocol, register: &Register, raw: i64) {
    let bytes = register.bytes(protocol, raw);
    memory[usize::from(register.address)..usize::from(register.end())].copy_from_slice(&bytes);
}

impl Device for Unit {
    fn id(&self) -> u8 {
        self.get_named("id").and_then(|id| u8::try_from(id).ok()).unwrap_or(self.declared.raw())
    }

    fn status_return_level(&self) -> u16 {
        match (self.get_named("status_return_level"), self.protocol) {
            (Some(1), Protocol::FeetechSts | Protocol::FeetechScs) | (Some(2) | None, _) => 2,
            (Some(1), _) | (Some(0), Protocol::FeetechSts | Protocol::FeetechScs) => 1,
            _ => 0,
        }
    }

    fn return_delay(&self) -> Duration {
        let delay = self.model.register("return_delay").map(|register| register.to_si(self.get(register)));
        Duration::from_secs_f64(delay.unwrap_or(0.0).clamp(0.0, 0.01))
    }

    fn error(&self) -> StatusError {
        if self.has_wrong_supply() { StatusError::INPUT_VOLTAGE } else { StatusError::NONE }
    }

    fn identity(&self) -> [u8; 3] {
        let number = self.get_named("model_number").unwrap_or(0).to_le_bytes();
        let firmware = self.get_named("firmware_version").unwrap_or(0).to_le_bytes();
        [number[0], number[1], firmware[0]]
    }

    fn read(&self, address: u16, length: u16) -> Result<Vec<u8>, StatusError> {
        let begin = usize::from(address);
        let bytes = self.memory.get(begin..begin + usize::from(length));
        bytes.map(<[u8]>::to_vec).ok_or(StatusError::RANGE)
    }

    fn write(&mut self, address: u16, data: &[u8]) -> Result<(), StatusError> {
        let begin = usize::from(address);
        let mut memory = self.memory.clone();
        let target = memory.get_mut(begin..begin + data.len()).filter(|target| !target.is_empty());
        target.ok_or(StatusError::RANGE)?.copy_from_slice(data);
        self.check(&memory, address, data)?;
        let had_torque = self.is_torque_enabled();
        self.memory = memory;
        let holds = |(joint, _): &(Joint, usize)| self.driven(joint, 0.0).is_none();
        if !had_torque && self.is_torque_enabled() && self.joint.as_ref().is_some_and(holds) {
            self.forget_turns();
        }
        // An offset takes effect at once.
        if let Some((joint, _)) = &self.joint {
            let position = self.counted(joint, self.steps);
            put(&mut self.memory, self.protocol, &joint.registers.position, position);
        }
        Ok(())
    }

    fn registered(&mut self) -> &mut Option<(u16, Vec<u8>)> {
        &mut self.registered
    }

    fn reboot(&mut self) {
        // Takes effect at once.
        self.has_power = false;
    }
}

/// Joints that turn without load, each on its own.
struct Joints {
    motions: Vec<JointMotion>,
    /// Where they are turned by hand.
    hands: Vec<Option<f64>>,
}

impl Joints {
    fn at(angles: &[f64]) -> Self {
        let at_rest = |position: &f64| JointMotion { position: *position, ..JointMotion::default() };
        Self { motions: angles.iter().map(at_rest).collect(), hands: vec![None; angles.len()] }
    }
}

impl Body for Joints {
    fn advance(&mut self, dt: Duration, commands: &[ServoCommand]) {
        let dt = dt.as_secs_f64();
        for ((motion, hand), command) in self.motions.iter_mut().zip(&mut self.hands).zip(commands) {
            motion.drive = command.drive_at(motion.position);
            let net = if motion.drive.abs() < FRICTION { 0.0 } else { motion.drive };
            motion.velocity += (net * NO_LOAD_RAD_S - motion.velocity) * (dt / MOTOR_LAG_S).min(1.0);
            if command.max_drive == 0.0 {
                // The gear holds it, but not against a hand.
                motion.velocity =
                    hand.map_or(0.0, |goal| ((goal - motion.position) / dt).clamp(-HAND_RAD_S, HAND_RAD_S));
            }
            hand.take_if(|_| motion.velocity == 0.0 || command.max_drive > 0.0);
            motion.position += motion.velocity * dt;
        }
    }

    fn joint(&self, index: usize) -> JointMotion {
        self.motions.get(index).copied().unwrap_or_default()
    }

    fn imu(&self) -> ImuMotion {
        ImuMotion { specific_force: [0.0, 0.0, STANDARD_GRAVITY], ..ImuMotion::default() }
    }

    fn turn_by_hand(&mut self, index: usize, angle: f64) {
        if let Some(hand) = self.hands.get_mut(index) {
            *hand = Some(angle);
        }
    }

    fn is_in_hand(&self, index: usize) -> bool {
        self.hands.get(index).is_some_and(Option::is_some)
    }
}
