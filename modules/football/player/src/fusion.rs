//! The shared knowledge of a team: the ball, and the robots on the field.
//!
//! Estimates close to each other belong to one object; they are averaged with the inverse of their variances
//! as weights. Older estimates are less certain, because a ball may have been kicked and a robot may have
//! walked.

use downbeat_executor::Time;
use downbeat_football::football_interfaces::msg::TeamMessage;
use downbeat_football::soccer_vision_attribute_msgs::msg::Robot as Attributes;
use glam::DVec2;
use std::time::Duration;

use crate::mates::sent_at;

/// An estimate of the ball by one player.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BallEstimate {
    pub(crate) position: DVec2,
    pub(crate) velocity: DVec2,
    /// In m².
    pub(crate) variance: f64,
    /// The time since the ball was seen.
    pub(crate) age: Duration,
}

/// An estimate of another robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RobotEstimate {
    pub(crate) position: DVec2,
    pub(crate) velocity: DVec2,
    /// In m².
    pub(crate) variance: f64,
    pub(crate) attributes: Attributes,
}

/// The lower limit of variances, in m².
const LEAST: f64 = 1e-4;
/// The possible speed of an unobserved ball and of an unobserved robot, in m/s.
const BALL_DRIFT: f64 = 0.3;
const ROBOT_DRIFT: f64 = 0.15;
/// The share of its velocity that a rolling ball loses per second.
const ROLL_OUT: f64 = 0.4;
/// Estimates farther apart belong to different balls, in m.
const SAME_BALL: f64 = 1.0;
/// Estimates farther apart belong to different robots, in m; the second value applies if one of them is a
/// mate's own position.
const SAME_ROBOT: f64 = 0.4;
const SAME_MATE: f64 = 0.6;
/// The largest number of robots.
const MOST: usize = 22;

/// The ball of the team: the position on which most of the weight agrees.
pub(crate) fn ball_of_team(
    own: Option<BallEstimate>,
    mates: &[&TeamMessage],
    now: Time,
) -> Option<BallEstimate> {
    let said = mates.iter().filter(|message| message.sees_ball && message.state != TeamMessage::PENALISED);
    let of_mates = said.map(|message| {
        let since = now.saturating_since(sent_at(message));
        BallEstimate {
            position: DVec2::new(message.ball.x, message.ball.y),
            velocity: DVec2::new(message.ball_velocity.x, message.ball_velocity.y),
            variance: f64::from(message.ball_variance) + variance_of_pose(message),
            age: since + Duration::from_secs_f64(f64::from(message.ball_age).clamp(0.0, 60.0)),
        }
        .later(since)
    });
    let estimates: Vec<BallEstimate> = own.into_iter().chain(of_mates).collect();
    let best = *estimates.iter().max_by(|one, other| one.weight().total_cmp(&other.weight()))?;
    let same = || estimates.iter().filter(|one| one.position.distance(best.position) <= SAME_BALL);
    let weight: f64 = same().map(BallEstimate::weight).sum();
    let mean =
        |of: fn(&BallEstimate) -> DVec2| same().map(|one| of(one) * one.weight()).sum::<DVec2>() / weight;
    Some(BallEstimate {
        position: mean(|one| one.position),
        velocity: mean(|one| one.velocity),
        variance: 1.0 / weight,
        age: same().map(|one| one.age).min().unwrap_or(best.age),
    })
}

/// All other robots: mates at their reported positions, opponents as seen by any player. `own` is the
/// position of this player.
pub(crate) fn robots_of_team(
    own: Option<DVec2>,
    seen: &[RobotEstimate],
    mates: &[&TeamMessage],
    now: Time,
) -> Vec<RobotEstimate> {
    let mut robots: Vec<RobotEstimate> = mates.iter().map(|message| mate(message, now)).collect();
    let known = robots.len();
    for one in seen {
        // Matches by the player number, or else the nearest candidate.
        let by_number = robots[..known].iter().position(|mate| {
            one.attributes.team == Attributes::TEAM_OWN
                && one.attributes.player_number != 0
                && mate.attributes.player_number == one.attributes.player_number
        });
        match by_number.or_else(|| same_as(one, &robots, known)) {
            Some(index) => robots[index].merge(one),
            None => robots.push(*one),
        }
    }
    for message in mates {
        let age = now.saturating_since(sent_at(message)).as_secs_f64();
        for other in &message.others {
            let position = DVec2::new(other.x.into(), other.y.into());
            let attributes =
                Attributes { team: other.team, player_number: other.player_number, ..Attributes::default() };
            let variance =
                f64::from(other.variance) + variance_of_pose(message) + (ROBOT_DRIFT * age).powi(2);
            let one = RobotEstimate { position, velocity: DVec2::ZERO, variance, attributes };
            let is_own = own.is_some_and(|own| own.distance(position) <= SAME_MATE);
            if is_own && other.team != Attributes::TEAM_OPPONENT {
                continue;
            }
            match same_as(&one, &robots, known) {
                Some(index) => robots[index].merge(&one),
                None => robots.push(one),
            }
        }
    }
    robots.truncate(MOST);
    robots
}

