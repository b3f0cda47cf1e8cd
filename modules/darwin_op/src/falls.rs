//! Detects falls, lets the robot go limp while it falls, and gets it up again.
//!
//! | name | type | |
//! | --- | --- | --- |
//! | `imu/data` (in) | `sensor_msgs/Imu` | with orientation, as from `downbeat-imu-filter` |
//! | `joint_states` (in) | `sensor_msgs/JointState` | the pose that a limp robot keeps |
//! | `robot_state` | `std_msgs/String` | a constant of [`RobotState`]; when it changes and once a second |
//! | `falls/joint_commands` | `sensor_msgs/JointState` | commands for all joints while the robot falls |
//! | `motions/stop` | `std_msgs/Empty` | when the robot falls |
//! | `play_motion` | action `downbeat_interfaces/PlayMotion`, used | `get_up_front`, `get_up_back` also from the right side, `get_up_left` |
//!
//! A robot that tilts by more than `tilt_limit` falls. Its joints are then commanded to where they are, so
//! that the servos hold with nothing but friction. When it has lain still for `still_s`, it plays the motion
//! for the side on which it lies, up to `attempts` times in a row; from back and sides it may first roll on
//! its front, in turn over one side and over the other, and gets up from there at once. After the last
//! attempt it is helpless, until somebody puts it on its feet. Modules that walk pause while the state is not
//! `upright`.
//!
//! | setting | |
//! | --- | --- |
//! | `tilt_limit` | angle between the trunk and the vertical from which the robot falls, rad |
//! | `still_rate` | largest rate of the gyroscope while the robot lies still, rad/s |
//! | `still_s` | for how long it must lie still, s |
//! | `get_up` | whether it gets up by itself |
//! | `attempts` | how often it tries |
//! | `humanoid` | file of the robot's numbers; empty for the Darwin OP: see [`humanoid`](crate::humanoid) |

use crate::attitude::world_from_trunk;
use crate::humanoid::Humanoid;
use crate::present_pose::{PresentPose, command};
use downbeat_actions::{ActionClient, GoalStatus};
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_msgs::downbeat_interfaces::action::{PlayMotion, PlayMotionGoal};
use downbeat_msgs::downbeat_interfaces::msg::RobotState;
use downbeat_msgs::sensor_msgs::msg::{Imu, JointState};
use downbeat_msgs::std_msgs::msg::{Empty, String as Text};
use glam::DVec3;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

/// Detects falls and gets the robot up; see the [module page](self).
#[derive(Debug, Default)]
pub struct Falls {
    state: State,
    is_tilted: bool,
    /// Up in the frame of the trunk.
    up: DVec3,
    /// Whether the motion that plays rolls the robot on its front.
    is_rolling: bool,
    attempts: i64,
    pose: PresentPose,
    get_ups: ActionClient<PlayMotion>,
    /// When `robot_state` is published next.
    report_at: Time,
}

/// The keys of [`Falls`].
pub struct Ports {
    robot_state: Publication<Text>,
    commands: Publication<JointState>,
    stop_motion: Publication<Empty>,
    tilt_limit: Setting<f64>,
    still_rate: Setting<f64>,
    still_s: Setting<f64>,
    get_up: Setting<bool>,
    attempts: Setting<i64>,
}

/// What the robot does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    /// It stands, walks, sits or plays a motion.
    #[default]
    Upright,
    /// It falls or has not come to rest yet.
    Falling {
        still_since: Option<Time>,
    },
    /// It lies and does not get up by itself.
    Fallen,
    GettingUp,
    /// All attempts failed.
    Helpless,
}

/// The side on which a robot lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Front,
    Back,
    Left,
    Right,
}

const REPORT: Duration = Duration::from_secs(1);

