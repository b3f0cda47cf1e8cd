//! Legs with six joints in closed form: hip yaw, roll and pitch about one point, knee, ankle pitch and roll.

mod description;
mod nearest;

pub use description::LegError;
pub use nearest::NearestLeg;

use downbeat_transforms::{Isometry, wrapped};
use glam::{DMat3, DQuat, DVec3};

/// A leg of a humanoid robot, whose hip turns about z, x and y through one point, its knee about y, and its
/// ankle about y and x.
///
/// The frame of the hip has the axes of the base and its origin where the three axes of the hip meet
/// ([`Leg::base_from_hip`]); the sole is on the ground below the ankle. With all angles 0 the leg is
/// straight.
///
/// ```
/// use downbeat_kinematics::darwin_op;
/// use downbeat_kinematics::leg::{Reach, Side};
/// use downbeat_transforms::Isometry;
///
/// // The foot 20 mm up and 10 mm forward of where it is with the leg straight.
/// let leg = darwin_op::leg(Side::Right);
/// let hip_from_sole = Isometry::from_translation(0.01, 0.0, 0.02 - leg.straight());
/// let solution = leg.inverse(&hip_from_sole);
/// assert_eq!(solution.reach, Reach::Exact);
/// assert!((leg.forward(&solution.angles).translation - hip_from_sole.translation).length() < 1e-12);
///
/// let names = darwin_op::leg_joint_names(Side::Right);
/// let knee = names.iter().position(|name| *name == "r_knee").unwrap();
/// assert!((solution.angles[knee].to_degrees() - 53.2).abs() < 0.1);
/// ```
///
/// # References
/// The solution goes from the foot to the hip, as that of UPenn (`OPKinematics`), with half angles instead of
/// inverse cosines, which keeps it exact when the leg is straight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leg {
    geometry: LegGeometry,
}

/// The lengths of a leg, and how its servos count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LegGeometry {
    /// Where the axes of the hip meet, in the base, in m.
    pub hip: DVec3,
    /// From the hip to the knee, in m.
    pub thigh: f64,
    /// From the knee to the ankle, in m.
    pub shank: f64,
    /// From the ankle to the sole, in m.
    pub foot: f64,
    /// 1 for each joint that turns about z, x, y, y, y, x as its angle grows, -1 if it turns the other way.
    pub signs: [f64; 6],
    /// The smallest and the greatest angles, in rad.
    pub limits: [[f64; 2]; 6],
}

/// The right or the left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Side {
    /// The right.
    Right,
    /// The left.
    Left,
}

/// The angles of a leg for a pose of the sole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LegSolution {
    /// In rad: hip yaw, roll and pitch, knee, ankle pitch and roll, within the limits.
    pub angles: [f64; 6],
    /// Whether the sole reaches the pose with these angles.
    pub reach: Reach,
}

/// Whether a leg reaches a pose. If several of them apply, it is the last one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Reach {
    /// It reaches the pose.
    Exact,
    /// The pose is too far away: the leg is straight and points to it; the sole has the orientation.
    TooFar,
    /// The pose is nearer to the hip than the knee can bend: the sole has the orientation and the direction.
    TooClose,
    /// A joint would exceed its limits: it is at its limit.
    BeyondLimits,
}

/// How far rounding may put a pose beyond what is reachable, in m and rad.
const TOLERANCE: f64 = 1e-9;
const KNEE: usize = 3;

impl Leg {
    /// A leg of this geometry.
    #[must_use]
    pub const fn new(geometry: LegGeometry) -> Self {
        Self { geometry }
    }

    /// Its lengths, and how its servos count.
    #[must_use]
    pub const fn geometry(&self) -> &LegGeometry {
        &self.geometry
    }

    /// The smallest and the greatest angles of its joints, in rad.
    #[must_use]
    pub const fn limits(&self) -> [[f64; 2]; 6] {
        self.geometry.limits
    }

    /// Where the hip is.
    #[must_use]
    pub fn base_from_hip(&self) -> Isometry {
        Isometry { translation: self.geometry.hip, rotation: DQuat::IDENTITY }
    }

    /// The distance from the hip to the sole of the straight leg, in m.
    #[must_use]
    pub const fn straight(&self) -> f64 {
        let LegGeometry { thigh, shank, foot, .. } = self.geometry;
        thigh + shank + foot
    }

