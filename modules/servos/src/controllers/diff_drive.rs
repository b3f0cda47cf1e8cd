//! Drives a base with two wheels, or with wheels on two sides, as the `diff_drive_controller` of ros2_control
//! does.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `cmd_vel` (in) | geometry_msgs/Twist, or TwistStamped with `use_stamped_vel` | `linear.x` in m/s, `angular.z` in rad/s; the rest is ignored |
//! | `joint_states` (in) | sensor_msgs/JointState | positions of the wheels, rad |
//! | `joint_commands` | sensor_msgs/JointState | velocities of the wheels, rad/s, at `rate_hz` |
//! | `odom` | nav_msgs/Odometry | pose of the base in the frame `odom_frame_id`, at `publish_rate`, with the stamp of a state of all wheels |
//! | `tf` | tf2_msgs/TFMessage | the same, unless `enable_odom_tf` is false |
//!
//! | setting | default | |
//! | --- | --- | --- |
//! | `left_wheel_names`, `right_wheel_names` | | as many on each side |
//! | `wheel_separation` | | m between the sides |
//! | `wheel_radius` | | m |
//! | `rate_hz` | 50 | rate of commands |
//! | `publish_rate` | `rate_hz` | Hz, rate of `odom` and `tf`, which follow from each state of the wheels, however often they are published; 0: with each state |
//! | `cmd_vel_timeout` | 0.5 | s after which the base stops without a new command; 0: never. With `use_stamped_vel` it counts from the stamp, and commands with an older or a newer stamp are dropped; a stamp of 0 means now |
//! | `linear.x.max_velocity`, `angular.z.max_velocity` | 1 m/s, 2 rad/s | limits, both ways |
//! | `linear.x.max_acceleration`, `angular.z.max_acceleration` | 2 m/s², 8 rad/s² | limits, both ways |
//! | `odom_frame_id`, `base_frame_id` | `odom`, `base_link` | |
//! | `enable_odom_tf`, `use_stamped_vel` | true, false | |
//!
//! # Odometry
//! With the distances l and r that the wheels of each side have rolled since the last state, the mean of each
//! side, and the wheel separation b, the base has moved by
//!
//! (1)  d = (l + r) / 2,  a = (r - l) / b
//!
//! on an arc. Its chord has the length d sin(a/2) / (a/2) and the direction of the heading in the middle:
//!
//! (2)  x' = x + d s cos(h + a/2),  y' = y + d s sin(h + a/2),  h' = h + a,  s = sin(a/2) / (a/2)
//!
//! While a wheel does not answer there is no odometry. When it answers again, it has turned the shorter way.
//!
//! The twist is the mean since the last message. Deactivation stops the base; what it moves until it is
//! activated again is not counted.
//!
//! The covariances are guesses that consumers of odometry expect to find: 1 mm and 0.01 rad per state on the
//! axes that wheels measure, 10^6 on the others.
//!
//! # References
//! `diff_drive_controller` of `ros-controls/ros2_controllers`, branch jazzy: `doc/userdoc.rst` for names and
//! defaults; for (1) and (2) R. Siegwart, I. Nourbakhsh, "Introduction to Autonomous Mobile Robots", section
//! 5.2.4.

use std::time::Duration;

use super::claims::OwnClaims;
use super::{is_fresh, joint_names};
use crate::stamps::{Stale, given_at, header};
use downbeat_executor::{
    Context, Module, Publication, Received, Setting, Setup, SetupError, Time, TransitionError,
};
use downbeat_msgs::geometry_msgs::msg::{Quaternion, TransformStamped, Twist, TwistStamped};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::tf2_msgs::msg::TFMessage;
use downbeat_transforms::wrapped;

/// Drives a base with wheels on two sides; see the [module page](self).
#[derive(Debug, Default)]
pub struct DiffDriveController {
    sides: [Vec<Wheel>; 2],
    asked: Option<(Time, Velocity)>,
    stale: Stale,
    commanded: Velocity,
    pose: Pose,
    /// How far the base has moved and turned since the last odometry was published: m, rad.
    moved: (f64, f64),
    published_at: Option<Time>,
    /// When the next odometry is due.
    due: Time,
    claims: OwnClaims,
}

