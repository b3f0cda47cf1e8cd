//! Standard messages of ROS from those of PX4: pure functions.

use crate::frames;
use crate::v1_17::msg::{SensorCombined, VehicleOdometry};
use downbeat_executor::Time;
use downbeat_msgs::geometry_msgs::msg::{Quaternion, Vector3};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::sensor_msgs::msg::{BatteryState, Imu};
use downbeat_servos::stamps::header;
use glam::{DMat3, DQuat, DVec3};

/// Why a `VehicleOdometry` says nothing.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(crate) enum OdometryRefused {
    #[error("pose_frame is {0}, and 1 (NED) and 2 (FRD) are known")]
    PoseFrame(u8),
    #[error("velocity_frame is {0}, and 1 (NED), 2 (FRD) and 3 (body FRD) are known")]
    VelocityFrame(u8),
    #[error("the quaternion q is not finite: the autopilot knows no attitude")]
    NoAttitude,
    #[error("the quaternion q has the length {0}, not 1")]
    Length(f64),
    #[error("the position is not finite: the autopilot has no position estimate")]
    NoPosition,
}

/// Where the vehicle is: in the frames of ROS.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct State {
    pub(crate) position: DVec3,
    pub(crate) world_from_body: DQuat,
    /// In NED, so that set-points have a heading; otherwise in a frame whose heading PX4 does not know.
    pub(crate) is_ned: bool,
}

/// From the world of PX4 to that of ROS.
type Turn<T> = fn(T) -> T;

/// The variance of what is not measured, as other modules and robot_localization have it.
const UNKNOWN: f64 = 1e6;
/// How far the length of a quaternion in f32 may be from 1.
const LENGTH_TOLERANCE: f64 = 1e-2;

fn dvec3([x, y, z]: [f32; 3]) -> DVec3 {
    DVec3::new(f64::from(x), f64::from(y), f64::from(z))
}

pub(crate) fn vector3(v: DVec3) -> Vector3 {
    Vector3 { x: v.x, y: v.y, z: v.z }
}

/// Variances of three axes, unknown ones as such.
fn variances(given: [f32; 3]) -> DMat3 {
    DMat3::from_diagonal(dvec3(given.map(|variance| match variance.is_finite() && variance >= 0.0 {
        true => variance,
        false => UNKNOWN as f32,
    })))
}

/// The odometry in the frames of ROS, with this stamp and these frames.
pub(crate) fn odometry(
    from: &VehicleOdometry,
    stamp: Time,
    [odom_frame, base_frame]: [&str; 2],
) -> Result<(Odometry, State), OdometryRefused> {
    let is_ned = match from.pose_frame {
        VehicleOdometry::POSE_FRAME_NED => true,
        VehicleOdometry::POSE_FRAME_FRD => false,
        other => return Err(OdometryRefused::PoseFrame(other)),
    };
    let [w, x, y, z] = from.q.map(f64::from);
    let rotation = DQuat::from_xyzw(x, y, z, w);
    if !rotation.is_finite() {
        return Err(OdometryRefused::NoAttitude);
    }
    if (rotation.length() - 1.0).abs() > LENGTH_TOLERANCE {
        return Err(OdometryRefused::Length(rotation.length()));
    }
    let position = dvec3(from.position);
    if !position.is_finite() {
        return Err(OdometryRefused::NoPosition);
    }
    // FRD worlds are to FLU worlds what bodies are to bodies.
    let (to_world, turned, spread): (Turn<DVec3>, Turn<DQuat>, Turn<DMat3>) = match is_ned {
        true => (frames::ned_enu, frames::rotation_ned_enu, frames::covariance_ned_enu),
        false => (frames::frd_flu, frames::rotation_frd_flu, frames::covariance_frd_flu),
    };
    let position = to_world(position);
    let world_from_body = turned(rotation.normalize());
    let body_from_world = world_from_body.conjugate();

    let given = dvec3(from.velocity);
    let variance = variances(from.velocity_variance);
    let (velocity, velocity_covariance) = match from.velocity_frame {
        VehicleOdometry::VELOCITY_FRAME_BODY_FRD => {
            (frames::frd_flu(given), frames::covariance_frd_flu(variance))
        }
        frame @ (VehicleOdometry::VELOCITY_FRAME_NED | VehicleOdometry::VELOCITY_FRAME_FRD)
            if (frame == VehicleOdometry::VELOCITY_FRAME_NED) == is_ned =>
        {
            (body_from_world * to_world(given), frames::rotated_covariance(body_from_world, spread(variance)))
        }
        other => return Err(OdometryRefused::VelocityFrame(other)),
    };
    let rates = frames::frd_flu(dvec3(from.angular_velocity));
    // Of a vector that is not finite nothing is known.
    let known = |vector: DVec3, covariance: DMat3| match vector.is_finite() {
        true => (vector, covariance),
        false => (DVec3::ZERO, DMat3::from_diagonal(DVec3::splat(UNKNOWN))),
    };
    let (velocity, velocity_covariance) = known(velocity, velocity_covariance);
    let (rates, rates_covariance) = known(rates, DMat3::ZERO);

    let mut odometry = Odometry {
        header: header(stamp, odom_frame),
        child_frame_id: base_frame.to_owned(),
        ..Odometry::default()
    };
    let pose = &mut odometry.pose;
    (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z) = position.into();
    pose.pose.orientation = quaternion(world_from_body);
    let in_body = frames::covariance_frd_flu(variances(from.orientation_variance));
    let orientation = frames::rotated_covariance(world_from_body, in_body);
    pose.covariance = six_by_six(spread(variances(from.position_variance)), orientation);
    odometry.twist.twist.linear = vector3(velocity);
    odometry.twist.twist.angular = vector3(rates);
    odometry.twist.covariance = six_by_six(velocity_covariance, rates_covariance);
    Ok((odometry, State { position, world_from_body, is_ned }))
}

