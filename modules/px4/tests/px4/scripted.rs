//! The module with messages that a test makes: bad input, and an autopilot that does not answer.

use std::time::Duration;

use downbeat_executor::{Heard, ModuleOptions, Probe, SettingValue};
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::geometry_msgs::msg::{PoseStamped, Twist, TwistStamped};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse};
use downbeat_px4::Px4;
use downbeat_px4::v1_17::msg::{
    OffboardControlMode, TrajectorySetpoint, VehicleCommand, VehicleCommandAck, VehicleOdometry,
    VehicleStatus,
};

const MS: Duration = Duration::from_millis(1);
const ODOMETRY: &str = "fmu/out/vehicle_odometry";

fn robot(settings: &[(&str, SettingValue)]) -> Probe {
    let settings = settings.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
    let mut probe = Probe::new();
    let options = ModuleOptions { settings, ..ModuleOptions::default() };
    probe.add_with("px4", Px4::default(), options).unwrap();
    probe
}

/// Facing north at the origin, now.
fn odometry(probe: &Probe) -> VehicleOdometry {
    VehicleOdometry {
        timestamp: (probe.now().as_nanos() / 1000) as u64,
        pose_frame: VehicleOdometry::POSE_FRAME_NED,
        q: [1.0, 0.0, 0.0, 0.0],
        velocity_frame: VehicleOdometry::VELOCITY_FRAME_NED,
        ..VehicleOdometry::default()
    }
}

fn value(status: &DiagnosticStatus, key: &str) -> String {
    status.values.iter().find(|value| value.key == key).unwrap().value.clone()
}

fn status(diagnostics: &Heard<DiagnosticArray>) -> DiagnosticStatus {
    diagnostics.take_last().unwrap().status.remove(0)
}

#[test]
fn odometry_that_says_nothing_is_dropped_and_counted() {
    let mut probe = robot(&[]);
    let odom = probe.listen::<Odometry>("odom").unwrap();
    let diagnostics = probe.listen::<DiagnosticArray>("diagnostics").unwrap();
    probe
        .publish(
            "fmu/out/vehicle_status_v1",
            VehicleStatus { pre_flight_checks_pass: true, ..Default::default() },
        )
        .unwrap();
    let changes: [fn(&mut VehicleOdometry); 4] = [
        |m| m.q = [f32::NAN; 4],
        |m| m.pose_frame = 9,
        |m| m.velocity_frame = 0,
        |m| m.position[0] = f32::NAN,
    ];
    for change in changes {
        let mut message = odometry(&probe);
        change(&mut message);
        probe.publish(ODOMETRY, message).unwrap();
    }
    assert!(odom.take().is_empty());
    probe.advance(1_100 * MS).unwrap();
    let reported = status(&diagnostics);
    assert_eq!((reported.level, reported.message.as_str()), (DiagnosticStatus::WARN, "no odometry"));
    assert_eq!(value(&reported, "dropped odometry"), "4");
    probe.publish(ODOMETRY, odometry(&probe)).unwrap();
    assert_eq!(odom.take().len(), 1);
    probe.advance(1_100 * MS).unwrap();
    assert_eq!(status(&diagnostics).level, DiagnosticStatus::OK);
}

#[test]
fn a_stamp_that_jumps_is_dropped_and_a_restart_is_followed() {
    let mut probe = robot(&[]);
    let odom = probe.listen::<Odometry>("odom").unwrap();
    let diagnostics = probe.listen::<DiagnosticArray>("diagnostics").unwrap();
    let send = |probe: &mut Probe, timestamp: u64| {
        let message = VehicleOdometry { timestamp, ..odometry(probe) };
        probe.publish(ODOMETRY, message).unwrap();
        probe.advance(10 * MS).unwrap();
        odom.take().len()
    };
    // Since the start of the autopilot, an hour ago.
    assert_eq!((0..5).map(|n| send(&mut probe, 3_600_000_000 + n * 10_000)).sum::<usize>(), 5);
    assert_eq!(send(&mut probe, 9_000_000_000_000), 0);
    assert_eq!(send(&mut probe, 0), 0);
    assert_eq!(send(&mut probe, u64::MAX), 0);
    assert_eq!(send(&mut probe, 3_600_080_000), 1);
    // It starts anew: two stamps are dropped, the third is believed.
    let after: Vec<usize> = (0..4).map(|n| send(&mut probe, 1_000_000 + n * 10_000)).collect();
    assert_eq!(after, [0, 0, 1, 1]);
    probe.advance(1_000 * MS).unwrap();
    let reported = status(&diagnostics);
    assert_eq!(
        (value(&reported, "dropped for their stamps"), value(&reported, "steps of time")),
        ("5".to_owned(), "1".to_owned())
    );
}

