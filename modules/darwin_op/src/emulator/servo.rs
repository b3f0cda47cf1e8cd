//! One MX-28: its control table, its position control, and its protection.
//!
//! The drive is proportional to the distance to the goal. What the drive does to the joint is up to the
//! [`Body`](downbeat_servos::servo_emulator::Body).

use super::control_table::ControlTable;
use crate::hardware::protocol::{Id, Protocol, StatusError};
use crate::hardware::tables::joints::{JOINTS, Joint};
use crate::hardware::tables::{Access, mx28, units};
use downbeat_servos::servo_emulator::Random;
use downbeat_servos::servo_emulator::{JointMotion, ServoCommand};

/// One step of the moving speed, in ticks/s.
const MOVING_SPEED_STEP: f64 = units::MOVING_SPEED_UNIT / units::RADIANS_PER_TICK;
/// The drive for each rad to the goal at a P gain of 1.
const DRIVE_PER_RADIAN: f64 = 1.0 / (8.0 * 1023.0 * units::RADIANS_PER_TICK);
/// With full drive, before cooling.
const HEATING_PER_S: f64 = 0.5;
const COOLING_TIME_S: f64 = 300.0;
const AMBIENT_CELSIUS: f64 = 27.0;
const STALL_CURRENT_A: f64 = 1.4;
const OVERLOAD_DRIVE: f64 = 0.95;
const OVERLOAD_AFTER_S: f64 = 2.0;
/// From power on to the first answer.
const BOOT_S: f64 = 0.1;

pub(super) struct Servo {
    pub(super) table: ControlTable,
    pub(super) registered: Option<(u16, Vec<u8>)>,
    joint: &'static Joint,
    /// The time since power on, or `None` without power.
    powered_s: Option<f64>,
    boot_s: f64,
    motion: JointMotion,
    /// The goal as limited by the speed limit, in ticks.
    reached_goal: f64,
    celsius: f64,
    overloaded_s: f64,
    error: StatusError,
}

impl Servo {
    /// The servo of the joint with this index, without power.
    pub(super) fn new(index: usize, boots_at_once: bool, random: &mut Random) -> Self {
        let joint = &JOINTS[index];
        let mut table = ControlTable::new(&mx28::TABLE, mx28::LENGTH);
        table.set(&mx28::ID, u16::from(joint.id.raw()));
        table.set(&mx28::BAUD_RATE, 1);
        Self {
            table,
            registered: None,
            joint,
            powered_s: None,
            boot_s: if boots_at_once { 0.0 } else { BOOT_S },
            motion: JointMotion::default(),
            reached_goal: 0.0,
            celsius: AMBIENT_CELSIUS + 2.0 + random.within(1.5),
            overloaded_s: 0.0,
            error: StatusError::NONE,
        }
    }

    pub(super) fn id(&self) -> Id {
        self.joint.id
    }

    pub(super) fn set_power(&mut self, is_on: bool) {
        match (is_on, self.powered_s) {
            (true, None) => {
                self.table.reset(|field| field.access == Access::Ram);
                self.table.set(&mx28::TORQUE_LIMIT, self.table.get(&mx28::MAX_TORQUE));
                self.table.set(&mx28::GOAL_POSITION, self.ticks());
                self.table.set(&mx28::PRESENT_POSITION, self.ticks());
                self.table.set(&mx28::REGISTERED, 0);
                self.registered = None;
                self.error = StatusError::NONE;
                self.reached_goal = self.position_ticks();
                self.powered_s = Some(0.0);
            }
            (false, Some(_)) => {
                self.powered_s = None;
                self.motion.drive = 0.0;
            }
            _ => {}
        }
    }

    /// Returns whether it receives and answers.
    pub(super) fn is_awake(&self) -> bool {
        self.powered_s.is_some_and(|powered_s| powered_s >= self.boot_s)
    }

    pub(super) fn error(&self) -> StatusError {
        self.error
    }

    /// From the supply, at most: the bridge lets current through for a share of the time, and its mean is
    /// that share of what the motor draws at full drive.
    pub(super) fn current_a(&self) -> f64 {
        self.motion.drive * self.motion.drive * STALL_CURRENT_A
    }

    /// Writes from outside. A goal beyond the angle limits is a separate error.
    pub(super) fn write(&mut self, address: u8, data: &[u8]) -> Result<(), StatusError> {
        let mut after = self.table.clone();
        after.write(address, data, self.table.get(&mx28::LOCK) == 1)?;
        let goal = after.get(&mx28::GOAL_POSITION);
        let changed = goal != self.table.get(&mx28::GOAL_POSITION);
        let limits = after.get(&mx28::CW_ANGLE_LIMIT)..=after.get(&mx28::CCW_ANGLE_LIMIT);
        if changed && !limits.contains(&goal) {
            return Err(StatusError::ANGLE_LIMIT);
        }
        let is_enabled = |table: &ControlTable| table.get(&mx28::TORQUE_ENABLE) == 1;
        if is_enabled(&after) && !is_enabled(&self.table) {
            self.reached_goal = self.position_ticks();
            self.overloaded_s = 0.0;
        }
        self.table = after;
        Ok(())
    }

