//! Head control: searches for the ball, follows it, or looks ahead.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `head/mode` (in) | `std_msgs/String` | `search`, `track` or `ahead`; anything else is refused |
//! | `pose` (in) | `geometry_msgs/PoseWithCovarianceStamped` | of `base_link` in `map` |
//! | `ball` (in) | `soccer_model_msgs/Ball` | in `map` |
//! | `head/joint_commands` | `sensor_msgs/JointState` | `head_pan` and `head_tilt`, every 40 ms |
//!
//! The search sweeps from side to side, first far away and then near the feet. With `track`, the head follows
//! the ball as long as ball and pose are younger than a second, and searches otherwise. The topic must be
//! among the `sources` of `joint_command_mux`.
//!
//! | setting | |
//! | --- | --- |
//! | `speed` | largest speed of a joint, rad/s |
//! | `sweep` | how far the search pans to each side, rad |
//! | `sweep_s` | duration of a sweep there and back, s |
//! | `height` | of `base_link` above the floor, m |
//! | `glances` | whether it looks up from the ball now and then, ahead and to both sides in turn, for nothing at the feet tells a robot that sees where it is; rarely from a ball that it is about to kick |

use crate::beliefs::Beliefs;
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError};
use downbeat_football::soccer_model_msgs::msg::Ball;
use downbeat_kinematics::darwin_op::Head as HeadKinematics;
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::geometry_msgs::msg::PoseWithCovarianceStamped;
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::std_msgs::msg::{Header, String as Text};
use glam::DVec2;
use std::f64::consts::TAU;
use std::time::Duration;

/// Controls the head; see the [module page](self).
#[derive(Debug, Default)]
pub struct Head {
    mode: Mode,
    beliefs: Beliefs,
    /// Pan and tilt, in rad.
    angles: DVec2,
    /// The duration of the current search, in s.
    searched: f64,
    /// For how long the ball is followed, in s.
    tracked: f64,
}

/// The keys of [`Head`].
pub struct Ports {
    commands: Publication<JointState>,
    speed: Setting<f64>,
    sweep: Setting<f64>,
    sweep_s: Setting<f64>,
    height: Setting<f64>,
    glances: Setting<bool>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Mode {
    #[default]
    Search,
    Track,
    Ahead,
}

const PERIOD: Duration = Duration::from_millis(40);
/// The tilts of the search, in rad; at 0 the camera looks down by 40 degrees.
const TILTS: [f64; 2] = [0.45, 0.0];
/// The tilt with a view over the field, in rad.
const AHEAD_TILT: f64 = 0.5;
/// From one glance to the next, and how long it lasts, in s; and where it goes, in rad to the left.
const GLANCE_PERIOD: f64 = 3.8;
const GLANCE: f64 = 0.8;
const GLANCE_PANS: [f64; 3] = [0.0, 0.6, -0.6];
/// Nearer than this a ball is about to be kicked, in m: only one of so many glances is made.
const NEAR: f64 = 0.4;
const NEAR_RARER: usize = 4;
/// The forward lean of the trunk while the robot stands or walks, in rad.
const LEAN: f64 = 0.2;
/// Half the diameter of a ball, in m.
const BALL_HEIGHT: f64 = 0.05;

impl Head {
    fn turn(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let seen = self.beliefs.place(now).zip(self.beliefs.ball(now));
        self.tracked += PERIOD.as_secs_f64();
        let is_near = seen.is_some_and(|(place, ball)| place.position.distance(ball) < NEAR);
        let glance = self.glance(is_near).filter(|_| *ctx.get(ctx.ports.glances));
        let wanted = match (self.mode, seen) {
            (Mode::Ahead, _) => DVec2::new(0.0, AHEAD_TILT),
            (Mode::Track, Some(_)) if let Some(pan) = glance => DVec2::new(pan, AHEAD_TILT),
            (Mode::Track, Some((place, ball))) => {
                let ball = place.point(ball);
                let below = BALL_HEIGHT - *ctx.get(ctx.ports.height);
                let level = ball.extend(below);
                let look = HeadKinematics.look_at(glam::DQuat::from_rotation_y(-LEAN) * level);
                DVec2::new(look.pan, look.tilt)
            }
            (Mode::Search | Mode::Track, _) => {
                self.tracked = 0.0;
                let sweeps = self.searched / *ctx.get(ctx.ports.sweep_s);
                let tilt = if sweeps.fract() < 0.5 { TILTS[0] } else { TILTS[1] };
                self.searched += PERIOD.as_secs_f64();
                DVec2::new(*ctx.get(ctx.ports.sweep) * libm::sin(TAU * sweeps), tilt)
            }
        };
        let step = DVec2::splat(*ctx.get(ctx.ports.speed) * PERIOD.as_secs_f64());
        self.angles += (wanted - self.angles).clamp(-step, step);
        let stamp = builtin_interfaces::msg::Time::from_nanos(now.as_nanos());
        let command = JointState {
            header: Header { stamp, frame_id: String::new() },
            name: vec!["head_pan".to_owned(), "head_tilt".to_owned()],
            position: self.angles.to_array().into(),
            ..JointState::default()
        };
        ctx.publish(ctx.ports.commands, command);
    }

    /// Where the head looks while it does not follow the ball, in rad.
    fn glance(&self, is_near: bool) -> Option<f64> {
        let glances = self.tracked / GLANCE_PERIOD;
        let is_glance = glances.fract() * GLANCE_PERIOD >= GLANCE_PERIOD - GLANCE;
        let number = glances as usize;
        let is_left_out = is_near && !number.is_multiple_of(NEAR_RARER);
        (is_glance && !is_left_out).then(|| GLANCE_PANS[number % GLANCE_PANS.len()])
    }
}

impl Module for Head {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.subscribe("head/mode", |head: &mut Self, mode: Received<'_, Text>, _| {
            let mode = match mode.data.as_str() {
                "search" => Mode::Search,
                "track" => Mode::Track,
                "ahead" => Mode::Ahead,
                other => {
                    return tracing::warn!("{other:?} is not a mode of the head: use search, track or ahead");
                }
            };
            if head.mode != mode {
                (head.mode, head.searched) = (mode, 0.0);
            }
        })?;
        setup.subscribe("pose", |head: &mut Self, pose: Received<'_, PoseWithCovarianceStamped>, ctx| {
            head.beliefs.take_pose(&pose, ctx.now());
        })?;
        setup.subscribe("ball", |head: &mut Self, ball: Received<'_, Ball>, ctx| {
            head.searched = 0.0;
            head.beliefs.take_ball(&ball, ctx.now());
        })?;
        setup.every(PERIOD, Self::turn)?;
        Ok(Ports {
            commands: setup.publish("head/joint_commands")?,
            speed: setup.setting_in("speed", 3.0, 0.1..=10.0, "rad/s; largest speed of a joint")?,
            sweep: setup.setting_in("sweep", 1.3, 0.1..=2.3, "rad; how far the search pans to each side")?,
            sweep_s: setup.setting_in("sweep_s", 4.0, 0.5..=60.0, "s; a sweep there and back")?,
            height: setup.setting_in("height", 0.29, 0.1..=1.0, "m; base_link above the floor")?,
            glances: setup.setting("glances", false, "whether it looks up from the ball now and then")?,
        })
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}
