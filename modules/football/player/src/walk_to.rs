//! Walks to a place on the field, or lines up behind the ball for a kick.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `walk_to/pose` (in) | `geometry_msgs/PoseStamped` | walk to this pose: in `map`, or relative to the current pose with `base_link` as frame |
//! | `walk_to/kick` (in) | `geometry_msgs/PointStamped` | line up for a kick of the ball towards this point in `map` |
//! | `walk_to/strike` (in) | `geometry_msgs/PointStamped` | line up for a kick of the ball towards this point in `map`, out of the walk |
//! | `walk_to/dribble` (in) | `geometry_msgs/PointStamped` | push the ball towards this point in `map`, walking |
//! | `walk_to/stop` (in) | `std_msgs/Empty` | stop |
//! | `pose` (in) | `geometry_msgs/PoseWithCovarianceStamped` | of `base_link` in `map` |
//! | `ball` (in) | `soccer_model_msgs/Ball` | in `map` |
//! | `robots` (in) | `soccer_model_msgs/RobotArray` | the other robots in `map`, as obstacles for the robot and for a pushed ball |
//! | `walking` (in) | `std_msgs/Bool` | from the gait |
//! | `cmd_vel` | `geometry_msgs/Twist` | every 40 ms while there is a goal |
//! | `walk_to/state` | `std_msgs/String` | a constant of [`WalkState`]; when it changes and once a second |
//!
//! A command holds until the next one.
//!
//! Far from its goal, the robot turns to the goal and walks forward; near the goal, it steps in all
//! directions. It approaches the ball from behind, walking around it if necessary; one that rolls, where it
//! comes to rest.
//!
//! | setting | |
//! | --- | --- |
//! | `forward`, `side`, `turn` | largest commands, m/s and rad/s |
//! | `kick_ahead`, `kick_aside` | position of the ball for a kick: ahead of `base_link`, and to the side of the foot, m |
//! | `kick_reach`, `kick_width`, `kick_angle` | tolerances of the kick, m and rad |
//! | `strike_ahead`, `strike_speed` | position of the ball for a kick out of the walk: ahead of `base_link`, m, and the speed towards it, m/s |
//! | `there_distance`, `there_angle` | tolerances of a place, m and rad |
//! | `field` | name of a built-in field, or path of a file, whose goal posts are obstacles; empty: none are |

use crate::beliefs::{Beliefs, Other, Place, heading_of};
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_football::Field;
use downbeat_football::football_interfaces::msg::WalkState;
use downbeat_football::soccer_model_msgs::msg::{Ball, RobotArray};
use downbeat_kinematics::wrapped;
use downbeat_msgs::geometry_msgs::msg::{PointStamped, PoseStamped, PoseWithCovarianceStamped, Twist};
use downbeat_msgs::std_msgs::msg::{Bool, Empty, String as Text};
use glam::DVec2;
use std::time::Duration;

/// Walks to places; see the [module page](self).
#[derive(Debug, Default)]
pub struct WalkTo {
    goal: Goal,
    beliefs: Beliefs,
    /// When the robot came to a stand; `None` while it walks.
    stands_since: Option<Time>,
    /// When the robot began to stop for a kick.
    stops_since: Option<Time>,
    /// The foot of the next kick: 1 for the left one, -1 for the right one.
    foot: Option<f64>,
    /// True if the robot steps in all directions instead of walking forward.
    steps: bool,
    /// True if the robot is close behind the ball.
    is_closing_in: bool,
    /// Where the ball is to the side, without the sway of the robot, in m.
    aside: Option<f64>,
    /// True if the robot walks straight to a ball that it kicks out of the walk.
    goes_straight: bool,
    /// When the ball was where a walking robot kicks it.
    strikes_since: Option<Time>,
    /// The side on which the robot pushes the ball past another robot: 1 for left, -1 for right.
    passing: Option<f64>,
    reported: Option<(Time, &'static str)>,
    /// The goal posts in `map`.
    posts: Vec<DVec2>,
}

/// The keys of [`WalkTo`].
pub struct Ports {
    cmd_vel: Publication<Twist>,
    state: Publication<Text>,
    settings: SettingKeys,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Goal {
    #[default]
    Nothing,
    Place(Place),
    /// Relative to the robot, until its next pose is known.
    FromHere(Place),
    Kick(DVec2),
    Strike(DVec2),
    Dribble(DVec2),
}

/// An obstacle, relative to the robot, in m.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Obstacle {
    at: DVec2,
    /// The distance to keep from it.
    keep: f64,
}

/// Velocities ahead and to the left in m/s, and turn rate to the left in rad/s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Velocity {
    linear: DVec2,
    turn: f64,
}

