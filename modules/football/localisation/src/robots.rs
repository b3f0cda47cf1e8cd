//! Where other robots are and how they move: a [`Track`] for each, in a frame that stands still for seconds.
//!
//! What is seen in a picture is associated with tracks by global nearest neighbours, greedily: the closest
//! pair first, within the gate. What belongs to no track begins one, which counts once it was seen twice. A
//! track that is not seen is kept until a timeout, since the head looks elsewhere most of the time. The team
//! and whether a robot lies are evidence that adds up over sightings.
//!
//! # References
//! - S. Blackman, R. Popoli, "Design and Analysis of Modern Tracking Systems", 1999: section 6.4 (global
//!   nearest neighbours), 6.2 (track confirmation and deletion).

use crate::track::{Motion, Track};
use downbeat_executor::Time;
use downbeat_football::soccer_vision_attribute_msgs::msg::Robot as Attributes;
use glam::{DMat2, DVec2};
use std::time::Duration;

/// A robot in a picture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sighting {
    pub(crate) position: DVec2,
    pub(crate) noise: DMat2,
    /// As the message numbers them.
    pub(crate) team: u8,
    pub(crate) state: u8,
}

/// A robot that is followed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Follow {
    pub(crate) track: Track,
    seen_at: Time,
    /// Sightings of the own team less those of opponents.
    own: i32,
    /// Sightings that stand less those that lie.
    upright: i32,
}

/// All that are followed.
#[derive(Clone, Debug, Default)]
pub(crate) struct RobotTracks {
    follows: Vec<Follow>,
}

/// A robot walks at 0.1 to 0.2 m/s, and stops or turns within a second or two.
const WALKING: Motion = Motion { slows: 0.5, acceleration: 0.02, unknown_velocity: 0.02 };
/// How many sightings make a robot.
const CONFIRMED: u32 = 2;
/// For how long one that was seen once waits for the second time.
const UNCONFIRMED: Duration = Duration::from_millis(700);
/// The most robots that are followed: two teams of eleven.
const MOST: usize = 22;
/// Two robots do not stand nearer to each other, in m.
const APART: f64 = 0.2;
/// The most that evidence adds up to, so that it can change within a second.
const MOST_EVIDENCE: i32 = 8;
/// The evidence from which on it is believed.
const BELIEVED: i32 = 2;

impl RobotTracks {
    /// Takes all robots of one picture; an older one than the last is ignored.
    pub(crate) fn see(&mut self, sightings: &[Sighting], at: Time) {
        if self.follows.iter().any(|follow| at < follow.track.at) {
            return;
        }
        self.follows.iter_mut().for_each(|follow| follow.track = follow.track.at(at));
        let mut pairs = Vec::new();
        for (robot, follow) in self.follows.iter().enumerate() {
            let fitting =
                sightings.iter().enumerate().filter(|(_, one)| follow.track.fits(one.position, one.noise));
            pairs.extend(
                fitting.map(|(index, one)| (follow.track.distance(one.position, one.noise), robot, index)),
            );
        }
        pairs.sort_by(|one, other| one.0.total_cmp(&other.0));
        let (mut is_taken, mut is_used) = (vec![false; self.follows.len()], vec![false; sightings.len()]);
        for (_, robot, index) in pairs {
            if is_taken[robot] || is_used[index] {
                continue;
            }
            (is_taken[robot], is_used[index]) = (true, true);
            self.follows[robot].take(&sightings[index], at);
        }
        for (one, _) in sightings.iter().zip(is_used).filter(|(_, is_used)| !is_used) {
            if self.follows.len() >= MOST {
                break;
            }
            let track = Track::new(one.position, one.noise, at, &WALKING);
            let mut follow = Follow { track, seen_at: at, own: 0, upright: 0 };
            follow.count_evidence(one);
            self.follows.push(follow);
        }
        self.join();
    }

    /// Those that were seen often enough, and not too long ago, as they are now.
    pub(crate) fn robots(&self, now: Time, timeout: Duration) -> impl Iterator<Item = Follow> + '_ {
        let is_robot = move |follow: &&Follow| {
            follow.track.count >= CONFIRMED && now.saturating_since(follow.seen_at) <= timeout
        };
        self.follows
            .iter()
            .filter(is_robot)
            .map(move |follow| Follow { track: follow.track.at(now), ..*follow })
    }

    /// Forgets those that were not seen for this long.
    pub(crate) fn forget_after(&mut self, now: Time, timeout: Duration) {
        self.follows.retain(|follow| {
            let kept = if follow.track.count < CONFIRMED { UNCONFIRMED.min(timeout) } else { timeout };
            now.saturating_since(follow.seen_at) <= kept
        });
    }

    /// Of two at one place, the one that was seen more often is right.
    fn join(&mut self) {
        self.follows.sort_by_key(|follow| std::cmp::Reverse(follow.track.count));
        let mut kept: Vec<Follow> = Vec::with_capacity(self.follows.len());
        for follow in &self.follows {
            let is_there = |other: &Follow| other.track.position.distance(follow.track.position) < APART;
            if !kept.iter().any(is_there) {
                kept.push(*follow);
            }
        }
        self.follows = kept;
    }
}

impl Follow {
    fn take(&mut self, one: &Sighting, at: Time) {
        (self.track, self.seen_at) = (self.track.corrected(one.position, one.noise), at);
        self.count_evidence(one);
    }

    fn count_evidence(&mut self, one: &Sighting) {
        let count = |sum: i32, by: i32| (sum + by).clamp(-MOST_EVIDENCE, MOST_EVIDENCE);
        self.own = count(self.own, sign(one.team, Attributes::TEAM_OWN, Attributes::TEAM_OPPONENT));
        self.upright =
            count(self.upright, sign(one.state, Attributes::STATE_STANDING, Attributes::STATE_FALLEN));
    }

