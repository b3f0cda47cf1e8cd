//! The filters as a module.

use crate::ball::BallFilter;
use crate::filter::{Believed, Landmarks, Pose, pitched};
use crate::hypotheses::Hypotheses;
use crate::messages::{FARTHEST, intersection, point, pose_from, pose_of, quaternion, time};
use crate::robots::{RobotTracks, Sighting};
use crate::track::Track;
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_football::football_interfaces::msg::GameState;
use downbeat_football::soccer_model_msgs::msg::{Ball, Robot, RobotArray};
use downbeat_football::soccer_vision_3d_msgs::msg::{GoalpostArray, MarkingArray, RobotArray as SeenRobots};
use downbeat_football::{Field, floor_covariance};
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus};
use downbeat_msgs::downbeat_interfaces::msg::RobotState;
use downbeat_msgs::geometry_msgs::msg::{
    Point, PoseWithCovarianceStamped, Transform, TransformStamped, Vector3,
};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::std_msgs::msg::{Header, String as Text};
use downbeat_transforms::TransformBroadcaster;
use glam::{DMat2, DQuat, DVec2};
use std::collections::VecDeque;
use std::f64::consts::{FRAC_PI_2, PI};
use std::time::Duration;

/// Knows where the robot and the ball are, in `map`: the own goal at -x, the origin in the centre of the
/// field.
///
/// | topic | type | |
/// | --- | --- | --- |
/// | `odom` (in) | nav_msgs/Odometry | of `base_link`, with the yaw of the gyroscope; the floor at z = 0 |
/// | `vision/markings` (in) | soccer_vision_3d_msgs/MarkingArray | in `base_footprint` |
/// | `vision/goalposts` (in) | soccer_vision_3d_msgs/GoalpostArray | in `base_footprint`, with the stamp of the markings |
/// | `vision/ball` (in) | soccer_model_msgs/Ball | in `base_footprint`, with covariance |
/// | `vision/robots` (in) | soccer_vision_3d_msgs/RobotArray | in `base_footprint` |
/// | `game_state` (in) | football_interfaces/GameState | when the robot is put somewhere; works without |
/// | `robot_state` (in) | std_msgs/String | from `falls`: what a robot that lies or gets up sees is of no use; works without |
/// | `initialpose` (in) | geometry_msgs/PoseWithCovarianceStamped | in `map`, as RViz and Foxglove send it: the robot is there; begins anew |
/// | `pose` | geometry_msgs/PoseWithCovarianceStamped | of `base_link` in `map`, at most 50 times a second |
/// | `tf` | tf2_msgs/TFMessage | `map` to `odom`, with each pose |
/// | `ball` | soccer_model_msgs/Ball | in `map`, with each pose, until `ball_timeout` after it was last seen; covariances with respect to the robot |
/// | `robots` | soccer_model_msgs/RobotArray | in `map`, ten times a second: those that are followed, until `robot_timeout` after they were last seen, with velocity, team and whether they lie; covariances with respect to the robot |
/// | `diagnostics` | diagnostic_msgs/DiagnosticArray | when the state changes: what is missing, and the remedy |
///
/// | setting | |
/// | --- | --- |
/// | `field` | a name or a file; empty: darwin_op_2014 |
/// | `seed` | same seed and messages, same beliefs |
/// | `starts` | where the robot enters: x, y (m) and heading (rad) in `map`, of one to four places; empty: the touch lines of its own half, facing inwards |
/// | `returns` | the same for a robot that was penalised; empty: as `starts` |
/// | `camera_height` | of the camera above the floor, m; for how certain landmarks are |
/// | `ball_timeout` | after which an unseen ball is forgotten, s |
/// | `robot_timeout` | the same of other robots, s |
///
/// The robot starts at one of `starts` when the module starts, when the game enters its initial state and
/// when it leaves it, for meanwhile the robot is carried to its place, and when the teams change sides; at
/// one of `returns` after a penalty; at `initialpose` when that arrives. With several places all are followed
/// until what is seen tells which is right. When the referee sets the robots up, it may have been put back to
/// a start: that is followed beside what was believed before. Landmarks are not used while the robot is
/// penalised.
#[derive(Debug, Default)]
pub struct Localisation {
    hypotheses: Option<Hypotheses>,
    starts: Vec<Pose>,
    returns: Vec<Pose>,
    odometry: VecDeque<(Time, Pose)>,
    /// Until when the filters have walked.
    walked: Option<(Time, Pose)>,
    believed: Believed,
    map_from_odom: Pose,
    /// What was seen at one time, until all of it is here.
    seeing: Option<Seeing>,
    ball: BallFilter,
    ball_height: f64,
    robots: RobotTracks,
    robots_published_at: Option<Time>,
    game: Option<Game>,
    published_at: Option<Time>,
    /// When the robot was put somewhere, or stood up: pictures from before are of no use.
    put_at: Time,
    is_down: bool,
    /// When it stands again after the referee may have put it back to a start.
    may_be_put_at: Option<Time>,
    /// When something arrived last: odometry, and landmarks.
    heard_at: [Option<Time>; 2],
    refused: Option<String>,
    told: Option<String>,
}