const PERIOD: Duration = Duration::from_millis(40);
const REPORT: Duration = Duration::from_secs(1);
/// The factor by which the window of a kick is wider for a standing robot, which no longer sways.
const STANDING_WINDOW: f64 = 1.4;
/// The longest time to stop for a kick.
const PATIENCE: Duration = Duration::from_secs(3);
/// The share of the tolerances of a kick within which a robot walks straight to the ball.
const STRAIGHT: f64 = 1.0;
/// The factor by which the ball may be farther aside before a robot that walks straight to it lines up again.
const STILL_STRAIGHT: f64 = 1.5;
/// How much too near the ball may be for a kick out of the walk, in m.
const TOO_NEAR: f64 = 0.02;
/// The speed of a robot that does no more than step, in m/s.
const ON_THE_SPOT: f64 = 0.02;
/// For how long a walking robot that was told to kick does no more than step: until its foot has swung and it
/// is steady again.
const SWING: Duration = Duration::from_millis(1600);
/// The time for which a robot sways after it has stopped.
const REST: Duration = Duration::from_secs(1);
/// Within the first distance the robot steps in all directions, in m; beyond the second it turns and walks
/// again.
const NEAR: f64 = 0.25;
const NO_LONGER_NEAR: f64 = 0.35;
/// Within this distance, in m, a robot that need not turn by more than this, in rad, steps as well.
const NEAR_FACING: f64 = 0.8;
const FACING: f64 = 0.6;
/// The distance behind the place of a kick at which the approach ends, in m.
const BEHIND: f64 = 0.08;
/// The distance behind the ball at which a push begins, in m.
const PUSH_FROM: f64 = 0.225;
/// The distance that the robot keeps from the ball when it walks around it, in m.
const CLEARANCE: f64 = 0.3;
/// The distances that the robot keeps from other robots, from fallen ones, which need room to get up, and
/// from posts, in m; and the speed at which it backs off from a much nearer obstacle, in m/s, and how fast it
/// turns there at most, in rad/s.
const KEEP_OFF: f64 = 0.35;
const KEEP_OFF_FALLEN: f64 = 0.6;
const KEEP_OFF_POST: f64 = 0.2;
const BACK_OFF: f64 = 0.08;
const TURN_BESIDE: f64 = 0.2;
/// How far the ball has to be on the other side before the foot changes, in m.
const OTHER_FOOT: f64 = 0.05;
/// The same while the robot walks, if it does not matter with which.
const OTHER_FOOT_OF_WALK: f64 = 0.02;
/// Time constant of where the ball is to the side of a robot that walks, in s, and by how much it sways, in
/// m.
const SWAY_SMOOTHING: f64 = 0.4;
const SWAYS: f64 = 0.08;
/// The angle by which the ball is pushed past another robot, in rad.
const PAST: f64 = 0.8;
/// The factor by which another robot has to be farther away before the ball is no longer pushed past it.
const STILL_PASSING: f64 = 1.3;
/// Proportional gains: velocity by distance, and turn rate by angle, in 1/s.
const GAIN: f64 = 1.0;
const TURN_GAIN: f64 = 1.2;

macro_rules! settings {
    ($($name:ident = $default:literal in $range:expr, $about:literal;)*) => {
        #[derive(Clone, Copy)]
        struct SettingKeys { $($name: Setting<f64>,)* }

        #[derive(Clone, Copy, Debug)]
        struct Settings { $($name: f64,)* }

        impl SettingKeys {
            fn declare<M: Module>(setup: &mut Setup<'_, M>) -> Result<Self, SetupError> {
                Ok(Self { $($name: setup.setting_in(stringify!($name), $default, $range, $about)?,)* })
            }

            fn values<P>(&self, ctx: &Context<'_, P>) -> Settings {
                Settings { $($name: *ctx.get(self.$name),)* }
            }
        }

        #[cfg(test)]
        impl Default for Settings {
            fn default() -> Self {
                Self { $($name: $default,)* }
            }
        }
    };
}

