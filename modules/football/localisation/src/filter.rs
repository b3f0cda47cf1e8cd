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
//!   nearer or farther together: for each particle the pitch is taken with which they fit best, by least
//!   squares, and as likely as it is far from that of late, which follows what the believed pose tells.
//! - (6) the belief stays with the particles around it until others have several times their weight.
//!
//! # References
//! - S. Thrun, W. Burgard, D. Fox, Probabilistic Robotics, 2005: table 8.3 (augmented Monte Carlo
//!   localisation), section 6.4, and table 4.4 (low variance sampling).
//! - S. Lenser, M. Veloso, "Sensor Resetting Localization for Poorly Modelled Mobile Robots", ICRA 2000, for
//!   (3).

use downbeat_football::{Field, Intersection, IntersectionKind, Line, floor_covariance};
use fastrand::Rng;
use glam::DVec2;
use std::f64::consts::{FRAC_PI_2, PI};

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
const ANGLE_DEVIATION: f64 = 0.02;
/// Of where it is, however near, in m².
const LEAST_VARIANCE: f64 = 0.0009;
/// Landmarks of a picture share more errors than that of the pitch: more than this many count as so many.
const INDEPENDENT: f64 = 2.0;
/// Equation (3): how far the mean of late may fall before anything is drawn anew.
const PATIENCE: f64 = 2.0;
/// ε of equation (2): how often something is seen that is not there.
const OUTLIER: f64 = 0.05;
/// How fast the means of equation (3) follow.
const FAST: f64 = 0.1;
const SLOW: f64 = 0.02;
/// The largest share of particles that are drawn anew at once.
const MOST_RESET: f64 = 0.05;
/// Equation (5): how far the pitch of a picture is from that of late, which follows it by a share and fades,
/// for where everything that is seen is ahead, a wrong pitch is a wrong place; and the most.
const PITCH_DEVIATION: f64 = 0.03;
const PITCH_SHARE: f64 = 0.1;
const PITCH_FADING: f64 = 0.02;
const MOST_PITCH: f64 = 0.1;
/// How certain the heading by odometry is, in rad; and by which share of its error a picture corrects it.
const HEADING_DEVIATION: f64 = 0.2;
const HEADING_SHARE: f64 = 0.01;
/// How many times as much weight others need than those around the pose that is believed.
const INCUMBENT: f64 = 3.0;
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
    /// What was believed after the last picture, moved by the odometry since.
    incumbent: Option<Pose>,
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

