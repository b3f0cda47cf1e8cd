//! Team play: sends the player's knowledge to its mates, and merges their messages with the player's own
//! perception.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `pose`, `ball`, `robots` (in) | as localisation publishes them | the player's own beliefs, in `map` |
//! | `game_state` (in) | `football_interfaces/GameState` | the identity of the player, and the remaining message budget of the team |
//! | `robot_state` (in) | `std_msgs/String` | from `falls`: `upright`, or another state |
//! | `team/role` (in) | `std_msgs/UInt8` | the role chosen by the state machine, numbered as in TeamMessage |
//! | `team_messages` (in) | `football_interfaces/TeamMessage` | messages of mates, from the radio or a simulated match |
//! | `team_status` | `football_interfaces/TeamMessage` | messages of this player, `rate` times a second, within the budget |
//! | `team/ball` | `soccer_model_msgs/Ball` | in `map`: the player's own ball at once while it is certain; otherwise the ball of the team, ten times a second |
//! | `team/robots` | `soccer_model_msgs/RobotArray` | in `map`: mates with their numbers at their reported positions, and all robots seen by any player; for each message on `robots`, and without such messages every 0.4 s |
//! | `team/report` | `football_interfaces/TeamReport` | the player's own message and the latest of each mate, five times a second; for the choice of roles |
//! | `diagnostics` | `diagnostic_msgs/DiagnosticArray` | the numbers of sent messages, and of refused ones by reason; at most once a second, after a change |
//!
//! The module refuses messages of another team or of the player itself, messages older than `timeout` or than
//! the latest of the same mate, and messages with numbers that are not finite or places that are off any
//! field. A ball is certain if its standard deviation is below 0.5 m. If the message budget is counted,
//! messages are spread over the rest of the half and over all players that send. The time to the ball
//! includes the walk around it, to the side away from the opponents' goal.
//!
//! | setting | |
//! | --- | --- |
//! | `rate` | largest number of messages per second |
//! | `reserve` | the part of a counted budget that is kept unused |
//! | `timeout` | age after which a message of a mate is discarded, s |
//! | `ball_timeout` | how long the team's ball is published after it was last seen, s |
//! | `walk`, `turn` | speeds of walking and turning, m/s and rad/s |

use crate::beliefs::{Beliefs, Place};
use crate::fusion::{BallEstimate, RobotEstimate, ball_of_team, robots_of_team};
use crate::mates::Mates;
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_football::football_interfaces::msg::{GameState, SeenRobot, TeamMessage, TeamReport};
use downbeat_football::soccer_model_msgs::msg::{Ball, Robot, RobotArray};
use downbeat_kinematics::wrapped;
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus, KeyValue};
use downbeat_msgs::downbeat_interfaces::msg::RobotState;
use downbeat_msgs::geometry_msgs::msg::{Point, PoseWithCovariance, PoseWithCovarianceStamped, Vector3};
use downbeat_msgs::std_msgs::msg::{Header, String as Text, UInt8};
use glam::DVec2;
use std::time::Duration;

/// Team play; see the [module page](self).
#[derive(Debug, Default)]
pub struct Team {
    beliefs: Beliefs,
    pose: PoseWithCovariance,
    ball: Option<(Time, BallEstimate)>,
    robots: Option<(Time, Vec<RobotEstimate>)>,
    game: Option<GameState>,
    is_down: bool,
    role: u8,
    mates: Mates,
    sent: Sent,
    published_robots: Option<Time>,
    reported: Option<(Time, Vec<KeyValue>)>,
}

/// The keys of [`Team`].
pub struct Ports {
    status: Publication<TeamMessage>,
    ball: Publication<Ball>,
    robots: Publication<RobotArray>,
    report: Publication<TeamReport>,
    diagnostics: Publication<DiagnosticArray>,
    rate: Setting<f64>,
    reserve: Setting<i64>,
    timeout: Setting<f64>,
    ball_timeout: Setting<f64>,
    walk: Setting<f64>,
    turn: Setting<f64>,
}

/// The messages sent so far.
#[derive(Debug, Default)]
struct Sent {
    at: Option<Time>,
    count: u64,
    /// The number since the last budget from the referee.
    since_told: u16,
}

const PERIOD: Duration = Duration::from_millis(100);
const REPORT: Duration = Duration::from_millis(200);
const DIAGNOSE: Duration = Duration::from_secs(1);
/// After this time without robots seen by the player itself, those of the team are published.
const SILENCE: Duration = Duration::from_millis(300);
/// The age beyond which the player's own beliefs are ignored.
const FRESH: Duration = Duration::from_secs(1);
/// The largest variance of a ball that is certain, in m².
const CERTAIN: f64 = 0.25;
/// The distance from the ball at which a player walks around it, in m.
const AROUND: f64 = 0.3;
/// The time to get up, in s.
const GET_UP: f64 = 10.0;
/// The budget value that means that messages are not counted.
const UNCOUNTED: u16 = u16::MAX;
/// The largest number of robots in a message.
const MOST_OTHERS: usize = 8;
/// The largest number of mates in a report, and of robots that the player itself sees.
const MOST_MATES: usize = 10;
const MOST_ROBOTS: usize = 32;

