//! One MX-28.
//!
//! The drive is proportional to the distance to the goal; after a short lag, the speed of the motor is
//! proportional to the drive minus friction and gravity. Gravity is a share of the drive per joint,
//! proportional to the sine of its angle.

use super::control_table::ControlTable;
use super::random::Random;
use crate::darwin_op::protocol::{Id, StatusError};
use crate::darwin_op::tables::joints::{JOINTS, Joint};
use crate::darwin_op::tables::{Access, mx28, units};

/// At 12 V (5.76 rad/s), in ticks/s.
const NO_LOAD_SPEED: f64 = 5.76 / units::RADIANS_PER_TICK;
/// One step of the present speed, in ticks/s.
const SPEED_STEP: f64 = units::PRESENT_SPEED_UNIT / units::RADIANS_PER_TICK;
/// One step of the moving speed, in ticks/s.
const MOVING_SPEED_STEP: f64 = units::MOVING_SPEED_UNIT / units::RADIANS_PER_TICK;
/// The share of the full drive below which a servo at rest does not move.
const STATIC_FRICTION: f64 = 0.006;
const MOTOR_LAG_S: f64 = 0.02;
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
    pub(super) registered: Option<(u8, Vec<u8>)>,
    joint: &'static Joint,
    gravity: f64,
    /// The time since power on, or `None` without power.
    powered_s: Option<f64>,
    boot_s: f64,
    position: f64,
    velocity: f64,
    /// The goal as limited by the speed limit.
    reached_goal: f64,
    drive: f64,
    celsius: f64,
    overloaded_s: f64,
    error: StatusError,
}