/// The keys of [`Localisation`].
pub struct Ports {
    pose: Publication<PoseWithCovarianceStamped>,
    ball: Publication<Ball>,
    robots: Publication<RobotArray>,
    diagnostics: Publication<DiagnosticArray>,
    transforms: TransformBroadcaster,
    camera_height: Setting<f64>,
    ball_timeout: Setting<f64>,
    robot_timeout: Setting<f64>,
}

#[derive(Debug)]
struct Seeing {
    at: Time,
    landmarks: Landmarks,
    has_markings: bool,
    has_posts: bool,
}

/// What of the state of the game matters here.
#[derive(Debug, Clone, Copy)]
struct Game {
    state: u8,
    own_half_is_left: bool,
    is_penalised: bool,
}

const MAP: &str = "map";
const ODOM: &str = "odom";
const FOOTPRINT: &str = "base_footprint";
/// Between poses.
const PERIOD: Duration = Duration::from_millis(20);
/// Between arrays of robots.
const ROBOTS_PERIOD: Duration = Duration::from_millis(100);
/// For how long odometry is kept: pictures may be as late.
const KEPT: Duration = Duration::from_secs(2);
/// The most samples of it.
const MOST_KEPT: usize = 1000;
/// How far a stamp may be ahead of the odometry.
const AHEAD: Duration = Duration::from_millis(100);
/// Without pictures the filters follow the odometry at this distance.
const BEHIND: Duration = Duration::from_secs(1);
/// The longest step of odometry that is no restart of it, in m.
const LONGEST_STEP: f64 = 0.5;
/// The most landmarks of a sort that are used.
const MOST_LANDMARKS: usize = 24;
/// How much of the round of a circle has to be seen. Of simulated circles below it two of three are lines.
const CIRCLE_CONFIDENCE: f32 = 0.6;
/// After which silence is reported.
const SILENCE: Duration = Duration::from_secs(5);
/// How long a robot that is put somewhere is carried: its gyroscope turns with it.
const CARRIED: Duration = Duration::from_secs(2);
/// How far a fall moves and turns a robot without its odometry, most of all one that rolls over to get up:
/// m, rad.
const FALLEN: (f64, f64) = (0.25, 0.2);
/// The least deviation of a ball's position, in m.
const BALL_DEVIATION: f64 = 0.01;
/// Of a robot's: it is wide, and its feet move. And of the direction to it, in rad.
const ROBOT_DEVIATION: f64 = 0.06;
const ROBOT_ANGLE_DEVIATION: f64 = 0.02;
/// What is seen nearer than this is the robot itself, in m.
const ITSELF: f64 = 0.12;