fn quaternion(rotation: DQuat) -> Quaternion {
    let DQuat { x, y, z, w } = rotation;
    Quaternion { x, y, z, w }
}

/// Two covariances that are independent of each other, row by row.
fn six_by_six(first: DMat3, second: DMat3) -> [f64; 36] {
    let mut covariance = [0.0; 36];
    for row in 0..3 {
        for column in 0..3 {
            covariance[6 * row + column] = first.col(column)[row];
            covariance[6 * (row + 3) + column + 3] = second.col(column)[row];
        }
    }
    covariance
}

/// What the IMU measures, in FLU; `None` if it measures nothing.
pub(crate) fn imu(from: &SensorCombined, stamp: Time, frame: &str) -> Option<Imu> {
    let rates = frames::frd_flu(dvec3(from.gyro_rad));
    let force = frames::frd_flu(dvec3(from.accelerometer_m_s2));
    let has_force = force.is_finite()
        && from.accelerometer_timestamp_relative != SensorCombined::RELATIVE_TIMESTAMP_INVALID;
    if !rates.is_finite() {
        return None;
    }
    let mut imu = Imu { header: header(stamp, frame), angular_velocity: vector3(rates), ..Imu::default() };
    imu.orientation_covariance[0] = -1.0;
    match has_force {
        true => imu.linear_acceleration = vector3(force),
        false => imu.linear_acceleration_covariance[0] = -1.0,
    }
    Some(imu)
}

/// The fields of a `BatteryStatus` that all releases have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Battery {
    pub(crate) connected: bool,
    pub(crate) voltage_v: f32,
    pub(crate) current_a: f32,
    pub(crate) remaining: f32,
    pub(crate) temperature: f32,
    pub(crate) capacity_mah: u16,
    pub(crate) cell_count: u8,
    pub(crate) cells_v: [f32; 14],
    pub(crate) id: u8,
    /// One of `WARNING_FAILED`.
    pub(crate) has_failed: bool,
    pub(crate) has_faults: bool,
}