fn mate(message: &TeamMessage, now: Time) -> RobotEstimate {
    let at = &message.pose.pose.position;
    let age = now.saturating_since(sent_at(message)).as_secs_f64();
    RobotEstimate {
        position: DVec2::new(at.x, at.y),
        velocity: DVec2::ZERO,
        variance: variance_of_pose(message) + (ROBOT_DRIFT * age).powi(2),
        attributes: Attributes {
            player_number: message.player,
            team: Attributes::TEAM_OWN,
            state: match message.state {
                TeamMessage::FALLEN => Attributes::STATE_FALLEN,
                TeamMessage::PENALISED => Attributes::STATE_INACTIVE,
                _ => Attributes::STATE_STANDING,
            },
            ..Attributes::default()
        },
    }
}

/// The nearest robot that may be the same; the first `mates` robots are mates with reported positions.
fn same_as(one: &RobotEstimate, robots: &[RobotEstimate], mates: usize) -> Option<usize> {
    let is_one_team = |other: &RobotEstimate| {
        let [one, other] = [one, other].map(|robot| robot.attributes.team);
        one == other || one == Attributes::TEAM_UNKNOWN || other == Attributes::TEAM_UNKNOWN
    };
    let distances =
        robots.iter().enumerate().filter(|(_, other)| is_one_team(other)).filter_map(|(index, other)| {
            let gate = if index < mates { SAME_MATE } else { SAME_ROBOT };
            let distance = other.position.distance(one.position);
            (distance <= gate).then_some((index, distance))
        });
    distances.min_by(|one, other| one.1.total_cmp(&other.1)).map(|(index, _)| index)
}

fn variance_of_pose(message: &TeamMessage) -> f64 {
    (message.pose.covariance[0] + message.pose.covariance[7]) / 2.0
}

impl BallEstimate {
    fn later(self, by: Duration) -> Self {
        let kept = (1.0 - libm::exp(-ROLL_OUT * by.as_secs_f64())) / ROLL_OUT;
        Self { position: self.position + self.velocity * kept, ..self }
    }

    fn weight(&self) -> f64 {
        1.0 / (LEAST + self.variance + (BALL_DRIFT * self.age.as_secs_f64()).powi(2))
    }
}

