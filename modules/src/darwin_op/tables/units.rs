//! Conversion between the devices' units and SI units in the frames of REP-103 (x forward, y left, z up).
//!
//! Only additions, multiplications and roundings, so that the same bytes give the same bits on every machine.

use std::f64::consts::{PI, TAU};

/// One step of the position, in rad.
pub const RADIANS_PER_TICK: f64 = TAU / 4096.0;
/// The tick at angle 0.
pub const CENTRE_TICKS: i32 = 2048;
/// One step of the present speed, 0.11 rpm, in rad/s.
pub const PRESENT_SPEED_UNIT: f64 = 0.11 * TAU / 60.0;
/// One step of the moving speed, 0.114 rpm, in rad/s.
pub const MOVING_SPEED_UNIT: f64 = 0.114 * TAU / 60.0;
/// Standard gravity, in m/s^2.
pub const STANDARD_GRAVITY: f64 = 9.806_65;
/// One step of the accelerometer, in m/s^2: 4 g over 512 steps.
pub const ACCELERATION_PER_LSB: f64 = 4.0 * STANDARD_GRAVITY / 512.0;
/// The raw value of gyroscope and accelerometer at rest.
pub const IMU_CENTRE: i32 = 512;

/// The bit that turns a magnitude negative.
const CLOCKWISE: u16 = 1 << 10;
const MAGNITUDE: u16 = CLOCKWISE - 1;

/// The angle of a joint, in rad. `offset_ticks` is added to goals to compensate for assembly tolerances.
#[must_use]
pub fn radians_from_ticks(ticks: u16, offset_ticks: i16) -> f64 {
    f64::from(i32::from(ticks) - i32::from(offset_ticks) - CENTRE_TICKS) * RADIANS_PER_TICK
}

/// The nearest position a servo can go to, 0 to 4095, for an angle in rad.
#[must_use]
pub fn ticks_from_radians(angle_rad: f64, offset_ticks: i16) -> u16 {
    let ticks = (angle_rad / RADIANS_PER_TICK).round() + f64::from(CENTRE_TICKS + i32::from(offset_ticks));
    // In range after the clamp.
    ticks.clamp(0.0, 4095.0) as u16
}

/// A speed or load, with its sign in bit 10.
#[must_use]
pub fn signed_from_magnitude(raw: u16) -> i16 {
    // Ten bits fit.
    let magnitude = (raw & MAGNITUDE) as i16;
    if raw & CLOCKWISE == 0 { magnitude } else { -magnitude }
}

/// The inverse of [`signed_from_magnitude`]; saturates at ten bits.
#[must_use]
pub fn magnitude_from_signed(value: i32) -> u16 {
    // Ten bits fit.
    let magnitude = value.unsigned_abs().min(u32::from(MAGNITUDE)) as u16;
    if value < 0 { magnitude | CLOCKWISE } else { magnitude }
}

/// The present speed, in rad/s.
#[must_use]
pub fn speed_from_raw(raw: u16) -> f64 {
    f64::from(signed_from_magnitude(raw)) * PRESENT_SPEED_UNIT
}

/// The present load: the drive as a fraction of its maximum, positive towards larger angles.
///
/// The servo infers it from the drive; it is not a measured torque.
#[must_use]
pub fn load_from_raw(raw: u16) -> f64 {
    f64::from(signed_from_magnitude(raw)) / 1000.0
}

/// A voltage, in V.
#[must_use]
pub fn volts_from_raw(raw: u16) -> f64 {
    f64::from(raw) / 10.0
}

/// Converts the IMU's numbers to SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuScale {
    /// One step of the gyroscope, in rad/s.
    radians_per_lsb: f64,
}

impl ImuScale {
    /// For a gyroscope whose 512 steps correspond to `gyro_full_scale_dps` degrees/s.
    ///
    /// 1600 for the CM-730 (3.125 degrees/s per step), 500.5 for the CM-740 (0.9775); other boards differ.
    #[must_use]
    pub fn new(gyro_full_scale_dps: f64) -> Self {
        Self { radians_per_lsb: gyro_full_scale_dps / 512.0 * (PI / 180.0) }
    }

