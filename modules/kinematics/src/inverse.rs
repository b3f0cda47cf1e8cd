//! Numeric inverse kinematics of a chain between two links.

use crate::description::{DescriptionError, Joint, JointKind, LinkId, Problem, Robot};
use downbeat_transforms::Isometry;
use glam::{DQuat, DVec3};
use nalgebra::{Matrix6, Matrix6xX, Vector6};

/// Finds positions of the joints between two links for which one link has a given pose in the other.
///
/// Damped least squares within the limits of the joints: each step minimises |J Δq - e|² + λ |Δq|², with λ as
/// in the method of Levenberg and Marquardt, and leaves out joints that are at a limit and would be moved
/// beyond it. If it ends at a pose that is not the wanted one, it starts again from random positions, which
/// are always the same ones.
///
/// Created once and used again, which allocates nothing.
///
/// ```
/// use downbeat_kinematics::{InverseKinematics, Pose, Robot, Search};
///
/// let robot = Robot::read("../../robots/darwin_op.urdf")?;
/// let (torso, hand) = (robot.link_id("torso")?, robot.link_id("l_hand")?);
/// let mut arm = InverseKinematics::new(&robot, torso, hand)?;
///
/// let mut pose = Pose::new(&robot);
/// let mut positions = vec![0.3; 20];
/// pose.update(&robot, &positions);
/// let torso_from_hand = pose.target_from_source(torso, hand);
///
/// positions.fill(0.0);
/// let found = arm.solve(&torso_from_hand, &mut positions, &Search::default());
/// assert!(found.is_reached && found.distance < 1e-8);
/// assert!((positions[robot.coordinate("l_el").unwrap()] - 0.3).abs() < 1e-6);
/// # Ok::<(), downbeat_kinematics::DescriptionError>(())
/// ```
///
/// # References
/// - S. R. Buss, Introduction to inverse kinematics with Jacobian transpose, pseudoinverse and damped least
///   squares methods, 2009.
/// - T. Sugihara, Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method, IEEE
///   Transactions on Robotics 27(5), 2011.
#[derive(Clone, Debug)]
pub struct InverseKinematics {
    steps: Vec<Step>,
    /// From the last joint to the tip.
    last_from_tip: Isometry,
    /// What is brought to a pose: the tip, or a frame in it.
    tip_from_end: Isometry,
    coordinates: Vec<Coordinate>,
    jacobian: Matrix6xX<f64>,
    current: Vec<f64>,
    trial: Vec<f64>,
    best: Vec<f64>,
    is_free: Vec<bool>,
}

/// A joint on the way from the base to the tip.
#[derive(Clone, Debug)]
struct Step {
    /// From the previous joint to this one, or to its child if passed upwards.
    before: Isometry,
    joint: Joint,
    direction: Direction,
    /// In the coordinates of the chain.
    column: usize,
    multiplier: f64,
    offset: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Direction {
    /// From the parent to the child.
    Down,
    /// From the child to the parent.
    Up,
}

/// A coordinate of the robot that moves the tip relative to the base.
#[derive(Clone, Copy, Debug)]
struct Coordinate {
    /// In the positions of the robot.
    index: usize,
    min: f64,
    max: f64,
}

/// How inverse kinematics searches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Search {
    /// The distance at which the tip is where it should be, in m.
    pub distance_tolerance: f64,
    /// The angle at which the tip is oriented as it should be, in rad.
    pub angle_tolerance: f64,
    /// The distance in m that counts as much as an angle of 1 rad. With 0, the orientation does not matter.
    pub angle_weight: f64,
    /// The maximum number of iterations from each start.
    pub iterations: u32,
    /// The maximum number of starts: the first from the given positions, the others from random ones.
    pub starts: u32,
    /// Determines the random positions.
    pub seed: u64,
}

/// The result of inverse kinematics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Whether distance and angle are within the tolerances. Otherwise the positions are those of the nearest
    /// pose that was found.
    pub is_reached: bool,
    /// From the wanted position of the tip, in m.
    pub distance: f64,
    /// From the wanted orientation of the tip, in rad.
    pub angle: f64,
    /// The iterations of all starts.
    pub iterations: u32,
    /// The number of starts.
    pub starts: u32,
}