/// The battery in the terms of ROS: a current that is drawn is negative, and what is unknown is NaN.
pub(crate) fn battery_state(from: &Battery, stamp: Time) -> BatteryState {
    // PX4 marks what it does not know with values that cannot be, and each field with another one.
    let known = |value: f32, is_known: bool| if is_known { value } else { f32::NAN };
    let current = known(-from.current_a, from.current_a >= 0.0);
    let capacity = known(f32::from(from.capacity_mah) / 1000.0, from.capacity_mah > 0);
    let percentage = known(from.remaining, (0.0..=1.0).contains(&from.remaining));
    let cells = usize::from(from.cell_count).min(from.cells_v.len());
    let has_cells = from.cells_v[..cells].iter().any(|voltage| *voltage > 0.0);
    BatteryState {
        header: header(stamp, ""),
        voltage: known(from.voltage_v, from.voltage_v > 0.0),
        temperature: from.temperature,
        current,
        charge: percentage * capacity,
        capacity,
        design_capacity: f32::NAN,
        percentage,
        power_supply_status: match from.current_a > 0.0 {
            true => BatteryState::POWER_SUPPLY_STATUS_DISCHARGING,
            false => BatteryState::POWER_SUPPLY_STATUS_UNKNOWN,
        },
        power_supply_health: match (from.has_failed, from.has_faults) {
            (true, _) => BatteryState::POWER_SUPPLY_HEALTH_DEAD,
            (_, true) => BatteryState::POWER_SUPPLY_HEALTH_UNSPEC_FAILURE,
            _ => BatteryState::POWER_SUPPLY_HEALTH_UNKNOWN,
        },
        power_supply_technology: BatteryState::POWER_SUPPLY_TECHNOLOGY_UNKNOWN,
        present: from.connected,
        cell_voltage: if has_cells { from.cells_v[..cells].to_vec() } else { Vec::new() },
        location: from.id.to_string(),
        ..BatteryState::default()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::f64::consts::FRAC_1_SQRT_2;

    const FRAMES: [&str; 2] = ["odom", "base_link"];

    /// 1 m north, 2 m east, 3 m up, facing north, flying north at 4 m/s.
    fn flying_north() -> VehicleOdometry {
        VehicleOdometry {
            pose_frame: VehicleOdometry::POSE_FRAME_NED,
            position: [1.0, 2.0, -3.0],
            q: [1.0, 0.0, 0.0, 0.0],
            velocity_frame: VehicleOdometry::VELOCITY_FRAME_NED,
            velocity: [4.0, 0.0, 0.0],
            angular_velocity: [0.0, 0.0, 0.5],
            position_variance: [0.1, 0.2, 0.3],
            orientation_variance: [0.01, 0.02, 0.03],
            velocity_variance: [1.0, 2.0, 3.0],
            ..VehicleOdometry::default()
        }
    }

    fn refused(message: &VehicleOdometry) -> OdometryRefused {
        odometry(message, Time::ZERO, FRAMES).unwrap_err()
    }

    fn near(one: f64, two: f64) -> bool {
        (one - two).abs() < 1e-6
    }

    #[test]
    fn the_odometry_is_in_enu_and_its_twist_in_the_body() {
        let (odometry, state) = odometry(&flying_north(), Time::from_nanos(5), FRAMES).unwrap();
        let pose = &odometry.pose.pose;
        assert_eq!((pose.position.x, pose.position.y, pose.position.z), (2.0, 1.0, 3.0));
        assert!(near(pose.orientation.z, FRAC_1_SQRT_2) && near(pose.orientation.w, FRAC_1_SQRT_2));
        let twist = &odometry.twist.twist;
        assert!(near(twist.linear.x, 4.0) && near(twist.linear.y, 0.0), "forward: {twist:?}");
        assert_eq!(twist.angular.z, -0.5, "to the right");
        let diagonal = |covariance: &[f64; 36]| [0, 7, 14, 21, 28, 35].map(|index| covariance[index]);
        let pose_variance = diagonal(&odometry.pose.covariance);
        for (found, expected) in pose_variance.iter().zip([0.2, 0.1, 0.3, 0.02, 0.01, 0.03]) {
            assert!(near(*found, expected), "{pose_variance:?}");
        }
        // North is forward.
        let twist_variance = diagonal(&odometry.twist.covariance);
        for (found, expected) in twist_variance.iter().zip([1.0, 2.0, 3.0, 0.0, 0.0, 0.0]) {
            assert!(near(*found, expected), "{twist_variance:?}");
        }
        assert_eq!(
            (odometry.header.frame_id.as_str(), odometry.child_frame_id.as_str()),
            ("odom", "base_link")
        );
        assert_eq!(odometry.header.stamp.as_nanos(), 5);
        assert!(state.is_ned);
    }

    #[test]
    fn a_velocity_of_the_body_and_a_world_without_north() {
        let mut message = flying_north();
        message.velocity_frame = VehicleOdometry::VELOCITY_FRAME_BODY_FRD;
        message.velocity = [1.0, 2.0, 3.0];
        let twist = odometry(&message, Time::ZERO, FRAMES).unwrap().0.twist.twist;
        assert_eq!((twist.linear.x, twist.linear.y, twist.linear.z), (1.0, -2.0, -3.0));

        message.pose_frame = VehicleOdometry::POSE_FRAME_FRD;
        message.velocity_frame = VehicleOdometry::VELOCITY_FRAME_FRD;
        let (odometry, state) = odometry(&message, Time::ZERO, FRAMES).unwrap();
        let position = &odometry.pose.pose.position;
        assert_eq!((position.x, position.y, position.z), (1.0, -2.0, 3.0));
        assert!(!state.is_ned);
        assert_eq!(odometry.twist.twist.linear.y, -2.0);
    }

    #[test]
    fn what_says_nothing_is_refused_with_the_reason() {
        let of = |change: fn(&mut VehicleOdometry)| {
            let mut message = flying_north();
            change(&mut message);
            refused(&message)
        };
        assert_eq!(of(|m| m.pose_frame = 7), OdometryRefused::PoseFrame(7));
        assert_eq!(of(|m| m.velocity_frame = 0), OdometryRefused::VelocityFrame(0));
        assert_eq!(of(|m| m.velocity_frame = 2), OdometryRefused::VelocityFrame(2), "FRD in a NED world");
        assert_eq!(of(|m| m.q[0] = f32::NAN), OdometryRefused::NoAttitude);
        assert_eq!(of(|m| m.q = [0.0; 4]), OdometryRefused::Length(0.0));
        assert_eq!(of(|m| m.position[2] = f32::INFINITY), OdometryRefused::NoPosition);
        let text = OdometryRefused::PoseFrame(7).to_string();
        assert_eq!(text, "pose_frame is 7, and 1 (NED) and 2 (FRD) are known");
    }

    #[test]
    fn an_unknown_velocity_is_zero_with_a_large_variance() {
        let mut message = flying_north();
        message.velocity[1] = f32::NAN;
        message.position_variance = [f32::NAN, -1.0, 0.3];
        let (odometry, _) = odometry(&message, Time::ZERO, FRAMES).unwrap();
        assert_eq!((odometry.twist.twist.linear.x, odometry.twist.covariance[0]), (0.0, UNKNOWN));
        assert_eq!((odometry.pose.covariance[0], odometry.pose.covariance[7]), (UNKNOWN, UNKNOWN));
    }

    #[test]
    fn an_imu_at_rest_measures_gravity_upwards() {
        let mut message =
            SensorCombined { accelerometer_m_s2: [0.1, 0.2, -9.8], ..SensorCombined::default() };
        message.gyro_rad = [0.1, 0.2, 0.3];
        let measured = imu(&message, Time::ZERO, "base_link").unwrap();
        assert!(near(measured.linear_acceleration.z, 9.8) && near(measured.linear_acceleration.y, -0.2));
        assert!(near(measured.angular_velocity.y, -0.2));
        assert_eq!(measured.orientation_covariance[0], -1.0);
        message.accelerometer_timestamp_relative = SensorCombined::RELATIVE_TIMESTAMP_INVALID;
        let measured = imu(&message, Time::ZERO, "base_link").unwrap();
        assert_eq!((measured.linear_acceleration.z, measured.linear_acceleration_covariance[0]), (0.0, -1.0));
        message.gyro_rad[0] = f32::NAN;
        assert_eq!(imu(&message, Time::ZERO, "base_link"), None);
    }

    #[test]
    fn a_battery_that_knows_little_says_so() {
        let unknown = Battery {
            connected: true,
            voltage_v: 0.0,
            current_a: -1.0,
            remaining: -1.0,
            temperature: f32::NAN,
            capacity_mah: 0,
            cell_count: 4,
            cells_v: [0.0; 14],
            id: 1,
            has_failed: false,
            has_faults: false,
        };
        let state = battery_state(&unknown, Time::ZERO);
        assert!(state.voltage.is_nan() && state.current.is_nan() && state.percentage.is_nan());
        assert!(state.charge.is_nan() && state.present && state.cell_voltage.is_empty());
        let mut cells_v = [0.0; 14];
        cells_v[..4].fill(3.7);
        let flying = Battery {
            voltage_v: 14.8,
            current_a: 10.0,
            remaining: 0.5,
            capacity_mah: 5000,
            cells_v,
            cell_count: 200,
            ..unknown
        };
        let state = battery_state(&flying, Time::ZERO);
        assert_eq!((state.current, state.percentage, state.capacity, state.charge), (-10.0, 0.5, 5.0, 2.5));
        assert_eq!(state.power_supply_status, BatteryState::POWER_SUPPLY_STATUS_DISCHARGING);
        assert_eq!(state.cell_voltage.len(), 14, "no more than there is room for");
    }
}
