//! What distinguishes one humanoid robot from another, for modules that move it: its joints, its legs, how it
//! stands.
//!
//! The modules have the setting `humanoid`, the path of a file. Without it the robot is the Darwin OP
//! ([`Humanoid::darwin_op`]).
//!
//! ```toml
//! # Relative to this file. Joints, limits, speeds and lengths of the legs are those of the description.
//! robot_description = "my_humanoid.urdf"
//!
//! # The names below are the defaults. Two joints whose names differ in how they begin, as here, are a pair.
//! sides = ["r_", "l_"]
//! base = "base_link"  # x forward, z up; its pose is the odometry
//! leg = ["hip_yaw", "hip_roll", "hip_pitch", "knee", "ank_pitch", "ank_roll"]
//! sole = "sole"       # a link below the ankle, on the ground
//! arm = "sho_pitch"   # swings forward and back while the robot walks; "" if there is none
//!
//! # How the robot stands, in degrees; joints that are not named stand at 0. A name without its side is both
//! # joints: the right one gets this angle, the left one its mirror image. The gait moves these joints and
//! # those of the legs, and leaves others, such as those of the head, to other modules.
//! [stand_degrees]
//! sho_roll = 70
//! knee = -40
//! ```

use crate::hardware::tables::joints::{COUNT, JOINTS};
use crate::hardware::tables::units::radians_from_ticks;
use crate::joints::{Joint, Joints};
use downbeat_executor::{Module, Setup, SetupError};
use downbeat_files::toml::{self, Spanned};
use downbeat_kinematics::description::{JointKind, LinkId};
use downbeat_kinematics::leg::{Leg, LegError, Side};
use downbeat_kinematics::{DescriptionError, Masses, Pose, Robot, darwin_op};
use glam::DVec3;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock};

/// The numbers of a humanoid robot; see the [module page](self).
#[derive(Clone, Debug)]
pub struct Humanoid {
    name: String,
    /// The path of the URDF; `None` for the Darwin OP.
    description: Option<PathBuf>,
    joints: Arc<Joints>,
    base: String,
    /// Right, left, as all that follows.
    soles: [String; 2],
    legs: [LegOfRobot; 2],
    /// The joints that swing the arms, right and left, with 1 for one that turns about y as its angle grows,
    /// and -1 for one that turns the other way.
    arms: Option<[(usize, f64); 2]>,
    /// In the base while the robot stands, in m; 0 if the description has no masses.
    centre_of_mass: DVec3,
}

/// A leg, and the positions of its joints among those of the robot.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LegOfRobot {
    pub(crate) leg: Leg,
    pub(crate) joints: [usize; 6],
}

/// Positions in [`LegOfRobot::joints`]; the first is that about the vertical.
pub(crate) const HIP_ROLL: usize = 1;
pub(crate) const HIP_PITCH: usize = 2;
pub(crate) const KNEE: usize = 3;
pub(crate) const ANKLE_PITCH: usize = 4;
pub(crate) const ANKLE_ROLL: usize = 5;

