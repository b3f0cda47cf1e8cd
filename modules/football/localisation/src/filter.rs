//! A particle filter with the likelihood of landmarks, which resets itself from what it sees.
//!
//! - (1) each particle moves with the odometry, with noise in proportion to the way;
//! - (2) its weight is the product over landmarks of `w = ε + exp(-d² / 2σ²)`, with d the distance to the
//!   nearest landmark of that kind on the field and σ by equations (1), (2) of [`floor_covariance`];
//! - (3) if the mean weight of late falls below that of long, that share of particles is drawn anew from
//!   poses that landmarks imply;
//! - (4) a field looks the same when turned by half: of the two, particles are drawn on the side on which the
//!   heading agrees with the odometry, whose gyroscope keeps turning with the robot also while it is carried.
//! - (5) while it walks, a robot does not know its pitch to two degrees, and all landmarks of a picture seem
//!   nearer or farther together: the pitch error is that of a few values around the last one with which they
//!   fit best, seen from the believed pose.
//!
//! # References
//! - S. Thrun, W. Burgard, D. Fox, Probabilistic Robotics, 2005: table 8.3 (augmented Monte Carlo
//!   localisation), section 6.4, and table 4.4 (low variance sampling).
//! - S. Lenser, M. Veloso, "Sensor Resetting Localization for Poorly Modelled Mobile Robots", ICRA 2000, for
//!   (3).

use downbeat_football::{Field, Intersection, IntersectionKind, Line, floor_covariance};
use fastrand::Rng;
use glam::DVec2;
use std::f64::consts::PI;

/// A pose on the field.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// In m.
    pub position: DVec2,
    /// In rad, from the x axis to the left.
    pub heading: f64,
}

/// What is seen at one time, on the floor, with respect to the robot.
#[derive(Clone, Debug, Default)]
pub struct Landmarks {
    /// The height of the camera above the floor, in m.
    pub camera_height: f64,
    /// Where lines meet, how, and the heading there; of an X modulo a quarter turn.
    pub intersections: Vec<(DVec2, IntersectionKind, f64)>,
    /// The ends of lines.
    pub lines: Vec<[DVec2; 2]>,
    /// Goal posts.
    pub posts: Vec<DVec2>,
    /// The middle of the centre circle.
    pub circle: Option<DVec2>,
}

/// A pose and how certain it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Believed {
    /// The mean of the particles around the best one.
    pub pose: Pose,
    /// Of x, y and heading, in m², m rad and rad².
    pub covariance: [[f64; 3]; 3],
}

/// The number of particles.
const PARTICLES: usize = 300;
/// The noise of odometry: m per m of the way, rad per rad, rad per m.
const WAY_NOISE: f64 = 0.15;
const TURN_NOISE: f64 = 0.1;
const DRIFT_NOISE: f64 = 0.03;
/// Of the direction of what is seen, in rad.
const ANGLE_DEVIATION: f64 = 0.035;
/// All landmarks of a picture share the error of the camera's pitch: more than this many count as so many.
const INDEPENDENT: f64 = 3.0;
/// Equation (3): how far the mean of late may fall before anything is drawn anew.
const PATIENCE: f64 = 1.3;
/// ε of equation (2): how often something is seen that is not there.
const OUTLIER: f64 = 0.05;
/// How fast the means of equation (3) follow.
const FAST: f64 = 0.1;
const SLOW: f64 = 0.02;
/// The largest share of particles that are drawn anew at once.
const MOST_RESET: f64 = 0.1;
/// The values of (5) on either side of the last one, and their distance, in rad.
const PITCHES: i32 = 4;
const PITCH_STEP: f64 = 0.004;
/// Standard deviations of the error's change between pictures, and of the error, in rad.
const PITCH_CHANGE: f64 = 0.008;
const PITCH_DEVIATION: f64 = 0.015;
/// How certain the heading by odometry is, in rad.
const HEADING_DEVIATION: f64 = 0.2;
/// How far particles may be from the best one to belong to it: m, rad.
const CLUSTER: (f64, f64) = (0.6, 0.6);

#[derive(Clone, Copy, Debug)]
struct Particle {
    pose: Pose,
    weight: f64,
}