    /// `hip_from_sole` for these angles, in rad.
    #[must_use]
    pub fn forward(&self, angles: &[f64; 6]) -> Isometry {
        let [yaw, roll, pitch, knee, ankle_pitch, ankle_roll] = product(angles, &self.geometry.signs);
        let about_y = DQuat::from_rotation_y;
        let hip_from_thigh = DQuat::from_rotation_z(yaw) * DQuat::from_rotation_x(roll) * about_y(pitch);
        let hip_from_shin = hip_from_thigh * about_y(knee);
        let rotation = hip_from_shin * about_y(ankle_pitch) * DQuat::from_rotation_x(ankle_roll);
        let LegGeometry { thigh, shank, foot, .. } = self.geometry;
        let ankle = hip_from_thigh * (DVec3::NEG_Z * thigh) + hip_from_shin * (DVec3::NEG_Z * shank);
        Isometry { translation: ankle + rotation * (DVec3::NEG_Z * foot), rotation }
    }

    /// The angles with which the sole reaches a pose, or comes near it; see [`Reach`]. Takes less than 300
    /// ns; [`Leg::nearest`] takes longer and comes nearest.
    ///
    /// The solution with the knee bent forward is preferred. For a pose that is not finite, all angles are
    /// NaN.
    #[must_use]
    pub fn inverse(&self, hip_from_sole: &Isometry) -> LegSolution {
        if !(hip_from_sole.translation.is_finite() && hip_from_sole.rotation.is_finite()) {
            return LegSolution { angles: [f64::NAN; 6], reach: Reach::BeyondLimits };
        }
        let mut solutions = self.solutions(hip_from_sole);
        let preferred = solutions.next();
        if let Some(preferred) = preferred.filter(|solution| solution.reach < Reach::BeyondLimits) {
            return preferred;
        }
        // Near the ends of the joints, only another solution may be within the limits.
        let other = solutions.find(|other| other.reach < Reach::BeyondLimits).or(preferred);
        other.unwrap_or(LegSolution { angles: [f64::NAN; 6], reach: Reach::BeyondLimits })
    }

    /// All four solutions, the preferred one first.
    fn solutions(self, hip_from_sole: &Isometry) -> impl Iterator<Item = LegSolution> {
        let hip_from_sole_axes = DMat3::from_quat(hip_from_sole.rotation);
        let ankle = hip_from_sole.translation + hip_from_sole_axes.z_axis * self.geometry.foot;
        // The hip as seen from the ankle.
        let sole_from_hip = hip_from_sole_axes.transpose() * -ankle;
        let all = [
            (Knee::Forward, Shin::Up),
            (Knee::Forward, Shin::Down),
            (Knee::Backward, Shin::Up),
            (Knee::Backward, Shin::Down),
        ];
        all.into_iter().map(move |(knee, shin)| self.solve(&hip_from_sole_axes, sole_from_hip, knee, shin))
    }

    /// `hip_from_sole` for these angles, and for each joint its axis and a point on it, both in the hip. The
    /// sole turns about the axis as the angle of the servo grows.
    fn axes(self, angles: &[f64; 6]) -> (Isometry, [(DVec3, DVec3); 6]) {
        let [yaw, roll, pitch, knee, ankle_pitch, ankle_roll] = product(angles, &self.geometry.signs);
        let about_y = DQuat::from_rotation_y;
        let after_yaw = DQuat::from_rotation_z(yaw);
        let after_roll = after_yaw * DQuat::from_rotation_x(roll);
        let hip_from_thigh = after_roll * about_y(pitch);
        let hip_from_shin = hip_from_thigh * about_y(knee);
        let hip_from_foot = hip_from_shin * about_y(ankle_pitch);
        let rotation = hip_from_foot * DQuat::from_rotation_x(ankle_roll);
        let LegGeometry { thigh, shank, foot, .. } = self.geometry;
        let knee = hip_from_thigh * (DVec3::NEG_Z * thigh);
        let ankle = knee + hip_from_shin * (DVec3::NEG_Z * shank);
        let hip_from_sole = Isometry { translation: ankle + rotation * (DVec3::NEG_Z * foot), rotation };
        let across = after_roll * DVec3::Y;
        let axes = [
            (DVec3::Z, DVec3::ZERO),
            (after_yaw * DVec3::X, DVec3::ZERO),
            (across, DVec3::ZERO),
            (across, knee),
            (across, ankle),
            (hip_from_foot * DVec3::X, ankle),
        ];
        let signs = self.geometry.signs;
        (hip_from_sole, std::array::from_fn(|joint| (axes[joint].0 * signs[joint], axes[joint].1)))
    }

