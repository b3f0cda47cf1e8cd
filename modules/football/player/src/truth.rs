//! Publishes the pose and the ball from a simulation's truth with noise, in place of vision and localisation.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `ground_truth/odom` (in) | `nav_msgs/Odometry` | pose of the root link on the field |
//! | `ground_truth/ball` (in) | `geometry_msgs/PoseStamped` | position on the field |
//! | `ground_truth/robots` (in) | `soccer_model_msgs/RobotArray` | the other robots on the field |
//! | `pose` | `geometry_msgs/PoseWithCovarianceStamped` | in `map`, for each true pose |
//! | `ball` | `soccer_model_msgs/Ball` | in `map`, if it is within `range` |
//! | `robots` | `soccer_model_msgs/RobotArray` | in `map`, the robots within `range` |
//!
//! | setting | |
//! | --- | --- |
//! | `seed` | same seed, same noise |
//! | `position_noise`, `heading_noise` | standard deviations, m and rad; errors change within a second |
//! | `ball_noise` | standard deviation of ball and robots as a share of the distance |
//! | `range` | largest distance at which they are seen, m |

use crate::beliefs::{Place, heading_of};
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError};
use downbeat_football::soccer_model_msgs::msg::{Ball, RobotArray};
use downbeat_msgs::geometry_msgs::msg::{PoseStamped, PoseWithCovarianceStamped, Quaternion};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_servos::servo_emulator::Random;
use glam::DVec2;

/// Publishes the truth with noise; see the [module page](self).
#[derive(Debug, Default)]
pub struct TruthBeliefs {
    random: Option<Random>,
    place: Option<Place>,
    error: Place,
}

/// The keys of [`TruthBeliefs`].
pub struct Ports {
    pose: Publication<PoseWithCovarianceStamped>,
    ball: Publication<Ball>,
    robots: Publication<RobotArray>,
    position_noise: Setting<f64>,
    heading_noise: Setting<f64>,
    ball_noise: Setting<f64>,
    range: Setting<f64>,
}

/// The frame of the field.
const MAP: &str = "map";
/// The share of an error that remains until the next truth.
const KEPT: f64 = 0.95;

impl TruthBeliefs {
    fn on_odometry(&mut self, truth: Received<'_, Odometry>, ctx: &mut Context<'_, Ports>) {
        let Some(random) = &mut self.random else { return };
        let pose = &truth.pose.pose;
        let position = DVec2::new(pose.position.x, pose.position.y);
        let place = Place { position, heading: heading_of(&pose.orientation) };
        self.place = Some(place);
        let deviations = [*ctx.get(ctx.ports.position_noise), *ctx.get(ctx.ports.heading_noise)];
        // A first-order autoregressive error with these standard deviations.
        let [far, turned] = deviations.map(|deviation| deviation * (1.0 - KEPT * KEPT).sqrt());
        let drift = DVec2::new(random.normal(far), random.normal(far));
        self.error = Place {
            position: self.error.position * KEPT + drift,
            heading: self.error.heading * KEPT + random.normal(turned),
        };
        let position = place.position + self.error.position;
        let mut message = PoseWithCovarianceStamped { header: truth.header.clone(), ..Default::default() };
        message.header.frame_id = MAP.to_owned();
        (message.pose.pose.position.x, message.pose.pose.position.y) = (position.x, position.y);
        let (z, w) = libm::sincos((place.heading + self.error.heading) / 2.0);
        message.pose.pose.orientation = Quaternion { x: 0.0, y: 0.0, z, w };
        for (index, deviation) in [(0, deviations[0]), (7, deviations[0]), (35, deviations[1])] {
            message.pose.covariance[index] = deviation * deviation;
        }
        ctx.publish(ctx.ports.pose, message);
    }

    fn on_ball(&mut self, truth: Received<'_, PoseStamped>, ctx: &mut Context<'_, Ports>) {
        let (Some(random), Some(place)) = (&mut self.random, self.place) else { return };
        let ball = DVec2::new(truth.pose.position.x, truth.pose.position.y);
        let distance = (ball - place.position).length();
        if distance > *ctx.get(ctx.ports.range) {
            return;
        }
        let deviation = *ctx.get(ctx.ports.ball_noise) * distance;
        let believed = believed(ball, place, self.error, deviation, random);
        let mut message = Ball { header: truth.header.clone(), ..Ball::default() };
        message.header.frame_id = MAP.to_owned();
        (message.point.point.x, message.point.point.y) = (believed.x, believed.y);
        message.point.point.z = truth.pose.position.z;
        (message.point.covariance[0], message.point.covariance[4]) = (deviation.powi(2), deviation.powi(2));
        ctx.publish(ctx.ports.ball, message);
    }
}

impl TruthBeliefs {
    fn on_robots(&mut self, truth: Received<'_, RobotArray>, ctx: &mut Context<'_, Ports>) {
        let (Some(random), Some(place)) = (&mut self.random, self.place) else { return };
        let (range, noise) = (*ctx.get(ctx.ports.range), *ctx.get(ctx.ports.ball_noise));
        let mut message = truth.clone();
        message.header.frame_id = MAP.to_owned();
        message.robots.retain_mut(|robot| {
            let at = &mut robot.pose.pose.position;
            let position = DVec2::new(at.x, at.y);
            let distance = (position - place.position).length();
            (at.x, at.y) = believed(position, place, self.error, noise * distance, random).into();
            distance <= range
        });
        ctx.publish(ctx.ports.robots, message);
    }
}

/// The believed position of an object at this point of the field, seen by a robot that localises itself with
/// an error.
fn believed(at: DVec2, place: Place, error: Place, deviation: f64, random: &mut Random) -> DVec2 {
    let seen = place.point(at) + DVec2::new(random.normal(deviation), random.normal(deviation));
    place.position + error.position + DVec2::from_angle(place.heading + error.heading).rotate(seen)
}

impl Module for TruthBeliefs {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let seed = setup.read_only_setting("seed", 1_i64, "same seed, same noise")?;
        let seed = setup.value(seed).copied().unwrap_or_default();
        // Negative seeds are valid.
        self.random = Some(Random::new(seed.cast_unsigned(), 3));
        setup.subscribe("ground_truth/odom", Self::on_odometry)?;
        setup.subscribe("ground_truth/ball", Self::on_ball)?;
        setup.subscribe("ground_truth/robots", Self::on_robots)?;
        let about = "m; standard deviation of the position";
        Ok(Ports {
            pose: setup.publish("pose")?,
            ball: setup.publish("ball")?,
            robots: setup.publish("robots")?,
            position_noise: setup.setting_in("position_noise", 0.03, 0.0..=10.0, about)?,
            heading_noise: setup.setting_in(
                "heading_noise",
                0.03,
                0.0..=3.0,
                "rad; standard deviation of the heading",
            )?,
            ball_noise: setup.setting_in(
                "ball_noise",
                0.03,
                0.0..=1.0,
                "standard deviation of the ball's position, as a share of its distance",
            )?,
            range: setup.setting_in("range", 20.0, 0.1..=100.0, "m; the ball is seen up to this distance")?,
        })
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}
