//! The pose nearest to one that a leg cannot reach.

use super::{Leg, Reach};
use crate::inverse::{difference, weighted};
use downbeat_transforms::Isometry;
use nalgebra::{Matrix6, SMatrix, Vector6};

/// The angles of a leg with which its sole comes nearest to a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearestLeg {
    /// In rad, in the order of [`LegSolution::angles`](super::LegSolution), within the limits.
    pub angles: [f64; 6],
    /// Why the sole does not reach the pose, if it does not.
    pub reach: Reach,
    /// From the wanted position of the sole, in m.
    pub distance: f64,
    /// From the wanted orientation of the sole, in rad.
    pub angle: f64,
}

impl NearestLeg {
    /// The distance in m that counts as much as an angle of 1 rad: the position goes before the orientation.
    pub const ANGLE_WEIGHT: f64 = 0.02;

    /// What [`Leg::nearest`] makes as small as it can, in m²: the square of the distance, plus that of the
    /// angle times [`NearestLeg::ANGLE_WEIGHT`].
    #[must_use]
    pub fn error(&self) -> f64 {
        self.distance.powi(2) + (self.angle * Self::ANGLE_WEIGHT).powi(2)
    }

    pub(crate) fn new(leg: &Leg, target: &Isometry, angles: [f64; 6], reach: Reach) -> Self {
        let (linear, angular) = difference(target, &leg.forward(&angles));
        Self { angles, reach, distance: linear.length(), angle: angular.length() }
    }
}

/// The maximum number of iterations from each start.
const ITERATIONS: u32 = 100;
/// The first, smallest and greatest damping, in m².
const DAMPING: [f64; 3] = [1e-4, 1e-12, 1e2];
/// The search ends where the error changes by less than this with the angles, in m²/rad.
const FLAT: f64 = 1e-9;

impl Leg {
    /// The angles within the limits with which the sole comes nearest to a pose: those of [`Leg::inverse`] if
    /// it reaches the pose; otherwise the best of what is found from its four solutions, each moved into the
    /// limits first. So the result is never worse than that of [`Leg::inverse`], as [`NearestLeg::error`]
    /// measures it. Small changes of the angles make that error at most 0.5 % smaller.
    ///
    /// For a pose out of reach it takes some hundred iterations, much longer than [`Leg::inverse`]. For a
    /// pose that is not finite, all angles are NaN.
    ///
    /// ```
    /// use downbeat_kinematics::darwin_op;
    /// use downbeat_kinematics::leg::{Reach, Side};
    /// use downbeat_transforms::Isometry;
    ///
    /// // 20 mm to the side of what a straight leg reaches: the foot tilts, and the sole comes nearer.
    /// let leg = darwin_op::leg(Side::Right);
    /// let hip_from_sole = Isometry::from_translation(0.0, -0.1, -0.22);
    /// let nearest = leg.nearest(&hip_from_sole);
    /// let clamped = leg.forward(&leg.inverse(&hip_from_sole).angles);
    /// assert_eq!(nearest.reach, Reach::TooFar);
    /// assert!(nearest.distance < (clamped.translation - hip_from_sole.translation).length());
    /// ```
    ///
    /// # References
    /// Damped least squares as in [`InverseKinematics`](crate::InverseKinematics): each step minimises
    /// `|J Δq - e|² + λ |Δq|²` over the joints that are not held at a limit, is moved into the limits, and is
    /// taken only if the error decreases.
    #[must_use]
    pub fn nearest(&self, hip_from_sole: &Isometry) -> NearestLeg {
        let solution = self.inverse(hip_from_sole);
        let mut best = NearestLeg::new(self, hip_from_sole, solution.angles, solution.reach);
        if solution.reach == Reach::Exact || solution.angles[0].is_nan() {
            return best;
        }
        for start in self.solutions(hip_from_sole) {
            let angles = self.descend(hip_from_sole, start.angles);
            let found = NearestLeg::new(self, hip_from_sole, angles, solution.reach);
            if found.error() < best.error() {
                best = found;
            }
        }
        best
    }

    /// Moves angles within the limits to a minimum of the error.
    fn descend(&self, target: &Isometry, mut angles: [f64; 6]) -> [f64; 6] {
        let limits = self.limits();
        let [mut damping, least_damping, most_damping] = DAMPING;
        let error_of = |reached: &Isometry| weighted(difference(target, reached), NearestLeg::ANGLE_WEIGHT);
        for _ in 0..ITERATIONS {
            let (reached, axes) = self.axes(&angles);
            let error = error_of(&reached);
            let columns = axes.map(|(axis, point)| {
                weighted((axis.cross(reached.translation - point), axis), NearestLeg::ANGLE_WEIGHT)
            });
            let mut jacobian = SMatrix::<f64, 6, 6>::from_columns(&columns);
            let mut pull: Vector6<f64> = jacobian.transpose() * error;
            // Joints at a limit that are pulled beyond it stay there.
            for (joint, [min, max]) in limits.into_iter().enumerate() {
                let is_held = (angles[joint] <= min && pull[joint] < 0.0)
                    || (angles[joint] >= max && pull[joint] > 0.0);
                if is_held {
                    jacobian.column_mut(joint).fill(0.0);
                    pull[joint] = 0.0;
                }
            }
            if pull.norm() < FLAT {
                return angles;
            }
            let (normal, cost) = (jacobian.transpose() * jacobian, error.norm_squared());
            angles = loop {
                // Positive definite, because the damping is.
                let damped = normal + Matrix6::from_diagonal_element(damping);
                let Some(step) = damped.cholesky().map(|factors| factors.solve(&pull)) else { return angles };
                let trial: [f64; 6] = std::array::from_fn(|joint| {
                    (angles[joint] + step[joint]).clamp(limits[joint][0], limits[joint][1])
                });
                if error_of(&self.forward(&trial)).norm_squared() < cost {
                    damping = (damping * 0.1).max(least_damping);
                    break trial;
                }
                damping *= 10.0;
                if damping > most_damping {
                    return angles;
                }
            };
        }
        angles
    }
}