#[test]
fn a_set_point_needs_a_heading_and_its_numbers_are_in_ned() {
    let mut probe = robot(&[]);
    let set_points = probe.listen::<TrajectorySetpoint>("fmu/in/trajectory_setpoint").unwrap();
    let modes = probe.listen::<OffboardControlMode>("fmu/in/offboard_control_mode").unwrap();
    let mut twist = Twist::default();
    [twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.z] = [1.0, 2.0, 3.0, 0.5];
    probe.publish("cmd_vel", twist).unwrap();
    probe.advance(200 * MS).unwrap();
    assert!(set_points.take().is_empty(), "no odometry: no heading");
    // Facing east, with the nose up by 0.3 rad: the velocity is level all the same.
    let (sin, cos) = libm::sincosf(std::f32::consts::FRAC_PI_4);
    let (up_sin, up_cos) = libm::sincosf(0.15);
    let q = [cos * up_cos, -sin * up_sin, cos * up_sin, sin * up_cos];
    probe.publish(ODOMETRY, VehicleOdometry { q, ..odometry(&probe) }).unwrap();
    probe.publish("cmd_vel", twist).unwrap();
    probe.advance(50 * MS).unwrap();
    let set_point = set_points.take_last().unwrap();
    // Forward is east, left is north.
    for (found, expected) in set_point.velocity.iter().zip([2.0, 1.0, -3.0]) {
        assert!((found - expected).abs() < 1e-5, "{:?}", set_point.velocity);
    }
    assert_eq!(set_point.yawspeed, -0.5);
    let is_free = |values: &[f32]| values.iter().all(|value| value.is_nan());
    assert!(is_free(&set_point.position) && is_free(&set_point.acceleration) && is_free(&[set_point.yaw]));
    assert!(modes.take().iter().all(|mode| mode.velocity && !mode.position));
    let mut pose = PoseStamped::default();
    pose.header.frame_id = "odom".to_owned();
    [pose.pose.position.x, pose.pose.position.y, pose.pose.position.z] = [1.0, 2.0, 3.0];
    pose.pose.orientation.w = 1.0; // east
    probe.publish("setpoint_pose", pose).unwrap();
    probe.advance(50 * MS).unwrap();
    let set_point = set_points.take_last().unwrap();
    assert_eq!(set_point.position, [2.0, 1.0, -3.0]);
    assert!((set_point.yaw - std::f32::consts::FRAC_PI_2).abs() < 1e-6 && set_point.velocity[0].is_nan());
    // Half a second later the heading is unknown again, although the command was given again.
    probe.advance(450 * MS).unwrap();
    set_points.take().clear();
    probe.publish("cmd_vel", Twist::default()).unwrap();
    probe.advance(200 * MS).unwrap();
    assert!(set_points.take().is_empty());
}

#[test]
fn commands_that_are_old_wrong_or_in_another_frame_are_dropped() {
    let mut probe = robot(&[("use_stamped_vel", SettingValue::from(true))]);
    let set_points = probe.listen::<TrajectorySetpoint>("fmu/in/trajectory_setpoint").unwrap();
    probe.publish(ODOMETRY, odometry(&probe)).unwrap();
    let now = probe.now().as_nanos();
    let stamped = |age_ms: i64, x: f64| {
        let mut command = TwistStamped::default();
        command.header.stamp =
            downbeat_msgs::builtin_interfaces::msg::Time::from_nanos(now - age_ms * 1_000_000);
        command.twist.linear.x = x;
        command
    };
    for command in [stamped(600, 1.0), stamped(-600, 1.0), stamped(0, f64::NAN)] {
        probe.publish("cmd_vel", command).unwrap();
    }
    let mut pose = PoseStamped::default();
    pose.pose.orientation.w = 1.0;
    pose.header.frame_id = "map".to_owned();
    probe.publish("setpoint_pose", pose.clone()).unwrap();
    pose.header.frame_id = "odom".to_owned();
    pose.pose.orientation.w = 0.0;
    probe.publish("setpoint_pose", pose).unwrap();
    probe.advance(100 * MS).unwrap();
    assert!(set_points.take().is_empty());
    // The time for which a command is valid counts from its stamp: 100 ms are left of this one.
    probe.publish("cmd_vel", stamped(300, 1.0)).unwrap();
    probe.advance(400 * MS).unwrap();
    assert_eq!(set_points.take().len(), 2);
}