impl RobotEstimate {
    /// Merges another estimate of the same robot.
    fn merge(&mut self, other: &Self) {
        let [one, two] = [self.variance, other.variance].map(|variance| 1.0 / (LEAST + variance));
        self.position = (self.position * one + other.position * two) / (one + two);
        self.variance = 1.0 / (one + two);
        if self.velocity == DVec2::ZERO {
            self.velocity = other.velocity;
        }
        let Attributes { player_number, team, state, facing } = &mut self.attributes;
        for (known, said) in [
            (player_number, other.attributes.player_number),
            (team, other.attributes.team),
            (state, other.attributes.state),
            (facing, other.attributes.facing),
        ] {
            if *known == 0 {
                *known = said;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_football::football_interfaces::msg::SeenRobot;
    use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;

    const NOW: Time = Time::from_nanos(10_000_000_000);

    fn message(player: u8, at: [f64; 2], ball: Option<[f64; 2]>) -> TeamMessage {
        let mut message = TeamMessage { team: 1, player, ball_variance: 0.01, ..TeamMessage::default() };
        message.header.stamp = Stamp::from_nanos(NOW.as_nanos());
        (message.pose.pose.position.x, message.pose.pose.position.y) = at.into();
        if let Some(ball) = ball {
            message.sees_ball = true;
            (message.ball.x, message.ball.y) = ball.into();
        }
        message
    }

    fn robot(x: f64, y: f64, team: u8) -> RobotEstimate {
        let attributes = Attributes { team, ..Attributes::default() };
        RobotEstimate { position: DVec2::new(x, y), velocity: DVec2::ZERO, variance: 0.01, attributes }
    }

    #[test]
    fn a_ball_that_two_see_is_between_them_and_more_certain() {
        let [one, other] =
            [message(3, [0.0, 0.0], Some([1.0, 0.0])), message(4, [0.0, 0.0], Some([1.2, 0.0]))];
        let ball = ball_of_team(None, &[&one, &other], NOW).unwrap();
        assert!((ball.position.x - 1.1).abs() < 1e-9 && ball.variance < 0.006, "{ball:?}");
        assert_eq!(ball_of_team(None, &[&message(3, [0.0; 2], None)], NOW), None);
    }

    #[test]
    fn an_old_or_a_far_ball_weighs_little() {
        let mut old = message(3, [0.0, 0.0], Some([1.0, 0.0]));
        old.ball_age = 3.0;
        let new = message(4, [0.0, 0.0], Some([1.5, 0.0]));
        let ball = ball_of_team(None, &[&old, &new], NOW).unwrap();
        assert!((ball.position.x - 1.5).abs() < 0.02, "{ball:?}");
        // If two balls are far apart, the more certain one counts.
        let mut vague = message(5, [0.0, 0.0], Some([-2.0, 0.0]));
        vague.ball_variance = 1.0;
        assert_eq!(ball_of_team(None, &[&vague, &new], NOW).unwrap().position, DVec2::new(1.5, 0.0));
        let own =
            BallEstimate { position: DVec2::Y, velocity: DVec2::ZERO, variance: 0.001, age: Duration::ZERO };
        assert_eq!(ball_of_team(Some(own), &[&new], NOW).unwrap().position, DVec2::Y);
    }

    #[test]
    fn a_rolling_ball_has_rolled_on_when_the_message_arrives() {
        let mut rolling = message(3, [0.0, 0.0], Some([0.0, 0.0]));
        rolling.ball_velocity.x = 1.0;
        let later = NOW + Duration::from_millis(100);
        let ball = ball_of_team(None, &[&rolling], later).unwrap();
        assert!(
            (ball.position.x - 0.098).abs() < 0.002 && ball.age == Duration::from_millis(100),
            "{ball:?}"
        );
    }

    #[test]
    fn mates_are_where_they_say_and_seen_ones_are_not_there_twice() {
        let mates = [message(1, [-2.0, 0.0], None), message(3, [0.0, 1.0], None)];
        let mates: Vec<&TeamMessage> = mates.iter().collect();
        let seen = [
            robot(-1.8, 0.1, Attributes::TEAM_OWN),
            robot(0.1, 1.1, Attributes::TEAM_UNKNOWN),
            // An opponent close to a mate remains an opponent.
            robot(0.3, 1.0, Attributes::TEAM_OPPONENT),
        ];
        let robots = robots_of_team(None, &seen, &mates, NOW);
        let who: Vec<(u8, u8)> =
            robots.iter().map(|robot| (robot.attributes.team, robot.attributes.player_number)).collect();
        assert_eq!(who, [(1, 1), (1, 3), (2, 0)]);
    }

    #[test]
    fn opponents_that_others_see_are_there_and_the_player_itself_is_not() {
        let mut mate = message(3, [0.0, 0.0], None);
        let other = |x: f32, team| SeenRobot { x, y: 0.0, variance: 0.01, team, player_number: 0 };
        mate.others = vec![
            other(1.0, Attributes::TEAM_OPPONENT),
            other(1.2, Attributes::TEAM_UNKNOWN),
            other(-1.0, Attributes::TEAM_OWN),
            other(2.5, Attributes::TEAM_OPPONENT),
        ];
        let seen = [robot(1.1, 0.0, Attributes::TEAM_UNKNOWN)];
        let robots = robots_of_team(Some(DVec2::new(-1.1, 0.0)), &seen, &[&mate], NOW);
        let places: Vec<(u8, i64)> = robots
            .iter()
            .map(|robot| (robot.attributes.team, (robot.position.x * 10.0).round() as i64))
            .collect();
        assert_eq!(places, [(1, 0), (2, 11), (2, 25)]);
    }

    #[test]
    fn however_many_are_said_a_bounded_number_is_there() {
        let mut mate = message(3, [0.0, 0.0], None);
        let many = (0..100_u8).map(|index| SeenRobot {
            x: f32::from(index),
            variance: 0.01,
            ..SeenRobot::default()
        });
        mate.others = many.collect();
        assert_eq!(robots_of_team(None, &[], &[&mate], NOW).len(), MOST);
    }
}
