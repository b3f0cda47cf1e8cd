//! Orientation from gyroscope and accelerometer, by the passive complementary filter of Mahony.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `imu/data_raw` (in) | `sensor_msgs/Imu` | rad/s, m/s² |
//! | `imu/data` | `sensor_msgs/Imu` | the same with orientation, and without the bias of the gyroscope |
//!
//! The orientation is that of the IMU in a level frame, z up, in which the robot first faces along x. Roll
//! and pitch are corrected by gravity; yaw is integrated only and drifts, and its covariance grows with time.
//!
//! | setting | |
//! | --- | --- |
//! | `gain` | how fast gravity corrects roll and pitch, 1/s |
//! | `bias_gain` | how fast this correction changes the bias, 1/s² |
//! | `gravity_tolerance` | how far the specific force may differ from g, as a fraction of g, to count as gravity |
//! | `still_s` | for how long the robot must be still until the mean of the gyroscope becomes its bias, s; 0 for never. Later means are averaged |
//! | `still_deviation` | the largest standard deviation of an axis of the gyroscope while still, rad/s |
//! | `max_bias` | the largest bias of an axis, rad/s |
//! | `tilt_deviation` | the standard deviation of roll and pitch to report, rad |
//! | `yaw_drift` | by how much the reported standard deviation of yaw grows, rad/s |
//!
//! It uses only additions, multiplications, divisions and square roots, so it computes the same bits on every
//! machine.
//!
//! # References
//! R. Mahony, T. Hamel, J.-M. Pflimlin, "Nonlinear Complementary Filters on the Special Orthogonal Group",
//! IEEE Transactions on Automatic Control 53 (2008), equations (32a) to (32c) with gravity as the only
//! reference.

use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError};
use downbeat_kind::Kind;
use downbeat_msgs::geometry_msgs::msg::{Quaternion, Vector3};
use downbeat_msgs::sensor_msgs::msg::Imu;
use glam::{DMat3, DQuat, DVec3};

/// The kinds of modules that this package offers to robot files.
#[must_use]
pub fn kinds() -> Vec<Kind> {
    vec![Kind::new("imu_filter", "orientation from gyroscope and accelerometer", ImuFilter::default)]
}

/// Adds the orientation to IMU data; see the [module page](self).
#[derive(Debug, Default)]
pub struct ImuFilter {
    filter: OrientationFilter,
    rest: Rest,
    average: Average,
    /// The stamp of the last message and the time since the first one, both in ns.
    time: Option<(i64, i64)>,
}

/// The keys of [`ImuFilter`].
pub struct Ports {
    data: Publication<Imu>,
    gain: Setting<f64>,
    bias_gain: Setting<f64>,
    gravity_tolerance: Setting<f64>,
    still_s: Setting<f64>,
    still_deviation: Setting<f64>,
    max_bias: Setting<f64>,
    tilt_deviation: Setting<f64>,
    yaw_drift: Setting<f64>,
}

/// In m/s².
const STANDARD_GRAVITY: f64 = 9.806_65;
/// The longest time between two messages that is integrated, in s. After a longer one the orientation is
/// initialised again.
const LONGEST_STEP: f64 = 0.5;

impl ImuFilter {
    fn on_raw(&mut self, raw: Received<'_, Imu>, ctx: &mut Context<'_, Ports>) {
        let gyro = dvec3(&raw.angular_velocity);
        let force = dvec3(&raw.linear_acceleration);
        if !(gyro.is_finite() && force.is_finite()) {
            return;
        }
        let stamp = raw.header.stamp.as_nanos();
        let (step, elapsed) = match self.time {
            Some((last, elapsed)) => (stamp.saturating_sub(last), elapsed),
            None => (0, 0),
        };
        let dt = step as f64 * 1e-9;
        let gains = Gains {
            proportional: *ctx.get(ctx.ports.gain),
            integral: *ctx.get(ctx.ports.bias_gain),
            tolerance: *ctx.get(ctx.ports.gravity_tolerance),
            max_bias: *ctx.get(ctx.ports.max_bias),
        };
        if self.time.is_some() && (0.0..=LONGEST_STEP).contains(&dt) {
            self.filter.update(gyro, force, dt, gains);
        } else {
            // The first message, or one after a gap or from an earlier time.
            self.filter.start(force);
            (self.rest, self.average) = Default::default();
        }
        self.time = Some((stamp, elapsed.saturating_add(step.max(0))));
        let still = (*ctx.get(ctx.ports.still_s), *ctx.get(ctx.ports.still_deviation));
        if let Some(bias) = self.rest.add(gyro, dt, still.0, still.1).and_then(|mean| self.average.add(mean))
        {
            self.filter.bias = clamped(bias, gains.max_bias);
        }
        let Some(orientation) = self.filter.world_from_imu() else { return };
        let tilt_variance = ctx.get(ctx.ports.tilt_deviation).powi(2);
        let drift = *ctx.get(ctx.ports.yaw_drift) * elapsed as f64 * 1e-9;
        let mut data = raw.clone();
        data.orientation =
            Quaternion { x: orientation.x, y: orientation.y, z: orientation.z, w: orientation.w };
        data.orientation_covariance = [0.0; 9];
        data.orientation_covariance[0] = tilt_variance;
        data.orientation_covariance[4] = tilt_variance;
        data.orientation_covariance[8] = tilt_variance + drift * drift;
        let rate = gyro - self.filter.bias;
        data.angular_velocity = Vector3 { x: rate.x, y: rate.y, z: rate.z };
        ctx.publish(ctx.ports.data, data);
    }
}