/// Where a point of the floor is if the camera looks up by this angle (rad) more than was thought; at most
/// twice as far.
pub(crate) fn pitched(point: DVec2, height: f64, angle: f64) -> DVec2 {
    let (distance, height) = (point.length(), height.max(0.05));
    let below = libm::atan2(height, distance) - angle;
    let least = libm::atan2(height, 2.0 * distance);
    let distance = height / libm::tan(below.clamp(least, FRAC_PI_2));
    point.normalize_or_zero() * distance
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
            incumbent: None,
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
        (self.means, self.incumbent) = (None, None);
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
        self.incumbent = self.incumbent.map(|pose| pose.then(step));
        for index in 0..self.particles.len() {
            let noise = DVec2::new(self.normal(), self.normal()) * WAY_NOISE * way;
            let turned = step.heading + self.normal() * (TURN_NOISE * turn + DRIFT_NOISE * way);
            let pose = &mut self.particles[index].pose;
            pose.position = pose.place(step.position + noise).clamp(-self.half, self.half);
            pose.heading = wrapped(pose.heading + turned);
        }
    }

    /// The robot was moved by about so much without its odometry, in m and rad.
    pub fn scatter(&mut self, (metres, radians): (f64, f64)) {
        for index in 0..self.particles.len() {
            self.particles[index].pose = self.scattered(self.particles[index].pose, metres, radians);
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
        let mut fits = Vec::with_capacity(count);
        for index in 0..self.particles.len() {
            let (likelihood, _) = self.likelihood(landmarks, self.particles[index].pose, &mut fits);
            let likelihood = libm::pow(likelihood, temper);
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
        self.incumbent = Some(believed.pose);
        let (_, pitch) = self.likelihood(landmarks, believed.pose, &mut fits);
        let pitch = (1.0 - PITCH_FADING) * (self.pitch + PITCH_SHARE * pitch);
        self.pitch = pitch.clamp(-MOST_PITCH, MOST_PITCH);
        let error = wrapped(believed.pose.heading - self.heading);
        // Drift of the gyroscope, not a turn by half.
        if error.abs() < 0.5 {
            self.heading = wrapped(self.heading + HEADING_SHARE * error);
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
        let incumbent = self.incumbent.map(|pose| (INCUMBENT * weight_around(pose), pose));
        let best = candidates.chain(incumbent).max_by(|one, other| one.0.total_cmp(&other.0));
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

    /// Equation (2), and the pitch of equation (5) with respect to that of the landmarks.
    fn likelihood(&self, landmarks: &Landmarks, pose: Pose, fits: &mut Vec<Fit>) -> (f64, f64) {
        fits.clear();
        let mut likelihood = self.fits(landmarks, pose, fits);
        let pitch = pitch_of(fits);
        likelihood *= libm::exp(-0.5 * (pitch / PITCH_DEVIATION).powi(2));
        for fit in fits {
            likelihood *= OUTLIER + libm::exp(-0.5 * fit.square(pitch));
        }
        (likelihood, pitch)
    }

    /// How far what is seen is from the nearest of its kind; returns how likely the directions are, and all
    /// that is of no kind.
    fn fits(&self, landmarks: &Landmarks, pose: Pose, fits: &mut Vec<Fit>) -> f64 {
        let height = landmarks.camera_height;
        let heading = DVec2::from_angle(pose.heading);
        let in_robot = |off: DVec2| DVec2::new(heading.dot(off), heading.perp_dot(off));
        let nearest = |at: DVec2, candidates: &mut dyn Iterator<Item = DVec2>| {
            candidates
                .map(|candidate| candidate - at)
                .min_by(|one, other| one.length_squared().total_cmp(&other.length_squared()))
        };
        let off = wrapped(pose.heading - self.heading) / HEADING_DEVIATION;
        let mut product = OUTLIER + libm::exp(-0.5 * off * off);
        for (seen, kind, turned) in &landmarks.intersections {
            let turned = pose.heading + turned;
            let fitting = |one: &&Intersection| {
                one.kind == *kind
                    && (*kind == IntersectionKind::X || wrapped(one.heading - turned).abs() < 0.6)
            };
            let mut candidates = self.intersections.iter().filter(fitting).map(|one| one.position);
            match nearest(pose.place(*seen), &mut candidates) {
                Some(off) => fits.push(Fit::of_point(*seen, in_robot(off), height)),
                None => product *= OUTLIER,
            }
        }
        for seen in &landmarks.posts {
            if let Some(off) = nearest(pose.place(*seen), &mut self.posts.into_iter()) {
                fits.push(Fit::of_point(*seen, in_robot(off), height));
            }
        }
        if let Some(seen) = landmarks.circle {
            fits.push(Fit::of_point(seen, in_robot(-pose.place(seen)), height));
        }
        for ends in &landmarks.lines {
            let middle = (ends[0] + ends[1]) / 2.0;
            let along = heading.rotate((ends[1] - ends[0]).normalize_or(DVec2::X));
            let at = pose.place(middle);
            let candidates = self.lines.iter().filter_map(|line| {
                let direction = (line.to - line.from).normalize();
                // Within a third of a right angle.
                if direction.perp_dot(along).abs() > 0.5 {
                    return None;
                }
                let way = (at - line.from).dot(direction).clamp(0.0, line.from.distance(line.to));
                Some((line.from + direction * way - at, direction))
            });
            // An arc of the circle looks like a short line.
            let is_short = ends[0].distance(ends[1]) < 0.8 * self.circle_radius;
            let off_circle = off_circle(at, along, self.circle_radius).filter(|_| is_short);
            let nearest = candidates
                .chain(off_circle.map(|off| (off, at.normalize_or(DVec2::X).perp())))
                .min_by(|one, other| one.0.length_squared().total_cmp(&other.0.length_squared()));
            match nearest {
                Some((off, direction)) => {
                    fits.push(Fit::of_line(middle, in_robot(off), in_robot(direction), height));
                }
                None => product *= OUTLIER,
            }
            let sharpness = 1.0 / (0.06 + 0.05 / ends[0].distance(ends[1]).max(0.1));
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

/// How far a landmark is from where it should be, along two axes.
#[derive(Clone, Copy, Debug)]
struct Fit([Axis; 2]);

#[derive(Clone, Copy, Debug)]
struct Axis {
    /// In m.
    off: f64,
    /// How far the landmark moves with the pitch of the camera, in m for each rad.
    by_pitch: f64,
    /// In m².
    variance: f64,
}

impl Fit {
    /// Along the line of sight and across. All are in axes of the robot.
    fn of_point(seen: DVec2, off: DVec2, height: f64) -> Self {
        let sight = seen.normalize_or(DVec2::X);
        Self([sight, sight.perp()].map(|axis| Axis::new(axis, seen, off, height)))
    }

    /// Across the line, and along it only beyond its ends.
    fn of_line(seen: DVec2, off: DVec2, direction: DVec2, height: f64) -> Self {
        let across = Axis::new(direction.perp(), seen, off, height);
        let mut along = Axis::new(direction, seen, off, height);
        if along.off.abs() < 1e-6 {
            along.by_pitch = 0.0;
        }
        Self([across, along])
    }

    /// Squared distance, in standard deviations.
    fn square(&self, pitch: f64) -> f64 {
        self.0.iter().map(|axis| (axis.off - axis.by_pitch * pitch).powi(2) / axis.variance).sum()
    }
}

impl Axis {
    fn new(axis: DVec2, seen: DVec2, off: DVec2, height: f64) -> Self {
        let height = height.max(0.05);
        let farther = (seen.length_squared() + height * height) / height;
        let [[xx, xy], [_, yy]] = floor_covariance(height, seen, ANGLE_DEVIATION);
        let DVec2 { x, y } = axis;
        Self {
            off: axis.dot(off),
            by_pitch: axis.dot(seen.normalize_or(DVec2::X)) * farther,
            variance: xx * x * x + 2.0 * xy * x * y + yy * y * y + LEAST_VARIANCE,
        }
    }
}

/// The pitch with which landmarks fit best: least squares, in which those that do not fit count less.
fn pitch_of(fits: &[Fit]) -> f64 {
    let mut pitch: f64 = 0.0;
    for _ in 0..2 {
        let (mut above, mut below) = (0.0, 1.0 / (PITCH_DEVIATION * PITCH_DEVIATION));
        for fit in fits {
            let weight = 1.0 / (1.0 + fit.square(pitch) / 4.0);
            for Axis { off, by_pitch, variance } in fit.0 {
                above += weight * by_pitch * off / variance;
                below += weight * by_pitch * by_pitch / variance;
            }
        }
        pitch = (above / below).clamp(-MOST_PITCH, MOST_PITCH);
    }
    pitch
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
