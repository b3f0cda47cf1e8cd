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
    ball: Option<(Time, DVec2)>,
    robots: Option<(Time, Vec<Other>)>,
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
        if position.is_finite() {
            self.ball = Some((now, position));
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
        self.ball.filter(|(at, _)| now.saturating_since(*at) <= FRESH).map(|(_, ball)| ball)
    }
}

/// The rotation about z, in rad.
pub(crate) fn heading_of(q: &Quaternion) -> f64 {
    libm::atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
}