settings! {
    forward = 0.2 in 0.01..=0.5, "m/s; largest velocity forward";
    side = 0.08 in 0.01..=0.3, "m/s; largest velocity to the side";
    turn = 0.75 in 0.05..=3.0, "rad/s; largest turn rate";
    kick_ahead = 0.12 in 0.02..=0.4, "m; the ball ahead of base_link for a kick";
    kick_aside = 0.04 in 0.0..=0.2, "m; the ball to the side of the foot for a kick";
    kick_reach = 0.035 in 0.001..=0.2, "m; how far the ball may be off ahead";
    kick_width = 0.033 in 0.001..=0.2, "m; how far the ball may be off to the side";
    kick_angle = 0.25 in 0.01..=1.0, "rad; how far the direction of a kick may be off";
    strike_ahead = 0.125 in 0.02..=0.4, "m; the ball ahead of base_link for a kick out of the walk";
    strike_speed = 0.05 in 0.0..=0.5, "m/s; velocity towards a ball that is kicked out of the walk";
    there_distance = 0.1 in 0.01..=2.0, "m; how far the robot may be off at a place";
    there_angle = 0.2 in 0.01..=3.2, "rad; how far its heading may be off at a place";
}

impl Settings {
    /// Whether the ball is in line for a kick, within a share of the tolerances.
    fn is_beside(&self, off: DVec2, heading: f64, share: f64) -> bool {
        off.y.abs() < self.kick_width * share && heading.abs() < self.kick_angle * share
    }
}

impl WalkTo {
    fn tick(&mut self, ctx: &mut Context<'_, Ports>) {
        let (now, settings) = (ctx.now(), ctx.ports.settings.values(ctx));
        let here = self.beliefs.place(now);
        if let (Goal::FromHere(goal), Some(here)) = (self.goal, here) {
            let position = here.position + DVec2::from_angle(here.heading).rotate(goal.position);
            self.goal = Goal::Place(Place { position, heading: here.heading + goal.heading });
        }
        let robots = here.map_or_else(Vec::new, |here| self.robots_from(here, now));
        let posts = here.map_or_else(Vec::new, |here| self.posts_from(here));
        let obstacles = [robots.as_slice(), &posts].concat();
        let (velocity, state) = match (self.goal, here) {
            (Goal::Nothing, _) => (None, WalkState::IDLE),
            (_, None) | (Goal::FromHere(_), _) => (None, WalkState::BLIND),
            (Goal::Place(goal), Some(here)) => {
                self.walk_to_place(goal.seen_from(here), &obstacles, &settings)
            }
            (Goal::Kick(target) | Goal::Strike(target) | Goal::Dribble(target), Some(here)) => {
                match self.beliefs.ball_for(here.position, now).map(|ball| here.point(ball)) {
                    Some(ball) if matches!(self.goal, Goal::Dribble(_)) => {
                        let target = past(&robots, ball, here.point(target), &mut self.passing);
                        (Some(self.dribble(ball, target, &obstacles, &settings)), WalkState::WALKING)
                    }
                    Some(ball) => self.line_up(ball, here.point(target), &obstacles, now, &settings),
                    None => (None, WalkState::BLIND),
                }
            }
        };
        // A player in possession ignores obstacles behind the ball.
        let is_at_ball = matches!(self.goal, Goal::Kick(_) | Goal::Strike(_) | Goal::Dribble(_));
        let has_ball = self.is_closing_in && is_at_ball;
        let ball = here.zip(self.beliefs.ball(now)).filter(|_| has_ball).map(|(here, ball)| here.point(ball));
        let is_beyond = |at: DVec2| ball.is_some_and(|ball| ball.dot(at) > ball.length_squared());
        // Who steps aside while a foot swings falls.
        let swings = matches!(state, WalkState::STRIKE_LEFT | WalkState::STRIKE_RIGHT);
        let near = obstacles.iter().filter(|obstacle| !swings && !is_beyond(obstacle.at));
        if let Some(Velocity { linear, turn }) = velocity.map(|velocity| keeping_off(velocity, near)) {
            let mut twist = Twist::default();
            (twist.linear.x, twist.linear.y, twist.angular.z) = (linear.x, linear.y, turn);
            ctx.publish(ctx.ports.cmd_vel, twist);
        }
        if self.reported.is_none_or(|(at, last)| last != state || at + REPORT <= now) {
            self.reported = Some((now, state));
            ctx.publish(ctx.ports.state, Text { data: state.to_owned() });
        }
    }