    /// What it does to its joint in the next `dt` seconds with this voltage on the bus.
    pub(super) fn command(&mut self, dt: f64, volts: f64) -> ServoCommand {
        if self.powered_s.is_none() {
            return ServoCommand::OFF;
        }
        if self.table.get(&mx28::TORQUE_ENABLE) == 0 {
            return ServoCommand { supply: volts, ..ServoCommand::OFF };
        }
        let goal = f64::from(self.table.get(&mx28::GOAL_POSITION));
        let limit = f64::from(self.table.get(&mx28::MOVING_SPEED)) * MOVING_SPEED_STEP * dt;
        self.reached_goal = if limit == 0.0 {
            goal
        } else {
            goal.clamp(self.reached_goal - limit, self.reached_goal + limit)
        };
        ServoCommand {
            goal: (self.reached_goal - f64::from(units::CENTRE_TICKS)) * units::RADIANS_PER_TICK,
            gain: f64::from(self.table.get(&mx28::P_GAIN)) * DRIVE_PER_RADIAN,
            max_drive: f64::from(self.table.get(&mx28::TORQUE_LIMIT)) / 1023.0,
            supply: volts,
        }
    }

    /// Measures its joint.
    pub(super) fn feel(&mut self, motion: JointMotion) {
        self.motion = motion;
    }

    /// Advances by `dt` seconds, at whose end its joint moves like this, with this voltage on the bus.
    pub(super) fn advance(&mut self, dt: f64, volts: f64, motion: JointMotion) {
        self.feel(motion);
        self.cool(dt);
        if let Some(powered_s) = &mut self.powered_s {
            *powered_s += dt;
            self.check(dt, volts);
            self.show(volts);
        }
    }

    fn cool(&mut self, dt: f64) {
        let heating = self.motion.drive * self.motion.drive * HEATING_PER_S;
        self.celsius += (heating - (self.celsius - AMBIENT_CELSIUS) / COOLING_TIME_S) * dt;
    }

    fn check(&mut self, dt: f64, volts: f64) {
        let limit = |field| f64::from(self.table.get(field));
        let tenths = (volts * 10.0).round();
        let mut error = StatusError::NONE;
        if tenths < limit(&mx28::MIN_VOLTAGE) || tenths > limit(&mx28::MAX_VOLTAGE) {
            error |= StatusError::INPUT_VOLTAGE;
        }
        if self.celsius > limit(&mx28::TEMPERATURE_LIMIT) {
            error |= StatusError::OVERHEATING;
        }
        let JointMotion { velocity, drive, .. } = self.motion;
        let is_straining = drive.abs() > OVERLOAD_DRIVE && velocity.abs() < units::PRESENT_SPEED_UNIT;
        // Once overloaded, it reports that until the torque is enabled again.
        if self.overloaded_s < OVERLOAD_AFTER_S {
            self.overloaded_s = if is_straining { self.overloaded_s + dt } else { 0.0 };
        }
        if self.overloaded_s >= OVERLOAD_AFTER_S {
            error |= StatusError::OVERLOAD;
        }
        if error.to_byte(Protocol::Dynamixel1) & self.table.get(&mx28::SHUTDOWN).to_le_bytes()[0] != 0 {
            self.table.set(&mx28::TORQUE_ENABLE, 0);
        }
        self.error = error;
    }

    /// Updates the readable entries of the table.
    fn show(&mut self, volts: f64) {
        let ticks = self.ticks();
        let JointMotion { velocity, drive, .. } = self.motion;
        let speed = units::magnitude_from_signed((velocity / units::PRESENT_SPEED_UNIT).round() as i32);
        let load = units::magnitude_from_signed((drive * 1000.0).round() as i32);
        let moving = u16::from(velocity.abs() >= units::PRESENT_SPEED_UNIT);
        self.table.set(&mx28::PRESENT_POSITION, ticks);
        self.table.set(&mx28::PRESENT_SPEED, speed);
        self.table.set(&mx28::PRESENT_LOAD, load);
        self.table.set(&mx28::PRESENT_VOLTAGE, (volts * 10.0).round() as u16);
        self.table.set(&mx28::PRESENT_TEMPERATURE, self.celsius.round() as u16);
        self.table.set(&mx28::MOVING, moving);
    }

    fn position_ticks(&self) -> f64 {
        self.motion.position / units::RADIANS_PER_TICK + f64::from(units::CENTRE_TICKS)
    }

    fn ticks(&self) -> u16 {
        self.position_ticks().round().clamp(0.0, 4095.0) as u16
    }
}