/// What is wrong with the file of a humanoid.
#[derive(Debug, thiserror::Error)]
pub enum HumanoidError {
    /// The file cannot be read or is invalid.
    #[error(transparent)]
    File(#[from] toml::Error),
    /// The description cannot be used.
    #[error(transparent)]
    Description(#[from] DescriptionError),
    /// A leg is not one that walks.
    #[error(transparent)]
    Leg(Box<LegError>),
}

impl From<LegError> for HumanoidError {
    fn from(error: LegError) -> Self {
        Self::Leg(Box::new(error))
    }
}

/// The largest file, in bytes.
const MAX_BYTES: u64 = 1 << 16;
/// While it stands, from its description, in m.
const DARWIN_OP_CENTRE_OF_MASS: DVec3 = DVec3::new(-0.001_67, 0.0, 0.013_94);
/// The speed of an MX-28 without load at 12 V, in rad/s.
const MX28_SPEED: f64 = 5.76;

static DARWIN_OP: LazyLock<Arc<Humanoid>> = LazyLock::new(|| Arc::new(Humanoid::of_tables()));

impl Humanoid {
    /// The Darwin OP, whose joints are those of [`JOINTS`].
    #[must_use]
    pub fn darwin_op() -> Arc<Self> {
        Arc::clone(&DARWIN_OP)
    }

    fn of_tables() -> Self {
        let place = |name: &str| JOINTS.iter().position(|joint| joint.name == name).unwrap_or(COUNT);
        let joints = JOINTS.iter().enumerate().map(|(index, joint)| {
            // The joints of the two sides alternate, those of the head are in the middle.
            let is_of_head = joint.name.starts_with("head_");
            let partner = if is_of_head { index } else { index ^ 1 };
            let [axis, other] = [joint, &JOINTS[partner]].map(|joint| DVec3::from(joint.axis.map(f64::from)));
            Joint {
                name: joint.name.to_owned(),
                limits: [joint.min_rad(), joint.max_rad()],
                max_speed: MX28_SPEED,
                stand: radians_from_ticks(joint.walking_ready_ticks, 0),
                is_of_gait: !is_of_head,
                mirror: (partner, mirror_sign(axis, other)),
            }
        });
        let leg = |side| LegOfRobot {
            leg: darwin_op::leg(side),
            joints: darwin_op::leg_joint_names(side).map(place),
        };
        let names = Names::default();
        let arm = |name: &str| (place(name), f64::from(JOINTS[place(name)].axis[1]));
        Self {
            name: "darwin_op".to_owned(),
            description: None,
            joints: Arc::new(Joints::new(joints.collect(), names.sides)),
            soles: ["r_sole", "l_sole"].map(str::to_owned),
            base: names.base,
            legs: [leg(Side::Right), leg(Side::Left)],
            arms: Some(["r_sho_pitch", "l_sho_pitch"].map(arm)),
            centre_of_mass: DARWIN_OP_CENTRE_OF_MASS,
        }
    }

    /// Reads a file as on the [module page](self).
    ///
    /// # Errors
    /// If the file or its description cannot be read, or does not describe a robot on two legs.
    pub fn read(file: &str) -> Result<Self, HumanoidError> {
        let source = toml::Source::read(file, "the numbers of a humanoid from", MAX_BYTES)?;
        let source = Source(source);
        let entries: Names = source.0.parse()?;
        let Some(description) = &entries.robot_description else {
            let problem = "robot_description is missing: name the URDF of the robot, relative to this file";
            return Err(source.error(0, problem.to_owned()));
        };
        let folder = Path::new(file).parent().unwrap_or(Path::new(""));
        let path = folder.join(description.get_ref());
        let robot = Robot::read(&path)?;
        Ok(Self { description: Some(path), ..Self::of(&robot, entries, &source)? })
    }

    fn of(robot: &Robot, names: Names, source: &Source<'_>) -> Result<Self, HumanoidError> {
        let base = robot.link_id(&names.base)?;
        let mut joints = described_joints(robot, base, &names.sides);
        let place = |joints: &[Joint], name: &str| -> Result<usize, HumanoidError> {
            robot.joint_id(name)?;
            let missing = || format!("joint \"{name}\" has no limits, or follows another one");
            joints.iter().position(|joint| joint.name == name).ok_or_else(|| source.error(0, missing()))
        };
        let mut legs = Vec::with_capacity(2);
        for side in &names.sides {
            let [yaw, roll, pitch, knee, ankle_pitch, ankle_roll] =
                names.leg.each_ref().map(|name| format!("{side}{name}"));
            let of_leg = [&*yaw, &*roll, &*pitch, &*knee, &*ankle_pitch, &*ankle_roll];
            let leg = Leg::of(robot, &names.base, of_leg, &format!("{side}{}", names.sole))?;
            let mut places = [0; 6];
            for (found, name) in places.iter_mut().zip(of_leg) {
                *found = place(&joints, name)?;
                joints[*found].is_of_gait = true;
            }
            legs.push(LegOfRobot { leg, joints: places });
        }
        let mut humanoid = Self {
            name: robot.name().to_owned(),
            description: None,
            joints: Arc::new(Joints::new(joints, names.sides.clone())),
            soles: names.sides.each_ref().map(|side| format!("{side}{}", names.sole)),
            base: names.base,
            legs: [legs[0], legs[1]],
            arms: None,
            centre_of_mass: DVec3::ZERO,
        };
        if !names.arm.is_empty() {
            let [right, left] = names.sides.each_ref().map(|side| format!("{side}{}", names.arm));
            let arm = |name: &str| {
                let axis = axis_in(robot, base, robot.joint(robot.joint_id(name)?).child);
                Ok::<_, HumanoidError>((place(&humanoid.joints, name)?, axis.y.signum()))
            };
            humanoid.arms = Some([arm(&right)?, arm(&left)?]);
        }
        for (name, degrees) in &names.stand_degrees {
            let joints = Arc::make_mut(&mut humanoid.joints);
            let Some(named) = joints.named(name.get_ref()) else {
                return Err(source.error(name.span().start, joints.none_named(name.get_ref())));
            };
            for (index, sign) in named {
                let joint = &mut joints[index];
                let angle = degrees.get_ref().to_radians() * sign;
                // A limit as written in degrees is inside.
                let slack = 1e-4;
                if !(joint.limits[0] - slack..=joint.limits[1] + slack).contains(&angle) {
                    let [min, max] = joint.limits.map(f64::to_degrees);
                    let problem = format!(
                        "{} = {} is beyond the limits of the joint, {min:.1} to {max:.1}",
                        joint.name,
                        angle.to_degrees()
                    );
                    return Err(source.error(degrees.span().start, problem));
                }
                (joint.stand, joint.is_of_gait) = (angle, true);
            }
        }
        if let Ok(masses) = Masses::new(robot) {
            let mut positions = vec![0.0; robot.coordinates().len()];
            for joint in humanoid.joints.iter() {
                if let Some(coordinate) = robot.coordinate(&joint.name) {
                    positions[coordinate] = joint.stand;
                }
            }
            let mut pose = Pose::new(robot);
            pose.update(robot, &positions);
            humanoid.centre_of_mass =
                pose.base_from_link(base).inverse().transform_point(masses.center_of_mass(&pose));
        }
        Ok(humanoid)
    }

    /// The setting `humanoid` of a module, and the robot that it names.
    ///
    /// # Errors
    /// If the file cannot be used.
    pub fn declare<M: Module>(setup: &mut Setup<'_, M>) -> Result<Arc<Self>, SetupError> {
        let file = setup.read_only_setting(
            "humanoid",
            String::new(),
            "file of the robot's numbers, relative to the robot file; empty: those of the Darwin OP",
        )?;
        match setup.value(file).map(String::as_str).unwrap_or_default() {
            "" => Ok(Self::darwin_op()),
            path => match Self::read(path) {
                Ok(humanoid) => Ok(Arc::new(humanoid)),
                Err(error) => Err(setup.refuse_value(file, error.to_string())),
            },
        }
    }

    /// The name of the robot.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The path of its description; `None` for the Darwin OP, whose numbers are part of the program.
    #[must_use]
    pub fn description(&self) -> Option<&Path> {
        self.description.as_deref()
    }

    /// The links that are its soles, right and left.
    #[must_use]
    pub fn soles(&self) -> &[String; 2] {
        &self.soles
    }

    /// The link whose pose is the odometry.
    #[must_use]
    pub fn base(&self) -> &str {
        &self.base
    }

    /// All joints.
    #[must_use]
    pub fn joints(&self) -> &Arc<Joints> {
        &self.joints
    }

    pub(crate) fn leg(&self, side: Side) -> &LegOfRobot {
        match side {
            Side::Right => &self.legs[0],
            Side::Left => &self.legs[1],
        }
    }

    /// Where its centre of mass is in the base while it stands, in m.
    pub(crate) fn centre_of_mass(&self) -> DVec3 {
        self.centre_of_mass
    }

    /// The joints that swing the arms, right and left, each with the sign of its axis about y.
    pub(crate) fn arms(&self) -> Option<[(usize, f64); 2]> {
        self.arms
    }
}

impl Default for Humanoid {
    /// The Darwin OP.
    fn default() -> Self {
        Self::clone(&DARWIN_OP)
    }
}

impl LegOfRobot {
    /// Turns a joint of the leg by an angle about the axis of the closed form.
    pub(crate) fn turn(&self, pose: &mut [f64], joint: usize, angle: f64) {
        pose[self.joints[joint]] += self.leg.geometry().signs[joint] * angle;
    }

    /// The angles of the leg in a pose of the robot.
    pub(crate) fn angles(&self, pose: &[f64]) -> [f64; 6] {
        self.joints.map(|joint| pose[joint])
    }
}

/// What a file may say.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Names {
    robot_description: Option<Spanned<String>>,
    sides: [String; 2],
    base: String,
    leg: [String; 6],
    sole: String,
    arm: String,
    stand_degrees: BTreeMap<Spanned<String>, Spanned<f64>>,
}

impl Default for Names {
    /// The names of ROBOTIS.
    fn default() -> Self {
        let leg = ["hip_yaw", "hip_roll", "hip_pitch", "knee", "ank_pitch", "ank_roll"];
        Self {
            robot_description: None,
            sides: ["r_", "l_"].map(str::to_owned),
            base: "base_link".to_owned(),
            leg: leg.map(str::to_owned),
            sole: "sole".to_owned(),
            arm: "sho_pitch".to_owned(),
            stand_degrees: BTreeMap::new(),
        }
    }
}

/// The joints of a description that can be driven, standing at 0.
fn described_joints(robot: &Robot, base: LinkId, sides: &[String; 2]) -> Vec<Joint> {
    let driven: Vec<_> = robot
        .joints()
        .iter()
        .filter(|joint| joint.kind == JointKind::Revolute && joint.mimic.is_none())
        .filter_map(|joint| Some((joint, joint.limits?)))
        .collect();
    let axes: Vec<DVec3> = driven.iter().map(|(joint, _)| axis_in(robot, base, joint.child)).collect();
    let partner = |index: usize| {
        let name = driven[index].0.name.as_str();
        let other = match (name.strip_prefix(&*sides[0]), name.strip_prefix(&*sides[1])) {
            (Some(rest), _) => format!("{}{rest}", sides[1]),
            (None, Some(rest)) => format!("{}{rest}", sides[0]),
            (None, None) => return index,
        };
        driven.iter().position(|(joint, _)| joint.name == other).unwrap_or(index)
    };
    let joints = driven.iter().enumerate().map(|(index, (joint, limits))| {
        let other = partner(index);
        Joint {
            name: joint.name.clone(),
            limits: [limits.lower, limits.upper],
            max_speed: if limits.velocity > 0.0 { limits.velocity } else { f64::INFINITY },
            stand: 0.0,
            is_of_gait: false,
            mirror: (other, mirror_sign(axes[index], axes[other])),
        }
    });
    joints.collect()
}

/// The axis of the joint above a link, in the base, with all angles 0.
fn axis_in(robot: &Robot, base: LinkId, link: LinkId) -> DVec3 {
    let axis = robot.link(link).parent.map_or(DVec3::ZERO, |joint| robot.joint(joint).axis);
    Pose::new(robot).target_from_source(base, link).rotation * axis
}

/// By what an angle about an axis is multiplied to be that of its mirror image about the other axis: left and
/// right change, and so does the sense of a rotation.
fn mirror_sign(axis: DVec3, other: DVec3) -> f64 {
    if DVec3::new(-axis.x, axis.y, -axis.z).dot(other) < 0.0 { -1.0 } else { 1.0 }
}

/// The file, for errors.
struct Source<'a>(toml::Source<'a>);

