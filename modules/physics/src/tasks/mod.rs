//! What a robot has to be able to do: stand, walk, turn, step sideways, stop, take a push, get up, kick. Each
//! task is a run in simulated time that succeeds or fails.
//!
//! `cargo xtask physics` runs all tasks in worlds that [`Variation::of_seed`] perturbs and prints how many
//! succeed.
//!
//! ```
//! use downbeat_physics::tasks::{Conditions, Task};
//!
//! let stopped = Task::Stop.run(Conditions::described(1))?;
//! assert!(stopped.figure < 0.3, "it needs {} m to stop", stopped.figure);
//! # Ok::<(), downbeat_physics::tasks::Failure>(())
//! ```

mod robot;

pub use robot::{Place, WalkingRobot};

use crate::error::SimulationError;
use crate::harness::SimulatedRunError;
use crate::scenery::Ball;
use crate::simulation::SimulationOptions;
use crate::world::{Posture, Variation};
use downbeat_executor::{InletError, SettingValue, SetupError};
use downbeat_msgs::downbeat_interfaces::msg::RobotState;
use downbeat_servos::servo_emulator::Random;
use glam::DVec2;
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::fmt;
use std::time::Duration;

/// Something that a robot has to be able to do. Tasks with two sides take the left one for odd seeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// Stands for 60 s.
    Stand,
    /// Walks 10 m straight ahead after it has stood for ten seconds, and stops.
    Walk,
    /// Walks 2 m backward, and stops.
    Backward,
    /// Steps 1 m to a side.
    SideStep,
    /// Walks 1 m ahead and to a side at once.
    Diagonal,
    /// Turns by 180 degrees on the spot.
    Turn,
    /// Turns by 360 degrees while it walks.
    Curve,
    /// Stops while it walks at full speed.
    Stop,
    /// Stays on its feet when its trunk is pushed with 0.5 N s, from all four sides.
    Push,
    /// Gets up from its front and walks.
    GetUpFront,
    /// Gets up from its back and walks.
    GetUpBack,
    /// Is pushed over while it walks, from a side that the seed tells, gets up and walks.
    Fall,
    /// Kicks a ball 1 m far and stays on its feet.
    Kick,
    /// Kicks a ball 1 m far while it walks, at most 1.5 s after it was told to, and stays on its feet.
    WalkingKick,
    /// Kicks while it walks where no ball is, and walks on.
    MissedKick,
}

/// In which world a task is done, and by which robot.
#[derive(Clone, Debug)]
pub struct Conditions {
    /// The robot and its world.
    pub simulation: SimulationOptions,
    /// Of the noise of the sensors; chooses the side of tasks with two sides.
    pub seed: u64,
    /// The file of motions; empty for the built-in motions.
    pub motions: String,
    /// Settings of the gait other than its defaults.
    pub gait: BTreeMap<String, SettingValue>,
}

/// A task that was done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Success {
    /// How well, in [`Task::unit`].
    pub figure: f64,
    /// How often the robot tried to get up.
    pub attempts: usize,
}

