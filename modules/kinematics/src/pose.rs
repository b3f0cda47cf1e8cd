//! Forward kinematics: frames, Jacobians and the centre of mass at given positions.

use crate::description::{DescriptionError, Joint, JointKind, LinkId, Robot};
use downbeat_transforms::Isometry;
use glam::{DQuat, DVec3};
use nalgebra::{Matrix3xX, Matrix6xX};

/// Where all links of a robot are at certain positions of its joints.
///
/// Created once and updated in each control cycle, which allocates nothing.
///
/// ```
/// use downbeat_kinematics::{Pose, Robot};
///
/// let robot = Robot::read("../../robots/darwin_op.urdf")?;
/// let mut pose = Pose::new(&robot);
/// let mut positions = vec![0.0; robot.coordinates().len()];
/// positions[robot.coordinate("head_pan").unwrap()] = 0.5;
/// pose.update(&robot, &positions);
///
/// let (camera, sole) = (robot.link_id("camera_link")?, robot.link_id("l_sole")?);
/// assert!((pose.base_from_link(sole).translation.z + 0.2195).abs() < 1e-12);
/// let sole_from_camera = pose.target_from_source(sole, camera);
/// assert!((sole_from_camera.translation.z - (0.2195 + 0.1727 + 0.005011)).abs() < 1e-12);
/// # Ok::<(), downbeat_kinematics::DescriptionError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Pose {
    base_from_links: Vec<Isometry>,
}

impl Pose {
    /// The pose at positions 0.
    #[must_use]
    pub fn new(robot: &Robot) -> Self {
        let mut pose = Self { base_from_links: vec![Isometry::IDENTITY; robot.links().len()] };
        pose.update(robot, &vec![0.0; robot.coordinates().len()]);
        pose
    }

    /// Computes the pose at these positions, in rad and m, one for each of [`Robot::coordinates`]. They may
    /// exceed the limits.
    ///
    /// # Panics
    /// If there are fewer positions than coordinates, or the pose is that of another robot with fewer links.
    pub fn update(&mut self, robot: &Robot, positions: &[f64]) {
        for joint in robot.joints() {
            let parent_from_child = joint.parent_from_child(positions);
            self.base_from_links[joint.child.0] = self.base_from_links[joint.parent.0] * parent_from_child;
        }
    }

    /// The pose of a link in the root of the robot.
    #[must_use]
    pub fn base_from_link(&self, link: LinkId) -> Isometry {
        self.base_from_links[link.0]
    }

    /// The pose of a link in another one.
    #[must_use]
    pub fn target_from_source(&self, target: LinkId, source: LinkId) -> Isometry {
        self.base_from_link(target).inverse() * self.base_from_link(source)
    }

    /// The geometric Jacobian of the origin of a link: its velocity in m/s (rows 0 to 2) and its angular
    /// velocity in rad/s (rows 3 to 5), both in the axes of the root, by the speed of each coordinate.
    ///
    /// Does not allocate if `jacobian` has a column for each coordinate; otherwise it is replaced.
    pub fn jacobian(&self, robot: &Robot, link: LinkId, jacobian: &mut Matrix6xX<f64>) {
        if jacobian.ncols() != robot.coordinates().len() {
            *jacobian = Matrix6xX::zeros(robot.coordinates().len());
        }
        jacobian.fill(0.0);
        let point = self.base_from_link(link).translation;
        let mut next = robot.link(link).parent;
        while let Some(id) = next {
            let joint = robot.joint(id);
            if let Some(drive) = joint.drive {
                let (linear, angular) = self.velocity_by_joint(joint, point);
                let mut column = jacobian.column_mut(drive.coordinate);
                for (row, value) in linear.to_array().into_iter().chain(angular.to_array()).enumerate() {
                    column[row] += drive.multiplier * value;
                }
            }
            next = robot.link(joint.parent).parent;
        }
    }

    /// The velocity of a point of the child and its angular velocity, in the root, by the speed of the joint.
    fn velocity_by_joint(&self, joint: &Joint, point: DVec3) -> (DVec3, DVec3) {
        let base_from_child = self.base_from_link(joint.child);
        let axis = base_from_child.rotation * joint.axis;
        match joint.kind {
            JointKind::Prismatic => (axis, DVec3::ZERO),
            _ => (axis.cross(point - base_from_child.translation), axis),
        }
    }
}

impl Joint {
    /// The pose of the child in the parent at these positions of the robot.
    #[must_use]
    pub fn parent_from_child(&self, positions: &[f64]) -> Isometry {
        let Some(drive) = self.drive else { return self.parent_from_joint };
        self.parent_from_child_at(drive.multiplier * positions[drive.coordinate] + drive.offset)
    }

    /// The pose of the child in the parent at this position of the joint; that at 0 for joints without a
    /// position.
    #[must_use]
    pub fn parent_from_child_at(&self, position: f64) -> Isometry {
        self.parent_from_joint * self.motion(position)
    }

