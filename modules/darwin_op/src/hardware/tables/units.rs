//! Conversion between the devices' units and SI units in the frames of REP-103 (x forward, y left, z up).
//!
//! Only additions, multiplications and roundings, so that the same bytes give the same bits on every machine.

pub use downbeat_servos::servo_bus::models::STANDARD_GRAVITY;
use std::f64::consts::{PI, TAU};

/// One step of the position, in rad.
pub const RADIANS_PER_TICK: f64 = TAU / 4096.0;
/// The tick at angle 0.
pub const CENTRE_TICKS: i32 = 2048;
/// One step of the present speed, 0.11 rpm, in rad/s.
pub const PRESENT_SPEED_UNIT: f64 = 0.11 * TAU / 60.0;
/// One step of the moving speed, 0.114 rpm, in rad/s.
pub const MOVING_SPEED_UNIT: f64 = 0.114 * TAU / 60.0;
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

/// An axis of a board, or the opposite of one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BoardAxis {
    /// 0 for X, 1 for Y, 2 for Z.
    pub index: usize,
    /// Whether it is the opposite.
    pub is_opposite: bool,
}

impl BoardAxis {
    const fn along(index: usize) -> Self {
        Self { index, is_opposite: false }
    }

    const fn against(index: usize) -> Self {
        Self { index, is_opposite: true }
    }

    /// Parses `x`, `-y` and so on.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let (axis, is_opposite) = text.strip_prefix('-').map_or((text, false), |axis| (axis, true));
        let index = ["x", "y", "z"].iter().position(|known| *known == axis)?;
        Some(Self { index, is_opposite })
    }

    fn of(self, values: [f64; 3]) -> f64 {
        if self.is_opposite { -values[self.index] } else { values[self.index] }
    }
}

/// The revision of the board, which determines the scale of its gyroscope and its axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BoardRevision {
    /// Of the Darwin OP: axes as in thedancomplex/ros2_cm730.
    #[default]
    Cm730,
    /// Of the OP2: axes as in ROBOTIS' `cm_740_module`. Sources disagree on both.
    Cm740,
}

impl BoardRevision {
    /// The degrees/s that correspond to 512 steps of the gyroscope.
    #[must_use]
    pub fn gyro_full_scale_dps(self) -> f64 {
        match self {
            Self::Cm730 => 1600.0,
            Self::Cm740 => 500.5,
        }
    }

    /// Forward, left and up of the gyroscope.
    #[must_use]
    pub fn gyro_axes(self) -> [BoardAxis; 3] {
        match self {
            Self::Cm730 => [BoardAxis::against(0), BoardAxis::against(1), BoardAxis::along(2)],
            Self::Cm740 => [BoardAxis::along(0), BoardAxis::along(1), BoardAxis::along(2)],
        }
    }

    /// Forward, left and up of the accelerometer.
    #[must_use]
    pub fn acceleration_axes(self) -> [BoardAxis; 3] {
        match self {
            Self::Cm730 => [BoardAxis::along(1), BoardAxis::against(0), BoardAxis::along(2)],
            Self::Cm740 => [BoardAxis::against(1), BoardAxis::along(0), BoardAxis::against(2)],
        }
    }
}

/// Converts the IMU's numbers to SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuScale {
    /// One step of the gyroscope, in rad/s.
    radians_per_lsb: f64,
    /// Forward, left, up of the gyroscope and of the accelerometer.
    axes: [[BoardAxis; 3]; 2],
}

impl ImuScale {
    /// For a CM-730 with a gyroscope whose 512 steps correspond to `gyro_full_scale_dps` degrees/s.
    ///
    /// 1600 for the CM-730 (3.125 degrees/s per step), 500.5 for the CM-740 (0.9775); other boards differ.
    #[must_use]
    pub fn new(gyro_full_scale_dps: f64) -> Self {
        let board = BoardRevision::Cm730;
        Self::with_axes(gyro_full_scale_dps, board.gyro_axes(), board.acceleration_axes())
    }

    /// As [`new`](Self::new), with the axes of the board that point forward, left and up.
    #[must_use]
    pub fn with_axes(gyro_full_scale_dps: f64, gyro: [BoardAxis; 3], acceleration: [BoardAxis; 3]) -> Self {
        Self { radians_per_lsb: gyro_full_scale_dps / 512.0 * (PI / 180.0), axes: [gyro, acceleration] }
    }

    /// One step of the gyroscope, in rad/s.
    #[must_use]
    pub fn radians_per_lsb(&self) -> f64 {
        self.radians_per_lsb
    }

    /// The angular rate about forward, left and up, in rad/s, from the board's `GYRO_X`, `GYRO_Y`, `GYRO_Z`.
    #[must_use]
    pub fn angular_velocity(&self, gyro: [u16; 3]) -> [f64; 3] {
        self.angular_velocity_from(gyro, [f64::from(IMU_CENTRE); 3])
    }

    /// The same with a gyroscope that reads `rest` at rest.
    #[must_use]
    pub fn angular_velocity_from(&self, gyro: [u16; 3], rest: [f64; 3]) -> [f64; 3] {
        let steps = std::array::from_fn(|axis| f64::from(gyro[axis]) - rest[axis]);
        self.axes[0].map(|axis| axis.of(steps) * self.radians_per_lsb)
    }

    /// The specific force forward, left and up, in m/s^2 (9.81 upwards at rest), from `ACC_X`, `ACC_Y`,
    /// `ACC_Z`.
    #[must_use]
    pub fn linear_acceleration(&self, acceleration: [u16; 3]) -> [f64; 3] {
        let steps = acceleration.map(centred);
        self.axes[1].map(|axis| axis.of(steps) * ACCELERATION_PER_LSB)
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
    fn the_axes_of_a_board_are_a_parameter() {
        let board = BoardRevision::Cm740;
        let scale =
            ImuScale::with_axes(board.gyro_full_scale_dps(), board.gyro_axes(), board.acceleration_axes());
        let [x, y, z] = scale.angular_velocity([513, 513, 513]);
        assert!(x > 0.0 && y > 0.0 && z > 0.0);
        assert!(scale.linear_acceleration([512, 640, 384])[0] < 0.0);
        near(scale.angular_velocity_from([515, 512, 512], [515.0, 512.0, 512.0])[0], 0.0);
        assert_eq!(BoardAxis::parse("-y"), Some(BoardAxis::against(1)));
        assert_eq!([BoardAxis::parse("w"), BoardAxis::parse("--x"), BoardAxis::parse("")], [None; 3]);
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
