//! Where the ball is and how it rolls: a [`Track`]. Measurements that do not fit are outliers, until several
//! of them agree with each other: then the ball is there (it was kicked, or placed).

use crate::track::{Motion, Track};
use downbeat_executor::Time;
use glam::{DMat2, DVec2};

/// A ball, and one that may be instead.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct BallFilter {
    track: Option<Track>,
    rival: Option<Track>,
    seen_at: Time,
}

/// A ball rolls out.
const ROLLING: Motion = Motion { slows: 0.4, acceleration: 0.3, unknown_velocity: 0.5 };
/// How many measurements make a ball.
const CONFIRMED: u32 = 2;
/// How many measurements in a row make outliers the ball.
const REPLACED: u32 = 3;

impl BallFilter {
    /// Takes a measurement; an older one than the last is ignored.
    pub(crate) fn see(&mut self, position: DVec2, noise: DMat2, at: Time) {
        let Some(track) = self.track else {
            (self.track, self.seen_at) = (Some(Track::new(position, noise, at, &ROLLING)), at);
            return;
        };
        if at < track.at {
            return;
        }
        let track = track.at(at);
        if track.fits(position, noise) {
            (self.track, self.rival, self.seen_at) = (Some(track.corrected(position, noise)), None, at);
            return;
        }
        let rival = match self.rival.map(|rival| rival.at(at)) {
            Some(rival) if rival.fits(position, noise) => rival.corrected(position, noise),
            _ => Track::new(position, noise, at, &ROLLING),
        };
        self.rival = Some(rival);
        // A ball that was seen once only is not worth more than its rival.
        if rival.count >= if track.count < CONFIRMED { CONFIRMED } else { REPLACED } {
            (self.track, self.rival, self.seen_at) = (Some(rival), None, at);
        }
    }

    /// The ball, if it was seen at least twice, and not long ago.
    pub(crate) fn ball(&self, now: Time, timeout: std::time::Duration) -> Option<Track> {
        let track = self.track.filter(|track| track.count >= CONFIRMED)?;
        (now.saturating_since(self.seen_at) <= timeout).then(|| track.at(now))
    }

    /// Forgets a ball that was not seen for this long.
    pub(crate) fn forget_after(&mut self, now: Time, timeout: std::time::Duration) {
        if now.saturating_since(self.seen_at) > timeout {
            *self = Self::default();
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::time::Duration;

    const NOISE: DMat2 = DMat2::from_cols(DVec2::new(4e-4, 0.0), DVec2::new(0.0, 4e-4));

    fn time(seconds: f64) -> Time {
        Time::from_nanos((1e9 * seconds) as i64)
    }

    fn ball(filter: &BallFilter, seconds: f64) -> Option<Track> {
        filter.ball(time(seconds), Duration::from_secs(1))
    }

    #[test]
    fn a_rolling_ball_has_a_velocity() {
        let mut filter = BallFilter::default();
        for step in 0..30 {
            let seconds = 0.1 * f64::from(step);
            // Alternating errors of 1 cm.
            let error = DVec2::splat(if step % 2 == 0 { 0.01 } else { -0.01 });
            filter.see(DVec2::new(0.5 * seconds, 1.0) + error, NOISE, time(1.0 + seconds));
        }
        let found = ball(&filter, 4.0).unwrap();
        assert!(found.velocity.distance(DVec2::new(0.5, 0.0)) < 0.1, "{found:?}");
        assert!(found.position.distance(DVec2::new(1.5, 1.0)) < 0.05, "{found:?}");
    }

    #[test]
    fn a_ball_that_is_seen_for_long_stays_where_it_is() {
        let mut filter = BallFilter::default();
        for step in 0..20_000 {
            // Of a robot that turns and sees distances worse than directions.
            let turn = DMat2::from_angle(0.3 + 1e-4 * f64::from(step));
            let noise = turn * DMat2::from_diagonal(DVec2::new(4.7e-4, 8.6e-5)) * turn.transpose();
            let error = DVec2::splat(if step % 2 == 0 { 0.003 } else { -0.003 });
            filter.see(DVec2::new(0.9, 0.02) + error, noise, time(1.0 + 0.1 * f64::from(step)));
        }
        let found = ball(&filter, 2001.0).unwrap();
        assert!(found.position.distance(DVec2::new(0.9, 0.02)) < 0.02, "{found:?}");
        let [position, _, velocity] = found.covariance;
        assert!(position.determinant() > 0.0 && velocity.determinant() > 0.0, "{found:?}");
    }

    #[test]
    fn one_false_ball_changes_nothing_and_three_move_it() {
        let mut filter = BallFilter::default();
        let (true_ball, other) = (DVec2::new(1.0, 0.0), DVec2::new(-1.0, 2.0));
        (0..10).for_each(|step| filter.see(true_ball, NOISE, time(1.0 + 0.1 * f64::from(step))));
        filter.see(other, NOISE, time(2.0));
        assert!(ball(&filter, 2.0).unwrap().position.distance(true_ball) < 0.03);
        filter.see(true_ball, NOISE, time(2.1));
        (0..3).for_each(|step| filter.see(other, NOISE, time(2.2 + 0.1 * f64::from(step))));
        assert!(ball(&filter, 2.5).unwrap().position.distance(other) < 0.05);
    }

    #[test]
    fn a_ball_seen_once_or_long_ago_is_none() {
        let mut filter = BallFilter::default();
        filter.see(DVec2::X, NOISE, time(1.0));
        assert_eq!(ball(&filter, 1.0), None);
        filter.see(DVec2::X, NOISE, time(1.1));
        assert!(ball(&filter, 2.0).is_some());
        assert_eq!(ball(&filter, 2.2), None);
    }
}