impl Falls {
    fn on_imu(&mut self, imu: Received<'_, Imu>, ctx: &mut Context<'_, Ports>) {
        let Some(up) = world_from_trunk(&imu).map(|rotation| rotation.conjugate() * DVec3::Z) else { return };
        let now = ctx.now();
        let tilt_limit = *ctx.get(ctx.ports.tilt_limit);
        let is_tilted = up.z < libm::cos(tilt_limit);
        (self.is_tilted, self.up) = (is_tilted, up);
        let rate = &imu.angular_velocity;
        let is_still = DVec3::new(rate.x, rate.y, rate.z).length() <= *ctx.get(ctx.ports.still_rate);
        match self.state {
            State::Upright if is_tilted => {
                tracing::warn!("the robot falls, its trunk is tilted by {:.0} degrees", tilt_degrees(up));
                self.attempts = 0;
                ctx.publish(ctx.ports.stop_motion, Empty::default());
                self.enter(State::Falling { still_since: None }, ctx);
            }
            State::Falling { still_since } => {
                let since = still_since.filter(|_| is_still).unwrap_or(now);
                self.state = State::Falling { still_since: is_still.then_some(since) };
                let is_at_rest = is_still
                    && now.saturating_since(since) >= Duration::from_secs_f64(*ctx.get(ctx.ports.still_s));
                if is_at_rest && !is_tilted {
                    self.stand(ctx);
                } else if is_at_rest {
                    self.get_up(ctx);
                }
            }
            State::Fallen | State::Helpless if !is_tilted => self.stand(ctx),
            State::Upright | State::Fallen | State::GettingUp | State::Helpless => {}
        }
        if now >= self.report_at {
            self.report(ctx);
        }
    }

    fn on_joint_states(&mut self, states: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        self.pose.take_states(&states);
        if matches!(self.state, State::Falling { .. }) {
            let limp = self.pose.measured_or_stand();
            let message = command(ctx.now(), self.pose.joints(), &limp, |_| true);
            ctx.publish(ctx.ports.commands, message);
        }
    }

    fn get_up(&mut self, ctx: &mut Context<'_, Ports>) {
        let side = Side::facing_down(self.up);
        if !ctx.get(ctx.ports.get_up) {
            tracing::info!("the robot lies on its {side}; setting \"get_up\" is off");
            return self.enter(State::Fallen, ctx);
        }
        if self.attempts >= *ctx.get(ctx.ports.attempts) {
            tracing::error!("the robot lies on its {side} and cannot get up; put it on its feet");
            return self.enter(State::Helpless, ctx);
        }
        self.attempts += 1;
        self.is_rolling = side != Side::Front;
        // Whatever is in the way of a roll may be so again: the next one goes to the other side.
        let swaps = self.attempts % 2 == 0;
        let name = match side {
            Side::Front => "get_up_front",
            Side::Back | Side::Right if !swaps => "get_up_back",
            Side::Left if swaps => "get_up_back",
            Side::Back | Side::Right | Side::Left => "get_up_left",
        };
        tracing::info!("the robot lies on its {side} and plays \"{name}\", attempt {}", self.attempts);
        self.get_ups.send(ctx, PlayMotionGoal { name: name.to_owned() });
        self.enter(State::GettingUp, ctx);
    }

    /// A motion has ended, or never began: the tilt decides what follows. A robot that has rolled on its
    /// front gets up at once.
    fn on_end(&mut self, problem: Option<String>, ctx: &mut Context<'_, Ports>) {
        if let Some(problem) = problem {
            tracing::warn!("the motion to get up was not played: {problem}");
        }
        let has_rolled = self.is_rolling && Side::facing_down(self.up) == Side::Front;
        match (self.state, self.is_tilted) {
            (State::GettingUp, true) if has_rolled => self.get_up(ctx),
            (State::GettingUp, true) => self.enter(State::Falling { still_since: None }, ctx),
            (State::GettingUp, false) => self.stand(ctx),
            _ => {}
        }
    }

    fn stand(&mut self, ctx: &mut Context<'_, Ports>) {
        tracing::info!("the robot is upright");
        self.enter(State::Upright, ctx);
    }

    fn enter(&mut self, state: State, ctx: &mut Context<'_, Ports>) {
        self.state = state;
        self.report(ctx);
    }