impl Servo {
    /// The servo of the joint with this index, near the middle of its range, without power.
    pub(super) fn new(index: usize, boots_at_once: bool, random: &mut Random) -> Self {
        let joint = &JOINTS[index];
        let mut table = ControlTable::new(&mx28::TABLE, mx28::LENGTH);
        table.set(&mx28::ID, u16::from(joint.id.raw()));
        table.set(&mx28::BAUD_RATE, 1);
        let gravity = match joint.name {
            "r_knee" | "l_knee" => 0.08,
            "r_hip_pitch" | "l_hip_pitch" | "r_ank_pitch" | "l_ank_pitch" => 0.03,
            "r_sho_pitch" | "l_sho_pitch" | "r_sho_roll" | "l_sho_roll" => -0.02,
            _ => 0.0,
        };
        Self {
            table,
            registered: None,
            joint,
            gravity,
            powered_s: None,
            boot_s: if boots_at_once { 0.0 } else { BOOT_S },
            position: f64::from(units::CENTRE_TICKS) + random.within(25.0),
            velocity: 0.0,
            reached_goal: 0.0,
            drive: 0.0,
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
                self.reached_goal = self.position;
                self.powered_s = Some(0.0);
            }
            (false, Some(_)) => {
                self.powered_s = None;
                self.drive = 0.0;
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

    /// The angle of the joint, in rad.
    pub(super) fn angle_rad(&self) -> f64 {
        (self.position - f64::from(units::CENTRE_TICKS)) * units::RADIANS_PER_TICK
    }

    pub(super) fn current_a(&self) -> f64 {
        self.drive.abs() * STALL_CURRENT_A
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
            self.reached_goal = self.position;
            self.overloaded_s = 0.0;
        }
        self.table = after;
        Ok(())
    }

    /// Advances by `dt` seconds with this voltage on the bus.
    pub(super) fn advance(&mut self, dt: f64, volts: f64) {
        let Some(powered_s) = &mut self.powered_s else {
            self.velocity = 0.0;
            self.cool(dt);
            return;
        };
        *powered_s += dt;
        self.drive = if self.table.get(&mx28::TORQUE_ENABLE) == 1 { self.drive_to_goal(dt) } else { 0.0 };
        self.turn(dt, volts);
        self.cool(dt);
        self.check(dt, volts);
        self.show(volts);
    }

    fn drive_to_goal(&mut self, dt: f64) -> f64 {
        let goal = f64::from(self.table.get(&mx28::GOAL_POSITION));
        let limit = f64::from(self.table.get(&mx28::MOVING_SPEED)) * MOVING_SPEED_STEP * dt;
        self.reached_goal = if limit == 0.0 {
            goal
        } else {
            goal.clamp(self.reached_goal - limit, self.reached_goal + limit)
        };
        let gain = f64::from(self.table.get(&mx28::P_GAIN)) / 8.0;
        let allowed = f64::from(self.table.get(&mx28::TORQUE_LIMIT)) / 1023.0;
        (gain * (self.reached_goal - self.position) / 1023.0).clamp(-allowed, allowed)
    }

    fn turn(&mut self, dt: f64, volts: f64) {
        // Without torque the gear holds the joint: 193:1 is hard to turn from outside.
        let holds_itself = self.drive == 0.0;
        let net = if holds_itself { 0.0 } else { self.drive + self.gravity * self.angle_rad().sin() };
        let sticks = net.abs() < STATIC_FRICTION && self.velocity.abs() < SPEED_STEP;
        let speed = if sticks { 0.0 } else { net * NO_LOAD_SPEED * volts / 12.0 };
        self.velocity += (speed - self.velocity) * (dt / MOTOR_LAG_S).min(1.0);
        if sticks {
            self.velocity = 0.0;
        }
        let moved = self.position + self.velocity * dt;
        self.position = moved.clamp(0.0, 4095.0);
        if self.position != moved {
            self.velocity = 0.0;
        }
    }

    fn cool(&mut self, dt: f64) {
        let heating = self.drive * self.drive * HEATING_PER_S;
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
        let is_straining = self.drive.abs() > OVERLOAD_DRIVE && self.velocity.abs() < SPEED_STEP;
        // Once overloaded, it reports that until the torque is enabled again.
        if self.overloaded_s < OVERLOAD_AFTER_S {
            self.overloaded_s = if is_straining { self.overloaded_s + dt } else { 0.0 };
        }
        if self.overloaded_s >= OVERLOAD_AFTER_S {
            error |= StatusError::OVERLOAD;
        }
        if error.bits() & self.table.get(&mx28::SHUTDOWN).to_le_bytes()[0] != 0 {
            self.table.set(&mx28::TORQUE_ENABLE, 0);
        }
        self.error = error;
    }

    /// Updates the readable entries of the table.
    fn show(&mut self, volts: f64) {
        let ticks = self.ticks();
        let speed = units::magnitude_from_signed((self.velocity / SPEED_STEP).round() as i32);
        let load = units::magnitude_from_signed((self.drive * 1000.0).round() as i32);
        let moving = u16::from(self.velocity.abs() >= SPEED_STEP);
        self.table.set(&mx28::PRESENT_POSITION, ticks);
        self.table.set(&mx28::PRESENT_SPEED, speed);
        self.table.set(&mx28::PRESENT_LOAD, load);
        self.table.set(&mx28::PRESENT_VOLTAGE, (volts * 10.0).round() as u16);
        self.table.set(&mx28::PRESENT_TEMPERATURE, self.celsius.round() as u16);
        self.table.set(&mx28::MOVING, moving);
    }

    fn ticks(&self) -> u16 {
        self.position.round() as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD_PAN: usize = 18;
    const KNEE: usize = 12;

    fn powered(index: usize) -> Servo {
        let mut servo = Servo::new(index, true, &mut Random::new(1, 0));
        servo.set_power(true);
        servo
    }

    fn run(servo: &mut Servo, seconds: f64) {
        for _ in 0..(seconds * 1000.0) as usize {
            servo.advance(0.001, 12.0);
        }
    }

    fn write(
        servo: &mut Servo,
        field: &crate::darwin_op::tables::Field,
        value: u16,
    ) -> Result<(), StatusError> {
        servo.write(field.address, &value.to_le_bytes()[..usize::from(field.size)])
    }

    #[test]
    fn a_goal_is_reached_only_with_torque() {
        let mut servo = powered(HEAD_PAN);
        let start = servo.ticks();
        assert_eq!(write(&mut servo, &mx28::GOAL_POSITION, 2600), Ok(()));
        run(&mut servo, 1.0);
        assert_eq!(servo.ticks(), start);
        assert_eq!(write(&mut servo, &mx28::TORQUE_ENABLE, 1), Ok(()));
        run(&mut servo, 1.0);
        assert!((i32::from(servo.ticks()) - 2600).abs() <= 3, "{}", servo.ticks());
    }

    #[test]
    fn the_moving_speed_limits_the_speed() {
        let mut servo = powered(HEAD_PAN);
        let start = servo.position;
        for (field, value) in
            [(&mx28::MOVING_SPEED, 20), (&mx28::TORQUE_ENABLE, 1), (&mx28::GOAL_POSITION, 3000)]
        {
            assert_eq!(write(&mut servo, field, value), Ok(()));
        }
        run(&mut servo, 1.0);
        let limit = 20.0 * MOVING_SPEED_STEP;
        let moved = servo.position - start;
        assert!(moved > limit * 0.8 && moved < limit * 1.02, "{moved} of {limit}");
    }

    #[test]
    fn a_smaller_gain_lets_gravity_pull_the_knee_further_from_its_goal() {
        let sag = |gain| {
            let mut servo = powered(KNEE);
            for (field, value) in
                [(&mx28::P_GAIN, gain), (&mx28::TORQUE_ENABLE, 1), (&mx28::GOAL_POSITION, 2653)]
            {
                assert_eq!(write(&mut servo, field, value), Ok(()));
            }
            run(&mut servo, 2.0);
            (servo.position - 2653.0).abs()
        };
        assert!(sag(8) > 2.0 * sag(32));
    }

    #[test]
    fn a_goal_beyond_the_angle_limits_is_an_error() {
        let mut servo = powered(HEAD_PAN);
        assert_eq!(write(&mut servo, &mx28::CCW_ANGLE_LIMIT, 2500), Ok(()));
        assert_eq!(write(&mut servo, &mx28::GOAL_POSITION, 2501), Err(StatusError::ANGLE_LIMIT));
    }

    #[test]
    fn a_power_cycle_clears_its_ram_but_not_its_eeprom() {
        let mut servo = powered(HEAD_PAN);
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
        let mut servo = powered(HEAD_PAN);
        servo.advance(0.001, 5.0);
        assert_eq!(servo.error(), StatusError::INPUT_VOLTAGE);
    }
}