/// Why a task was not done.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The robot fell.
    #[error("fell after {after:.1} s")]
    Fell {
        /// Since the start, in s.
        after: f64,
    },
    /// The robot did not get as far as it should.
    #[error("{found:.2} instead of {wanted:.2} {unit}")]
    Short {
        /// How far it got.
        found: f64,
        /// How far it should have got.
        wanted: f64,
        /// The unit of both.
        unit: &'static str,
    },
    /// The robot left its way.
    #[error("is {aside:.2} m and {turned:.2} rad off its way")]
    Strayed {
        /// In m.
        aside: f64,
        /// In rad.
        turned: f64,
    },
    /// The robot moved when it should have stood.
    #[error("moves by {moved:.3} m when it should stand")]
    Moves {
        /// In m.
        moved: f64,
    },
    /// The robot did not get up.
    #[error("lies after {attempts} attempts to get up")]
    Lies {
        /// How often it tried.
        attempts: usize,
    },
    /// The robot cannot be simulated.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// A module cannot join.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The core cannot run.
    #[error(transparent)]
    Run(#[from] SimulatedRunError),
    /// The core does not take messages.
    #[error(transparent)]
    Inlet(#[from] InletError),
}

/// The largest distance from a straight way: in m, and beside that as a share of the way.
const WIDEST: [f64; 2] = [0.2, 0.1];
/// The largest angle by which a robot turns on a straight way, in rad.
const MOST_TURNED: f64 = 0.3;
/// How long a robot stands before a long walk, in s: its IMU filter learns the bias of the gyroscope from
/// that.
const RESTS: f64 = 10.0;
/// The way from the ball to the robot's feet, in m.
const BALL_AHEAD: f64 = 0.11;
const BALL_FAR_AHEAD: f64 = 0.35;
/// How far the ball is ahead when the walking robot is told to kick it, in m.
const KICKING_DISTANCE: f64 = 0.112;
/// How long a robot may take to get up, in s.
const PATIENCE: f64 = 60.0;

impl Task {
    /// All tasks.
    pub const ALL: [Self; 15] = [
        Self::Stand,
        Self::Walk,
        Self::Backward,
        Self::SideStep,
        Self::Diagonal,
        Self::Turn,
        Self::Curve,
        Self::Stop,
        Self::Push,
        Self::GetUpFront,
        Self::GetUpBack,
        Self::Fall,
        Self::Kick,
        Self::WalkingKick,
        Self::MissedKick,
    ];

    /// Its name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Stand => "stand",
            Self::Walk => "walk",
            Self::Backward => "backward",
            Self::SideStep => "side_step",
            Self::Diagonal => "diagonal",
            Self::Turn => "turn",
            Self::Curve => "curve",
            Self::Stop => "stop",
            Self::Push => "push",
            Self::GetUpFront => "get_up_front",
            Self::GetUpBack => "get_up_back",
            Self::Fall => "fall",
            Self::Kick => "kick",
            Self::WalkingKick => "walking_kick",
            Self::MissedKick => "missed_kick",
        }
    }

    /// The unit of [`Success::figure`], and what the figure is.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::Stand => "m moved",
            Self::Walk | Self::Backward | Self::SideStep | Self::Diagonal => "m/s",
            Self::Turn | Self::Curve => "rad/s",
            Self::Stop => "m to stop",
            Self::Push => "rad tilted",
            Self::GetUpFront | Self::GetUpBack | Self::Fall => "s",
            Self::Kick | Self::WalkingKick => "m",
            Self::MissedKick => "m walked",
        }
    }

    /// Runs the task.
    ///
    /// # Errors
    /// Why it was not done.
    pub fn run(self, mut conditions: Conditions) -> Result<Success, Failure> {
        let side = if conditions.seed.is_multiple_of(2) { -1.0 } else { 1.0 };
        let simulation = &mut conditions.simulation;
        match self {
            Self::GetUpFront => simulation.start.posture = Posture::Prone,
            Self::GetUpBack => simulation.start.posture = Posture::Supine,
            Self::Kick | Self::WalkingKick => {
                let ahead = if self == Self::Kick { BALL_AHEAD } else { BALL_FAR_AHEAD };
                let ball = Ball { position: [ahead, 0.045 * side], ..Ball::default() };
                simulation.world.ball = Some(ball);
            }
            _ => {}
        }
        let seed = conditions.seed;
        let mut robot = WalkingRobot::new(conditions)?;
        let (figure, attempts) = match self {
            Self::Stand => (stand(&mut robot)?, 0),
            Self::Walk => {
                robot.run(RESTS)?;
                (straight(&mut robot, [0.235, 0.0], 10.0, 0.2)?, 0)
            }
            Self::Backward => (straight(&mut robot, [-0.11, 0.0], 2.0, 0.08)?, 0),
            Self::SideStep => (straight(&mut robot, [0.0, 0.065 * side], 1.0, 0.05)?, 0),
            Self::Diagonal => (straight(&mut robot, [0.07, 0.04 * side], 1.0, 0.05)?, 0),
            Self::Turn => (turn(&mut robot, [0.0, 0.6 * side], PI)?, 0),
            Self::Curve => (turn(&mut robot, [0.1, 0.4 * side], 2.0 * PI)?, 0),
            Self::Stop => (stop(&mut robot)?, 0),
            Self::Push => (push(&mut robot, 0.5)?, 0),
            Self::GetUpFront | Self::GetUpBack => get_up(&mut robot)?,
            Self::Fall => {
                fall(&mut robot, seed)?;
                get_up(&mut robot)?
            }
            Self::Kick => (kick(&mut robot, side)?, 0),
            Self::WalkingKick => (walking_kick(&mut robot, side)?, 0),
            Self::MissedKick => (missed_kick(&mut robot, side)?, 0),
        };
        Ok(Success { figure, attempts })
    }
}