#[derive(Debug)]
struct Wheel {
    name: String,
    /// In rad, in the last state that had it.
    position: Option<f64>,
    /// In rad since the last odometry.
    turned: f64,
    /// True if a state had it since the last odometry.
    is_fresh: bool,
}

/// Between two messages of odometry.
const LONGEST_PERIOD_S: f64 = 3600.0;

/// In the plane: along x, and about z.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Velocity {
    linear: f64,
    angular: f64,
}

/// Of the base in the frame of the odometry: m, rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Pose {
    x: f64,
    y: f64,
    heading: f64,
}

/// The keys of [`DiffDriveController`].
pub struct Ports {
    commands: Publication<JointState>,
    odom: Publication<Odometry>,
    tf: Publication<TFMessage>,
    period_s: f64,
    publish_rate: Setting<f64>,
    wheel_separation: Setting<f64>,
    wheel_radius: Setting<f64>,
    timeout: Setting<f64>,
    max_velocity: [Setting<f64>; 2],
    max_acceleration: [Setting<f64>; 2],
    odom_frame: Setting<String>,
    base_frame: Setting<String>,
    enable_tf: Setting<bool>,
}

impl DiffDriveController {
    fn on_stamped(&mut self, command: &TwistStamped, ctx: &Context<'_, Ports>) {
        let timeout = Duration::from_secs_f64(*ctx.get(ctx.ports.timeout));
        match given_at(&command.header.stamp, ctx.now(), timeout) {
            Ok(given) => self.on_twist(&command.twist, given),
            Err(reason) => self.stale.drop_for("cmd_vel", &reason),
        }
    }

    fn on_twist(&mut self, twist: &Twist, given: Time) {
        let velocity = Velocity { linear: twist.linear.x, angular: twist.angular.z };
        if velocity.linear.is_finite() && velocity.angular.is_finite() {
            self.asked = Some((given, velocity));
        } else {
            tracing::warn!("a command on cmd_vel has values that are not finite; it is dropped");
        }
    }

    fn tick(&mut self, ctx: &mut Context<'_, Ports>) {
        if !self.claims.are_granted(ctx) {
            return;
        }
        let ports = ctx.ports;
        let timeout = *ctx.get(ports.timeout);
        let is_late = |at: Time| timeout > 0.0 && ctx.now() > at + Duration::from_secs_f64(timeout);
        let asked =
            self.asked.filter(|(at, _)| !is_late(*at)).map_or(Velocity::default(), |(_, velocity)| velocity);
        let [linear, angular] = [0, 1].map(|axis| {
            let most = *ctx.get(ports.max_velocity[axis]);
            let (asked, commanded) = match axis {
                0 => (asked.linear, self.commanded.linear),
                _ => (asked.angular, self.commanded.angular),
            };
            let step = *ctx.get(ports.max_acceleration[axis]) * ports.period_s;
            asked.clamp(-most, most).clamp(commanded - step, commanded + step)
        });
        self.commanded = Velocity { linear, angular };
        self.command_wheels(ctx);
    }

    fn command_wheels(&self, ctx: &mut Context<'_, Ports>) {
        let (ports, Velocity { linear, angular }) = (ctx.ports, self.commanded);
        let (radius, half) = (*ctx.get(ports.wheel_radius), *ctx.get(ports.wheel_separation) / 2.0);
        let of_side = [linear - angular * half, linear + angular * half].map(|speed| speed / radius);
        let mut command = JointState { header: header(ctx.now(), ""), ..JointState::default() };
        for (side, speed) in self.sides.iter().zip(of_side) {
            for wheel in side {
                command.name.push(wheel.name.clone());
                command.velocity.push(speed);
            }
        }
        ctx.publish(ports.commands, command);
    }