/// Where the robot is. The same seed and inputs give the same result.
#[derive(Clone, Debug)]
pub struct Filter {
    random: Rng,
    particles: Vec<Particle>,
    intersections: Vec<Intersection>,
    lines: Vec<Line>,
    posts: [DVec2; 4],
    /// 0 if there is no circle.
    circle_radius: f64,
    half: DVec2,
    /// The mean weights of equation (3): of late, and of long.
    means: Option<[f64; 2]>,
    /// The heading that odometry alone would give, corrected slowly.
    heading: f64,
    evidence: f64,
    pitch: f64,
}

impl Landmarks {
    /// As if the camera looked up by this angle more, in rad.
    fn pitched(&self, angle: f64) -> Self {
        let moved = |point: &DVec2| pitched(*point, self.camera_height, angle);
        Self {
            camera_height: self.camera_height,
            intersections: self
                .intersections
                .iter()
                .map(|(at, kind, heading)| (moved(at), *kind, *heading))
                .collect(),
            lines: self.lines.iter().map(|ends| ends.each_ref().map(moved)).collect(),
            posts: self.posts.iter().map(moved).collect(),
            circle: self.circle.as_ref().map(moved),
        }
    }
}

/// Where a point of the floor is if the camera looks up by this angle (rad) more than was thought: (d² + h²)
/// / h for each rad.
pub(crate) fn pitched(point: DVec2, height: f64, angle: f64) -> DVec2 {
    let (distance, height) = (point.length(), height.max(0.05));
    let farther = angle * (distance * distance + height * height) / height;
    // Far away the linear step is too long.
    point + point.normalize_or_zero() * farther.clamp(-0.5 * distance, distance)
}

impl Pose {
    /// The pose on the other side of a field that looks the same.
    #[must_use]
    pub fn mirrored(self) -> Self {
        Self { position: -self.position, heading: wrapped(self.heading + PI) }
    }

    /// A point that is seen from this pose, on the field.
    #[must_use]
    pub fn place(self, seen: DVec2) -> DVec2 {
        self.position + DVec2::from_angle(self.heading).rotate(seen)
    }

    /// A pose that is known with respect to this one, on the field.
    #[must_use]
    pub fn then(self, step: Self) -> Self {
        Self { position: self.place(step.position), heading: wrapped(self.heading + step.heading) }
    }

    /// The inverse of [`Pose::then`]: another pose with respect to this one.
    #[must_use]
    pub fn step_to(self, other: Self) -> Self {
        let position = DVec2::from_angle(-self.heading).rotate(other.position - self.position);
        Self { position, heading: wrapped(other.heading - self.heading) }
    }
}

impl Filter {
    /// A filter that begins around these poses, about as certain as these deviations in m and rad.
    #[must_use]
    pub fn new(field: &Field, starts: &[Pose], deviations: (f64, f64), seed: u64) -> Self {
        let mut filter = Self {
            random: Rng::with_seed(seed),
            particles: Vec::new(),
            intersections: field.intersections(),
            lines: field.lines(),
            posts: field.posts(),
            circle_radius: field.circle_diameter / 2.0,
            half: DVec2::new(field.length, field.width) / 2.0 + field.margin,
            means: None,
            heading: 0.0,
            evidence: 0.0,
            pitch: 0.0,
        };
        filter.start(starts, deviations);
        filter
    }

    /// Begins again, as [`Filter::new`]: when the referee says where the robot enters the field.
    pub fn start(&mut self, starts: &[Pose], (metres, radians): (f64, f64)) {
        let fallback = [Pose::default()];
        let starts = if starts.is_empty() { &fallback[..] } else { starts };
        self.heading = starts[0].heading;
        self.means = None;
        self.evidence = 0.0;
        let poses: Vec<Pose> = (0..PARTICLES)
            .map(|index| self.scattered(starts[index % starts.len()], metres, radians))
            .collect();
        self.particles =
            poses.into_iter().map(|pose| Particle { pose, weight: 1.0 / PARTICLES as f64 }).collect();
    }