impl Default for Search {
    /// 10 nm and 0.1 µrad, 1 rad counting as 0.1 m; 20 starts of 100 iterations.
    fn default() -> Self {
        Self {
            distance_tolerance: 1e-8,
            angle_tolerance: 1e-7,
            angle_weight: 0.1,
            iterations: 100,
            starts: 20,
            seed: 1,
        }
    }
}

/// The largest change of a position in one iteration, in rad or m.
const LONGEST_STEP: f64 = 0.5;
/// The first, smallest and greatest damping, in m².
const DAMPING: [f64; 3] = [1e-4, 1e-14, 1e2];
/// A search ends if the square of the error decreases by less than this factor in an iteration.
const LEAST_PROGRESS: f64 = 1e-6;

impl InverseKinematics {
    /// For the pose of `tip` in `base`.
    ///
    /// # Errors
    /// [`Problem::NotMovable`] if no joint moves one relative to the other.
    pub fn new(robot: &Robot, base: LinkId, tip: LinkId) -> Result<Self, DescriptionError> {
        let mut chain = Self {
            steps: Vec::new(),
            last_from_tip: Isometry::IDENTITY,
            tip_from_end: Isometry::IDENTITY,
            coordinates: Vec::new(),
            jacobian: Matrix6xX::zeros(0),
            current: Vec::new(),
            trial: Vec::new(),
            best: Vec::new(),
            is_free: Vec::new(),
        };
        let to_root = |link: LinkId| {
            std::iter::successors(robot.link(link).parent, |&joint| {
                robot.link(robot.joint(joint).parent).parent
            })
        };
        let (up, down): (Vec<_>, Vec<_>) = (to_root(base).collect(), to_root(tip).collect());
        let shared = up.iter().rev().zip(down.iter().rev()).take_while(|(up, down)| up == down).count();
        for &id in &up[..up.len() - shared] {
            chain.pass(robot.joint(id), Direction::Up);
        }
        for &id in down[..down.len() - shared].iter().rev() {
            chain.pass(robot.joint(id), Direction::Down);
        }
        if chain.coordinates.is_empty() {
            let [base, tip] = [base, tip].map(|link| robot.link(link).name.clone());
            return Err(robot.error(None, Problem::NotMovable { base, tip }));
        }
        let count = chain.coordinates.len();
        chain.jacobian = Matrix6xX::zeros(count);
        for positions in [&mut chain.current, &mut chain.trial, &mut chain.best] {
            positions.resize(count, 0.0);
        }
        chain.is_free.resize(count, true);
        Ok(chain)
    }

    /// Adds the next joint on the way to the tip.
    fn pass(&mut self, joint: &Joint, direction: Direction) {
        if direction == Direction::Down {
            self.last_from_tip = self.last_from_tip * joint.parent_from_joint;
        }
        if let Some(drive) = joint.drive {
            let known = self.coordinates.iter().position(|coordinate| coordinate.index == drive.coordinate);
            let column = known.unwrap_or_else(|| {
                let (min, max) = (f64::NEG_INFINITY, f64::INFINITY);
                self.coordinates.push(Coordinate { index: drive.coordinate, min, max });
                self.coordinates.len() - 1
            });
            let range = joint.range();
            let limits =
                [*range.start(), *range.end()].map(|limit| (limit - drive.offset) / drive.multiplier);
            let coordinate = &mut self.coordinates[column];
            coordinate.min = coordinate.min.max(limits[0].min(limits[1]));
            coordinate.max = coordinate.max.min(limits[0].max(limits[1])).max(coordinate.min);
            let before = std::mem::take(&mut self.last_from_tip);
            let (multiplier, offset) = (drive.multiplier, drive.offset);
            self.steps.push(Step { before, joint: joint.clone(), direction, column, multiplier, offset });
        }
        if direction == Direction::Up {
            self.last_from_tip = self.last_from_tip * joint.parent_from_joint.inverse();
        }
    }

    /// Brings this frame of the tip to the wanted poses from now on, instead of the tip itself.
    pub fn set_end(&mut self, tip_from_end: Isometry) {
        self.tip_from_end = tip_from_end;
    }

    /// The indices of the positions that it changes.
    pub fn coordinates(&self) -> impl Iterator<Item = usize> {
        self.coordinates.iter().map(|coordinate| coordinate.index)
    }