#[cfg(test)]
mod tests {
    use super::super::standing::Standing;
    use super::*;
    use crate::hardware::tables::joints::COUNT;
    use downbeat_servos::servo_emulator::Body;
    use std::time::Duration;

    const HEAD_PAN: usize = 18;
    const KNEE: usize = 12;

    /// A servo with power, and the body whose joint it drives.
    fn powered(index: usize) -> (Servo, Standing) {
        let mut servo = Servo::new(index, true, &mut Random::new(1, 0));
        let body = Standing::new([f64::from(units::CENTRE_TICKS); COUNT]);
        servo.feel(body.joint(index));
        servo.set_power(true);
        (servo, body)
    }

    fn run((servo, body): (&mut Servo, &mut Standing), seconds: f64) {
        let index = usize::from(servo.id().raw()) - 1;
        let mut commands = [ServoCommand::OFF; COUNT];
        for _ in 0..(seconds * 1000.0) as usize {
            commands[index] = servo.command(0.001, 12.0);
            body.advance(Duration::from_millis(1), &commands);
            servo.advance(0.001, 12.0, body.joint(index));
        }
    }

    fn write(
        servo: &mut Servo,
        field: &crate::hardware::tables::Field,
        value: u16,
    ) -> Result<(), StatusError> {
        servo.write(field.address, &value.to_le_bytes()[..usize::from(field.size)])
    }

    #[test]
    fn a_goal_is_reached_only_with_torque() {
        let (mut servo, mut body) = powered(HEAD_PAN);
        let start = servo.ticks();
        assert_eq!(write(&mut servo, &mx28::GOAL_POSITION, 2600), Ok(()));
        run((&mut servo, &mut body), 1.0);
        assert_eq!(servo.ticks(), start);
        assert_eq!(write(&mut servo, &mx28::TORQUE_ENABLE, 1), Ok(()));
        run((&mut servo, &mut body), 1.0);
        assert!((i32::from(servo.ticks()) - 2600).abs() <= 3, "{}", servo.ticks());
    }

    #[test]
    fn the_moving_speed_limits_the_speed() {
        let (mut servo, mut body) = powered(HEAD_PAN);
        let start = servo.position_ticks();
        for (field, value) in
            [(&mx28::MOVING_SPEED, 20), (&mx28::TORQUE_ENABLE, 1), (&mx28::GOAL_POSITION, 3000)]
        {
            assert_eq!(write(&mut servo, field, value), Ok(()));
        }
        run((&mut servo, &mut body), 1.0);
        let limit = 20.0 * MOVING_SPEED_STEP;
        let moved = servo.position_ticks() - start;
        assert!(moved > limit * 0.8 && moved < limit * 1.02, "{moved} of {limit}");
    }

    #[test]
    fn a_smaller_gain_lets_gravity_pull_the_knee_further_from_its_goal() {
        let sag = |gain| {
            let (mut servo, mut body) = powered(KNEE);
            for (field, value) in
                [(&mx28::P_GAIN, gain), (&mx28::TORQUE_ENABLE, 1), (&mx28::GOAL_POSITION, 2653)]
            {
                assert_eq!(write(&mut servo, field, value), Ok(()));
            }
            run((&mut servo, &mut body), 2.0);
            (servo.position_ticks() - 2653.0).abs()
        };
        assert!(sag(8) > 2.0 * sag(32));
    }

    #[test]
    fn a_goal_beyond_the_angle_limits_is_an_error() {
        let (mut servo, _) = powered(HEAD_PAN);
        assert_eq!(write(&mut servo, &mx28::CCW_ANGLE_LIMIT, 2500), Ok(()));
        assert_eq!(write(&mut servo, &mx28::GOAL_POSITION, 2501), Err(StatusError::ANGLE_LIMIT));
    }

    #[test]
    fn a_power_cycle_clears_its_ram_but_not_its_eeprom() {
        let (mut servo, _) = powered(HEAD_PAN);
        for (field, value) in [(&mx28::RETURN_DELAY, 0), (&mx28::P_GAIN, 8), (&mx28::TORQUE_ENABLE, 1)] {
            assert_eq!(write(&mut servo, field, value), Ok(()));
        }
        servo.set_power(false);
        assert!(!servo.is_awake());
        servo.set_power(true);
        let table = &servo.table;
        let after = [&mx28::RETURN_DELAY, &mx28::P_GAIN, &mx28::TORQUE_ENABLE].map(|field| table.get(field));
        assert_eq!(after, [0, 32, 0]);
    }

    #[test]
    fn a_voltage_outside_its_limits_is_an_error() {
        let (mut servo, _) = powered(HEAD_PAN);
        servo.advance(0.001, 5.0, JointMotion::default());
        assert_eq!(servo.error(), StatusError::INPUT_VOLTAGE);
    }
}