impl Team {
    fn on_pose(&mut self, pose: Received<'_, PoseWithCovarianceStamped>, ctx: &mut Context<'_, Ports>) {
        self.beliefs.take_pose(&pose, ctx.now());
        self.pose = pose.pose;
    }

    fn on_ball(&mut self, ball: Received<'_, Ball>, ctx: &mut Context<'_, Ports>) {
        let at = DVec2::new(ball.point.point.x, ball.point.point.y);
        let velocity = &ball.twist.twist.linear;
        let variance = ball.point.covariance[0].max(ball.point.covariance[4]);
        if !at.is_finite() || !variance.is_finite() {
            return;
        }
        // An unknown velocity has a negative variance.
        let is_known = ball.twist.covariance[0] >= 0.0 && velocity.x.is_finite() && velocity.y.is_finite();
        let velocity = if is_known { DVec2::new(velocity.x, velocity.y) } else { DVec2::ZERO };
        let estimate = BallEstimate { position: at, velocity, variance, age: Duration::ZERO };
        self.ball = Some((ctx.now(), estimate));
        if variance <= CERTAIN {
            ctx.publish(ctx.ports.ball, ball.clone());
        }
    }

    fn on_robots(&mut self, robots: Received<'_, RobotArray>, ctx: &mut Context<'_, Ports>) {
        let estimates = robots.robots.iter().take(MOST_ROBOTS).filter_map(estimate_of).collect();
        self.robots = Some((ctx.now(), estimates));
        self.publish_robots(ctx);
    }

    fn on_game(&mut self, game: Received<'_, GameState>, _: &mut Context<'_, Ports>) {
        self.game = Some(game.clone());
        self.sent.since_told = 0;
    }

    fn on_message(&mut self, message: Received<'_, TeamMessage>, ctx: &mut Context<'_, Ports>) {
        let of = self.game.as_ref().map_or([0, 0], |game| [game.own_team, game.player]);
        let timeout = Duration::from_secs_f64(*ctx.get(ctx.ports.timeout));
        self.mates.take(&message, of, ctx.now(), timeout);
    }

    fn tick(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        self.mates.forget_after(now, Duration::from_secs_f64(*ctx.get(ctx.ports.timeout)));
        let joint = self.joint_ball(ctx);
        let is_own_certain = self
            .ball
            .is_some_and(|(at, ball)| now.saturating_since(at) < SILENCE && ball.variance <= CERTAIN);
        if let Some(ball) = joint.filter(|_| !is_own_certain) {
            ctx.publish(ctx.ports.ball, ball_message(&ball, now));
        }
        let is_silent = self.published_robots.is_none_or(|at| now.saturating_since(at) > SILENCE);
        if is_silent {
            self.publish_robots(ctx);
        }
        if let Some(own) = self.status(joint, ctx).filter(|_| self.may_send(ctx)) {
            self.sent = Sent {
                at: Some(now),
                count: self.sent.count + 1,
                since_told: self.sent.since_told.saturating_add(1),
            };
            ctx.publish(ctx.ports.status, own);
        }
        self.diagnose(ctx);
    }

    fn report(&mut self, ctx: &mut Context<'_, Ports>) {
        let own = self.status(self.joint_ball(ctx), ctx).unwrap_or_default();
        let mates = self.mates.messages().take(MOST_MATES).cloned().collect();
        ctx.publish(ctx.ports.report, TeamReport { header: header(ctx.now()), own, mates });
    }

    /// The ball of the team, if any player has seen it recently.
    fn joint_ball(&self, ctx: &Context<'_, Ports>) -> Option<BallEstimate> {
        let (now, timeout) = (ctx.now(), Duration::from_secs_f64(*ctx.get(ctx.ports.ball_timeout)));
        let own = self.ball.map(|(at, ball)| BallEstimate { age: now.saturating_since(at), ..ball });
        let own = own.filter(|ball| ball.age <= timeout);
        if let Some(own) = own.filter(|ball| ball.age <= FRESH && ball.variance <= CERTAIN) {
            return Some(own);
        }
        let mates: Vec<&TeamMessage> = self.mates.messages().collect();
        ball_of_team(own, &mates, now).filter(|ball| ball.age <= timeout)
    }