    /// The other robots, relative to this place.
    fn robots_from(&self, here: Place, now: Time) -> Vec<Obstacle> {
        let keep = |robot: &Other| if robot.is_fallen { KEEP_OFF_FALLEN } else { KEEP_OFF };
        let robots = self.beliefs.robots(now).iter();
        robots.map(|robot| Obstacle { at: here.point(robot.position), keep: keep(robot) }).collect()
    }

    /// The goal posts, relative to this place.
    fn posts_from(&self, here: Place) -> Vec<Obstacle> {
        self.posts.iter().map(|post| Obstacle { at: here.point(*post), keep: KEEP_OFF_POST }).collect()
    }

    /// Lines up for a kick; ball and target are relative to the robot.
    fn line_up(
        &mut self,
        ball: DVec2,
        target: DVec2,
        obstacles: &[Obstacle],
        now: Time,
        settings: &Settings,
    ) -> (Option<Velocity>, &'static str) {
        let direction = target - ball;
        let heading = if direction.length() > 1e-3 { direction.to_angle() } else { 0.0 };
        // The ball, relative to the robot with the heading of the kick.
        let mut straight = DVec2::from_angle(-heading).rotate(ball);
        let is_striking = matches!(self.goal, Goal::Strike(_));
        if is_striking {
            straight.y = self.without_sway(straight.y);
        }
        let (other_foot, ahead) = match is_striking {
            true => (OTHER_FOOT_OF_WALK, settings.strike_ahead),
            false => (OTHER_FOOT, settings.kick_ahead),
        };
        let foot = match self.foot {
            Some(foot) if straight.y * foot > -other_foot => foot,
            _ => 1.0_f64.copysign(straight.y),
        };
        self.foot = Some(foot);
        let off = straight - DVec2::new(ahead, foot * settings.kick_aside);
        if is_striking {
            return self.strike(ball, off, heading, obstacles, now, settings);
        }
        let is_in_window =
            |share: f64| off.x.abs() < settings.kick_reach * share && settings.is_beside(off, heading, share);
        // The robot kicks while standing, after it has come to rest, because only then the position of the
        // ball relative to its feet is known.
        let is_at_rest = self.stands_since.is_some_and(|since| since + REST <= now);
        if is_at_rest && is_in_window(STANDING_WINDOW) {
            return (
                Some(Velocity::default()),
                if foot > 0.0 { WalkState::KICK_LEFT } else { WalkState::KICK_RIGHT },
            );
        }
        let stops =
            self.stops_since.filter(|since| !is_at_rest && now < *since + PATIENCE && is_in_window(2.0));
        self.stops_since = stops.or_else(|| (!is_at_rest && is_in_window(1.0)).then_some(now));
        if self.stops_since.is_some() {
            return (Some(Velocity::default()), WalkState::WALKING);
        }
        (Some(self.approach(ball, off, heading, obstacles, settings)), WalkState::WALKING)
    }

    /// Lines up for a kick out of the walk, and kicks: as [`WalkTo::approach`].
    fn strike(
        &mut self,
        ball: DVec2,
        off: DVec2,
        heading: f64,
        obstacles: &[Obstacle],
        now: Time,
        settings: &Settings,
    ) -> (Option<Velocity>, &'static str) {
        let width = if self.goes_straight { STILL_STRAIGHT } else { STRAIGHT };
        self.goes_straight =
            self.is_closing_in && off.x > -TOO_NEAR && settings.is_beside(off, heading, width);
        let since = self.strikes_since.filter(|since| now < *since + SWING);
        self.strikes_since = since.or_else(|| (self.goes_straight && off.x < 0.0).then_some(now));
        let straight_at = |speed: f64| Some(Velocity { linear: DVec2::new(speed, 0.0), turn: 0.0 });
        // The foot swings some time after it was told to: the robot steps on the spot until then.
        if self.strikes_since.is_some() {
            let is_left = self.foot.is_some_and(|foot| foot > 0.0);
            let state = if is_left { WalkState::STRIKE_LEFT } else { WalkState::STRIKE_RIGHT };
            return (straight_at(ON_THE_SPOT), state);
        }
        let approach = self.approach(ball, off, heading, obstacles, settings);
        let velocity = if self.goes_straight { straight_at(settings.strike_speed) } else { Some(approach) };
        (velocity, WalkState::WALKING)
    }