#[test]
fn an_autopilot_that_does_not_answer_is_an_answer() {
    let mut probe = robot(&[]);
    let commands = probe.listen::<VehicleCommand>("fmu/in/vehicle_command").unwrap();
    let error =
        probe.call::<SetBoolRequest, SetBoolResponse>("arm", SetBoolRequest { data: true }).unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains("no answer on fmu/out/vehicle_command_ack within 2 s to the command to arm"),
        "{text}"
    );
    let sent = commands.take();
    assert_eq!(sent.len(), 1, "it is not sent again");
    assert_eq!((sent[0].command, sent[0].param1, sent[0].target_system), (400, 1.0, 1));
    assert!(sent[0].from_external);
}

#[test]
fn answers_to_others_are_not_ours_and_progress_is_waited_for() {
    let mut probe = robot(&[]);
    let (sender, answer) = std::sync::mpsc::channel();
    let caller = probe.core().caller::<SetBoolRequest, SetBoolResponse>("arm").unwrap();
    let patience = Duration::from_secs(60);
    caller.call(SetBoolRequest { data: true }, patience, move |result| drop(sender.send(result))).unwrap();
    probe.advance(100 * MS).unwrap();
    let ack = |result, target_system, target_component| VehicleCommandAck {
        command: 400,
        result,
        target_system,
        target_component,
        ..VehicleCommandAck::default()
    };
    const TOPIC: &str = "fmu/out/vehicle_command_ack";
    // An answer names the command alone, so there is one request for each.
    let error =
        probe.call::<SetBoolRequest, SetBoolResponse>("arm", SetBoolRequest { data: false }).unwrap_err();
    assert!(error.to_string().contains("another request waits for PX4's answer to command 400"), "{error}");
    probe.publish(TOPIC, ack(0, 255, 190)).unwrap(); // to a ground station
    probe.publish(TOPIC, VehicleCommandAck { command: 176, ..ack(0, 1, 1) }).unwrap();
    probe.publish(TOPIC, ack(5, 1, 1)).unwrap(); // in progress
    probe.advance(1_900 * MS).unwrap();
    assert!(answer.try_recv().is_err());
    probe.publish(TOPIC, ack(42, 1, 1)).unwrap();
    probe.advance(10 * MS).unwrap();
    let text = answer.try_recv().unwrap().unwrap_err().to_string();
    assert!(text.contains("PX4 answers the command to arm: the unknown result 42"), "{text}");
}

#[test]
fn a_silent_autopilot_is_stale() {
    let mut probe = robot(&[]);
    let diagnostics = probe.listen::<DiagnosticArray>("diagnostics").unwrap();
    probe.advance(100 * MS).unwrap();
    assert_eq!(status(&diagnostics).message, "PX4 was not heard yet");
    probe
        .publish(
            "fmu/out/vehicle_status_v1",
            VehicleStatus { pre_flight_checks_pass: true, ..Default::default() },
        )
        .unwrap();
    assert_eq!(status(&diagnostics).message, "connected");
    probe.advance(3_100 * MS).unwrap();
    let reported = status(&diagnostics);
    assert_eq!(
        (reported.level, reported.message.as_str()),
        (DiagnosticStatus::STALE, "PX4 is not heard any more")
    );
}

#[test]
fn settings_out_of_range_are_refused_with_what_is_possible() {
    let refused = |name: &str, value: SettingValue| {
        let settings = [(name.to_owned(), value)].into();
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        Probe::new().add_with("px4", Px4::default(), options).unwrap_err().to_string()
    };
    let text = refused("release", SettingValue::from("1.13".to_owned()));
    assert!(text.contains("\"1.13\" is none of 1.14, 1.15, 1.16, 1.17"), "{text}");
    let text = refused("rate_hz", SettingValue::from(2.0));
    assert!(text.contains("2 Hz is not within 5 and 1000 Hz"), "{text}");
}