impl Conditions {
    /// The Darwin OP and its floor as described.
    #[must_use]
    pub fn described(seed: u64) -> Self {
        Self {
            simulation: SimulationOptions::darwin_op(),
            seed,
            motions: String::new(),
            gait: BTreeMap::new(),
        }
    }

    /// As described, except for [`Variation::of_seed`].
    #[must_use]
    pub fn perturbed(seed: u64) -> Self {
        let mut conditions = Self::described(seed);
        conditions.simulation.variation = Variation::of_seed(seed);
        conditions
    }
}

impl fmt::Display for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl Variation {
    /// A robot and a floor that differ from the description as much as real ones do: masses by up to 5 %,
    /// friction by up to 25 %, strength of the servos by up to 10 %, centre of mass of the trunk by up to 4
    /// mm, free play of the gears by up to 50 %, and a latency of up to 4 ms. Equal for equal seeds.
    #[must_use]
    pub fn of_seed(seed: u64) -> Self {
        let described = Self::default();
        let mut random = Random::new(seed, 1);
        Self {
            mass: 1.0 + random.within(0.05),
            friction: 1.0 + random.within(0.25),
            strength: 1.0 + random.within(0.1),
            centre_of_mass: random.within(0.004),
            backlash: described.backlash * (1.0 + random.within(0.5)),
            latency: Duration::from_secs_f64(random.unit() * 0.004),
        }
    }
}

/// The largest impulse that does not throw the robot over, in N s, in steps of 0.05 up to 5, in a direction
/// in the plane. The robot walks ahead with this velocity in m/s, or stands.
///
/// # Errors
/// If the robot cannot be simulated.
pub fn push_limit(conditions: &Conditions, direction: [f64; 2], walking: f64) -> Result<f64, Failure> {
    let mut limit = 0.0;
    for step in 1..=100 {
        let impulse = f64::from(step) * 0.05;
        let mut robot = WalkingRobot::new(conditions.clone())?;
        match push_while_walking(&mut robot, walking, direction.map(|share| share * impulse)) {
            Ok(()) => limit = impulse,
            Err(Failure::Fell { .. } | Failure::Moves { .. }) => break,
            Err(other) => return Err(other),
        }
    }
    Ok(limit)
}

fn stand(robot: &mut WalkingRobot) -> Result<f64, Failure> {
    let start = robot.place().position;
    robot.run(60.0)?;
    robot.has_not_fallen()?;
    robot.stands_still()?;
    Ok((robot.place().position - start).length())
}

/// Walks a way with a velocity (forward and to the left, in m/s), at this speed or faster, and stops.
fn straight(robot: &mut WalkingRobot, velocity: [f64; 2], way: f64, slowest: f64) -> Result<f64, Failure> {
    let start = robot.place();
    let [forward, left] = velocity;
    let direction = DVec2::from_angle(start.yaw).rotate(DVec2::new(forward, left).normalize_or_zero());
    let moved = |place: Place| (place.position - start.position).truncate();
    let along = |place: Place| moved(place).dot(direction);
    let time = robot.walk_until([forward, left, 0.0], way / slowest, |place| along(place) >= way)?;
    let there = robot.place();
    if along(there) < way {
        return Err(Failure::Short { found: along(there), wanted: way, unit: "m" });
    }
    let aside = direction.perp_dot(moved(there));
    let turned = downbeat_kinematics::wrapped(there.yaw - start.yaw);
    let [widest, share] = WIDEST;
    if aside.abs() > widest + share * way || turned.abs() > MOST_TURNED {
        return Err(Failure::Strayed { aside, turned });
    }
    comes_to_rest(robot)?;
    Ok(way / time)
}