impl Localisation {
    fn on_odometry(&mut self, message: Received<'_, Odometry>, ctx: &mut Context<'_, Ports>) {
        let Some((pose, orientation)) = pose_of(&message) else {
            self.refused = Some("odom has numbers that are no pose".to_owned());
            return;
        };
        let at = time(&message.header);
        self.heard_at[0] = Some(ctx.now());
        if let Some((last_at, last)) = self.odometry.back() {
            let is_jump = last.position.distance(pose.position) > LONGEST_STEP;
            if at < *last_at || is_jump {
                self.odometry_restarts(pose);
            }
        }
        self.odometry.push_back((at, pose));
        let stands = self.may_be_put_at.take_if(|stands| *stands <= ctx.now()).is_some();
        if let Some(hypotheses) = self.hypotheses.as_mut().filter(|_| stands) {
            hypotheses.add(&self.starts);
        }
        while self.odometry.len() > MOST_KEPT
            || self.odometry.front().is_some_and(|(oldest, _)| at.saturating_since(*oldest) > KEPT)
        {
            self.odometry.pop_front();
        }
        match self.walked {
            None => {
                self.walked = Some((at, pose));
                self.believe();
            }
            Some((walked, _)) if at.saturating_since(walked) > BEHIND => {
                self.walk_to(at - BEHIND);
                self.believe();
            }
            Some(_) => {}
        }
        let is_due = self.published_at.is_none_or(|last| at < last || at.saturating_since(last) >= PERIOD);
        if is_due {
            self.published_at = Some(at);
            let height = message.pose.pose.position.z;
            self.publish(&message.header, pose, height, orientation, ctx);
        }
    }

    /// Where the robot is believed to be stays, although odometry begins anew at this pose.
    fn odometry_restarts(&mut self, pose: Pose) {
        if let Some((_, last)) = self.odometry.back().copied() {
            let last_at = self.odometry.back().map(|(at, _)| *at);
            last_at.into_iter().for_each(|at| self.walk_to(at));
            self.believe();
            self.map_from_odom = of_origin(self.map_from_odom.then(last), pose);
        }
        self.odometry.clear();
        self.walked = None;
        self.ball = BallFilter::default();
        self.robots = RobotTracks::default();
    }

    fn on_markings(&mut self, message: Received<'_, MarkingArray>, ctx: &mut Context<'_, Ports>) {
        let Some(at) = self.time_of_picture(&message.header) else { return };
        let seeing = self.seeing_at(at, ctx);
        seeing.has_markings = true;
        let landmarks = &mut seeing.landmarks;
        landmarks.intersections =
            message.intersections.iter().filter_map(intersection).take(MOST_LANDMARKS).collect();
        let lines = message.segments.iter().filter_map(|line| Some([point(&line.start)?, point(&line.end)?]));
        landmarks.lines = lines.take(MOST_LANDMARKS).collect();
        let circles =
            message.ellipses.iter().filter(|circle| circle.confidence.confidence >= CIRCLE_CONFIDENCE);
        landmarks.circle = circles.filter_map(|circle| point(&circle.center.position)).next();
        self.look(ctx);
    }

    fn on_posts(&mut self, message: Received<'_, GoalpostArray>, ctx: &mut Context<'_, Ports>) {
        let Some(at) = self.time_of_picture(&message.header) else { return };
        let seeing = self.seeing_at(at, ctx);
        seeing.has_posts = true;
        let posts = message.posts.iter().filter_map(|post| point(&post.bb.center.position));
        seeing.landmarks.posts = posts.take(MOST_LANDMARKS).collect();
        self.look(ctx);
    }