impl Source<'_> {
    fn error(&self, position: usize, problem: String) -> HumanoidError {
        self.0.error(position, problem).into()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    const DARWIN_OP_URDF: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../robots/darwin_op.urdf");

    fn read(text: &str) -> Result<Humanoid, String> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("humanoid.toml");
        std::fs::write(&file, format!("robot_description = \"{DARWIN_OP_URDF}\"\n{text}")).unwrap();
        let folder = folder.path().to_str().unwrap().to_owned();
        Humanoid::read(file.to_str().unwrap()).map_err(|error| error.to_string().replace(&folder, ""))
    }

    #[test]
    fn the_description_of_the_darwin_op_gives_the_robot_of_its_tables() {
        let (described, known) = (read("").unwrap(), Humanoid::darwin_op());
        assert_eq!(described.joints.len(), COUNT);
        for joint in known.joints.iter() {
            let found = &described.joints[described.joints.index_of(&joint.name).unwrap()];
            let partner = |of: &Humanoid, joint: &Joint| of.joints[joint.mirror.0].name.clone();
            assert_eq!(partner(&described, found), partner(&known, joint));
            assert_eq!(
                (found.mirror.1, found.max_speed),
                (joint.mirror.1, joint.max_speed),
                "{}",
                joint.name
            );
            assert!((found.limits[0] - joint.limits[0]).abs() < 1e-9, "{}", joint.name);
        }
        let arms =
            |of: &Humanoid| of.arms.unwrap().map(|(joint, sign)| (of.joints[joint].name.clone(), sign));
        assert_eq!(arms(&described), arms(&known));
        for side in [Side::Right, Side::Left] {
            let names = |of: &Humanoid| of.leg(side).joints.map(|joint| of.joints[joint].name.clone());
            assert_eq!(names(&described), darwin_op::leg_joint_names(side));
            assert_eq!(names(&described), names(&known));
        }
    }

    #[test]
    fn a_file_says_how_the_robot_stands_and_which_joints_the_gait_moves() {
        let humanoid = read("[stand_degrees]\nknee = 40\nr_el = 10\n").unwrap();
        let stand =
            |name: &str| humanoid.joints[humanoid.joints.index_of(name).unwrap()].stand.to_degrees().round();
        assert_eq!(
            ["r_knee", "l_knee", "r_el", "l_el", "head_pan"].map(stand),
            [40.0, -40.0, 10.0, 0.0, 0.0]
        );
        let moved = humanoid.joints.iter().filter(|joint| joint.is_of_gait).count();
        assert_eq!(moved, 13);
    }

    #[test]
    fn the_centre_of_mass_is_that_of_the_stand() {
        let stand =
            "sho_pitch = -48.3\nsho_roll = -17.8\nel = 29.3\nhip_pitch = -36.1\nknee = 53.2\nank_pitch = 30";
        let described = read(&format!("[stand_degrees]\n{stand}\n")).unwrap();
        let known = Humanoid::darwin_op();
        let off = described.centre_of_mass - known.centre_of_mass;
        assert!(off.length() < 2e-4, "{} and {}", described.centre_of_mass, known.centre_of_mass);
    }

    #[test]
    fn a_bad_file_is_refused_with_its_line() {
        let refused = |text: &str| read(text).unwrap_err();
        assert_eq!(
            refused("[stand_degrees]\nkne = 40"),
            "/humanoid.toml:3: there is no joint \"kne\", did you mean \"r_knee\"?"
        );
        assert_eq!(
            refused("[stand_degrees]\nr_knee = -40"),
            "/humanoid.toml:3: r_knee = -40 is beyond the limits of the joint, -6.0 to 130.0"
        );
        assert!(refused("legs = []").starts_with("/humanoid.toml:2: unknown field `legs`"));
        assert!(
            refused("sole = \"foot\"").contains("there is no link \"r_foot\""),
            "{}",
            refused("sole = \"foot\"")
        );
        assert!(refused("arm = \"shoulder\"").contains("there is no joint \"r_shoulder\""));
        let error = Humanoid::read("/no/such/file.toml").unwrap_err().to_string();
        assert!(
            error.starts_with("cannot read the numbers of a humanoid from /no/such/file.toml: "),
            "{error}"
        );
    }
}