    fn report(&mut self, ctx: &mut Context<'_, Ports>) {
        self.report_at = ctx.now() + REPORT;
        ctx.publish(ctx.ports.robot_state, Text { data: self.state.to_string() });
    }
}

impl Module for Falls {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let ports = Ports {
            robot_state: setup.publish("robot_state")?,
            commands: setup.publish("falls/joint_commands")?,
            stop_motion: setup.publish("motions/stop")?,
            tilt_limit: setup.setting_in(
                "tilt_limit",
                0.8,
                0.2..=1.5,
                "rad; angle between the trunk and the vertical from which the robot falls",
            )?,
            still_rate: setup.setting_in(
                "still_rate",
                0.3,
                0.01..=10.0,
                "rad/s; largest rate of the gyroscope while the robot lies still",
            )?,
            still_s: setup.setting_in("still_s", 0.5, 0.0..=60.0, "s; how long it must lie still")?,
            get_up: setup.setting("get_up", true, "whether the robot gets up by itself")?,
            attempts: setup.setting_in("attempts", 5, 1.0..=100.0, "how often it tries to get up")?,
        };
        self.pose = PresentPose::new(Arc::clone(Humanoid::declare(setup)?.joints()));
        setup.subscribe("imu/data", Self::on_imu)?;
        setup.subscribe("joint_states", Self::on_joint_states)?;
        ActionClient::builder(|falls: &mut Self| &mut falls.get_ups)
            .on_response(|falls, _, response, ctx| {
                if let Err(refused) = response {
                    falls.on_end(Some(refused.to_string()), ctx);
                }
            })
            .on_result(|falls, _, end, ctx| {
                let problem = match end {
                    Ok(end) if end.status == GoalStatus::Succeeded => None,
                    Ok(end) => Some(end.result.message),
                    Err(error) => Some(error.to_string()),
                };
                falls.on_end(problem, ctx);
            })
            .declare(setup, "play_motion", &mut self.get_ups)?;
        Ok(ports)
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

impl Side {
    /// The side that faces down, from where up is in the frame of the trunk.
    fn facing_down(up: DVec3) -> Self {
        match (up.x.abs() >= up.y.abs(), up.x < 0.0, up.y < 0.0) {
            (true, true, _) => Self::Front,
            (true, false, _) => Self::Back,
            (false, _, true) => Self::Left,
            (false, _, false) => Self::Right,
        }
    }
}

impl fmt::Display for Side {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Front => "front",
            Self::Back => "back",
            Self::Left => "left side",
            Self::Right => "right side",
        })
    }
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Upright => RobotState::UPRIGHT,
            Self::Falling { .. } => RobotState::FALLING,
            Self::Fallen => RobotState::FALLEN,
            Self::GettingUp => RobotState::GETTING_UP,
            Self::Helpless => RobotState::HELPLESS,
        })
    }
}