    /// Moves by a step of odometry, in axes of the robot before it.
    pub fn walk(&mut self, step: Pose) {
        let way = step.position.length();
        let turn = step.heading.abs();
        self.heading = wrapped(self.heading + step.heading);
        for index in 0..self.particles.len() {
            let noise = DVec2::new(self.normal(), self.normal()) * WAY_NOISE * way;
            let turned = step.heading + self.normal() * (TURN_NOISE * turn + DRIFT_NOISE * way);
            let pose = &mut self.particles[index].pose;
            pose.position = pose.place(step.position + noise).clamp(-self.half, self.half);
            pose.heading = wrapped(pose.heading + turned);
        }
    }

    /// Weighs the particles by what is seen, and draws them anew.
    pub fn see(&mut self, landmarks: &Landmarks) -> Believed {
        let count = landmarks.intersections.len()
            + landmarks.lines.len()
            + landmarks.posts.len()
            + usize::from(landmarks.circle.is_some());
        if count == 0 {
            return self.believed();
        }
        let landmarks = &landmarks.pitched(self.pitch);
        let temper = (INDEPENDENT / count as f64).min(1.0);
        let mut sum = 0.0;
        for index in 0..self.particles.len() {
            let likelihood = libm::pow(self.likelihood(landmarks, self.particles[index].pose), temper);
            let particle = &mut self.particles[index];
            particle.weight *= likelihood;
            sum += particle.weight;
        }
        self.evidence += libm::log(sum.max(1e-300));
        // The geometric mean for one landmark, so that pictures with many and with few are comparable.
        let mean = libm::pow(sum.max(1e-300), 1.0 / (count as f64 * temper));
        let [fast, slow] = self.means.unwrap_or([mean, mean]);
        let [fast, slow] = [fast + FAST * (mean - fast), slow + SLOW * (mean - slow)];
        self.means = Some([fast, slow]);
        let reset = (1.0 - PATIENCE * fast / slow).clamp(0.0, MOST_RESET);
        for particle in &mut self.particles {
            particle.weight = if sum > 1e-300 { particle.weight / sum } else { 1.0 / PARTICLES as f64 };
        }
        let believed = self.believed();
        self.correct_pitch(landmarks, temper, believed.pose);
        let error = wrapped(believed.pose.heading - self.heading);
        // Drift of the gyroscope, not a turn by half.
        if error.abs() < 0.5 {
            self.heading = wrapped(self.heading + 0.05 * error);
        }
        self.draw(landmarks, reset);
        believed
    }

    /// The logarithm of how likely all that was seen is, given the start. Filters that saw the same are
    /// compared by its difference: the logarithm of their Bayes factor.
    #[must_use]
    pub fn evidence(&self) -> f64 {
        self.evidence
    }

    /// The mean and the covariance of the particles around the best one.
    #[must_use]
    pub fn believed(&self) -> Believed {
        // A single particle may fit one picture by chance: the best one is that with the most weight around
        // it.
        let is_near = |pose: Pose, particle: &&Particle| {
            particle.pose.position.distance(pose.position) < CLUSTER.0
                && wrapped(particle.pose.heading - pose.heading).abs() < CLUSTER.1
        };
        let weight_around = |pose: Pose| {
            self.particles
                .iter()
                .filter(|particle| is_near(pose, particle))
                .map(|particle| particle.weight)
                .sum::<f64>()
        };
        let candidates =
            self.particles.iter().step_by(8).map(|particle| (weight_around(particle.pose), particle.pose));
        let best = candidates.max_by(|one, other| one.0.total_cmp(&other.0));
        let Some((_, best)) = best else { return Believed::default() };
        let near = |particle: &&Particle| is_near(best, particle);
        let (mut weight, mut position, mut turn) = (0.0, DVec2::ZERO, 0.0);
        for Particle { pose, weight: own } in self.particles.iter().filter(near) {
            weight += own;
            position += pose.position * *own;
            turn += wrapped(pose.heading - best.heading) * own;
        }
        let weight: f64 = if weight > 0.0 { weight } else { 1.0 };
        let pose = Pose { position: position / weight, heading: wrapped(best.heading + turn / weight) };
        let mut covariance = [[0.0; 3]; 3];
        for Particle { pose: own, weight: share } in self.particles.iter().filter(near) {
            let off = own.position - pose.position;
            let off = [off.x, off.y, wrapped(own.heading - pose.heading)];
            for (row, one) in off.iter().enumerate() {
                for (column, other) in off.iter().enumerate() {
                    covariance[row][column] += share / weight * one * other;
                }
            }
        }
        Believed { pose, covariance }
    }