    /// Where the ball is to the side of a robot that sways from foot to foot, on average.
    fn without_sway(&mut self, aside: f64) -> f64 {
        let last = self.aside.filter(|last| (aside - last).abs() < SWAYS).unwrap_or(aside);
        let smoothed = last + (aside - last) * (PERIOD.as_secs_f64() / SWAY_SMOOTHING);
        self.aside = Some(smoothed);
        smoothed
    }

    /// Walks behind the ball and up to it: `off` is the way to the place of the kick in axes of the kick,
    /// whose direction is `heading`.
    fn approach(
        &mut self,
        ball: DVec2,
        off: DVec2,
        heading: f64,
        obstacles: &[Obstacle],
        settings: &Settings,
    ) -> Velocity {
        let limit = if self.is_closing_in { 0.35 } else { 0.2 };
        let is_behind = off.x > -0.05 && off.x < BEHIND + 0.15 && off.y.abs() < limit / 2.0;
        self.is_closing_in = is_behind && heading.abs() < limit;
        if self.is_closing_in {
            // First to the side and around, then ahead: feet that step next to the place of the kick would
            // push the ball.
            let is_beside = settings.is_beside(off, heading, STRAIGHT);
            let ahead = if is_beside { off.x } else { off.x - BEHIND };
            let way = DVec2::from_angle(heading).rotate(DVec2::new(ahead, off.y));
            step(way, heading, settings)
        } else {
            let place = off - DVec2::new(BEHIND, 0.0);
            let way = around(DVec2::from_angle(heading).rotate(place), ball);
            self.step_or_walk(way, heading, obstacles, settings)
        }
    }

    /// Dribbles; ball and target are relative to the robot. Behind the ball on the line to the target, the
    /// robot walks on through the ball.
    fn dribble(
        &mut self,
        ball: DVec2,
        target: DVec2,
        obstacles: &[Obstacle],
        settings: &Settings,
    ) -> Velocity {
        let direction = target - ball;
        let heading = if direction.length() > 1e-3 { direction.to_angle() } else { 0.0 };
        let straight = DVec2::from_angle(-heading).rotate(ball);
        // Once the robot pushes the ball, it continues until the ball is clearly to its side.
        let [aside, turned] = if self.is_closing_in { [0.1, 0.5] } else { [0.05, 0.25] };
        let is_ahead = straight.x > 0.0 && straight.x < 2.0 * CLEARANCE;
        self.is_closing_in = is_ahead && straight.y.abs() < aside && heading.abs() < turned;
        if self.is_closing_in {
            let side = (GAIN * straight.y).clamp(-settings.side, settings.side);
            let turn = (TURN_GAIN * heading).clamp(-settings.turn, settings.turn);
            return Velocity { linear: DVec2::new(settings.forward, side), turn };
        }
        let place = straight - DVec2::new(PUSH_FROM, 0.0);
        let way = around(DVec2::from_angle(heading).rotate(place), ball);
        self.step_or_walk(way, heading, obstacles, settings)
    }

    /// Walks to a goal relative to the robot.
    fn walk_to_place(
        &mut self,
        goal: Place,
        obstacles: &[Obstacle],
        settings: &Settings,
    ) -> (Option<Velocity>, &'static str) {
        if goal.position.length() < settings.there_distance && goal.heading.abs() < settings.there_angle {
            return (Some(Velocity::default()), WalkState::THERE);
        }
        // To turn twice takes longer than to step there.
        let is_facing = goal.heading.abs() < FACING && goal.position.length() < NEAR_FACING;
        let velocity = if is_facing {
            step(goal.position, goal.heading, settings)
        } else {
            self.step_or_walk(goal.position, goal.heading, obstacles, settings)
        };
        (Some(velocity), WalkState::WALKING)
    }

    /// Steps or walks to a place and a heading there.
    fn step_or_walk(
        &mut self,
        to: DVec2,
        heading: f64,
        obstacles: &[Obstacle],
        settings: &Settings,
    ) -> Velocity {
        self.steps = to.length() < if self.steps { NO_LONGER_NEAR } else { NEAR };
        if self.steps { step(to, heading, settings) } else { far(avoiding(to, obstacles), settings) }
    }
}