fn tilt_degrees(up: DVec3) -> f64 {
    libm::acos(up.z.clamp(-1.0, 1.0)).to_degrees()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::motions::MotionPlayer;
    use downbeat_executor::{Heard, Probe};
    use downbeat_msgs::geometry_msgs::msg::{Quaternion, Vector3};
    use glam::DQuat;

    struct Robot {
        probe: Probe,
        robot_state: Heard<Text>,
        playing: Heard<Text>,
        limp: Heard<JointState>,
    }

    impl Robot {
        fn new() -> Self {
            let mut probe = Probe::new();
            let robot_state = probe.listen("robot_state").unwrap();
            let playing = probe.listen("motions/playing").unwrap();
            let limp = probe.listen("falls/joint_commands").unwrap();
            probe.add("falls", Falls::default()).unwrap();
            probe.add("motions", MotionPlayer::default()).unwrap();
            Self { probe, robot_state, playing, limp }
        }

        /// Holds an orientation and a rate for a time in ms.
        fn hold(&mut self, orientation: DQuat, rate: f64, ms: u64) {
            for _ in 0..ms / 8 {
                self.probe.advance(Duration::from_millis(8)).unwrap();
                let (q, w) = (orientation, Vector3 { x: rate, y: 0.0, z: 0.0 });
                let orientation = Quaternion { x: q.x, y: q.y, z: q.z, w: q.w };
                let imu = Imu { orientation, angular_velocity: w, ..Imu::default() };
                self.probe.publish("imu/data", imu).unwrap();
                self.probe
                    .publish(
                        "joint_states",
                        command(Time::ZERO, Humanoid::darwin_op().joints(), &[0.25; 20], |_| true),
                    )
                    .unwrap();
            }
        }

        fn states(&self) -> Vec<String> {
            without_repeats(self.robot_state.take())
        }

        fn played(&self) -> Vec<String> {
            without_repeats(self.playing.take())
        }
    }

    fn without_repeats(texts: Vec<Text>) -> Vec<String> {
        let mut texts: Vec<String> = texts.into_iter().map(|text| text.data).collect();
        texts.dedup();
        texts
    }

    fn pitched(degrees: f64) -> DQuat {
        DQuat::from_rotation_y(degrees.to_radians())
    }

    #[test]
    fn a_robot_on_its_front_gets_up_when_it_lies_still() {
        let mut robot = Robot::new();
        robot.hold(pitched(20.0), 0.0, 1000);
        assert_eq!((robot.states(), robot.limp.take().len()), (vec!["upright".to_owned()], 0));
        robot.hold(pitched(60.0), 3.0, 800);
        assert_eq!(robot.states(), ["falling"]);
        let limp = robot.limp.take();
        assert!(limp.len() > 90 && limp[0].position == [0.25; 20], "its goals are where its joints are");
        robot.hold(pitched(85.0), 0.1, 700);
        assert_eq!(robot.states(), ["falling", "getting_up"]);
        assert_eq!(robot.played(), ["", "get_up_front"]);
        robot.hold(pitched(10.0), 0.1, 30_000);
        assert_eq!(robot.states(), ["getting_up", "upright"]);
    }

    #[test]
    fn the_side_that_faces_down_decides_how_it_gets_up() {
        let rolled = |degrees: f64| DQuat::from_rotation_x(f64::to_radians(degrees));
        let cases =
            [(pitched(-90.0), "get_up_back"), (rolled(-90.0), "get_up_left"), (rolled(90.0), "get_up_back")];
        for (orientation, motion) in cases {
            let mut robot = Robot::new();
            robot.hold(orientation, 0.0, 700);
            assert_eq!(robot.played(), ["", motion]);
        }
    }

    #[test]
    fn a_robot_that_has_rolled_on_its_front_gets_up_at_once() {
        let mut robot = Robot::new();
        robot.hold(pitched(-90.0), 0.0, 1500);
        assert_eq!(robot.played(), ["", "get_up_back"]);
        // It still rocks.
        robot.hold(pitched(90.0), 1.0, 3000);
        assert_eq!(robot.played(), ["get_up_back", "", "get_up_front"]);
        robot.hold(pitched(0.0), 0.0, 10_000);
        assert_eq!(robot.states().last().unwrap(), "upright");
    }

    #[test]
    fn after_several_attempts_it_is_helpless_until_it_is_put_on_its_feet() {
        let mut robot = Robot::new();
        robot.hold(pitched(90.0), 0.0, 150_000);
        assert_eq!(robot.states().last().unwrap(), "helpless");
        let attempts = robot.played().iter().filter(|name| *name == "get_up_front").count();
        assert_eq!(attempts, 5);
        robot.hold(pitched(0.0), 0.0, 100);
        assert_eq!(robot.states().last().unwrap(), "upright");
    }

    #[test]
    fn data_without_orientation_is_ignored() {
        let mut robot = Robot::new();
        let mut imu = Imu::default();
        imu.orientation_covariance[0] = -1.0;
        robot.probe.publish("imu/data", imu).unwrap();
        assert_eq!(robot.states(), Vec::<String>::new());
    }
}