impl Module for ImuFilter {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let ports = Ports {
            data: setup.publish("imu/data")?,
            gain: setup.setting_in("gain", 0.5, 0.0..=50.0, "1/s; how fast gravity corrects roll and pitch")?,
            bias_gain: setup.setting_in(
                "bias_gain",
                0.01,
                0.0..=10.0,
                "1/s^2; how fast the correction by gravity changes the bias of the gyroscope",
            )?,
            gravity_tolerance: setup.setting_in(
                "gravity_tolerance",
                0.5,
                0.0..=10.0,
                "how far the specific force may differ from g, as a fraction of g, to count as gravity",
            )?,
            still_s: setup.setting_in(
                "still_s",
                0.8,
                0.0..=60.0,
                "s; after this time at rest the mean of the gyroscope becomes its bias; 0 for never",
            )?,
            still_deviation: setup.setting_in(
                "still_deviation",
                0.11,
                0.0..=10.0,
                "rad/s; largest standard deviation of an axis of the gyroscope at rest, 2 steps of the CM-730's",
            )?,
            max_bias: setup.setting_in("max_bias", 0.3, 0.0..=10.0, "rad/s; largest bias of an axis")?,
            tilt_deviation: setup.setting_in(
                "tilt_deviation",
                0.03,
                0.0..=4.0,
                "rad; standard deviation of roll and pitch in orientation_covariance",
            )?,
            yaw_drift: setup.setting_in(
                "yaw_drift",
                0.01,
                0.0..=10.0,
                "rad/s; growth of the standard deviation of yaw in orientation_covariance",
            )?,
        };
        setup.subscribe("imu/data_raw", Self::on_raw)?;
        Ok(ports)
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

/// Parameters of an update of [`OrientationFilter`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// How fast gravity corrects the orientation, in 1/s.
    pub proportional: f64,
    /// How fast this correction changes the bias, in 1/s².
    pub integral: f64,
    /// How far the specific force may differ from g, as a fraction of g, to count as gravity.
    pub tolerance: f64,
    /// The largest bias of an axis, in rad/s.
    pub max_bias: f64,
}

/// The filter without messages: angular rates and specific forces in, orientation out.
#[derive(Clone, Debug, Default)]
pub struct OrientationFilter {
    orientation: Option<DQuat>,
    /// The bias of the gyroscope, in rad/s.
    pub bias: DVec3,
}

impl OrientationFilter {
    /// The orientation; `None` before a specific force was measured.
    #[must_use]
    pub fn world_from_imu(&self) -> Option<DQuat> {
        self.orientation
    }

    /// Initialises the orientation by gravity alone: x of the IMU points along x of the world, as far as it
    /// is level. The bias remains. A specific force of zero has no direction and changes nothing.
    pub fn start(&mut self, specific_force: DVec3) {
        let Some(up) = specific_force.try_normalize() else { return };
        // The axes of the world in the frame of the IMU. If x of the IMU is vertical, its z is ahead or
        // behind.
        let ahead = if up.x.abs() < 0.99 { DVec3::X } else { DVec3::Z * -up.x };
        let x = (ahead - up * ahead.dot(up)).normalize();
        let imu_from_world = DMat3::from_cols(x, up.cross(x), up);
        self.orientation = Some(DQuat::from_mat3(&imu_from_world.transpose()).normalize());
    }