/// Turns by an angle with a velocity (forward in m/s, and to the left in rad/s).
fn turn(robot: &mut WalkingRobot, [forward, rate]: [f64; 2], angle: f64) -> Result<f64, Failure> {
    let start = robot.place();
    let (mut yaw, mut turned) = (start.yaw, 0.0);
    let time = robot.walk_until([forward, 0.0, rate], 5.0 / 3.0 * angle / rate.abs(), |place| {
        turned += downbeat_kinematics::wrapped(place.yaw - yaw) * rate.signum();
        yaw = place.yaw;
        turned >= angle
    })?;
    if turned < angle {
        return Err(Failure::Short { found: turned, wanted: angle, unit: "rad" });
    }
    // A full turn ends where it began, and so does one on the spot.
    let aside = (robot.place().position - start.position).truncate().length();
    if aside > 0.2 {
        return Err(Failure::Strayed { aside, turned });
    }
    comes_to_rest(robot)?;
    Ok(turned / time)
}

fn stop(robot: &mut WalkingRobot) -> Result<f64, Failure> {
    robot.walk_until([0.2, 0.0, 0.0], 5.0, |_| false)?;
    let start = robot.place().position;
    comes_to_rest(robot)?;
    Ok((robot.place().position - start).length())
}

/// Without commands the robot has four seconds to stop.
fn comes_to_rest(robot: &mut WalkingRobot) -> Result<(), Failure> {
    robot.run(4.0)?;
    robot.has_not_fallen()?;
    robot.stands_still()
}

fn push(robot: &mut WalkingRobot, impulse: f64) -> Result<f64, Failure> {
    let mut worst: f64 = 0.0;
    for direction in [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]] {
        worst = worst.max(push_once(robot, direction.map(|share| share * impulse))?);
    }
    Ok(worst)
}

/// The largest change of the tilt after a push.
fn push_once(robot: &mut WalkingRobot, [x, y]: [f64; 2]) -> Result<f64, Failure> {
    let before = robot.tilt();
    let mut worst: f64 = 0.0;
    robot.simulated().push("torso", [x, y, 0.0]);
    for _ in 0..40 {
        robot.run(0.05)?;
        robot.has_not_fallen()?;
        worst = worst.max((robot.tilt() - before).abs());
    }
    robot.stands_still()?;
    Ok(worst)
}

/// The time in which a robot that was pushed comes to rest, in s.
const SETTLES: f64 = 5.0;

/// Walks ahead, is pushed, walks on and stops.
fn push_while_walking(robot: &mut WalkingRobot, velocity: f64, [x, y]: [f64; 2]) -> Result<(), Failure> {
    let walks = if velocity == 0.0 { 0.0 } else { 3.0 };
    robot.walk_until([velocity, 0.0, 0.0], walks, |_| false)?;
    robot.simulated().push("torso", [x, y, 0.0]);
    robot.walk_until([velocity, 0.0, 0.0], walks, |_| false)?;
    robot.run(SETTLES)?;
    robot.has_not_fallen()?;
    robot.stands_still()
}

/// The sides of successive seeds are a golden angle apart, which covers all of them evenly.
fn fall(robot: &mut WalkingRobot, seed: u64) -> Result<(), Failure> {
    const GOLDEN_ANGLE: f64 = 2.399_963;
    const IMPULSE: f64 = 3.0;
    let (y, x) = libm::sincos(seed as f64 * GOLDEN_ANGLE);
    robot.walk_until([0.1, 0.0, 0.0], 3.0, |_| false)?;
    robot.simulated().push("torso", [x * IMPULSE, y * IMPULSE, 0.0]);
    robot.run(1.5)
}