    fn on_ball(&mut self, message: Received<'_, Ball>, ctx: &mut Context<'_, Ports>) {
        let Some(at) = self.time_of_picture(&message.header) else { return };
        let (Some(position), Some(robot)) = (point(&message.point.point), self.odometry_at(at)) else {
            return;
        };
        let [xx, xy, _, _, yy, ..] = message.point.covariance;
        let is_covariance =
            [xx, xy, yy].iter().all(|part| part.is_finite()) && xx > 0.0 && yy > 0.0 && xy * xy < xx * yy;
        if !is_covariance {
            self.refused = Some(
                "vision/ball has no covariance of its position; publish it with one (xx, xy, yy)".to_owned(),
            );
            return;
        }
        let least = DMat2::from_diagonal(DVec2::splat(BALL_DEVIATION.powi(2)));
        let noise = DMat2::from_cols(DVec2::new(xx, xy), DVec2::new(xy, yy)) + least;
        let turn = DMat2::from_angle(robot.heading);
        self.ball_height = if message.point.point.z.is_finite() { message.point.point.z } else { 0.0 };
        let pitch = self.hypotheses.as_ref().map_or(0.0, Hypotheses::pitch);
        let position = pitched(position, *ctx.get(ctx.ports.camera_height), pitch);
        self.ball.see(robot.place(position), turn * noise * turn.transpose(), at);
    }

    fn on_robots(&mut self, message: Received<'_, SeenRobots>, ctx: &mut Context<'_, Ports>) {
        let Some(at) = self.time_of_picture(&message.header) else { return };
        let Some(robot) = self.odometry_at(at) else { return };
        let height = *ctx.get(ctx.ports.camera_height);
        let pitch = self.hypotheses.as_ref().map_or(0.0, Hypotheses::pitch);
        let turn = DMat2::from_angle(robot.heading);
        let least = DMat2::from_diagonal(DVec2::splat(ROBOT_DEVIATION.powi(2)));
        let sightings = message.robots.iter().filter_map(|seen| {
            let position = point(&seen.bb.center.position).filter(|point| point.length() > ITSELF)?;
            let [[xx, xy], [_, yy]] = floor_covariance(height, position, ROBOT_ANGLE_DEVIATION);
            let noise = DMat2::from_cols(DVec2::new(xx, xy), DVec2::new(xy, yy)) + least;
            Some(Sighting {
                position: robot.place(pitched(position, height, pitch)),
                noise: turn * noise * turn.transpose(),
                team: seen.attributes.team,
                state: seen.attributes.state,
            })
        });
        let sightings: Vec<Sighting> = sightings.take(MOST_LANDMARKS).collect();
        self.robots.see(&sightings, at);
    }

    fn on_game(&mut self, message: Received<'_, GameState>, ctx: &mut Context<'_, Ports>) {
        let game = Game {
            state: message.state,
            own_half_is_left: message.own_half_is_left,
            is_penalised: message.is_penalised,
        };
        let Some(last) = self.game.replace(game) else { return };
        let Some(hypotheses) = &mut self.hypotheses else { return };
        let is_placed = (game.state == GameState::INITIAL) != (last.state == GameState::INITIAL);
        if is_placed || game.own_half_is_left != last.own_half_is_left {
            hypotheses.restart(&self.starts);
        } else if last.is_penalised && !game.is_penalised {
            hypotheses.restart(&self.returns);
        } else if game.state == GameState::SET && last.state != GameState::SET {
            self.may_be_put_at = Some(ctx.now() + CARRIED);
            return;
        } else {
            return;
        }
        self.forget(ctx.now());
    }

    fn on_robot_state(&mut self, state: Received<'_, Text>, ctx: &mut Context<'_, Ports>) {
        let was_down = std::mem::replace(&mut self.is_down, state.data != RobotState::UPRIGHT);
        if was_down && !self.is_down {
            self.put_at = ctx.now();
            if let Some(hypotheses) = &mut self.hypotheses {
                hypotheses.scatter(FALLEN);
            }
        }
    }