    fn publish_robots(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let fresh = self.robots.as_ref().filter(|(at, _)| now.saturating_since(*at) <= FRESH);
        let seen = fresh.map_or(&[][..], |(_, robots)| robots);
        let mates: Vec<&TeamMessage> = self.mates.messages().collect();
        let here = self.beliefs.place(now).map(|place| place.position);
        let robots = robots_of_team(here, seen, &mates, now).iter().map(robot_message).collect();
        self.published_robots = Some(now);
        ctx.publish(ctx.ports.robots, RobotArray { header: header(now), robots });
    }

    /// The message of this player, if it knows its identity and place.
    fn status(&self, joint: Option<BallEstimate>, ctx: &Context<'_, Ports>) -> Option<TeamMessage> {
        let now = ctx.now();
        let game = self.game.as_ref().filter(|game| game.own_team != 0 && game.player != 0)?;
        let place = self.beliefs.place(now)?;
        let state = match (game.is_penalised, self.is_down) {
            (true, _) => TeamMessage::PENALISED,
            (false, true) => TeamMessage::FALLEN,
            (false, false) => TeamMessage::ACTIVE,
        };
        let mut message = TeamMessage {
            header: header(now),
            team: game.own_team,
            player: game.player,
            state,
            role: self.role,
            pose: self.pose,
            time_to_ball: f32::INFINITY,
            others: self.others(place.position, now),
            ..TeamMessage::default()
        };
        if let Some((at, ball)) = self.ball.filter(|(at, _)| now.saturating_since(*at) <= FRESH) {
            message.sees_ball = true;
            message.ball = Point { x: ball.position.x, y: ball.position.y, z: 0.0 };
            message.ball_velocity = Vector3 { x: ball.velocity.x, y: ball.velocity.y, z: 0.0 };
            message.ball_variance = ball.variance as f32;
            message.ball_age = now.saturating_since(at).as_secs_f32();
        }
        if let Some(ball) = joint.filter(|_| state != TeamMessage::PENALISED) {
            let [walk, turn] = [*ctx.get(ctx.ports.walk), *ctx.get(ctx.ports.turn)];
            let up = if self.is_down { GET_UP } else { 0.0 };
            message.time_to_ball = (up + time_to_ball(place, ball.position, walk, turn)) as f32;
        }
        Some(message)
    }

    /// The robots seen by the player itself, the nearest first.
    fn others(&self, here: DVec2, now: Time) -> Vec<SeenRobot> {
        let fresh = self.robots.as_ref().filter(|(at, _)| now.saturating_since(*at) <= FRESH);
        let mut robots: Vec<&RobotEstimate> = fresh.map_or(&[][..], |(_, robots)| robots).iter().collect();
        robots.sort_by(|one, other| {
            one.position.distance_squared(here).total_cmp(&other.position.distance_squared(here))
        });
        let seen = robots.into_iter().take(MOST_OTHERS).map(|robot| SeenRobot {
            team: robot.attributes.team,
            player_number: robot.attributes.player_number,
            x: robot.position.x as f32,
            y: robot.position.y as f32,
            variance: robot.variance as f32,
        });
        seen.collect()
    }

    /// True if a message is due and the budget of the team allows it.
    fn may_send(&self, ctx: &Context<'_, Ports>) -> bool {
        let Some(game) = &self.game else { return false };
        let mut period = 1.0 / *ctx.get(ctx.ports.rate);
        if game.message_budget != UNCOUNTED {
            let left = i64::from(game.message_budget) - i64::from(self.sent.since_told);
            let left = left - *ctx.get(ctx.ports.reserve);
            if left <= 0 {
                return false;
            }
            let speakers = (self.mates.messages().len() + 1) as f64;
            let remaining = f64::from(game.seconds_remaining);
            if remaining.is_finite() {
                period = period.max(remaining * speakers / left as f64);
            }
        }
        // Rounded to the nearest tick, because messages are rarely due exactly at a tick.
        let early = PERIOD.as_secs_f64() / 2.0;
        self.sent.at.is_none_or(|at| ctx.now().saturating_since(at).as_secs_f64() + early >= period)
    }

