//! The joints of a robot whose poses are made by hand or by file.

use std::ops::{Deref, DerefMut};

use downbeat_files::suggestion;
use downbeat_servos::servo_bus::BusPlan;

/// The joints of a robot, in the order of its poses.
#[derive(Clone, Debug)]
pub struct Joints {
    joints: Vec<Joint>,
    /// How the names of the two joints of a pair begin: of the right one, then of the left one. Empty for a
    /// robot without sides.
    sides: [String; 2],
}

/// A joint of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Its name.
    pub name: String,
    /// The smallest and the largest angle, in rad.
    pub limits: [f64; 2],
    /// In rad/s, without load; infinite if it is not known.
    pub max_speed: f64,
    /// Where it is when the robot stands, in rad.
    pub stand: f64,
    /// Whether the gait moves it.
    pub is_of_gait: bool,
    /// The position of the joint that is its mirror image (itself, if it is in the middle), and by what its
    /// angle is multiplied to have that of the other one.
    pub mirror: (usize, f64),
}

/// The speed of a servo whose speed is not known, in rad/s: motions begin slowly.
const CAREFUL: f64 = 2.0;

impl Joints {
    /// These joints, of which pairs differ in how their names begin.
    pub(crate) fn new(joints: Vec<Joint>, sides: [String; 2]) -> Self {
        Self { joints, sides }
    }

    /// The joints of a bus that are moved by positions: of an arm, or any other robot without sides. What
    /// stands still is at 0, or at the limit next to it.
    #[must_use]
    pub fn of_servos(bus: &BusPlan) -> Self {
        let positioned = bus.joints.iter().filter(|joint| joint.drive.is_none());
        let joints = positioned.enumerate().map(|(index, joint)| Joint {
            name: joint.name.clone(),
            limits: [joint.min_rad, joint.max_rad],
            max_speed: f64::INFINITY,
            stand: 0.0_f64.clamp(joint.min_rad, joint.max_rad),
            is_of_gait: false,
            mirror: (index, 1.0),
        });
        Self::new(joints.collect(), Default::default())
    }

    /// The position of a joint among these.
    #[must_use]
    pub fn index_of(&self, name: &str) -> Option<usize> {
        self.iter().position(|joint| joint.name == name)
    }

    /// The angles of all joints of a robot that stands, in rad.
    #[must_use]
    pub fn stand(&self) -> Vec<f64> {
        self.iter().map(|joint| joint.stand).collect()
    }

    /// The speed of the slowest joint, in rad/s.
    #[must_use]
    pub fn max_speed(&self) -> f64 {
        let slowest = self.iter().map(|joint| joint.max_speed).fold(f64::INFINITY, f64::min);
        if slowest.is_finite() { slowest } else { CAREFUL }
    }

    /// The joints that a name stands for, with the sign of their angle: one, or one of each side.
    pub(crate) fn named(&self, name: &str) -> Option<Vec<(usize, f64)>> {
        if let Some(index) = self.index_of(name) {
            return Some(vec![(index, 1.0)]);
        }
        let right = self.index_of(&format!("{}{name}", self.sides[0]))?;
        let (left, sign) = self[right].mirror;
        (left != right).then(|| vec![(right, 1.0), (left, sign)])
    }

    /// What is wrong with a name for which [`Joints::named`] has no joint.
    pub(crate) fn none_named(&self, name: &str) -> String {
        let hint = suggestion(name, self.iter().map(|joint| &joint.name));
        format!("there is no joint \"{name}\"{hint}")
    }
}

impl Deref for Joints {
    type Target = [Joint];

    fn deref(&self) -> &[Joint] {
        &self.joints
    }
}

impl DerefMut for Joints {
    fn deref_mut(&mut self) -> &mut [Joint] {
        &mut self.joints
    }
}