    fn on_initial_pose(
        &mut self,
        message: Received<'_, PoseWithCovarianceStamped>,
        ctx: &mut Context<'_, Ports>,
    ) {
        let frame = message.header.frame_id.as_str();
        if !frame.is_empty() && frame != MAP {
            let frame: String = frame.chars().take(64).collect();
            return self.refuse(format!("initialpose is in the frame \"{frame}\"; send it in {MAP}"), ctx);
        }
        let Some((pose, _)) =
            pose_from(&message.pose.pose).filter(|(pose, _)| pose.position.length() < FARTHEST)
        else {
            return self.refuse("initialpose is no pose on the field".to_owned(), ctx);
        };
        let deviation = |at: usize, [least, most]: [f64; 2]| {
            let variance = message.pose.covariance[at];
            // 0 is what a sender leaves out.
            if variance > 0.0 { variance.sqrt().clamp(least, most) } else { (least * most).sqrt() }
        };
        let deviations = (deviation(0, [0.1, 1.0]).max(deviation(7, [0.1, 1.0])), deviation(35, [0.05, 1.0]));
        if let Some(hypotheses) = &mut self.hypotheses {
            hypotheses.restart_at(pose, deviations);
            self.forget(ctx.now());
        }
    }

    /// Reports at once what the next picture would make forgotten.
    fn refuse(&mut self, problem: String, ctx: &mut Context<'_, Ports>) {
        self.refused = Some(problem);
        self.report(ctx);
    }

    /// The robot was put somewhere else: what was seen from where it was is of no use.
    fn forget(&mut self, now: Time) {
        self.put_at = now;
        self.seeing = None;
        self.walked = self.odometry.back().copied();
        self.ball = BallFilter::default();
        self.robots = RobotTracks::default();
        self.believe();
    }

    /// The time of a picture, if it is in the right frame and odometry reaches back to it.
    fn time_of_picture(&mut self, header: &Header) -> Option<Time> {
        if header.frame_id != FOOTPRINT {
            let frame: String = header.frame_id.chars().take(64).collect();
            self.refused = Some(format!(
                "what is seen has to be in {FOOTPRINT}, as vision publishes it, not in \"{frame}\""
            ));
            return None;
        }
        let (oldest, newest) = (self.odometry.front()?.0, self.odometry.back()?.0);
        let at = time(header);
        if at < oldest || at > newest + AHEAD {
            self.refused = Some(format!(
                "a picture is {:.1} s {} the odometry; let both have stamps of one clock, and pictures arrive within 2 s",
                if at < oldest { oldest.saturating_since(at) } else { at.saturating_since(newest) }
                    .as_secs_f64(),
                if at < oldest { "before" } else { "ahead of" },
            ));
            return None;
        }
        self.refused = None;
        Some(at).filter(|at| !self.is_down && *at > self.put_at)
    }

    /// What is seen at this time so far; what was seen at another is used as it is.
    fn seeing_at(&mut self, at: Time, ctx: &Context<'_, Ports>) -> &mut Seeing {
        if self.seeing.as_ref().is_some_and(|seeing| seeing.at != at) {
            self.take_landmarks(ctx);
        }
        let landmarks =
            || Landmarks { camera_height: *ctx.get(ctx.ports.camera_height), ..Landmarks::default() };
        self.seeing.get_or_insert_with(|| Seeing {
            at,
            landmarks: landmarks(),
            has_markings: false,
            has_posts: false,
        })
    }

    fn look(&mut self, ctx: &Context<'_, Ports>) {
        if self.seeing.as_ref().is_some_and(|seeing| seeing.has_markings && seeing.has_posts) {
            self.take_landmarks(ctx);
        }
    }

    fn take_landmarks(&mut self, ctx: &Context<'_, Ports>) {
        let Some(Seeing { at, landmarks, .. }) = self.seeing.take() else { return };
        // A picture from before another that was used already.
        if self.walked.is_none_or(|(walked, _)| at < walked) {
            return;
        }
        self.walk_to(at);
        let Landmarks { intersections, lines, posts, circle, .. } = &landmarks;
        let is_empty = intersections.is_empty() && lines.is_empty() && posts.is_empty() && circle.is_none();
        let is_penalised = self.game.is_some_and(|game| game.is_penalised);
        if let Some(hypotheses) = &mut self.hypotheses
            && !is_empty
            && !is_penalised
        {
            hypotheses.see(&landmarks);
            self.heard_at[1] = Some(ctx.now());
        }
        self.believe();
    }