    fn diagnose(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        if self.reported.as_ref().is_some_and(|(at, _)| now.saturating_since(*at) < DIAGNOSE) {
            return;
        }
        let refused =
            self.mates.refused().iter().map(|(why, count)| (format!("refused_{}", why.name()), *count));
        let counts =
            [("sent".to_owned(), self.sent.count), ("mates".to_owned(), self.mates.messages().len() as u64)];
        let values: Vec<KeyValue> = counts
            .into_iter()
            .chain(refused)
            .map(|(key, count)| KeyValue { key, value: count.to_string() })
            .collect();
        // The number of sent messages changes all the time, and is no reason for a report.
        let is_news = |value: &&KeyValue| value.key != "sent";
        let before = self.reported.as_ref().map(|(_, values)| values);
        let has_changed =
            before.is_none_or(|before| !before.iter().filter(is_news).eq(values.iter().filter(is_news)));
        if has_changed {
            let any = values.iter().any(|value| value.key.starts_with("refused"));
            let message = if any { "some team messages were refused" } else { "hears its team" };
            let status = DiagnosticStatus {
                level: if any { DiagnosticStatus::WARN } else { DiagnosticStatus::OK },
                name: format!("{}: team messages", ctx.module_name()),
                message: message.to_owned(),
                values: values.clone(),
                ..DiagnosticStatus::default()
            };
            let header = Header { frame_id: String::new(), ..header(now) };
            ctx.publish(ctx.ports.diagnostics, DiagnosticArray { header, status: vec![status] });
        }
        self.reported = Some((now, values));
    }
}

impl Module for Team {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.subscribe("game_state", Self::on_game)?;
        setup.subscribe("pose", Self::on_pose)?;
        setup.subscribe("ball", Self::on_ball)?;
        setup.subscribe("robots", Self::on_robots)?;
        setup.subscribe("robot_state", |team: &mut Self, state: Received<'_, Text>, _| {
            team.is_down = state.data != RobotState::UPRIGHT;
        })?;
        setup.subscribe("team/role", |team: &mut Self, role: Received<'_, UInt8>, _| {
            team.role = role.data;
        })?;
        setup.subscribe("team_messages", Self::on_message)?;
        setup.every(PERIOD, Self::tick)?;
        setup.every(REPORT, Self::report)?;
        Ok(Ports {
            status: setup.publish("team_status")?,
            ball: setup.publish("team/ball")?,
            robots: setup.publish("team/robots")?,
            report: setup.publish("team/report")?,
            diagnostics: setup.publish("diagnostics")?,
            rate: setup.setting_in("rate", 5.0, 0.1..=10.0, "Hz; largest rate of messages")?,
            reserve: setup.setting_in(
                "reserve",
                100_i64,
                0.0..=65535.0,
                "the part of a counted message budget that is kept unused",
            )?,
            timeout: setup.setting_in(
                "timeout",
                2.0,
                0.1..=60.0,
                "s; age after which a message of a mate is discarded",
            )?,
            ball_timeout: setup.setting_in(
                "ball_timeout",
                3.0,
                0.1..=60.0,
                "s; how long the ball is published after the team last saw it",
            )?,
            walk: setup.setting_in("walk", 0.1, 0.01..=2.0, "m/s; speed of walking")?,
            turn: setup.setting_in("turn", 0.5, 0.05..=6.0, "rad/s; speed of turning")?,
        })
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

/// The time in s to turn to the ball, and to walk to the side from which it can be pushed towards +x.
fn time_to_ball(place: Place, ball: DVec2, walk: f64, turn: f64) -> f64 {
    let way = ball - place.position;
    let bearing = wrapped(way.to_angle() - place.heading).abs();
    let around = AROUND * way.to_angle().abs();
    bearing / turn + (way.length() + around) / walk
}

fn estimate_of(robot: &Robot) -> Option<RobotEstimate> {
    let (at, velocity) = (&robot.pose.pose.position, &robot.twist.twist.linear);
    let [position, velocity] = [DVec2::new(at.x, at.y), DVec2::new(velocity.x, velocity.y)];
    let variance = robot.pose.covariance[0].max(robot.pose.covariance[7]);
    let is_finite = position.is_finite() && velocity.is_finite() && variance.is_finite();
    is_finite.then_some(RobotEstimate { position, velocity, variance, attributes: robot.attributes })
}

fn robot_message(robot: &RobotEstimate) -> Robot {
    let mut message = Robot { attributes: robot.attributes, ..Robot::default() };
    message.pose.pose.position = Point { x: robot.position.x, y: robot.position.y, z: 0.0 };
    message.pose.pose.orientation.w = 1.0;
    (message.pose.covariance[0], message.pose.covariance[7]) = (robot.variance, robot.variance);
    message.twist.twist.linear = Vector3 { x: robot.velocity.x, y: robot.velocity.y, z: 0.0 };
    message
}

fn ball_message(ball: &BallEstimate, now: Time) -> Ball {
    let mut message = Ball { header: header(now), ..Ball::default() };
    message.point.point = Point { x: ball.position.x, y: ball.position.y, z: 0.0 };
    (message.point.covariance[0], message.point.covariance[4]) = (ball.variance, ball.variance);
    message.twist.twist.linear = Vector3 { x: ball.velocity.x, y: ball.velocity.y, z: 0.0 };
    message
}

fn header(at: Time) -> Header {
    Header { stamp: Stamp::from_nanos(at.as_nanos()), frame_id: "map".to_owned() }
}