    /// Changes the positions of the robot, in rad and m, so that `base_from_tip` becomes the given pose, or
    /// the nearest to it that was found. Positions outside the limits are moved into them.
    ///
    /// Nothing changes if the pose is not finite.
    ///
    /// # Panics
    /// If there are fewer positions than coordinates of the robot.
    pub fn solve(&mut self, base_from_tip: &Isometry, positions: &mut [f64], search: &Search) -> Found {
        let mut found = Found {
            is_reached: false,
            distance: f64::INFINITY,
            angle: f64::INFINITY,
            iterations: 0,
            starts: 0,
        };
        if !(base_from_tip.translation.is_finite() && base_from_tip.rotation.is_finite()) {
            return found;
        }
        let (mut best, mut random) = (f64::INFINITY, search.seed);
        while found.starts < search.starts.max(1) && !found.is_reached {
            for (current, coordinate) in self.current.iter_mut().zip(&self.coordinates) {
                *current = match found.starts {
                    0 => Some(positions[coordinate.index])
                        .filter(|position| position.is_finite())
                        .unwrap_or(0.0),
                    _ => coordinate.random(&mut random),
                };
                *current = current.clamp(coordinate.min, coordinate.max);
            }
            let (cost, iterations) = self.descend(base_from_tip, search);
            found.starts += 1;
            found.iterations += iterations;
            if cost < best {
                best = cost;
                self.best.copy_from_slice(&self.current);
                let error = difference(base_from_tip, &self.forward(Of::Current));
                (found.distance, found.angle) = (error.0.length(), error.1.length());
                found.is_reached = search.is_reached(found.distance, found.angle);
            }
        }
        for (coordinate, &position) in self.coordinates.iter().zip(&self.best) {
            positions[coordinate.index] = position;
        }
        found
    }

    /// Moves the current positions to a minimum of the error. Returns its square and the number of
    /// iterations.
    fn descend(&mut self, target: &Isometry, search: &Search) -> (f64, u32) {
        let [mut damping, least_damping, most_damping] = DAMPING;
        let mut reached = self.forward(Of::Current);
        let mut error = weighted(difference(target, &reached), search.angle_weight);
        let mut cost = error.norm_squared();
        for iteration in 0..search.iterations {
            let (distance, angle) = difference(target, &reached);
            if search.is_reached(distance.length(), angle.length()) {
                return (cost, iteration);
            }
            self.linearise(&reached, search.angle_weight);
            loop {
                let step = self.step(&error, damping);
                reached = self.forward(Of::Trial);
                error = weighted(difference(target, &reached), search.angle_weight);
                let new_cost = error.norm_squared();
                if new_cost < cost {
                    std::mem::swap(&mut self.current, &mut self.trial);
                    damping = (damping * 0.1).max(least_damping);
                    let is_stuck = new_cost > cost * (1.0 - LEAST_PROGRESS);
                    cost = new_cost;
                    if is_stuck {
                        return (cost, iteration + 1);
                    }
                    break;
                }
                damping *= 10.0;
                if damping > most_damping || step == 0.0 {
                    return (cost, iteration + 1);
                }
                reached = self.forward(Of::Current);
                error = weighted(difference(target, &reached), search.angle_weight);
            }
        }
        (cost, search.iterations)
    }

    /// `base_from_tip` at the current positions or at those on trial.
    fn forward(&self, of: Of) -> Isometry {
        let positions = if of == Of::Current { &self.current } else { &self.trial };
        let mut base_from_next = Isometry::IDENTITY;
        for step in &self.steps {
            base_from_next = base_from_next * step.before * step.motion(positions);
        }
        base_from_next * self.last_from_tip * self.tip_from_end
    }