    /// The motion of the child relative to position 0.
    pub(crate) fn motion(&self, position: f64) -> Isometry {
        match self.kind {
            JointKind::Fixed | JointKind::Floating | JointKind::Planar => Isometry::IDENTITY,
            JointKind::Prismatic => Isometry { translation: self.axis * position, rotation: DQuat::IDENTITY },
            JointKind::Revolute | JointKind::Continuous => {
                let rotation = DQuat::from_axis_angle(self.axis, position);
                Isometry { translation: DVec3::ZERO, rotation }
            }
        }
    }
}

/// The masses of a robot, for its centre of mass.
///
/// ```
/// use downbeat_kinematics::{Masses, Pose, Robot};
///
/// let robot = Robot::read("../../robots/darwin_op.urdf")?;
/// let masses = Masses::new(&robot)?;
/// let center_of_mass = masses.center_of_mass(&Pose::new(&robot));
/// assert!(center_of_mass.y.abs() < 1e-4 && center_of_mass.z > 0.0);
/// # Ok::<(), downbeat_kinematics::DescriptionError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Masses {
    total: f64,
    bodies: Vec<BodyMass>,
    /// The body of each link.
    body_of: Vec<usize>,
    /// Of each body with all that hangs from it: the mass, and the mass times the centre of mass in the root.
    below: Vec<(f64, DVec3)>,
}

#[derive(Clone, Copy, Debug)]
struct BodyMass {
    link: LinkId,
    mass: f64,
    /// In the frame of the link.
    center_of_mass: DVec3,
}

impl Masses {
    /// The masses of a robot.
    ///
    /// # Errors
    /// As [`Robot::bodies`]; a robot without any mass.
    pub fn new(robot: &Robot) -> Result<Self, DescriptionError> {
        let bodies = robot.bodies()?;
        let mut body_of = vec![0; robot.links().len()];
        for (index, body) in bodies.iter().enumerate() {
            body.links.iter().for_each(|(link, _)| body_of[link.0] = index);
        }
        let of_body = |body: &crate::description::Body| BodyMass {
            link: body.link,
            mass: body.mass.map_or(0.0, |mass| mass.mass),
            center_of_mass: body.mass.map_or(DVec3::ZERO, |mass| mass.center_of_mass),
        };
        let bodies: Vec<BodyMass> = bodies.iter().map(of_body).collect();
        let total: f64 = bodies.iter().map(|body| body.mass).sum();
        if total <= 0.0 {
            return Err(robot.no_mass(robot.root()));
        }
        Ok(Self { total, body_of, below: vec![(0.0, DVec3::ZERO); bodies.len()], bodies })
    }

    /// The mass of the robot, in kg.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.total
    }

    /// The centre of mass in the root, in m.
    #[must_use]
    pub fn center_of_mass(&self, pose: &Pose) -> DVec3 {
        let moments = self.bodies.iter().map(|body| body.mass * body.in_base(pose));
        moments.sum::<DVec3>() / self.total
    }

    /// The Jacobian of the centre of mass: its velocity in m/s, in the axes of the root, by the speed of each
    /// coordinate. Does not allocate if `jacobian` has a column for each coordinate; otherwise it is
    /// replaced.
    ///
    /// A joint moves the centre of mass of all that hangs from it, at distance d, so its column is
    /// (mass below / total mass) axis × d.
    pub fn jacobian(&mut self, robot: &Robot, pose: &Pose, jacobian: &mut Matrix3xX<f64>) {
        if jacobian.ncols() != robot.coordinates().len() {
            *jacobian = Matrix3xX::zeros(robot.coordinates().len());
        }
        jacobian.fill(0.0);
        for (below, body) in self.below.iter_mut().zip(&self.bodies) {
            *below = (body.mass, body.mass * body.in_base(pose));
        }
        // Children come after their parents.
        for index in (1..self.bodies.len()).rev() {
            let Some(id) = robot.link(self.bodies[index].link).parent else { continue };
            let joint = robot.joint(id);
            let (mass, moment) = self.below[index];
            let parent = &mut self.below[self.body_of[joint.parent.0]];
            *parent = (parent.0 + mass, parent.1 + moment);
            if let (Some(drive), true) = (joint.drive, mass > 0.0) {
                let (linear, _) = pose.velocity_by_joint(joint, moment / mass);
                let mut column = jacobian.column_mut(drive.coordinate);
                for (row, value) in linear.to_array().into_iter().enumerate() {
                    column[row] += drive.multiplier * value * mass / self.total;
                }
            }
        }
    }
}

impl BodyMass {
    /// The centre of mass in the root.
    fn in_base(&self, pose: &Pose) -> DVec3 {
        pose.base_from_link(self.link).transform_point(self.center_of_mass)
    }
}
