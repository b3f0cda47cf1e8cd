//! The module and the emulated autopilot, in one core.

use std::time::Duration;

use downbeat_executor::{Heard, ModuleOptions, Probe, SettingValue};
use downbeat_msgs::diagnostic_msgs::msg::DiagnosticArray;
use downbeat_msgs::geometry_msgs::msg::{PoseStamped, Twist};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::sensor_msgs::msg::{BatteryState, Imu};
use downbeat_msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse, TriggerRequest, TriggerResponse};
use downbeat_msgs::tf2_msgs::msg::TFMessage;
use downbeat_px4::{Autopilot, Px4, Release, v1_17};

const MS: Duration = Duration::from_millis(1);

fn options(settings: &[(&str, SettingValue)]) -> ModuleOptions {
    let settings = settings.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
    ModuleOptions { settings, ..ModuleOptions::default() }
}

/// A flight: the module, the autopilot, and what the module publishes.
struct Flight {
    probe: Probe,
    odom: Heard<Odometry>,
    diagnostics: Heard<DiagnosticArray>,
    last: Odometry,
}

impl Flight {
    fn of(release: Release, time: &str) -> Self {
        let mut probe = Probe::new();
        let release = ("release", SettingValue::from(release.name().to_owned()));
        let pilot = options(&[release.clone(), ("time", SettingValue::from(time.to_owned()))]);
        probe.add_with("autopilot", Autopilot::default(), pilot).unwrap();
        probe.add_with("px4", Px4::default(), options(&[release])).unwrap();
        let (odom, diagnostics) = (probe.listen("odom").unwrap(), probe.listen("diagnostics").unwrap());
        let mut flight = Self { probe, odom, diagnostics, last: Odometry::default() };
        flight.pass(100 * MS);
        flight
    }

    /// Lets time pass, and keeps the last odometry.
    fn pass(&mut self, time: Duration) {
        self.probe.advance(time).unwrap();
        if let Some(odometry) = self.odom.take_last() {
            self.last = odometry;
        }
    }

    fn trigger(&mut self, service: &str) -> Result<TriggerResponse, String> {
        self.probe.call(service, TriggerRequest::default()).map_err(|error| error.to_string())
    }

    fn arm(&mut self, data: bool) -> Result<SetBoolResponse, String> {
        self.probe.call("arm", SetBoolRequest { data }).map_err(|error| error.to_string())
    }

    /// Publishes a pose again and again, as a client does.
    fn hold(&mut self, pose: &PoseStamped, time: Duration) {
        let end = self.probe.now() + time;
        while self.probe.now() < end {
            self.probe.publish("setpoint_pose", pose.clone()).unwrap();
            self.pass(100 * MS);
        }
    }

    fn mode(&mut self) -> String {
        self.pass(1_100 * MS);
        let status = self.diagnostics.take_last().unwrap().status.remove(0);
        status.values.into_iter().find(|value| value.key == "mode").unwrap().value
    }

    fn position(&self) -> [f64; 3] {
        let position = &self.last.pose.pose.position;
        [position.x, position.y, position.z]
    }
}

/// A pose that faces north, without a stamp: now.
fn pose(position: [f64; 3]) -> PoseStamped {
    let mut pose = PoseStamped::default();
    pose.header.frame_id = "odom".to_owned();
    [pose.pose.position.x, pose.pose.position.y, pose.pose.position.z] = position;
    (pose.pose.orientation.z, pose.pose.orientation.w) = (0.5_f64.sqrt(), 0.5_f64.sqrt());
    pose
}

fn assert_near(one: [f64; 3], two: [f64; 3]) {
    assert!(one.iter().zip(two).all(|(one, two)| (one - two).abs() < 0.1), "{one:?} is not near {two:?}");
}

#[test]
fn a_flight_with_every_release_from_arming_to_landing() {
    for release in Release::ALL {
        let mut flight = Flight::of(release, "agent");
        let target = pose([3.0, 2.0, 5.0]);
        flight.hold(&target, 200 * MS);
        assert!(flight.arm(true).unwrap().success, "{release}");
        // Set-points have been streamed for less than a second: the module waits until PX4 would accept it.
        flight.hold(&target, 1_200 * MS);
        let response = flight.trigger("offboard").unwrap();
        assert_eq!(response.message, "PX4 has accepted the command to enter offboard mode");
        flight.hold(&target, 6_000 * MS);
        assert_near(flight.position(), [3.0, 2.0, 5.0]);
        let turned = &flight.last.pose.pose.orientation;
        assert!((turned.z - 0.5_f64.sqrt()).abs() < 1e-3, "{release}: faces north: {turned:?}");
        let refused = flight.arm(false).unwrap_err();
        assert!(refused.contains("PX4 answers the command to disarm: denied"), "{refused}");
        flight.trigger("land").unwrap();
        flight.pass(9_000 * MS);
        assert!(flight.position()[2].abs() < 0.1, "{release}: {:?}", flight.position());
        assert_eq!(flight.mode(), "land");
    }
}