    fn walk_to(&mut self, at: Time) {
        let (Some((_, from)), Some(to)) = (self.walked, self.odometry_at(at)) else { return };
        if let Some(hypotheses) = &mut self.hypotheses {
            hypotheses.walk(from.step_to(to));
        }
        self.walked = Some((at, to));
    }

    fn believe(&mut self) {
        let (Some(hypotheses), Some((_, odometry))) = (&self.hypotheses, self.walked) else { return };
        self.believed = hypotheses.believed();
        self.map_from_odom = of_origin(self.believed.pose, odometry);
    }

    /// The pose in `odom` at this time, between two samples; the nearest one outside of them.
    fn odometry_at(&self, at: Time) -> Option<Pose> {
        let next = self.odometry.partition_point(|(time, _)| *time < at);
        let Some((after, later)) = self.odometry.get(next) else {
            return self.odometry.back().map(|(_, pose)| *pose);
        };
        let Some((before, earlier)) = next.checked_sub(1).and_then(|index| self.odometry.get(index)) else {
            return Some(*later);
        };
        let share =
            at.saturating_since(*before).as_secs_f64() / after.saturating_since(*before).as_secs_f64();
        let step = earlier.step_to(*later);
        Some(earlier.then(Pose { position: step.position * share, heading: step.heading * share }))
    }

    fn publish(
        &mut self,
        odometry: &Header,
        pose: Pose,
        height: f64,
        orientation: DQuat,
        ctx: &mut Context<'_, Ports>,
    ) {
        let header = Header { frame_id: MAP.to_owned(), ..odometry.clone() };
        let turn = DQuat::from_rotation_z(self.map_from_odom.heading);
        let DVec2 { x, y } = self.map_from_odom.position;
        ctx.ports.transforms.clone().send(
            ctx,
            [TransformStamped {
                header: header.clone(),
                child_frame_id: ODOM.to_owned(),
                transform: Transform { translation: Vector3 { x, y, z: 0.0 }, rotation: quaternion(turn) },
            }],
        );
        let place = self.map_from_odom.then(pose);
        let mut message = PoseWithCovarianceStamped { header: header.clone(), ..Default::default() };
        message.pose.pose.position = Point { x: place.position.x, y: place.position.y, z: height };
        message.pose.pose.orientation = quaternion(turn * orientation);
        // Of x, y, z and the rotations about them.
        for (row, to_row) in [0, 1, 5].into_iter().enumerate() {
            for (column, to_column) in [0, 1, 5].into_iter().enumerate() {
                message.pose.covariance[6 * to_row + to_column] = self.believed.covariance[row][column];
            }
        }
        ctx.publish(ctx.ports.pose, message);
        let timeout = Duration::from_secs_f64(*ctx.get(ctx.ports.ball_timeout));
        let now = time(odometry);
        self.ball.forget_after(now, timeout);
        if let Some(ball) = self.ball.ball(now, timeout) {
            let message = self.ball_in_map(&ball, header.clone());
            ctx.publish(ctx.ports.ball, message);
        }
        let is_due = |last: Time| now < last || now.saturating_since(last) >= ROBOTS_PERIOD;
        if self.robots_published_at.is_none_or(is_due) {
            self.robots_published_at = Some(now);
            let timeout = Duration::from_secs_f64(*ctx.get(ctx.ports.robot_timeout));
            self.robots.forget_after(now, timeout);
            let robots = self.robots_in_map(now, timeout);
            ctx.publish(ctx.ports.robots, RobotArray { header, robots });
        }
    }