/// From the beginning of the first motion until the robot is upright, in s.
fn get_up(robot: &mut WalkingRobot) -> Result<(f64, usize), Failure> {
    let attempts = |robot: &WalkingRobot| {
        robot.states().iter().filter(|(_, state)| state == RobotState::GETTING_UP).count()
    };
    let is = |robot: &WalkingRobot, what: &str| robot.states().last().is_some_and(|(_, state)| state == what);
    let mut waited = 0.0;
    while attempts(robot) == 0 || !is(robot, RobotState::UPRIGHT) {
        if waited > PATIENCE || is(robot, RobotState::HELPLESS) {
            return Err(Failure::Lies { attempts: attempts(robot) });
        }
        robot.run(0.1)?;
        waited += 0.1;
    }
    let states = robot.states();
    let begun = states.iter().find(|(_, state)| state == RobotState::GETTING_UP);
    let time = begun
        .zip(states.last())
        .map_or(0.0, |((begun, _), (upright, _))| upright.saturating_since(*begun).as_secs_f64());
    let tried = attempts(robot);
    robot.run(3.0)?;
    robot.stands_still()?;
    robot.forget_falls();
    let start = robot.place().position;
    robot.walk_until([0.1, 0.0, 0.0], 5.0, |_| false)?;
    let found = (robot.place().position - start).truncate().length();
    if found < 0.2 { Err(Failure::Short { found, wanted: 0.2, unit: "m" }) } else { Ok((time, tried)) }
}

fn kick(robot: &mut WalkingRobot, side: f64) -> Result<f64, Failure> {
    const WAY: f64 = 1.0;
    let motion = if side > 0.0 { "kick_left" } else { "kick_right" };
    robot.play(motion, 12.0)?;
    robot.has_not_fallen()?;
    robot.stands_still()?;
    let found = ball(robot) - BALL_AHEAD;
    if found < WAY { Err(Failure::Short { found, wanted: WAY, unit: "m" }) } else { Ok(found) }
}

/// How far ahead the ball is, in m.
fn ball(robot: &mut WalkingRobot) -> f64 {
    let things = robot.simulated().snapshot().things;
    let ball = things.iter().find(|(name, ..)| name == "ball");
    ball.map_or(0.0, |(.., ball)| ball.world_from_body.translation.x)
}

fn walking_kick(robot: &mut WalkingRobot, side: f64) -> Result<f64, Failure> {
    const WAY: f64 = 1.0;
    const LATEST: f64 = 1.5;
    const VELOCITY: [f64; 3] = [0.05, 0.0, 0.0];
    const KICKING: [f64; 3] = [0.02, 0.0, 0.0];
    robot.walk_until(VELOCITY, 10.0, |place| BALL_FAR_AHEAD - place.position.x <= KICKING_DISTANCE)?;
    robot.kick(if side > 0.0 { "left" } else { "right" })?;
    robot.walk_until(KICKING, LATEST, |_| false)?;
    let found = ball(robot) - BALL_FAR_AHEAD;
    if found <= 0.01 {
        return Err(Failure::Short { found, wanted: WAY, unit: "m within 1.5 s" });
    }
    comes_to_rest(robot)?;
    robot.run(2.0)?;
    let found = ball(robot) - BALL_FAR_AHEAD;
    if found < WAY { Err(Failure::Short { found, wanted: WAY, unit: "m" }) } else { Ok(found) }
}

fn missed_kick(robot: &mut WalkingRobot, side: f64) -> Result<f64, Failure> {
    const KICKS: f64 = 1.5;
    robot.walk_until([0.05, 0.0, 0.0], 3.0, |_| false)?;
    let from = robot.place().position;
    robot.kick(if side > 0.0 { "left" } else { "right" })?;
    robot.walk_until([0.02, 0.0, 0.0], KICKS, |_| false)?;
    robot.walk_until([0.1, 0.0, 0.75 * side], 4.0, |_| false)?;
    comes_to_rest(robot)?;
    Ok(robot.place().position.distance(from))
}