/// Slows down towards obstacles, stops before near ones and backs off from very near ones, because robots
/// that touch fall, and who lies entangled does not get up.
fn keeping_off<'a>(mut velocity: Velocity, obstacles: impl IntoIterator<Item = &'a Obstacle>) -> Velocity {
    for Obstacle { at, keep } in obstacles {
        let distance = at.length();
        if distance < 1e-3 {
            continue;
        }
        let towards = *at / distance;
        let speed = velocity.linear.dot(towards);
        velocity.linear -= towards * (speed - (GAIN * (distance - keep)).max(0.0)).max(0.0);
        if distance < 0.75 * keep {
            velocity.linear -= towards * BACK_OFF;
            velocity.turn = velocity.turn.clamp(-TURN_BESIDE, TURN_BESIDE);
        }
    }
    velocity
}

/// The point towards which to push the ball: past an obstacle on the way to the target, on the current side
/// if there is one.
fn past(robots: &[Obstacle], ball: DVec2, target: DVec2, passing: &mut Option<f64>) -> DVec2 {
    let way = target - ball;
    let widened = if passing.is_some() { STILL_PASSING } else { 1.0 };
    let is_on_way = |other: &DVec2| {
        let off = *other - ball;
        off.length() < 2.0 * CLEARANCE * widened && way.angle_to(off).abs() < 0.8 * widened
    };
    let nearest = robots
        .iter()
        .map(|robot| robot.at)
        .filter(is_on_way)
        .min_by(|one, other| one.distance_squared(ball).total_cmp(&other.distance_squared(ball)));
    let Some(other) = nearest else {
        *passing = None;
        return target;
    };
    // The side that needs the least turning of the ball and the least walking around it. If the obstacle is
    // straight ahead, the right side, so that an opponent with the same rule takes the other one.
    let (of_other, of_push) = (way.angle_to(other - ball), way.angle_to(ball));
    let direction = |side: f64| of_other + side * PAST;
    let effort = |side: f64| direction(side).abs() + wrapped(direction(side) - of_push).abs() / 2.0;
    let easier = if effort(1.0) + 0.05 < effort(-1.0) { 1.0 } else { -1.0 };
    ball + DVec2::from_angle(direction(*passing.get_or_insert(easier))).rotate(way)
}

/// The next point on the way to `to` that avoids the obstacles.
fn avoiding(to: DVec2, obstacles: &[Obstacle]) -> DVec2 {
    let in_the_way = obstacles.iter().filter(|obstacle| obstacle.at.distance(to) > CLEARANCE);
    in_the_way.fold(to, |to, obstacle| around(to, obstacle.at))
}

/// Steps in all directions.
fn step(to: DVec2, heading: f64, settings: &Settings) -> Velocity {
    let limit = DVec2::new(settings.forward / 2.0, settings.side);
    let turn = (TURN_GAIN * wrapped(heading)).clamp(-settings.turn, settings.turn);
    Velocity { linear: (to * GAIN).clamp(-limit, limit), turn }
}

/// Turns to a point and walks forward.
fn far(to: DVec2, settings: &Settings) -> Velocity {
    let bearing = to.to_angle();
    let share = libm::cos(bearing).max(0.0).powi(4);
    let turn = (TURN_GAIN * bearing).clamp(-settings.turn, settings.turn);
    Velocity { linear: DVec2::new(settings.forward * share, 0.0), turn }
}

/// The next point on the way to `to` that does not lead through the ball.
fn around(to: DVec2, ball: DVec2) -> DVec2 {
    let Some(along) = to.try_normalize() else { return to };
    let passes = ball.dot(along);
    let aside = along.perp().dot(ball);
    // For a place next to the ball, the clearance is limited to the distance of the place.
    let clearance = CLEARANCE.min(0.8 * to.distance(ball));
    if passes <= 0.0 || passes >= to.length() || aside.abs() >= clearance {
        return to;
    }
    let side = -1.0_f64.copysign(aside);
    ball + along.perp() * side * clearance
}