    /// One of the four solutions.
    ///
    /// Rotations of the chain are Rz(yaw) Rx(roll) Ry(pitch) Ry(knee) Ry(ankle_pitch) Rx(ankle_roll).
    fn solve(&self, hip_from_sole_axes: &DMat3, sole_from_hip: DVec3, knee: Knee, shin: Shin) -> LegSolution {
        // (1) The ankle roll turns the hip into the plane in which knee and ankle pitch bend the leg.
        let across = libm::hypot(sole_from_hip.y, sole_from_hip.z);
        let up = if shin == Shin::Up { across } else { -across };
        let (sin_roll, cos_roll) =
            if across > 0.0 { (sole_from_hip.y / up, sole_from_hip.z / up) } else { (0.0, 1.0) };
        let ankle_roll = libm::atan2(sin_roll, cos_roll);
        // (2) The law of cosines, for half the angle of the knee: with a and b the lengths of thigh and
        // shank, and d the distance from hip to ankle,
        // tan^2(knee / 2) = ((a + b)^2 - d^2) / (d^2 - (a - b)^2).
        let LegGeometry { thigh, shank, signs, limits, .. } = self.geometry;
        let (longest, shortest) = (thigh + shank, thigh - shank);
        let distance = sole_from_hip.length();
        let bend = ((longest - distance) * (longest + distance)).max(0.0).sqrt();
        let bend = 2.0 * libm::atan2(bend, ((distance - shortest) * (distance + shortest)).max(0.0).sqrt());
        let [min, max] = match (limits[KNEE], signs[KNEE] > 0.0) {
            (limits, true) => limits,
            ([min, max], false) => [-max, -min],
        };
        let wanted = if knee == Knee::Forward { bend } else { -bend };
        let knee = wanted.clamp(min, max);
        // (3) Seen from the ankle, the hip is at the angle -knee / 2 - skew - ankle_pitch from z to x, by the
        // law of tangents: tan(skew) = (a - b) / (a + b) tan(knee / 2), 0 for equal lengths.
        let (sin, cos) = libm::sincos(knee / 2.0);
        let skew = libm::atan2(shortest * sin, longest * cos);
        let ankle_pitch = -(knee / 2.0 + skew) - libm::atan2(sole_from_hip.x, up);
        // (4) What remains of the rotation is that of the hip: Rz(yaw) Rx(roll) Ry(pitch + knee +
        // ankle_pitch).
        let DMat3 { x_axis, y_axis, z_axis } = *hip_from_sole_axes;
        let y = y_axis * cos_roll - z_axis * sin_roll;
        let z = y_axis * sin_roll + z_axis * cos_roll;
        let yaw = libm::atan2(-y.x, y.y);
        let roll = libm::atan2(y.z, libm::hypot(y.x, y.y));
        let pitch = libm::atan2(-x_axis.z, z.z);
        let pitch = wrapped(pitch - knee - ankle_pitch);
        let wanted_angles = [yaw, roll, pitch, knee, wrapped(ankle_pitch), ankle_roll];
        let wanted_angles = product(&wanted_angles, &signs);
        let angles =
            std::array::from_fn(|index| wanted_angles[index].clamp(limits[index][0], limits[index][1]));
        let is_beyond = |index: usize| (wanted_angles[index] - angles[index]).abs() > TOLERANCE;
        let reach = if (0..6).any(is_beyond) || wanted < min - TOLERANCE {
            Reach::BeyondLimits
        } else if wanted > max + TOLERANCE {
            Reach::TooClose
        } else if distance > longest + TOLERANCE {
            Reach::TooFar
        } else {
            Reach::Exact
        };
        LegSolution { angles, reach }
    }
}

/// In which direction the knee points.
#[derive(Clone, Copy, PartialEq)]
enum Knee {
    Forward,
    Backward,
}

/// On which side of the foot the hip is.
#[derive(Clone, Copy, PartialEq)]
enum Shin {
    Up,
    Down,
}

fn product(left: &[f64; 6], right: &[f64; 6]) -> [f64; 6] {
    std::array::from_fn(|index| left[index] * right[index])
}