    fn on_joint_states(&mut self, state: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        for (index, (name, position)) in state.name.iter().zip(&state.position).enumerate() {
            let wheel = self.sides.iter_mut().flatten().find(|wheel| wheel.name == *name);
            // A wheel that does not answer may be turning. There is no odometry until its position is known.
            if let Some(wheel) = wheel.filter(|_| is_fresh(&state, index)) {
                // A servo may count within one turn: what it has turned is the shorter way round.
                let turned = wheel.position.map_or(0.0, |before| wrapped(position - before));
                wheel.turned += turned;
                wheel.position = Some(*position);
                wheel.is_fresh = true;
            }
        }
        if self.sides.iter().flatten().all(|wheel| wheel.is_fresh) {
            let stamp = Time::from_nanos(state.header.stamp.as_nanos());
            let measured_at = if stamp == Time::ZERO { ctx.now() } else { stamp };
            self.roll_on(ctx);
            if self.is_due(measured_at, *ctx.get(ctx.ports.publish_rate)) {
                self.publish_odometry(measured_at, ctx);
            }
        }
    }

    /// Whether the next odometry is due, at this rate on average.
    fn is_due(&mut self, measured_at: Time, rate_hz: f64) -> bool {
        if rate_hz <= 0.0 {
            return true;
        }
        let period = Duration::from_secs_f64((1.0 / rate_hz).min(LONGEST_PERIOD_S));
        // Also after a time that has gone back.
        let is_near = self.due <= measured_at + period && measured_at < self.due + period;
        if is_near && measured_at < self.due {
            return false;
        }
        self.due = if is_near { self.due + period } else { measured_at + period };
        true
    }

    /// Moves the pose by what the wheels have rolled.
    fn roll_on(&mut self, ctx: &Context<'_, Ports>) {
        let ports = ctx.ports;
        let radius = *ctx.get(ports.wheel_radius);
        let [left, right] = self.sides.each_mut().map(|side| {
            let turned: f64 = side.iter().map(|wheel| wheel.turned).sum();
            let mean = turned / side.len() as f64;
            for wheel in side {
                (wheel.turned, wheel.is_fresh) = (0.0, false);
            }
            mean * radius
        });
        let (distance, angle) = moved(left, right, *ctx.get(ports.wheel_separation));
        self.pose = self.pose.after(distance, angle);
        self.moved = (self.moved.0 + distance, self.moved.1 + angle);
    }

    fn publish_odometry(&mut self, measured_at: Time, ctx: &mut Context<'_, Ports>) {
        let ports = ctx.ports;
        let (distance, angle) = std::mem::take(&mut self.moved);
        let before = self.published_at.replace(measured_at);
        let period = before.map_or(0.0, |before| measured_at.saturating_since(before).as_secs_f64());
        let per_second = |way: f64| if period > 0.0 { way / period } else { 0.0 };

        let mut odometry = Odometry {
            header: header(measured_at, ctx.get::<String>(ports.odom_frame)),
            child_frame_id: ctx.get(ports.base_frame).clone(),
            ..Odometry::default()
        };
        let (position, orientation) = (&mut odometry.pose.pose.position, self.pose.orientation());
        (position.x, position.y) = (self.pose.x, self.pose.y);
        odometry.twist.twist.linear.x = per_second(distance);
        odometry.twist.twist.angular.z = per_second(angle);
        for (axis, variance) in [1e-6, 1e-6, 1e6, 1e6, 1e6, 1e-4].into_iter().enumerate() {
            odometry.pose.covariance[7 * axis] = variance;
            odometry.twist.covariance[7 * axis] = variance;
        }
        if *ctx.get(ports.enable_tf) {
            let mut transform = TransformStamped {
                header: odometry.header.clone(),
                child_frame_id: odometry.child_frame_id.clone(),
                ..TransformStamped::default()
            };
            (transform.transform.translation.x, transform.transform.translation.y) =
                (self.pose.x, self.pose.y);
            transform.transform.rotation = orientation;
            ctx.publish(ports.tf, TFMessage { transforms: vec![transform] });
        }
        odometry.pose.pose.orientation = orientation;
        ctx.publish(ports.odom, odometry);
    }
}

