//! The leg of a robot description.

use super::{Leg, LegGeometry};
use crate::description::{DescriptionError, Joint, JointKind, LinkId, Robot};
use crate::pose::Pose;
use glam::DVec3;

/// Why a leg of a description has no closed form. The messages end with the remedy.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum LegError {
    /// A name that the description lacks.
    #[error(transparent)]
    Description(#[from] DescriptionError),
    /// The joints between base and sole are others.
    #[error(
        "{file}: between \"{base}\" and \"{sole}\" the joints {found} move; a leg has six, in this order: {wanted}"
    )]
    Chain { file: String, base: String, sole: String, found: String, wanted: String },
    /// A joint without limits, or one that slides or follows another one.
    #[error("{file}:{line}: joint \"{joint}\" of a leg has to be revolute and to follow no other joint")]
    Kind { file: String, line: u32, joint: String },
    /// A joint turns about another axis.
    #[error(
        "{file}:{line}: joint \"{joint}\" turns about {axis} of \"{base}\" and not about {wanted}: the hip has \
         to turn about z, x and y, the knee about y, the ankle about y and x"
    )]
    Axis { file: String, line: u32, joint: String, axis: String, base: String, wanted: &'static str },
    /// Lengths that the closed form does not have.
    #[error(
        "{file}: {what} is {millimetres:.1} mm off with all angles 0: the axes of the hip have to meet, and \
         knee, ankle and sole to be below them"
    )]
    Offset { file: String, what: &'static str, millimetres: f64 },
}

/// How far a leg may be from one whose axes meet and that is straight at 0, in m: the gears of a robot have
/// more play at its soles.
const MOST_OFFSET: f64 = 1e-3;
/// The cosine of the largest angle between an axis and that of the closed form.
const PARALLEL: f64 = 0.9999;

const AXES: [(DVec3, &str); 6] =
    [(DVec3::Z, "z"), (DVec3::X, "x"), (DVec3::Y, "y"), (DVec3::Y, "y"), (DVec3::Y, "y"), (DVec3::X, "x")];

impl Leg {
    /// The leg of a robot between a base, whose x axis points forward and whose z axis up, and a sole. The
    /// joints are hip yaw, roll and pitch, knee, ankle pitch and roll.
    ///
    /// ```
    /// use downbeat_kinematics::leg::{Leg, Side};
    /// use downbeat_kinematics::{Robot, darwin_op};
    ///
    /// let robot = Robot::read("../../robots/darwin_op.urdf")?;
    /// let leg = Leg::of(&robot, "base_link", darwin_op::leg_joint_names(Side::Left), "l_sole")?;
    /// assert!((leg.straight() - 0.2195).abs() < 1e-9);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// If the description has other joints there, or they do not turn about axes as those of [`Leg`] within 1
    /// mm.
    pub fn of(robot: &Robot, base: &str, joints: [&str; 6], sole: &str) -> Result<Self, LegError> {
        let file = || robot.file().to_owned();
        let (base_id, sole_id) = (robot.link_id(base)?, robot.link_id(sole)?);
        let names = |names: &[&str]| names.join(", ");
        let found = moving_between(robot, base_id, sole_id);
        if found != joints {
            let (base, sole) = (base.to_owned(), sole.to_owned());
            let found = if found.is_empty() { "none".to_owned() } else { names(&found) };
            return Err(LegError::Chain { file: file(), base, sole, found, wanted: names(&joints) });
        }
        let pose = Pose::new(robot);
        let (mut signs, mut limits, mut points) = ([1.0; 6], [[0.0; 2]; 6], [DVec3::ZERO; 6]);
        for (index, (name, (wanted, wanted_name))) in joints.into_iter().zip(AXES).enumerate() {
            let joint = robot.joint(robot.joint_id(name)?);
            let Joint { line, .. } = *joint;
            let joint_name = || joint.name.clone();
            let refused = || LegError::Kind { file: file(), line, joint: joint_name() };
            let is_plain = joint.kind == JointKind::Revolute && joint.mimic.is_none();
            let allowed = joint.limits.filter(|_| is_plain).ok_or_else(refused)?;
            let base_from_joint = pose.target_from_source(base_id, joint.child);
            let axis = base_from_joint.rotation * joint.axis;
            if axis.dot(wanted).abs() < PARALLEL {
                let (axis, base) =
                    (format!("({:.3}, {:.3}, {:.3})", axis.x, axis.y, axis.z), base.to_owned());
                return Err(LegError::Axis {
                    file: file(),
                    line,
                    joint: joint_name(),
                    axis,
                    base,
                    wanted: wanted_name,
                });
            }
            signs[index] = axis.dot(wanted).signum();
            limits[index] = [allowed.lower, allowed.upper];
            points[index] = base_from_joint.translation;
        }
        let [yaw, roll, pitch, knee, ankle_pitch, ankle_roll] = points;
        let hip = DVec3::new(pitch.x, roll.y, pitch.z);
        let base_from_sole = pose.target_from_source(base_id, sole_id);
        let sole = base_from_sole.translation;
        // Of a point on each axis only what is across the axis matters.
        let offsets = [
            ("the axis of the hip's yaw", (yaw - hip).truncate().length()),
            ("the axis of the hip's roll", (roll - hip).z.abs()),
            ("the axis of the knee", (knee - hip).x.abs()),
            ("the axis of the ankle's pitch", (ankle_pitch - hip).x.abs()),
            ("the axis of the ankle's roll", (ankle_roll - hip).y.abs()),
            ("the axis of the ankle's roll", (ankle_roll - ankle_pitch).z.abs()),
            ("the sole", (sole - hip).truncate().length()),
            // At the distance of a foot's length.
            ("the direction of the sole", (base_from_sole.rotation * DVec3::Z - DVec3::Z).length() * 0.1),
            ("the heading of the sole", (base_from_sole.rotation * DVec3::X - DVec3::X).length() * 0.1),
        ];
        if let Some((what, offset)) = offsets.into_iter().find(|(_, offset)| *offset > MOST_OFFSET) {
            return Err(LegError::Offset { file: file(), what, millimetres: offset * 1e3 });
        }
        let (thigh, shank, foot) = (hip.z - knee.z, knee.z - ankle_pitch.z, ankle_pitch.z - sole.z);
        let lengths = [("the knee", thigh), ("the ankle", shank), ("the sole", foot)];
        if let Some((what, length)) = lengths.into_iter().find(|(_, length)| *length < MOST_OFFSET) {
            return Err(LegError::Offset {
                file: file(),
                what,
                millimetres: (length - MOST_OFFSET).abs() * 1e3,
            });
        }
        Ok(Self::new(LegGeometry { hip, thigh, shank, foot, signs, limits }))
    }
}

/// The joints that move a link relative to one above it, from there down; none if it is not above.
fn moving_between(robot: &Robot, base: LinkId, tip: LinkId) -> Vec<&str> {
    let (mut names, mut link) = (Vec::new(), tip);
    while link != base {
        let Some(parent) = robot.link(link).parent else { return Vec::new() };
        let joint = robot.joint(parent);
        if joint.kind != JointKind::Fixed {
            names.push(joint.name.as_str());
        }
        link = joint.parent;
    }
    names.reverse();
    names
}
