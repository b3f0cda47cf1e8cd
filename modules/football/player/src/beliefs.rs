//! The beliefs of a player: its place, the ball and the other robots.

use downbeat_executor::Time;
use downbeat_football::soccer_model_msgs::msg::{Ball, RobotArray};
use downbeat_football::soccer_vision_attribute_msgs::msg::Robot as Attributes;
use downbeat_kinematics::wrapped;
use downbeat_msgs::geometry_msgs::msg::{PoseWithCovarianceStamped, Quaternion};
use glam::DVec2;
use std::time::Duration;

/// A position on the field and a heading, in m and rad.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Place {
    pub(crate) position: DVec2,
    pub(crate) heading: f64,
}

/// The latest messages; they are used only while fresh.
#[derive(Clone, Debug, Default)]
pub(crate) struct Beliefs {
    place: Option<(Time, Place)>,
    ball: Option<(Time, RollingBall)>,
    robots: Option<(Time, Vec<Other>)>,
}

/// A ball on the field, in m and m/s.
#[derive(Clone, Copy, Debug, PartialEq)]
struct RollingBall {
    position: DVec2,
    velocity: DVec2,
}

/// Another robot, in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Other {
    pub(crate) position: DVec2,
    /// True if the robot lies on the floor.
    pub(crate) is_fallen: bool,
}

/// The age beyond which a belief is ignored.
const FRESH: Duration = Duration::from_secs(1);
/// What slows a ball on carpet down, as a share of its weight: that of a simulated ball.
const ROLLING_FRICTION: f64 = 0.05;
const GRAVITY: f64 = 9.81;
/// A ball is not expected to roll farther, in m.
const LONGEST_ROLL: f64 = 2.0;
/// A ball that is nearer rolls because the player pushes it, in m.
const AT_FEET: f64 = 0.5;
/// The largest number of robots; further ones are ignored.
const MOST_ROBOTS: usize = 32;

impl Place {
    /// This place, relative to another one.
    pub(crate) fn seen_from(self, from: Self) -> Self {
        Self { position: from.point(self.position), heading: wrapped(self.heading - from.heading) }
    }

    /// A point on the field, relative to this place: ahead, to the left.
    pub(crate) fn point(self, on_field: DVec2) -> DVec2 {
        DVec2::from_angle(-self.heading).rotate(on_field - self.position)
    }
}

impl Beliefs {
    /// Takes a pose in `map`, and ignores it if it is not finite.
    pub(crate) fn take_pose(&mut self, pose: &PoseWithCovarianceStamped, now: Time) {
        let pose = &pose.pose.pose;
        let position = DVec2::new(pose.position.x, pose.position.y);
        let place = Place { position, heading: heading_of(&pose.orientation) };
        if position.is_finite() && place.heading.is_finite() {
            self.place = Some((now, place));
        }
    }

    /// Takes a ball in `map`, and ignores it if it is not finite.
    pub(crate) fn take_ball(&mut self, ball: &Ball, now: Time) {
        let position = DVec2::new(ball.point.point.x, ball.point.point.y);
        let velocity = DVec2::new(ball.twist.twist.linear.x, ball.twist.twist.linear.y);
        let velocity = if velocity.is_finite() { velocity } else { DVec2::ZERO };
        if position.is_finite() {
            self.ball = Some((now, RollingBall { position, velocity }));
        }
    }

    /// Takes the other robots in `map`, except those whose position is not finite.
    pub(crate) fn take_robots(&mut self, robots: &RobotArray, now: Time) {
        let others = robots.robots.iter().map(|robot| {
            let at = &robot.pose.pose.position;
            let is_fallen = robot.attributes.state == Attributes::STATE_FALLEN;
            Other { position: DVec2::new(at.x, at.y), is_fallen }
        });
        let others = others.filter(|other| other.position.is_finite());
        self.robots = Some((now, others.take(MOST_ROBOTS).collect()));
    }

    /// The other robots on the field; empty if the belief is not fresh.
    pub(crate) fn robots(&self, now: Time) -> &[Other] {
        let fresh = self.robots.as_ref().filter(|(at, _)| now.saturating_since(*at) <= FRESH);
        fresh.map_or(&[], |(_, robots)| robots)
    }

    pub(crate) fn place(&self, now: Time) -> Option<Place> {
        self.place.filter(|(at, _)| now.saturating_since(*at) <= FRESH).map(|(_, place)| place)
    }

    /// The position of the ball on the field.
    pub(crate) fn ball(&self, now: Time) -> Option<DVec2> {
        self.rolling_ball(now).map(|ball| ball.position)
    }

    /// Where a player who is here finds the ball: a rolling one where it comes to rest, unless it is at the
    /// player's feet.
    pub(crate) fn ball_for(&self, here: DVec2, now: Time) -> Option<DVec2> {
        let RollingBall { position, velocity } = self.rolling_ball(now)?;
        if here.distance(position) < AT_FEET {
            return Some(position);
        }
        let roll = velocity * velocity.length() / (2.0 * ROLLING_FRICTION * GRAVITY);
        Some(position + roll.clamp_length_max(LONGEST_ROLL))
    }

    fn rolling_ball(&self, now: Time) -> Option<RollingBall> {
        self.ball.filter(|(at, _)| now.saturating_since(*at) <= FRESH).map(|(_, ball)| ball)
    }
}

/// The rotation about z, in rad.
pub(crate) fn heading_of(q: &Quaternion) -> f64 {
    libm::atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn believed(vx: f64) -> Beliefs {
        let mut ball = Ball::default();
        ball.point.point.x = 1.0;
        ball.twist.twist.linear.x = vx;
        let mut beliefs = Beliefs::default();
        beliefs.take_ball(&ball, Time::ZERO);
        beliefs
    }

    #[test]
    fn a_rolling_ball_is_found_where_it_comes_to_rest() {
        let found = |vx, here| believed(vx).ball_for(DVec2::new(here, 0.0), Time::ZERO);
        let x = |vx, here| found(vx, here).map_or(f64::NAN, |ball| ball.x);
        assert_eq!(x(0.0, 0.0), 1.0);
        // 1 m/s against 0.49 m/s².
        assert!((x(1.0, 0.0) - 2.019).abs() < 1e-3 && (x(-1.0, 0.0) + 0.019).abs() < 1e-3, "{}", x(1.0, 0.0));
        // The noise of a ball that lies moves it by less than a footstep.
        assert!((x(0.1, 0.0) - 1.0).abs() < 0.011, "{}", x(0.1, 0.0));
        assert_eq!(x(9.0, 0.0), 3.0, "the longest way");
        assert_eq!(x(1.0, 0.6), 1.0, "at the feet");
        assert_eq!(believed(1.0).ball(Time::ZERO), Some(DVec2::X), "the head looks at the ball");
        assert_eq!(believed(f64::NAN).ball_for(DVec2::ZERO, Time::ZERO), Some(DVec2::X));
    }
}