/// (1): how far the base has moved, and by which angle it has turned to the left.
fn moved(left: f64, right: f64, separation: f64) -> (f64, f64) {
    ((left + right) / 2.0, (right - left) / separation)
}

fn check_length(metres: f64) -> Result<(), &'static str> {
    let is_length = metres > 0.0 && metres.is_finite();
    is_length.then_some(()).ok_or("it must be given, in m, and be greater than 0")
}

impl Pose {
    /// (2).
    fn after(self, distance: f64, angle: f64) -> Self {
        let half = angle / 2.0;
        // The series is exact to the last digit below this angle.
        let shortening = if half.abs() < 1e-4 { 1.0 - half * half / 6.0 } else { libm::sin(half) / half };
        let (sin, cos) = libm::sincos(self.heading + half);
        let chord = distance * shortening;
        Self { x: self.x + chord * cos, y: self.y + chord * sin, heading: wrapped(self.heading + angle) }
    }

    fn orientation(self) -> Quaternion {
        let (z, w) = libm::sincos(self.heading / 2.0);
        Quaternion { x: 0.0, y: 0.0, z, w }
    }
}

impl Module for DiffDriveController {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let mut side = |name: &str, which: &str| {
            let names = joint_names(setup, name, &format!("joints of the wheels on the {which}"))?;
            let wheel = |name| Wheel { name, position: None, turned: 0.0, is_fresh: false };
            Ok::<Vec<Wheel>, SetupError>(names.into_iter().map(wheel).collect())
        };
        self.sides = [side("left_wheel_names", "left")?, side("right_wheel_names", "right")?];
        let [left, right] = self.sides.each_ref().map(Vec::len);
        if left != right {
            return Err(setup.refuse(format!(
                "{left} wheels are on the left and {right} on the right; there must be as many on each side"
            )));
        }
        let rate_hz: Setting<f64> =
            setup.read_only_setting("rate_hz", 50.0, "Hz; how often wheels are commanded")?;
        let rate = setup.value(rate_hz).copied().unwrap_or(0.0);
        if !(1.0..=10_000.0).contains(&rate) {
            return Err(setup.refuse_value(rate_hz, format!("{rate} Hz is not within 1 and 10000 Hz")));
        }
        let stamped: Setting<bool> =
            setup.read_only_setting("use_stamped_vel", false, "cmd_vel is a TwistStamped")?;
        // Without defaults: those of ros2_control, 0, could not drive.
        let mut length = |name: &str, description: &str| {
            let key = setup.setting(name, 0.0, description)?;
            setup.accept_if(key, |_, value: &f64| check_length(*value).map_err(str::to_owned));
            let given = setup.value(key).copied().unwrap_or(0.0);
            check_length(given).map_err(|reason| setup.refuse_value(key, reason))?;
            Ok::<Setting<f64>, SetupError>(key)
        };
        let wheel_separation = length("wheel_separation", "m between the wheels of the two sides")?;
        let wheel_radius = length("wheel_radius", "m")?;
        let ports = Ports {
            commands: setup.publish("joint_commands")?,
            odom: setup.publish("odom")?,
            tf: setup.publish("tf")?,
            period_s: 1.0 / rate,
            publish_rate: setup.setting_in(
                "publish_rate",
                rate,
                0.0..=10_000.0,
                "Hz; rate of odom and tf; 0: with each state of the wheels",
            )?,
            wheel_separation,
            wheel_radius,
            timeout: setup.setting_in(
                "cmd_vel_timeout",
                0.5,
                0.0..=3600.0,
                "s; the base stops this long after the last command; 0 never",
            )?,
            max_velocity: [
                setup.setting_in("linear.x.max_velocity", 1.0, 0.0..=100.0, "m/s")?,
                setup.setting_in("angular.z.max_velocity", 2.0, 0.0..=100.0, "rad/s")?,
            ],
            max_acceleration: [
                setup.setting_in("linear.x.max_acceleration", 2.0, 0.0..=1000.0, "m/s²")?,
                setup.setting_in("angular.z.max_acceleration", 8.0, 0.0..=1000.0, "rad/s²")?,
            ],
            odom_frame: setup.setting("odom_frame_id", "odom".to_owned(), "frame of the odometry")?,
            base_frame: setup.setting("base_frame_id", "base_link".to_owned(), "frame of the base")?,
            enable_tf: setup.setting("enable_odom_tf", true, "the odometry is published on tf too")?,
        };
        if setup.value(stamped).copied().unwrap_or(false) {
            setup.subscribe::<TwistStamped, _>("cmd_vel", |module, command, ctx| {
                module.on_stamped(&command, ctx);
            })?;
        } else {
            setup.subscribe::<Twist, _>("cmd_vel", |module, command, ctx| {
                module.on_twist(&command, ctx.now());
            })?;
        }
        setup.subscribe("joint_states", Self::on_joint_states)?;
        setup.every(Duration::from_secs_f64(1.0 / rate), Self::tick)?;
        let wheels: Vec<String> = self.sides.iter().flatten().map(|wheel| wheel.name.clone()).collect();
        self.claims = OwnClaims::declare(setup, "joint_commands", &wheels);
        Ok(ports)
    }

    fn activate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        self.claims.take(ctx)?;
        (self.asked, self.commanded) = (None, Velocity::default());
        // How far the wheels have turned meanwhile is not known.
        for wheel in self.sides.iter_mut().flatten() {
            (wheel.position, wheel.turned, wheel.is_fresh) = (None, 0.0, false);
        }
        (self.moved, self.published_at) = ((0.0, 0.0), None);
        Ok(())
    }

    fn deactivate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        if self.claims.are_granted(ctx) {
            self.commanded = Velocity::default();
            self.command_wheels(ctx);
        }
        self.claims.give_back(ctx);
        Ok(())
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::testing::{Collector, core_at_zero};
    use downbeat_executor::{Clock, Core, ManualClock, ModuleOptions, SettingValue};

    const SEPARATION: f64 = 0.3;
    const RADIUS: f64 = 0.05;

    fn add(core: &mut Core, change: &[(&str, SettingValue)]) -> Result<(), SetupError> {
        let mut settings: Vec<(&str, SettingValue)> = vec![
            ("left_wheel_names", vec!["left".to_owned()].into()),
            ("right_wheel_names", vec!["right".to_owned()].into()),
            ("wheel_separation", SEPARATION.into()),
            ("wheel_radius", RADIUS.into()),
        ];
        settings.extend(change.iter().cloned());
        let settings = settings.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        core.add_with("base", DiffDriveController::default(), options).map(drop)
    }

    /// Wheels that turn as they are commanded, and count within one turn.
    struct Base {
        core: Core,
        clock: ManualClock,
        commands: Collector<JointState>,
        odom: Collector<Odometry>,
        wheels: [f64; 2],
    }

    impl Base {
        fn new() -> Self {
            let (mut core, clock) = core_at_zero();
            add(&mut core, &[]).unwrap();
            let commands = Collector::add(&mut core, "joint_commands");
            let odom = Collector::add(&mut core, "odom");
            Self { core, clock, commands, odom, wheels: [0.0; 2] }
        }

        /// Drives with a command in each period of 20 ms; returns the last odometry.
        fn drive(&mut self, command: Option<(f64, f64)>, periods: u32) -> Odometry {
            let states = self.core.inlet("joint_states").unwrap();
            let twists = self.core.inlet("cmd_vel").unwrap();
            for _ in 0..periods {
                if let Some((linear, angular)) = command {
                    let mut twist = Twist::default();
                    (twist.linear.x, twist.angular.z) = (linear, angular);
                    twists.publish(twist).unwrap();
                }
                self.clock.advance(Duration::from_millis(20));
                (0..2).for_each(|_| self.core.cycle().unwrap());
                if let Some(command) = self.commands.take().pop() {
                    for (wheel, speed) in self.wheels.iter_mut().zip(&command.velocity) {
                        *wheel = wrapped(*wheel + speed * 0.02);
                    }
                }
                let name = vec!["left".into(), "right".into()];
                let header = header(self.clock.now(), "");
                let state =
                    JointState { header, name, position: self.wheels.into(), ..JointState::default() };
                states.publish(state).unwrap();
            }
            (0..3).for_each(|_| self.core.cycle().unwrap());
            self.odom.take().pop().unwrap()
        }
    }

    #[test]
    fn a_wheel_that_does_not_answer_is_not_taken_as_standing() {
        let mut base = Base::new();
        base.drive(Some((0.1, 0.0)), 20);
        let states = base.core.inlet("joint_states").unwrap();
        for period in 0..10 {
            base.clock.advance(Duration::from_millis(20));
            let (name, header) = (vec!["left".into(), "right".into()], header(base.clock.now(), ""));
            // As `servo_bus` shows it: the last position, and NaN beside it.
            let position = vec![base.wheels[0] + 0.05 * f64::from(period), base.wheels[1]];
            let velocity = vec![2.5, f64::NAN];
            let state = JointState { header, name, position, effort: velocity.clone(), velocity };
            states.publish(state).unwrap();
            (0..2).for_each(|_| base.core.cycle().unwrap());
        }
        assert_eq!(base.odom.take().len(), 0);
        base.wheels = base.wheels.map(|wheel| wheel + 0.5);
        let end = base.drive(None, 1).pose.pose;
        assert!(end.orientation.z.abs() < 1e-9 && end.position.x > 0.01, "{end:?}");
    }

    #[test]
    fn a_circle_ends_where_it_began() {
        let mut base = Base::new();
        base.drive(Some((0.3, 1.0)), 20);
        let begin = base.drive(Some((0.3, 1.0)), 1).pose.pose;
        // 2 pi at 1 rad/s, in periods of 20 ms.
        let end = base.drive(Some((0.3, 1.0)), 314).pose.pose;
        let distance = libm::hypot(end.position.x - begin.position.x, end.position.y - begin.position.y);
        assert!(distance < 0.002, "{distance}");
        assert!((end.orientation.z - begin.orientation.z).abs() < 0.003);
    }

    #[test]
    fn a_straight_way_is_as_long_as_the_wheels_rolled() {
        let mut base = Base::new();
        let odometry = base.drive(Some((0.5, 0.0)), 100);
        // 2 s at 0.5 m/s, less what speeding up at 2 m/s² costs; the last command is on its way.
        let x = odometry.pose.pose.position.x;
        assert!((x - 0.93).abs() < 0.02 && odometry.pose.pose.position.y == 0.0, "{x}");
        assert!((odometry.twist.twist.linear.x - 0.5).abs() < 0.01);
        assert_eq!((&*odometry.header.frame_id, &*odometry.child_frame_id), ("odom", "base_link"));
    }

    #[test]
    fn odometry_has_the_rate_of_the_commands_unless_another_one_is_set() {
        // Of states at 125 Hz.
        let published = |settings: &[(&str, SettingValue)], at: f64| {
            let (mut core, clock) = core_at_zero();
            add(&mut core, settings).unwrap();
            let odom = Collector::<Odometry>::add(&mut core, "odom");
            let states = core.inlet("joint_states").unwrap();
            let mut count = 0;
            for number in 0..250 {
                clock.advance(Duration::from_millis(8));
                let position = vec![f64::from(number) * 0.016, f64::from(number) * 0.016];
                let (name, header) = (vec!["left".into(), "right".into()], header(clock.now(), ""));
                states.publish(JointState { header, name, position, ..JointState::default() }).unwrap();
                (0..3).for_each(|_| core.cycle().unwrap());
                let heard = odom.take();
                count += heard.len();
                if let Some(odometry) = heard.last().filter(|_| number > 10) {
                    // 2 rad/s of wheels with a radius of 5 cm.
                    assert!((odometry.twist.twist.linear.x - 0.1).abs() < 1e-9, "{number}");
                    assert!((odometry.pose.pose.position.x - f64::from(number) * 0.0008).abs() < 1e-9);
                }
            }
            assert!((count as f64 - 2.0 * at).abs() < 3.0, "{count} in 2 s, expected {at} a second");
        };
        published(&[], 50.0);
        published(&[("rate_hz", 20.0.into())], 20.0);
        published(&[("publish_rate", 10.0.into())], 10.0);
        published(&[("publish_rate", 0.0.into())], 125.0);
        published(&[("publish_rate", 1000.0.into())], 125.0);
    }

    #[test]
    fn the_base_stops_when_commands_stop() {
        let mut base = Base::new();
        base.drive(Some((0.5, 0.0)), 50);
        let still_moving = base.drive(None, 20);
        assert!(still_moving.twist.twist.linear.x > 0.4, "0.4 s after the last command");
        assert_eq!(base.drive(None, 40).twist.twist.linear.x, 0.0);
    }

    #[test]
    fn a_stamped_command_that_is_older_or_newer_than_its_time_out_does_not_drive() {
        let (mut core, clock) = core_at_zero();
        add(&mut core, &[("use_stamped_vel", true.into())]).unwrap();
        let commands = Collector::<JointState>::add(&mut core, "joint_commands");
        let twists = core.inlet("cmd_vel").unwrap();
        let mut drive = |offset_ms: Option<i64>| {
            let mut fastest: f64 = 0.0;
            for _ in 0..50 {
                let mut twist = TwistStamped::default();
                twist.twist.linear.x = 0.5;
                if let Some(offset) = offset_ms {
                    let stamp = clock.now().as_nanos() + offset * 1_000_000;
                    twist.header.stamp = downbeat_msgs::builtin_interfaces::msg::Time::from_nanos(stamp);
                }
                twists.publish(twist).unwrap();
                clock.advance(Duration::from_millis(20));
                (0..2).for_each(|_| core.cycle().unwrap());
                let speeds = commands.take().into_iter().map(|command| command.velocity[0]);
                fastest = speeds.fold(fastest, f64::max);
            }
            // Until it has stopped.
            for _ in 0..100 {
                clock.advance(Duration::from_millis(20));
                (0..2).for_each(|_| core.cycle().unwrap());
                commands.take();
            }
            fastest
        };
        assert!(drive(Some(0)) > 1.0);
        assert_eq!(drive(Some(-10_000)), 0.0, "10 s old");
        assert_eq!(drive(Some(10_000)), 0.0, "10 s in the future");
        assert!(drive(Some(-300)) > 1.0 && drive(Some(300)) > 1.0, "within the time-out");
        assert!(drive(None) > 1.0, "a stamp of 0 is now");
    }

    #[test]
    fn commands_are_limited_in_velocity_and_acceleration() {
        let mut base = Base::new();
        let first = base.drive(Some((50.0, 0.0)), 1);
        assert_eq!(first.twist.twist.linear.x, 0.0, "the first state has nothing before it");
        let after_a_second = base.drive(Some((50.0, f64::NAN)), 2);
        assert_eq!(after_a_second.pose.pose.orientation.z, 0.0);
        let (mut core, _) = core_at_zero();
        for (setting, value) in [("wheel_radius", 0.0), ("wheel_separation", f64::NAN)] {
            let refused = add(&mut core, &[(setting, value.into())]).unwrap_err().to_string();
            assert!(refused.contains(setting) && refused.contains("greater than 0"), "{refused}");
        }
    }

    #[test]
    fn both_sides_need_as_many_wheels() {
        let wheels: SettingValue = vec!["right".to_owned(), "rear_right".to_owned()].into();
        let refused = add(&mut core_at_zero().0, &[("right_wheel_names", wheels)]).unwrap_err().to_string();
        assert!(refused.contains("1 wheels are on the left and 2 on the right"), "{refused}");
    }
}