#[test]
fn a_twist_is_in_the_body_and_px4_leaves_offboard_mode_when_it_ends() {
    let mut flight = Flight::of(Release::V1_16, "agent");
    // Forward and up, while the vehicle faces north.
    let mut twist = Twist::default();
    (twist.linear.x, twist.linear.z) = (1.0, 0.5);
    for step in 0..40 {
        if step == 1 {
            flight.arm(true).unwrap();
        }
        if step == 15 {
            flight.trigger("offboard").unwrap();
        }
        flight.probe.publish("cmd_vel", twist).unwrap();
        flight.pass(100 * MS);
    }
    let [east, north, up] = flight.position();
    assert!(
        east.abs() < 1e-3 && (1.5..3.0).contains(&north) && (up - north / 2.0).abs() < 1e-3,
        "{north} {up}"
    );
    assert!((flight.last.twist.twist.linear.x - 1.0).abs() < 1e-3, "{:?}", flight.last.twist.twist);
    // Silence: valid for another 0.5 s, and after another 0.5 s of silence PX4 holds.
    flight.pass(2_000 * MS);
    let there = flight.position();
    assert!(there[1] - north < 1.2, "{there:?}");
    flight.pass(1_000 * MS);
    assert_eq!(flight.position(), there, "it stands");
    assert_eq!(flight.mode(), "hold");
    flight.pass(1_100 * MS);
    let status = flight.diagnostics.take_last().unwrap().status.remove(0);
    assert_eq!((status.level, status.message.as_str()), (2, "failsafe"));
}

#[test]
fn without_current_commands_offboard_mode_is_refused_and_nothing_is_streamed() {
    let mut flight = Flight::of(Release::V1_17, "agent");
    let modes =
        flight.probe.listen::<v1_17::msg::OffboardControlMode>("fmu/in/offboard_control_mode").unwrap();
    let commands = flight.probe.listen::<v1_17::msg::VehicleCommand>("fmu/in/vehicle_command").unwrap();
    flight.pass(3_000 * MS);
    let refused = flight.trigger("offboard").unwrap_err();
    assert!(refused.contains("publish current commands on cmd_vel or setpoint_pose first"), "{refused}");
    assert!(modes.take().is_empty() && commands.take().is_empty(), "nothing was asked for");
    // A command that becomes too old while the request waits.
    flight.probe.publish("setpoint_pose", pose([0.0, 0.0, 2.0])).unwrap();
    flight.pass(200 * MS);
    let refused = flight.trigger("offboard").unwrap_err();
    assert!(refused.contains("set-points have stopped"), "{refused}");
    let streamed = modes.take();
    assert!((9..=11).contains(&streamed.len()), "0.5 s at 20 Hz: {}", streamed.len());
    assert!(streamed.iter().all(|mode| mode.position && !mode.velocity));
    assert!(commands.take().is_empty());
}

#[test]
fn hold_ends_offboard_mode() {
    let mut flight = Flight::of(Release::V1_14, "agent");
    let target = pose([0.0, 0.0, 2.0]);
    flight.hold(&target, 1_500 * MS);
    flight.trigger("offboard").unwrap();
    flight.hold(&target, 300 * MS);
    assert_eq!(flight.trigger("hold").unwrap().message, "PX4 has accepted the command to hold");
    assert_eq!(flight.mode(), "hold");
}

#[test]
fn what_the_autopilot_measures_is_in_the_frames_of_ros() {
    for time in ["agent", "boot"] {
        let mut flight = Flight::of(Release::V1_17, time);
        let imu = flight.probe.listen::<Imu>("imu/data_raw").unwrap();
        let battery = flight.probe.listen::<BatteryState>("battery_state").unwrap();
        let tf = flight.probe.listen::<TFMessage>("tf").unwrap();
        flight.pass(1_000 * MS);
        let now = flight.probe.now().as_nanos();
        let measured = imu.take_last().unwrap();
        assert!((measured.linear_acceleration.z - 9.806_65).abs() < 1e-5);
        let age = now - measured.header.stamp.as_nanos();
        assert!((0..20_000_000).contains(&age), "{time}: {age} ns");
        let battery = battery.take_last().unwrap();
        assert_eq!((battery.voltage, battery.current), (15.2, -4.0));
        let transform = tf.take_last().unwrap().transforms.remove(0);
        assert_eq!(
            (transform.header.frame_id.as_str(), transform.child_frame_id.as_str()),
            ("odom", "base_link")
        );
        assert_eq!(transform.transform.rotation, flight.last.pose.pose.orientation);
        let status = flight.diagnostics.take_last().unwrap().status.remove(0);
        let value = |key: &str| status.values.iter().find(|value| value.key == key).unwrap().value.clone();
        assert_eq!((status.level, value("armed")), (0, "false".to_owned()));
        assert_eq!(value("time"), if time == "agent" { "converted by PX4" } else { "by timesync_status" });
    }
}
