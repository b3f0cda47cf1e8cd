//! A Kalman filter of position and velocity of something that moves on the floor, in a frame that stands
//! still for seconds.
//!
//! The state is x = (p, v), with p' = v and v' = -k v + noise: what moves comes to rest by itself.
//!
//! # References
//! - Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation",
//!   2001: section 6.2.2 (white noise acceleration), section 5.4 (gates).

use downbeat_executor::Time;
use glam::{DMat2, DVec2};

/// Where something is and how it moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Track {
    /// In m.
    pub(crate) position: DVec2,
    /// In m/s.
    pub(crate) velocity: DVec2,
    /// Of the position, of position and velocity, of the velocity.
    pub(crate) covariance: [DMat2; 3],
    pub(crate) at: Time,
    /// How many measurements it has.
    pub(crate) count: u32,
    motion: &'static Motion,
}

/// How something moves.
#[derive(Debug, PartialEq)]
pub(crate) struct Motion {
    /// The share of its velocity that it loses, per s.
    pub(crate) slows: f64,
    /// Of the acceleration, in m²/s³.
    pub(crate) acceleration: f64,
    /// Of an unknown velocity, in m²/s².
    pub(crate) unknown_velocity: f64,
}

/// Measurements beyond this squared Mahalanobis distance are outliers: 1 in 3000 of those that are none.
const GATE: f64 = 16.0;

impl Track {
    pub(crate) fn new(position: DVec2, covariance: DMat2, at: Time, motion: &'static Motion) -> Self {
        let unknown = DMat2::from_diagonal(DVec2::splat(motion.unknown_velocity));
        let velocity = DVec2::ZERO;
        Self { position, velocity, covariance: [covariance, DMat2::ZERO, unknown], at, count: 1, motion }
    }

    /// As it is later.
    pub(crate) fn at(mut self, time: Time) -> Self {
        let dt = time.saturating_since(self.at).as_secs_f64().min(10.0);
        if dt <= 0.0 {
            return self;
        }
        self.at = time;
        let kept = libm::exp(-self.motion.slows * dt);
        let [a, b, c] = self.covariance;
        let noise = |power: f64| DMat2::from_diagonal(DVec2::splat(self.motion.acceleration * power));
        self.position += self.velocity * dt;
        self.velocity *= kept;
        self.covariance = [
            a + (b + b.transpose()) * dt + c * (dt * dt) + noise(dt * dt * dt / 3.0),
            (b + c * dt) * kept + noise(dt * dt / 2.0),
            c * (kept * kept) + noise(dt),
        ];
        self
    }

    /// Whether a measurement belongs to it, at its time.
    pub(crate) fn fits(&self, position: DVec2, noise: DMat2) -> bool {
        self.distance(position, noise) <= GATE
    }

    /// The squared Mahalanobis distance of a measurement at its time.
    pub(crate) fn distance(&self, position: DVec2, noise: DMat2) -> f64 {
        let off = position - self.position;
        off.dot((self.covariance[0] + noise).inverse() * off)
    }

    /// With a measurement at its time.
    pub(crate) fn corrected(mut self, position: DVec2, noise: DMat2) -> Self {
        let [a, b, c] = self.covariance;
        let inverse = (a + noise).inverse();
        let (gain, gain_of_velocity) = (a * inverse, b.transpose() * inverse);
        let off = position - self.position;
        self.position += gain * off;
        self.velocity += gain_of_velocity * off;
        // Rounding errors that are not symmetric would grow from measurement to measurement.
        let symmetric = |matrix: DMat2| (matrix + matrix.transpose()) * 0.5;
        self.covariance = [symmetric(a - gain * a), b - gain * b, symmetric(c - gain_of_velocity * b)];
        self.count = self.count.saturating_add(1);
        self
    }
}