    /// The believed error of the camera's pitch, in rad: what is seen is so much farther up.
    #[must_use]
    pub fn pitch(&self) -> f64 {
        self.pitch
    }

    /// Point (5), for landmarks that are corrected by the last error already.
    fn correct_pitch(&mut self, landmarks: &Landmarks, temper: f64, pose: Pose) {
        let fit = |index: i32| {
            let off = f64::from(index) * PITCH_STEP;
            let likelihood = libm::log(self.likelihood(&landmarks.pitched(off), pose).max(1e-300));
            let [change, size] = [off / PITCH_CHANGE, (self.pitch + off) / PITCH_DEVIATION];
            (temper * likelihood - 0.5 * (change * change + size * size), off)
        };
        let best = (-PITCHES..=PITCHES).map(fit).max_by(|one, other| one.0.total_cmp(&other.0));
        let off = best.map_or(0.0, |(_, off)| off);
        self.pitch += 0.5 * off;
    }

    /// Equation (2).
    fn likelihood(&self, landmarks: &Landmarks, pose: Pose) -> f64 {
        let height = landmarks.camera_height;
        let heading = DVec2::from_angle(pose.heading);
        let fit = |seen: DVec2, off: DVec2| {
            // Into the axes of the robot, in which the covariance is.
            let off = DVec2::new(heading.dot(off), heading.perp_dot(off));
            let [[xx, xy], [_, yy]] = floor_covariance(height, seen, ANGLE_DEVIATION);
            let (xx, yy) = (xx + 0.0009, yy + 0.0009);
            let square =
                (yy * off.x * off.x - 2.0 * xy * off.x * off.y + xx * off.y * off.y) / (xx * yy - xy * xy);
            OUTLIER + libm::exp(-0.5 * square)
        };
        let nearest = |at: DVec2, candidates: &mut dyn Iterator<Item = DVec2>| {
            candidates
                .map(|candidate| candidate - at)
                .min_by(|one, other| one.length_squared().total_cmp(&other.length_squared()))
        };
        let off = wrapped(pose.heading - self.heading) / HEADING_DEVIATION;
        let mut product = OUTLIER + libm::exp(-0.5 * off * off);
        for (seen, kind, turned) in &landmarks.intersections {
            let at = pose.place(*seen);
            let turned = pose.heading + turned;
            let fitting = |one: &&Intersection| {
                one.kind == *kind
                    && (*kind == IntersectionKind::X || wrapped(one.heading - turned).abs() < 0.6)
            };
            let mut candidates = self.intersections.iter().filter(fitting).map(|one| one.position);
            product *= nearest(at, &mut candidates).map_or(OUTLIER, |off| fit(*seen, off));
        }
        for seen in &landmarks.posts {
            product *= nearest(pose.place(*seen), &mut self.posts.into_iter())
                .map_or(OUTLIER, |off| fit(*seen, off));
        }
        if let Some(seen) = landmarks.circle {
            product *= fit(seen, -pose.place(seen));
        }
        for ends in &landmarks.lines {
            let middle = (ends[0] + ends[1]) / 2.0;
            let along = DVec2::from_angle(pose.heading).rotate((ends[1] - ends[0]).normalize_or(DVec2::X));
            let at = pose.place(middle);
            let mut candidates = self.lines.iter().filter_map(|line| {
                let direction = (line.to - line.from).normalize();
                // Within a third of a right angle.
                if direction.perp_dot(along).abs() > 0.5 {
                    return None;
                }
                let way = (at - line.from).dot(direction).clamp(0.0, line.from.distance(line.to));
                Some(line.from + direction * way)
            });
            let mut candidates_off = nearest(at, &mut candidates);
            let sharpness = 1.0 / (0.06 + 0.05 / ends[0].distance(ends[1]).max(0.1));
            // An arc of the circle looks like a short line.
            let is_short = ends[0].distance(ends[1]) < 0.8 * self.circle_radius;
            let off_circle = off_circle(at, along, self.circle_radius).filter(|_| is_short);
            if let Some(off) = off_circle {
                candidates_off = Some(candidates_off.map_or(off, |other: DVec2| {
                    if other.length_squared() < off.length_squared() { other } else { off }
                }));
            }
            product *= candidates_off.map_or(OUTLIER, |off| fit(middle, off));
            let angle = self
                .lines
                .iter()
                .map(|line| (line.to - line.from).normalize().perp_dot(along).abs())
                .fold(if off_circle.is_some() { 0.0 } else { 1.0 }, f64::min);
            product *= OUTLIER + libm::exp(-0.5 * (angle * sharpness).powi(2));
        }
        product
    }

