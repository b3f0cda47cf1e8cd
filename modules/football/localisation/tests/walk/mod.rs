//! Seeded walks over a field with a model of noise: odometry that is 10 % off and drifts, a head that sweeps,
//! landmarks within 4 m and 28 degrees of where the head looks, each seen in three of five pictures, with
//! errors of direction of 0.02 rad, and one of thirty that is not there.
#![allow(dead_code)] // not all tests use all of it
use downbeat_football::{Field, floor_covariance};
use downbeat_localisation::{Landmarks, Pose};
use fastrand::Rng;
use glam::DVec2;
use std::f64::consts::PI;

pub const HEIGHT: f64 = 0.42;
/// Pictures per second.
pub const RATE: f64 = 10.0;

pub struct Walk {
    random: Rng,
    pub field: Field,
    pub truth: Pose,
    goal: DVec2,
    /// Constant errors of this walk's odometry: of the way, and rad per s.
    bias: (DVec2, f64),
    time: f64,
    /// The error of the camera's pitch: of all pictures, and how much it differs between them, in rad.
    pub pitch: (f64, f64),
    pitch_now: f64,
}

pub fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(2.0 * PI) - PI
}

impl Walk {
    pub fn new(seed: u64) -> Self {
        let mut walk = Self {
            random: Rng::with_seed(seed),
            field: Field::default(),
            // It enters its own half at the touch line.
            truth: Pose { position: DVec2::new(-2.0, 3.0), heading: -PI / 2.0 },
            goal: DVec2::ZERO,
            bias: (DVec2::ONE, 0.0),
            time: 0.0,
            pitch: (0.0, 0.0),
            pitch_now: 0.0,
        };
        walk.bias =
            (DVec2::new(walk.between(0.9, 1.1), walk.between(-0.1, 0.1)), walk.between(-0.003, 0.003));
        walk
    }

    fn between(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.random.f64()
    }

    fn normal(&mut self) -> f64 {
        ((0..4).map(|_| self.random.f64()).sum::<f64>() - 2.0) * 3.0_f64.sqrt()
    }

    fn somewhere(&mut self) -> DVec2 {
        DVec2::new(self.between(-4.0, 4.0), self.between(-2.6, 2.6))
    }

    /// Walks to random places for one picture's time; returns what odometry measures.
    pub fn step(&mut self) -> Pose {
        self.time += 1.0 / RATE;
        let to_goal = self.goal - self.truth.position;
        if to_goal.length() < 0.3 {
            self.goal = self.somewhere();
        }
        let turn = wrapped(to_goal.to_angle() - self.truth.heading).clamp(-0.6, 0.6) / RATE;
        let speed = if turn.abs() * RATE > 0.5 { 0.03 } else { 0.15 };
        let way = DVec2::X * speed / RATE;
        self.truth.position += DVec2::from_angle(self.truth.heading).rotate(way);
        self.truth.heading = wrapped(self.truth.heading + turn);
        let noise = DVec2::new(self.normal(), self.normal()) * 0.003;
        let (scale, drift) = self.bias;
        Pose {
            position: DVec2::new(way.x * scale.x, way.x * scale.y) + noise,
            heading: turn + drift / RATE + self.normal() * 0.002,
        }
    }

    /// Somewhere else; odometry measures the turn only.
    pub fn kidnap(&mut self) -> Pose {
        let before = self.truth.heading;
        self.truth = Pose { position: self.somewhere(), heading: self.between(-PI, PI) };
        self.goal = self.somewhere();
        Pose { position: DVec2::ZERO, heading: wrapped(self.truth.heading - before) + self.normal() * 0.05 }
    }

    pub fn in_robot(&self, point: DVec2) -> DVec2 {
        DVec2::from_angle(-self.truth.heading).rotate(point - self.truth.position)
    }

    pub fn noisy(&mut self, point: DVec2) -> DVec2 {
        let [[xx, xy], [_, yy]] = floor_covariance(HEIGHT, point, 0.02);
        // Cholesky.
        let (a, b) = (xx.sqrt(), xy / xx.sqrt());
        let c = (yy - b * b).max(0.0).sqrt();
        let (one, other) = (self.normal(), self.normal());
        let below = libm::atan2(HEIGHT, point.length()) - self.pitch_now;
        let pitched = point.normalize() * HEIGHT / libm::tan(below.max(0.05));
        pitched + DVec2::new(a * one, b * one + c * other)
    }

    pub fn is_visible(&self, point: DVec2) -> bool {
        let head = 0.7 * libm::sin(self.time * 1.5);
        (0.25..4.0).contains(&point.length()) && wrapped(point.to_angle() - head).abs() < 0.49
    }

    pub fn see(&mut self) -> Landmarks {
        self.pitch_now = self.pitch.0 + self.pitch.1 * self.normal();
        let mut seen = Landmarks { camera_height: HEIGHT, ..Landmarks::default() };
        for one in self.field.intersections() {
            let at = self.in_robot(one.position);
            if self.is_visible(at) && self.random.f64() < 0.6 {
                let heading = wrapped(one.heading - self.truth.heading) + self.normal() * 0.1;
                seen.intersections.push((self.noisy(at), one.kind, heading));
            }
        }
        if self.random.u8(..30) == 0 {
            let at = DVec2::from_angle(self.between(-0.4, 0.4)) * self.between(0.5, 3.0);
            let kind = downbeat_football::IntersectionKind::L;
            let heading = self.between(-PI, PI);
            seen.intersections.push((at, kind, heading));
        }
        for post in self.field.posts() {
            let at = self.in_robot(post);
            if self.is_visible(at) && self.random.f64() < 0.6 {
                let post = self.noisy(at);
                seen.posts.push(post);
            }
        }
        let centre = self.in_robot(DVec2::ZERO);
        if self.is_visible(centre) && self.random.f64() < 0.6 {
            seen.circle = Some(self.noisy(centre));
        }
        for line in self.field.lines() {
            let part: Vec<DVec2> = (0..=40)
                .map(|index| self.in_robot(line.from.lerp(line.to, f64::from(index) / 40.0)))
                .filter(|point| self.is_visible(*point))
                .collect();
            if let [first, .., last] = part[..]
                && first.distance(last) > 0.4
                && self.random.f64() < 0.6
            {
                let ends = [self.noisy(first), self.noisy(last)];
                seen.lines.push(ends);
            }
        }
        seen
    }

    pub fn error(&self, believed: Pose) -> (f64, f64) {
        let turned = wrapped(believed.heading - self.truth.heading).abs();
        (believed.position.distance(self.truth.position), turned)
    }
}