    /// The Jacobian at the current positions, in the base, its angles weighted.
    fn linearise(&mut self, base_from_tip: &Isometry, angle_weight: f64) {
        self.jacobian.fill(0.0);
        let mut base_from_next = Isometry::IDENTITY;
        for step in &self.steps {
            // A joint does not move its own axis, so this is the same before and after its motion.
            let base_from_joint = base_from_next * step.before;
            let axis = base_from_joint.rotation * step.joint.axis;
            let (linear, angular) = match step.joint.kind {
                JointKind::Prismatic => (axis, DVec3::ZERO),
                _ => (axis.cross(base_from_tip.translation - base_from_joint.translation), axis),
            };
            let speed = if step.direction == Direction::Down { step.multiplier } else { -step.multiplier };
            let column = weighted((linear * speed, angular * speed), angle_weight);
            let mut sum = self.jacobian.column_mut(step.column);
            sum += column;
            base_from_next = base_from_joint * step.motion(&self.current);
        }
    }

    /// Puts the next positions on trial. Returns the greatest change.
    fn step(&mut self, error: &Vector6<f64>, damping: f64) -> f64 {
        self.is_free.fill(true);
        loop {
            let mut normal = Matrix6::from_diagonal_element(damping);
            for (index, column) in self.jacobian.column_iter().enumerate() {
                if self.is_free[index] {
                    normal.ger(1.0, &column, &column, 1.0);
                }
            }
            // Positive definite, because the damping is.
            let Some(factors) = normal.cholesky() else { return 0.0 };
            let multipliers = factors.solve(error);
            let change = |index: usize| self.jacobian.column(index).dot(&multipliers);
            let free = || (0..self.coordinates.len()).filter(|&index| self.is_free[index]);
            let longest = free().map(|index| change(index).abs()).fold(0.0, f64::max);
            let scale = if longest > LONGEST_STEP { LONGEST_STEP / longest } else { 1.0 };
            let mut blocked = None;
            let mut moved = 0.0_f64;
            for (index, coordinate) in self.coordinates.iter().enumerate() {
                let now = self.current[index];
                let wanted = if self.is_free[index] { now + scale * change(index) } else { now };
                let (is_low, is_high) = (now <= coordinate.min, now >= coordinate.max);
                if self.is_free[index] && (is_low && wanted < now || is_high && wanted > now) {
                    blocked = Some(index);
                    break;
                }
                self.trial[index] = wanted.clamp(coordinate.min, coordinate.max);
                moved = moved.max((self.trial[index] - now).abs());
            }
            match blocked {
                Some(index) => self.is_free[index] = false,
                None => return moved,
            }
        }
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Of {
    Current,
    Trial,
}

impl Step {
    fn motion(&self, positions: &[f64]) -> Isometry {
        let motion = self.joint.motion(self.multiplier * positions[self.column] + self.offset);
        if self.direction == Direction::Down { motion } else { motion.inverse() }
    }
}

impl Coordinate {
    /// A position within the limits, or within one turn.
    fn random(&self, state: &mut u64) -> f64 {
        use std::f64::consts::PI;
        let (min, max) = (self.min.max(-PI), self.max.min(PI));
        min + (max - min).max(0.0) * unit(state)
    }
}

/// A number from 0 to 1.
///
/// # References
/// SplitMix64: G. L. Steele, D. Lea, C. H. Flood, Fast splittable pseudorandom number generators, OOPSLA
/// 2014.
fn unit(state: &mut u64) -> f64 {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut bits = *state;
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    bits ^= bits >> 31;
    (bits >> 11) as f64 / (1_u64 << 53) as f64
}

impl Search {
    fn is_reached(&self, distance: f64, angle: f64) -> bool {
        distance <= self.distance_tolerance && (angle <= self.angle_tolerance || self.angle_weight == 0.0)
    }
}

/// The translation and the rotation vector from one pose to another, in the frame in which both are.
pub(crate) fn difference(target: &Isometry, reached: &Isometry) -> (DVec3, DVec3) {
    let rotation = target.rotation * reached.rotation.conjugate();
    (target.translation - reached.translation, rotation_vector(rotation))
}

/// The axis times the angle, which is at most π. Also exact for small angles.
fn rotation_vector(rotation: DQuat) -> DVec3 {
    let rotation = if rotation.w < 0.0 { -rotation } else { rotation };
    let sin = rotation.xyz().length();
    if sin < 1e-150 { DVec3::ZERO } else { rotation.xyz() * (2.0 * libm::atan2(sin, rotation.w) / sin) }
}

pub(crate) fn weighted((linear, angular): (DVec3, DVec3), angle_weight: f64) -> Vector6<f64> {
    let angular = angular * angle_weight;
    Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
}