    /// Low variance sampling, with a share of poses that landmarks imply.
    fn draw(&mut self, landmarks: &Landmarks, reset: f64) {
        let fresh = (reset * PARTICLES as f64) as usize;
        let kept = PARTICLES - fresh;
        let mut drawn = Vec::with_capacity(PARTICLES);
        let start = self.random.f64() / kept as f64;
        let (mut sum, mut index) = (self.particles[0].weight, 0);
        for number in 0..kept {
            let target = start + number as f64 / kept as f64;
            while sum < target && index + 1 < self.particles.len() {
                index += 1;
                sum += self.particles[index].weight;
            }
            drawn.push(self.particles[index].pose);
        }
        // Against the loss of variety, as much as a standing robot sways.
        for pose in &mut drawn {
            *pose = self.scattered(*pose, 0.008, 0.006);
        }
        for _ in 0..fresh {
            let pose = self.implied(landmarks);
            drawn.push(pose);
        }
        self.particles =
            drawn.into_iter().map(|pose| Particle { pose, weight: 1.0 / PARTICLES as f64 }).collect();
    }

    /// A pose from which a landmark would be seen where it is seen, on the side that odometry knows.
    fn implied(&mut self, landmarks: &Landmarks) -> Pose {
        let heading = self.heading + self.normal() * 0.15;
        let (seen, place) = if let Some(index) = self.pick(landmarks.intersections.len()) {
            let (seen, kind, turned) = landmarks.intersections[index];
            let fits = |one: &Intersection| {
                one.kind == kind
                    && (kind == IntersectionKind::X || wrapped(one.heading - heading - turned).abs() < 0.6)
            };
            let fitting: Vec<DVec2> =
                self.intersections.iter().filter(|one| fits(one)).map(|one| one.position).collect();
            (Some(seen), self.pick(fitting.len()).map(|index| fitting[index]))
        } else if let Some(seen) = landmarks.circle {
            (Some(seen), Some(DVec2::ZERO))
        } else if let Some(index) = self.pick(landmarks.posts.len()) {
            let post = self.random.usize(..self.posts.len());
            (Some(landmarks.posts[index]), Some(self.posts[post]))
        } else {
            (None, None)
        };
        if let (Some(seen), Some(place)) = (seen, place) {
            let position = place - DVec2::from_angle(heading).rotate(seen);
            if position.abs().cmple(self.half).all() {
                return self.scattered(Pose { position, heading: wrapped(heading) }, 0.1, 0.05);
            }
        }
        let share = DVec2::new(self.random.f64(), self.random.f64()) * 2.0 - 1.0;
        Pose { position: share * self.half, heading: wrapped(heading) }
    }

    fn pick(&mut self, count: usize) -> Option<usize> {
        (count > 0).then(|| self.random.usize(..count))
    }

    fn scattered(&mut self, pose: Pose, metres: f64, radians: f64) -> Pose {
        let off = DVec2::new(self.normal(), self.normal()) * metres;
        let heading = wrapped(pose.heading + self.normal() * radians);
        Pose { position: (pose.position + off).clamp(-self.half, self.half), heading }
    }

    /// About normal, with deviation 1: the sum of four.
    fn normal(&mut self) -> f64 {
        ((0..4).map(|_| self.random.f64()).sum::<f64>() - 2.0) * 3.0_f64.sqrt()
    }
}

/// From the nearest point of the circle to one on a line in this direction, if the circle runs that way
/// there.
fn off_circle(at: DVec2, along: DVec2, radius: f64) -> Option<DVec2> {
    let outwards = at.normalize_or_zero();
    (radius > 0.0 && at.length() < 2.0 * radius && outwards.dot(along).abs() < 0.5)
        .then(|| at - outwards * radius)
}

/// From -π to π.
pub(crate) fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(2.0 * PI) - PI
}