    fn robots_in_map(&self, now: Time, timeout: Duration) -> Vec<Robot> {
        let turn = DMat2::from_angle(self.map_from_odom.heading);
        let in_map = |covariance: DMat2| (turn * covariance * turn.transpose()).to_cols_array_2d();
        let robots = self.robots.robots(now, timeout).map(|follow| {
            let position = self.map_from_odom.place(follow.track.position);
            let velocity = turn * follow.track.velocity;
            let [of_position, _, of_velocity] = follow.track.covariance.map(in_map);
            let mut robot = Robot { attributes: follow.attributes(), ..Robot::default() };
            robot.pose.pose.position = Point { x: position.x, y: position.y, z: 0.0 };
            robot.pose.pose.orientation.w = 1.0;
            robot.twist.twist.linear = Vector3 { x: velocity.x, y: velocity.y, z: 0.0 };
            for row in 0..2 {
                for column in 0..2 {
                    robot.pose.covariance[6 * row + column] = of_position[column][row];
                    robot.twist.covariance[6 * row + column] = of_velocity[column][row];
                }
            }
            // Where it faces is not known.
            robot.pose.covariance[35] = PI * PI;
            robot
        });
        robots.collect()
    }

    fn ball_in_map(&self, ball: &Track, header: Header) -> Ball {
        let position = self.map_from_odom.place(ball.position);
        let turn = DMat2::from_angle(self.map_from_odom.heading);
        let velocity = turn * ball.velocity;
        let [position_covariance, _, velocity_covariance] =
            ball.covariance.map(|covariance| turn * covariance * turn.transpose());
        let mut message = Ball { header, ..Ball::default() };
        message.point.point = Point { x: position.x, y: position.y, z: self.ball_height };
        let [[xx, xy], [yx, yy]] = position_covariance.to_cols_array_2d();
        message.point.covariance = [xx, yx, 0.0, xy, yy, 0.0, 0.0, 0.0, 1e-6];
        message.twist.twist.linear = Vector3 { x: velocity.x, y: velocity.y, z: 0.0 };
        let [[xx, xy], [yx, yy]] = velocity_covariance.to_cols_array_2d();
        for (index, value) in [(0, xx), (1, yx), (6, xy), (7, yy)] {
            message.twist.covariance[index] = value;
        }
        message
    }

    /// Reports the state if it changed.
    fn report(&mut self, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let is_silent = |heard: Option<Time>| heard.is_none_or(|at| now.saturating_since(at) > SILENCE);
        let is_penalised = self.game.is_some_and(|game| game.is_penalised);
        let is_decided = self.hypotheses.as_ref().is_some_and(Hypotheses::is_decided);
        let (level, message) = if is_silent(self.heard_at[0]) {
            (DiagnosticStatus::ERROR, "no odometry; let gait publish odom".to_owned())
        } else if let Some(refused) = &self.refused {
            (DiagnosticStatus::WARN, refused.clone())
        } else if is_penalised {
            (DiagnosticStatus::OK, "penalised: waits for the return to the field".to_owned())
        } else if is_silent(self.heard_at[1]) {
            let message =
                "odometry only: no landmarks for 5 s; let vision run, and the head look at the field";
            (DiagnosticStatus::WARN, message.to_owned())
        } else if is_decided {
            (DiagnosticStatus::OK, "knows where it is".to_owned())
        } else {
            (DiagnosticStatus::OK, "decides from where it came".to_owned())
        };
        if self.told.as_ref() == Some(&message) {
            return;
        }
        self.told = Some(message.clone());
        let name = format!("{}: position", ctx.module_name());
        let status = DiagnosticStatus { level, name, message, ..DiagnosticStatus::default() };
        let stamp = builtin_interfaces::msg::Time::from_nanos(now.as_nanos());
        let header = Header { stamp, frame_id: String::new() };
        ctx.publish(ctx.ports.diagnostics, DiagnosticArray { header, status: vec![status] });
    }
}

