//! Converts readings to ROS messages.

use super::reading::{BoardReading, Reading};
use super::servo::Servo;
use super::settings::Settings;
use super::tables::joints::{COUNT, JOINTS};
use super::tables::units::{
    ACCELERATION_PER_LSB, load_from_raw, radians_from_ticks, speed_from_raw, volts_from_raw,
};
use downbeat_executor::Time;
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::geometry_msgs::msg::Vector3;
use downbeat_msgs::sensor_msgs::msg::{BatteryState, Imu, JointState, Joy};
use downbeat_msgs::std_msgs::msg::Header;

/// The capacity of the battery, in Ah.
const DESIGN_CAPACITY_AH: f32 = 1.0;

/// A header with that stamp.
pub(super) fn header(stamp: Time, frame_id: &str) -> Header {
    let stamp = builtin_interfaces::msg::Time::from_nanos(stamp.as_nanos());
    Header { stamp, frame_id: frame_id.to_owned() }
}

/// All joints. A stale one keeps its last position and has NaN as velocity and effort, and as position if it
/// was never read.
pub(super) fn joint_state(reading: &Reading, servos: &[Servo; COUNT], settings: &Settings) -> JointState {
    let mut message = JointState {
        header: header(reading.sent, &settings.joint_frame),
        name: JOINTS.iter().map(|joint| joint.name.to_owned()).collect(),
        position: Vec::with_capacity(COUNT),
        velocity: Vec::with_capacity(COUNT),
        effort: Vec::with_capacity(COUNT),
    };
    for (servo, offset_ticks) in servos.iter().zip(settings.offset_ticks) {
        let fresh = servo.last.filter(|_| !servo.is_stale());
        let position = servo.last.map(|last| radians_from_ticks(last.position, offset_ticks));
        message.position.push(position.unwrap_or(f64::NAN));
        message.velocity.push(fresh.map_or(f64::NAN, |last| speed_from_raw(last.speed)));
        message.effort.push(fresh.map_or(f64::NAN, |last| load_from_raw(last.load)));
    }
    message
}

/// Angular rate and specific force. The orientation is not measured, as marked by -1.
///
/// The covariances take one step of the 10-bit numbers as standard deviation.
pub(super) fn imu(sent: Time, board: &BoardReading, settings: &Settings) -> Imu {
    let mut orientation_covariance = [0.0; 9];
    orientation_covariance[0] = -1.0;
    Imu {
        header: header(sent, &settings.imu_frame),
        orientation_covariance,
        angular_velocity: vector(settings.imu.angular_velocity(board.gyro)),
        angular_velocity_covariance: diagonal(settings.imu.radians_per_lsb()),
        linear_acceleration: vector(settings.imu.linear_acceleration(board.acceleration)),
        linear_acceleration_covariance: diagonal(ACCELERATION_PER_LSB),
        ..Imu::default()
    }
}

/// The battery, of which only the voltage is measured.
pub(super) fn battery_state(sent: Time, board: &BoardReading) -> BatteryState {
    BatteryState {
        header: header(sent, ""),
        voltage: volts_from_raw(board.voltage) as f32,
        temperature: f32::NAN,
        current: f32::NAN,
        charge: f32::NAN,
        capacity: f32::NAN,
        design_capacity: DESIGN_CAPACITY_AH,
        percentage: f32::NAN,
        power_supply_status: BatteryState::POWER_SUPPLY_STATUS_UNKNOWN,
        power_supply_health: BatteryState::POWER_SUPPLY_HEALTH_UNKNOWN,
        power_supply_technology: BatteryState::POWER_SUPPLY_TECHNOLOGY_LIPO,
        present: true,
        ..BatteryState::default()
    }
}

/// The buttons: mode, start.
pub(super) fn buttons(sent: Time, board: &BoardReading) -> Joy {
    let button = |bit: u16| i32::from(board.buttons >> bit & 1);
    Joy { header: header(sent, ""), axes: Vec::new(), buttons: vec![button(0), button(1)] }
}

fn vector([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3 { x, y, z }
}

fn diagonal(deviation: f64) -> [f64; 9] {
    let variance = deviation * deviation;
    [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, variance]
}