    /// Integrates a rate of the gyroscope in rad/s over `dt` in s, and corrects it by a specific force in
    /// m/s², both in the frame of the IMU.
    pub fn update(&mut self, gyro: DVec3, specific_force: DVec3, dt: f64, gains: Gains) {
        let Some(orientation) = self.orientation else { return self.start(specific_force) };
        let mut rate = gyro - self.bias;
        let strength = specific_force.length();
        if strength > 0.0 && (strength / STANDARD_GRAVITY - 1.0).abs() <= gains.tolerance {
            let up = orientation.conjugate() * DVec3::Z;
            let error = (specific_force / strength).cross(up);
            rate += gains.proportional * error;
            self.bias = clamped(self.bias - gains.integral * dt * error, gains.max_bias);
        }
        self.orientation = Some((orientation * rotation_by(rate * dt)).normalize());
    }
}

/// The rotation by a small vector in rad: the exponential map up to the fifth order, without trigonometry.
fn rotation_by(angle: DVec3) -> DQuat {
    let half = angle * 0.5;
    let square = half.length_squared();
    let cos = 1.0 - square * (0.5 - square / 24.0);
    let sinc = 1.0 - square * (1.0 / 6.0 - square / 120.0);
    DQuat::from_xyzw(half.x * sinc, half.y * sinc, half.z * sinc, cos)
}

fn clamped(bias: DVec3, max: f64) -> DVec3 {
    bias.clamp(DVec3::splat(-max), DVec3::splat(max))
}

/// Detects that the robot is still, in consecutive windows.
#[derive(Clone, Debug, Default)]
struct Rest {
    time: f64,
    count: f64,
    sum: DVec3,
    sum_of_squares: DVec3,
}

impl Rest {
    /// The mean of the gyroscope if a window ends with this sample and the robot was still in it.
    fn add(&mut self, gyro: DVec3, dt: f64, window_s: f64, max_deviation: f64) -> Option<DVec3> {
        if window_s <= 0.0 {
            return None;
        }
        self.time += dt;
        self.count += 1.0;
        self.sum += gyro;
        self.sum_of_squares += gyro * gyro;
        if self.time < window_s || self.count < 10.0 {
            return None;
        }
        let Self { count, sum, sum_of_squares, .. } = std::mem::take(self);
        let mean = sum / count;
        let variance = sum_of_squares / count - mean * mean;
        (variance.max_element() <= max_deviation * max_deviation).then_some(mean)
    }
}

/// The mean of what rests told: one of them is as exact as a fraction of the gyroscope's step, which turns a
/// walking robot by degrees within a minute.
#[derive(Clone, Debug, Default)]
struct Average {
    mean: DVec3,
    count: f64,
    /// How many in a row were far off.
    far: u32,
}

impl Average {
    /// What is averaged, in windows: so long ago, a temperature was another one.
    const MOST: f64 = 20.0;
    /// Who seems to be at rest but is so far off turns slowly, in rad/s.
    const FAR: f64 = 0.03;
    /// Unless it does so many times in a row.
    const MOST_FAR: u32 = 5;
    /// The least number of windows that tells what is far off.
    const LEAST: f64 = 3.0;

    /// The new mean, unless this one is far off.
    fn add(&mut self, rest: DVec3) -> Option<DVec3> {
        if self.count >= Self::LEAST && (rest - self.mean).abs().max_element() > Self::FAR {
            self.far += 1;
            if self.far < Self::MOST_FAR {
                return None;
            }
            *self = Self::default();
        }
        self.far = 0;
        self.count = (self.count + 1.0).min(Self::MOST);
        self.mean += (rest - self.mean) / self.count;
        Some(self.mean)
    }
}