impl Module for Localisation {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let field = setup.read_only_setting(
            "field",
            String::new(),
            "name of a built-in field, or path of a file; empty: darwin_op_2014",
        )?;
        let name = setup.value(field).cloned().unwrap_or_default();
        let found = Field::named(&name).map_err(|error| setup.refuse_value(field, error.to_string()))?;
        let seed = setup.read_only_setting("seed", 1_i64, "same seed and messages, same beliefs")?;
        let seed = setup.value(seed).copied().unwrap_or_default();
        let about = "where the robot enters: x, y, heading in map (m, rad), up to four times; empty: the touch lines of its own half";
        let starts = places(setup, "starts", about)?;
        let returns =
            places(setup, "returns", "where it returns after a penalty, as starts; empty: as starts")?;
        self.starts = if starts.is_empty() { touch_lines(&found) } else { starts };
        self.returns = if returns.is_empty() { self.starts.clone() } else { returns };
        // Negative seeds are valid.
        self.hypotheses = Some(Hypotheses::new(found, &self.starts, seed.cast_unsigned()));
        setup.subscribe("game_state", Self::on_game)?;
        setup.subscribe("robot_state", Self::on_robot_state)?;
        setup.subscribe("initialpose", Self::on_initial_pose)?;
        setup.subscribe("odom", Self::on_odometry)?;
        setup.subscribe("vision/markings", Self::on_markings)?;
        setup.subscribe("vision/goalposts", Self::on_posts)?;
        setup.subscribe("vision/ball", Self::on_ball)?;
        setup.subscribe("vision/robots", Self::on_robots)?;
        setup.every(Duration::from_secs(1), Self::report)?;
        Ok(Ports {
            pose: setup.publish("pose")?,
            ball: setup.publish("ball")?,
            robots: setup.publish("robots")?,
            diagnostics: setup.publish("diagnostics")?,
            transforms: TransformBroadcaster::declare(setup)?,
            camera_height: setup.setting_in(
                "camera_height",
                0.33,
                0.1..=3.0,
                "m; of the camera above the floor",
            )?,
            ball_timeout: setup.setting_in(
                "ball_timeout",
                1.0,
                0.1..=60.0,
                "s; after which an unseen ball is forgotten",
            )?,
            robot_timeout: setup.setting_in(
                "robot_timeout",
                3.0,
                0.1..=60.0,
                "s; after which an unseen robot is forgotten",
            )?,
        })
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

/// Reads a setting of poses.
fn places(setup: &mut Setup<'_, Localisation>, name: &str, about: &str) -> Result<Vec<Pose>, SetupError> {
    let setting = setup.read_only_setting(name, Vec::<f64>::new(), about)?;
    let numbers = setup.value(setting).cloned().unwrap_or_default();
    let is_possible = numbers.len() % 3 == 0
        && numbers.len() <= 12
        && numbers.iter().all(|number| number.is_finite() && number.abs() <= 100.0);
    if !is_possible {
        let refusal = "it has x, y (m) and heading (rad) of up to four places, as [-1.0, 3.0, -1.57]";
        return Err(setup.refuse_value(setting, refusal));
    }
    let place = |three: &[f64]| Pose { position: DVec2::new(three[0], three[1]), heading: three[2] };
    Ok(numbers.chunks_exact(3).map(place).collect())
}

/// The middles of the touch lines of the own half, facing inwards.
fn touch_lines(field: &Field) -> Vec<Pose> {
    let at = |side: f64| Pose {
        position: DVec2::new(-field.length / 4.0, side * field.width / 2.0),
        heading: -side * FRAC_PI_2,
    };
    vec![at(1.0), at(-1.0)]
}

/// The pose of the origin of odometry in the map, from poses of the robot in both.
fn of_origin(in_map: Pose, in_odom: Pose) -> Pose {
    in_map.then(in_odom.step_to(Pose::default()))
}