    /// One step of the gyroscope, in rad/s.
    #[must_use]
    pub fn radians_per_lsb(&self) -> f64 {
        self.radians_per_lsb
    }

    /// The angular rate about forward, left and up, in rad/s, from the board's `GYRO_X`, `GYRO_Y`, `GYRO_Z`.
    #[must_use]
    pub fn angular_velocity(&self, gyro: [u16; 3]) -> [f64; 3] {
        let [x, y, z] = gyro.map(centred);
        [-x * self.radians_per_lsb, -y * self.radians_per_lsb, z * self.radians_per_lsb]
    }

    /// The specific force forward, left and up, in m/s^2 (9.81 upwards at rest), from `ACC_X`, `ACC_Y`, `ACC_Z`.
    #[must_use]
    pub fn linear_acceleration(&self, acceleration: [u16; 3]) -> [f64; 3] {
        let [x, y, z] = acceleration.map(centred);
        [y * ACCELERATION_PER_LSB, -x * ACCELERATION_PER_LSB, z * ACCELERATION_PER_LSB]
    }
}

fn centred(raw: u16) -> f64 {
    f64::from(i32::from(raw) - IMU_CENTRE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[track_caller]
    fn near(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-9, "{found} is not {expected}");
    }

    #[test]
    fn ticks_and_radians_agree_with_the_manual() {
        near(radians_from_ticks(2048, 0), 0.0);
        near(radians_from_ticks(2049, 0).to_degrees(), 360.0 / 4096.0);
        near(radians_from_ticks(1498, 0).to_degrees(), -48.339_843_75);
        assert_eq!(ticks_from_radians(-PI, 0), 0);
        assert_eq!(ticks_from_radians(PI, 0), 4095);
    }

    #[test]
    fn an_offset_is_added_to_the_goal_and_taken_from_the_position() {
        assert_eq!(ticks_from_radians(0.0, 12), 2060);
        near(radians_from_ticks(2060, 12), 0.0);
        assert_eq!(ticks_from_radians(0.0, -12), 2036);
    }

    #[test]
    fn bit_ten_of_speed_and_load_is_the_sign() {
        near(speed_from_raw(100), 100.0 * 0.11 * TAU / 60.0);
        near(speed_from_raw(1024 + 100), -100.0 * 0.11 * TAU / 60.0);
        near(load_from_raw(1024 + 250), -0.25);
        assert_eq!(magnitude_from_signed(-2000), 2047);
    }

    #[test]
    fn the_gyro_scale_is_a_parameter() {
        near(ImuScale::new(1600.0).radians_per_lsb().to_degrees(), 3.125);
        near(ImuScale::new(500.5).angular_velocity([512, 512, 1023])[2].to_degrees(), 511.0 * 500.5 / 512.0);
    }

    #[test]
    fn a_standing_robot_feels_one_g_upwards() {
        let [x, y, z] = ImuScale::new(1600.0).linear_acceleration([512, 512, 640]);
        near(x, 0.0);
        near(y, 0.0);
        near(z, STANDARD_GRAVITY);
    }

    #[test]
    fn imu_axes_are_turned_to_forward_left_up() {
        let scale = ImuScale::new(1600.0);
        // Fallen forward: the framework reads ACC_Y below 390, gravity pulls along the forward axis.
        assert!(scale.linear_acceleration([512, 390, 512])[0] < -0.9 * STANDARD_GRAVITY);
        // The board's x is to the right.
        assert!(scale.linear_acceleration([640, 512, 512])[1] < 0.0);
        let [x, y, z] = scale.angular_velocity([513, 513, 513]);
        assert!(x < 0.0 && y < 0.0 && z > 0.0);
    }

    proptest! {
        #[test]
        fn every_tick_survives_a_round_trip(ticks in 300..3800_u16, offset in -300..300_i16) {
            prop_assert_eq!(ticks_from_radians(radians_from_ticks(ticks, offset), offset), ticks);
        }

        #[test]
        fn every_magnitude_survives_a_round_trip(value in -1023..=1023_i16) {
            prop_assert_eq!(signed_from_magnitude(magnitude_from_signed(i32::from(value))), value);
        }
    }
}