fn dvec3(vector: &Vector3) -> DVec3 {
    DVec3::new(vector.x, vector.y, vector.z)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use downbeat_executor::Probe;
    use downbeat_msgs::builtin_interfaces::msg::Time;
    use std::f64::consts::FRAC_PI_2;

    const GAINS: Gains = Gains { proportional: 0.5, integral: 0.01, tolerance: 0.5, max_bias: 0.3 };
    const DT: f64 = 0.008;

    /// The angle of the rotation between two orientations, in rad.
    fn between(a: DQuat, b: DQuat) -> f64 {
        a.angle_between(b)
    }

    /// The specific force at rest in an orientation.
    fn gravity_in(world_from_imu: DQuat) -> DVec3 {
        world_from_imu.conjugate() * DVec3::Z * STANDARD_GRAVITY
    }

    #[test]
    fn gravity_alone_gives_roll_and_pitch_and_no_yaw() {
        for (roll, pitch) in
            [(0.0, 0.0), (0.3, -0.2), (-1.2, 0.7), (3.0, 0.1), (0.0, FRAC_PI_2), (0.0, -FRAC_PI_2)]
        {
            let expected = DQuat::from_rotation_y(pitch) * DQuat::from_rotation_x(roll);
            let mut filter = OrientationFilter::default();
            filter.start(gravity_in(expected));
            assert!(between(filter.world_from_imu().unwrap(), expected) < 1e-7, "{roll} {pitch}");
        }
        let mut filter = OrientationFilter::default();
        filter.start(DVec3::ZERO);
        assert_eq!(filter.world_from_imu(), None);
    }

    #[test]
    fn a_turn_is_integrated_and_a_wrong_tilt_fades() {
        let mut filter = OrientationFilter::default();
        filter.start(DVec3::Z * STANDARD_GRAVITY);
        for _ in 0..250 {
            filter.update(DVec3::Z * 0.5, DVec3::Z * STANDARD_GRAVITY, DT, GAINS);
        }
        let turned = DQuat::from_rotation_z(1.0);
        assert!(between(filter.world_from_imu().unwrap(), turned) < 1e-9);
        filter.orientation = Some(turned * DQuat::from_rotation_x(0.3));
        for _ in 0..2500 {
            filter.update(DVec3::ZERO, DVec3::Z * STANDARD_GRAVITY, DT, Gains { integral: 0.0, ..GAINS });
        }
        assert!(between(filter.world_from_imu().unwrap(), turned) < 1e-3);
    }

    #[test]
    fn forces_far_from_gravity_do_not_tilt() {
        let mut filter = OrientationFilter::default();
        filter.start(DVec3::Z * STANDARD_GRAVITY);
        for _ in 0..250 {
            filter.update(DVec3::ZERO, DVec3::X * 30.0, DT, GAINS);
            filter.update(DVec3::ZERO, DVec3::ZERO, DT, GAINS);
        }
        assert!(between(filter.world_from_imu().unwrap(), DQuat::IDENTITY) < 1e-12);
    }

    fn raw(ms: i64, gyro: [f64; 3], force: [f64; 3]) -> Imu {
        let vector = |[x, y, z]: [f64; 3]| Vector3 { x, y, z };
        let mut imu =
            Imu { angular_velocity: vector(gyro), linear_acceleration: vector(force), ..Imu::default() };
        imu.header.stamp = Time::from_nanos(ms * 1_000_000);
        imu.orientation_covariance[0] = -1.0;
        imu
    }

    /// What the module makes of messages every 8 ms.
    fn filtered(messages: impl Iterator<Item = ([f64; 3], [f64; 3])>) -> Vec<Imu> {
        let mut probe = Probe::new();
        probe.add("imu_filter", ImuFilter::default()).unwrap();
        let data = probe.listen("imu/data").unwrap();
        for (number, (gyro, force)) in (0_i64..).zip(messages) {
            probe.publish("imu/data_raw", raw(8 * number, gyro, force)).unwrap();
        }
        data.take()
    }

    #[test]
    fn the_bias_of_a_robot_at_rest_is_taken_off() {
        let bias = [0.1, -0.05, 0.15];
        let data = filtered((0..500).map(|_| (bias, [0.0, 0.0, STANDARD_GRAVITY])));
        let last = data.last().unwrap();
        assert!(dvec3(&last.angular_velocity).length() < 0.01);
        let yaw = 2.0 * libm::atan2(last.orientation.z, last.orientation.w);
        assert!(yaw.abs() < 0.15, "it has turned for less than a second, {yaw}");
        assert!(last.orientation_covariance[8] > data[0].orientation_covariance[8]);
        assert_eq!(last.orientation_covariance[0], 0.03 * 0.03);
    }

    #[test]
    fn a_slow_turn_does_not_become_the_bias_but_a_new_bias_does() {
        let mut average = Average::default();
        for off in [0.0, 0.02, -0.02, 0.02, -0.02] {
            average.add(DVec3::new(0.0, 0.0, 0.1 + off)).unwrap();
        }
        assert!((average.mean.z - 0.1).abs() < 1e-9, "{average:?}");
        let turns = DVec3::new(0.0, 0.0, 0.2);
        for _ in 1..Average::MOST_FAR {
            assert_eq!(average.add(turns), None);
        }
        assert_eq!(average.add(turns), Some(turns));
    }

    #[test]
    fn a_turning_robot_is_not_at_rest_and_numbers_that_are_none_are_dropped() {
        let gravity = [0.0, 0.0, STANDARD_GRAVITY];
        let swinging = (0..500).map(|number| ([0.0, 0.0, 0.5 + 0.3 * libm::sin(f64::from(number))], gravity));
        let data = filtered(swinging);
        assert!((data.last().unwrap().angular_velocity.z - 0.5).abs() < 0.31);
        assert_eq!(filtered([([f64::NAN; 3], gravity), ([0.0; 3], gravity)].into_iter()).len(), 1);
    }
}