    /// As the message numbers them; the number is not seen.
    pub(crate) fn attributes(&self) -> Attributes {
        let believed = |sum: i32, positive, negative| match sum.signum() {
            1 if sum >= BELIEVED => positive,
            -1 if sum <= -BELIEVED => negative,
            _ => 0,
        };
        Attributes {
            team: believed(self.own, Attributes::TEAM_OWN, Attributes::TEAM_OPPONENT),
            state: believed(self.upright, Attributes::STATE_STANDING, Attributes::STATE_FALLEN),
            ..Attributes::default()
        }
    }
}

/// 1 or -1 for the two values, 0 for any other.
fn sign(value: u8, positive: u8, negative: u8) -> i32 {
    i32::from(value == positive) - i32::from(value == negative)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const TIMEOUT: Duration = Duration::from_secs(4);

    fn time(seconds: f64) -> Time {
        Time::from_nanos((1e9 * seconds) as i64)
    }

    fn sighting(x: f64, y: f64, team: u8) -> Sighting {
        let noise = DMat2::from_diagonal(DVec2::splat(0.0025));
        Sighting { position: DVec2::new(x, y), noise, team, state: Attributes::STATE_STANDING }
    }

    fn robots(tracks: &RobotTracks, seconds: f64) -> Vec<Follow> {
        tracks.robots(time(seconds), TIMEOUT).collect()
    }

    #[test]
    fn two_that_pass_each_other_keep_their_teams_and_have_velocities() {
        let mut tracks = RobotTracks::default();
        for step in 0..40 {
            let seconds = 0.1 * f64::from(step);
            // Alternating errors of 3 cm, and a colour that is seen wrong now and then.
            let error = if step % 2 == 0 { 0.03 } else { -0.03 };
            let team = if step % 7 == 3 { Attributes::TEAM_UNKNOWN } else { Attributes::TEAM_OWN };
            let there = sighting(0.15 * seconds + error, 0.3, team);
            let back = sighting(0.6 - 0.15 * seconds, -0.3 - error, Attributes::TEAM_OPPONENT);
            let both = if step % 3 == 0 { [there, back] } else { [back, there] };
            tracks.see(&both, time(1.0 + seconds));
        }
        let mut found = robots(&tracks, 4.9);
        assert_eq!(found.len(), 2);
        found.sort_by(|one, other| one.track.position.y.total_cmp(&other.track.position.y));
        let teams = [Attributes::TEAM_OPPONENT, Attributes::TEAM_OWN];
        assert_eq!([found[0].attributes().team, found[1].attributes().team], teams);
        assert!((found[1].track.velocity.x - 0.15).abs() < 0.05, "{found:?}");
        assert!((found[0].track.velocity.x + 0.15).abs() < 0.05, "{found:?}");
        assert_eq!(found[1].attributes().state, Attributes::STATE_STANDING);
    }

    #[test]
    fn one_out_of_view_is_kept_until_the_timeout_and_less_certain() {
        let mut tracks = RobotTracks::default();
        (0..5).for_each(|step| tracks.see(&[sighting(1.0, 0.0, 0)], time(1.0 + 0.1 * f64::from(step))));
        let [before, after] = [1.4, 4.4].map(|seconds| robots(&tracks, seconds)[0].track);
        assert!(after.position.distance(DVec2::X) < 0.1);
        assert!(after.covariance[0].determinant() > 4.0 * before.covariance[0].determinant());
        // Nothing of it in later pictures.
        tracks.see(&[], time(5.0));
        assert_eq!(robots(&tracks, 5.3).len(), 1);
        assert_eq!(robots(&tracks, 5.5).len(), 0);
        tracks.forget_after(time(5.5), TIMEOUT);
        assert!(tracks.follows.is_empty());
    }

    #[test]
    fn one_false_sighting_is_no_robot_and_one_wrong_colour_changes_no_team() {
        let mut tracks = RobotTracks::default();
        for step in 0..25 {
            let team = if step == 10 { Attributes::TEAM_OPPONENT } else { Attributes::TEAM_OWN };
            let mut seen = vec![sighting(1.0, 0.0, team)];
            seen.extend((step == 12).then(|| sighting(2.5, 1.0, 0)));
            let now = 1.0 + 0.1 * f64::from(step);
            tracks.see(&seen, time(now));
            tracks.forget_after(time(now), TIMEOUT);
        }
        let found = robots(&tracks, 3.4);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].attributes().team, Attributes::TEAM_OWN);
        assert_eq!(tracks.follows.len(), 1, "the false one is forgotten");
    }

    #[test]
    fn however_many_are_seen_a_bounded_number_is_followed() {
        let mut tracks = RobotTracks::default();
        for step in 0..10 {
            let many: Vec<Sighting> =
                (0..200).map(|index| sighting(f64::from(index), f64::from(step) * 3.0, 0)).collect();
            tracks.see(&many, time(1.0 + 0.1 * f64::from(step)));
        }
        assert!(tracks.follows.len() <= MOST);
    }

    #[test]
    fn one_that_falls_lies_within_a_second() {
        let mut tracks = RobotTracks::default();
        for step in 0..30 {
            let mut one = sighting(1.0, 0.0, 0);
            if step >= 20 {
                one.state = Attributes::STATE_FALLEN;
            }
            tracks.see(&[one], time(1.0 + 0.1 * f64::from(step)));
        }
        assert_eq!(robots(&tracks, 4.0)[0].attributes().state, Attributes::STATE_FALLEN);
    }
}