impl Module for WalkTo {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let field = setup.read_only_setting(
            "field",
            String::new(),
            "name of a built-in field, or path of a file, whose goal posts are obstacles; empty: none are",
        )?;
        let name = setup.value(field).cloned().unwrap_or_default();
        self.posts = match name.as_str() {
            "" => Vec::new(),
            name => match Field::named(name) {
                Ok(field) => field.posts().to_vec(),
                Err(error) => return Err(setup.refuse_value(field, error.to_string())),
            },
        };
        setup.subscribe("walk_to/pose", |walk: &mut Self, goal: Received<'_, PoseStamped>, _| {
            let position = DVec2::new(goal.pose.position.x, goal.pose.position.y);
            let place = Place { position, heading: heading_of(&goal.pose.orientation) };
            if !position.is_finite() || !place.heading.is_finite() {
                return tracing::warn!("a goal that is not finite is ignored");
            }
            match goal.header.frame_id.as_str() {
                "map" => walk.goal = Goal::Place(place),
                "base_link" | "base_footprint" => walk.goal = Goal::FromHere(place),
                other => tracing::warn!("a goal in the frame {other:?} is ignored; use map or base_link"),
            }
        })?;
        type GoalAt = fn(DVec2) -> Goal;
        let goals: [(&str, GoalAt); 3] = [
            ("walk_to/kick", Goal::Kick),
            ("walk_to/strike", Goal::Strike),
            ("walk_to/dribble", Goal::Dribble),
        ];
        for (topic, goal) in goals {
            setup.subscribe(topic, move |walk: &mut Self, target: Received<'_, PointStamped>, _| {
                let target = DVec2::new(target.point.x, target.point.y);
                if target.is_finite() {
                    walk.goal = goal(target);
                }
            })?;
        }
        setup.subscribe("walk_to/stop", |walk: &mut Self, _: Received<'_, Empty>, _| {
            walk.goal = Goal::Nothing;
        })?;
        setup.subscribe("pose", |walk: &mut Self, pose: Received<'_, PoseWithCovarianceStamped>, ctx| {
            walk.beliefs.take_pose(&pose, ctx.now());
        })?;
        setup.subscribe("ball", |walk: &mut Self, ball: Received<'_, Ball>, ctx| {
            walk.beliefs.take_ball(&ball, ctx.now());
        })?;
        setup.subscribe("robots", |walk: &mut Self, robots: Received<'_, RobotArray>, ctx| {
            walk.beliefs.take_robots(&robots, ctx.now());
        })?;
        setup.subscribe("walking", |walk: &mut Self, walking: Received<'_, Bool>, ctx| {
            walk.stands_since = (!walking.data).then(|| walk.stands_since.unwrap_or(ctx.now()));
        })?;
        setup.every(PERIOD, Self::tick)?;
        Ok(Ports {
            cmd_vel: setup.publish("cmd_vel")?,
            state: setup.publish("walk_to/state")?,
            settings: SettingKeys::declare(setup)?,
        })
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot(ahead: f64, left: f64) -> Obstacle {
        Obstacle { at: DVec2::new(ahead, left), keep: KEEP_OFF }
    }

    #[test]
    fn the_way_to_a_place_behind_the_ball_goes_around_it() {
        let ball = DVec2::new(0.5, 0.05);
        let way = around(DVec2::new(1.0, 0.0), ball);
        assert!((way - ball).length() > 0.29 && way.y < 0.0, "{way}");
        assert_eq!(around(DVec2::new(0.3, 0.0), ball), DVec2::new(0.3, 0.0), "nearer than the ball");
        assert_eq!(around(DVec2::new(-1.0, 0.0), ball), DVec2::new(-1.0, 0.0), "behind the robot");
    }

    #[test]
    fn only_a_robot_that_stands_behind_the_ball_kicks_and_with_the_nearer_foot() {
        let settings = Settings::default();
        let target = DVec2::new(5.0, 0.0);
        let state = |walk: &mut WalkTo, ball| walk.line_up(ball, target, &[], Time::ZERO + REST, &settings).1;
        let mut walk = WalkTo { stands_since: Some(Time::ZERO), ..WalkTo::default() };
        assert_eq!(state(&mut walk, DVec2::new(0.1, 0.045)), "kick_left");
        // The foot stays the same where both would do.
        assert_eq!(state(&mut walk, DVec2::new(0.1, -0.02)), "walking");
        assert_eq!(state(&mut walk, DVec2::new(0.1, -0.06)), "kick_right");
        walk.stands_since = Some(Time::ZERO + REST / 2);
        assert_eq!(state(&mut walk, DVec2::new(0.1, -0.045)), "walking");
        walk.stands_since = None;
        assert_eq!(state(&mut walk, DVec2::new(0.1, -0.045)), "walking");
    }

    #[test]
    fn a_walking_robot_goes_straight_to_the_ball_and_steps_on_the_spot_while_it_kicks() {
        let settings = Settings::default();
        let target = DVec2::new(5.0, 0.0);
        let mut walk = WalkTo { goal: Goal::Strike(target), ..WalkTo::default() };
        let mut now = Time::ZERO;
        let mut at = |walk: &mut WalkTo, ahead: f64| {
            now = now + PERIOD;
            let (velocity, state) = walk.line_up(DVec2::new(ahead, -0.045), target, &[], now, &settings);
            (velocity.unwrap_or_default().linear.x, state)
        };
        at(&mut walk, 0.2);
        assert_eq!(at(&mut walk, 0.2), (settings.strike_speed, "walking"));
        assert_eq!(at(&mut walk, settings.strike_ahead - 0.01), (ON_THE_SPOT, "strike_right"));
        assert_eq!(at(&mut walk, 0.6).1, "strike_right", "until the foot has swung");
        for _ in 0..SWING.as_millis() / PERIOD.as_millis() {
            at(&mut walk, 0.6);
        }
        let (ahead, state) = at(&mut walk, 0.6);
        assert!(ahead > settings.strike_speed && state == "walking");
        // A ball at its toes would be trodden on.
        let mut near = WalkTo { goal: Goal::Strike(target), ..WalkTo::default() };
        at(&mut near, settings.strike_ahead - TOO_NEAR - 0.01);
        let (back, state) = at(&mut near, settings.strike_ahead - TOO_NEAR - 0.01);
        assert!(back < 0.0 && state == "walking", "{back}");
    }

    #[test]
    fn the_ball_is_pushed_past_who_stands_on_its_way() {
        let (ball, target) = (DVec2::new(0.2, 0.0), DVec2::new(3.0, 0.0));
        let aside = |robots: &[Obstacle], passing: &mut _| past(robots, ball, target, passing).y;
        assert_eq!(aside(&[robot(-0.3, 0.0), robot(1.5, 0.0)], &mut None), 0.0);
        let mut passing = None;
        assert!(aside(&[robot(0.6, 0.1)], &mut passing) < -1.0);
        assert!(aside(&[robot(0.6, -0.1)], &mut passing) < -1.0, "the side is kept");
        assert!(aside(&[robot(0.6, -0.1)], &mut None) > 1.0);
        assert_eq!(aside(&[robot(1.5, 0.0)], &mut passing), 0.0);
        assert_eq!(passing, None);
        let way = avoiding(DVec2::new(2.0, 0.0), &[robot(1.0, 0.1)]);
        assert!(way.y < -0.1, "{way}");
    }

    #[test]
    fn nobody_walks_into_others() {
        let at = |ahead| robot(ahead, 0.0);
        let ahead = Velocity { linear: DVec2::new(0.1, 0.02), turn: 0.3 };
        let slowed = keeping_off(ahead, &[at(KEEP_OFF + 0.04)]);
        assert!((slowed.linear.x - 0.04).abs() < 1e-9 && slowed.linear.y == 0.02, "{slowed:?}");
        let stopped = keeping_off(ahead, &[at(0.3), at(2.0)]);
        assert_eq!(stopped, Velocity { linear: DVec2::new(0.0, 0.02), turn: 0.3 });
        let back = keeping_off(ahead, &[at(0.2)]);
        assert!(back.linear.x < 0.0 && back.turn == TURN_BESIDE, "{back:?}");
        assert_eq!(keeping_off(ahead, &[at(-0.3)]), ahead);
    }

    #[test]
    fn who_dribbles_walks_through_a_ball_ahead_and_around_one_behind() {
        let settings = Settings::default();
        let mut walk = WalkTo::default();
        let push = walk.dribble(DVec2::new(0.15, 0.01), DVec2::new(3.0, 0.0), &[], &settings);
        assert_eq!(push.linear.x, settings.forward);
        let turn = walk.dribble(DVec2::new(-0.5, 0.0), DVec2::new(3.0, 0.0), &[], &settings);
        assert!(turn.linear.x < settings.forward && turn.turn != 0.0, "{turn:?}");
    }

    #[test]
    fn a_goal_far_behind_is_turned_to_first_and_one_nearby_is_stepped_to() {
        let settings = Settings::default();
        let behind = far(DVec2::new(-1.0, 0.1), &settings);
        assert!(behind.linear.length() < 1e-9 && behind.turn > 0.5, "{behind:?}");
        let aside = step(DVec2::new(0.0, -0.2), 0.0, &settings);
        assert!(aside.linear.y < -0.04 && aside.turn == 0.0, "{aside:?}");
        let back = step(DVec2::new(-0.2, 0.0), 0.2, &settings);
        assert!(back.linear.x == -settings.forward / 2.0 && back.turn > 0.1, "{back:?}");
    }
}
