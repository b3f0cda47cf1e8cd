//! A robot as rigid bodies: its description with fixed joints merged.

use downbeat_kinematics::Robot;
use downbeat_kinematics::description::{Geometry, JointKind};
use downbeat_transforms::Isometry;
use glam::{DMat3, DVec3};
use std::collections::BTreeMap;

/// A robot whose joints are revolute: rigid bodies in a tree, parents before children.
#[derive(Clone, Debug)]
pub struct Model {
    /// The name of the robot.
    pub name: String,
    /// The bodies. The first is free, each other turns about a joint.
    pub bodies: Vec<Body>,
    /// All links of the description: the body each belongs to, and its pose in that body.
    pub frames: BTreeMap<String, (usize, Isometry)>,
    /// Which of them are sensors and soles.
    pub marks: Marks,
    /// The description as MJCF.
    #[cfg(feature = "mujoco")]
    pub(crate) mjcf: String,
}

/// The links of a robot that the simulation has to know. A robot may lack any of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Marks {
    /// The soles, right and left: on the ground, x forward.
    pub soles: [String; 2],
    /// The IMU, as its data is oriented. A robot without this link has it in its first link.
    pub imu: String,
    /// The camera, with z ahead and y down.
    pub camera: String,
}

impl Default for Marks {
    fn default() -> Self {
        Self {
            soles: ["r_sole", "l_sole"].map(str::to_owned),
            imu: "imu_link".to_owned(),
            camera: "camera_optical_frame".to_owned(),
        }
    }
}

/// A rigid body.
#[derive(Clone, Debug)]
pub struct Body {
    /// The name of its first link.
    pub link: String,
    /// In kg.
    pub mass: f64,
    /// In m.
    pub centre_of_mass: DVec3,
    /// About the centre of mass, along the axes of the body, in kg m^2.
    pub inertia: DMat3,
    /// What can touch others.
    pub shapes: Vec<(Isometry, Shape)>,
    /// `None` for the first body.
    pub joint: Option<Joint>,
}

/// A revolute joint to the parent of a body.
#[derive(Clone, Debug)]
pub struct Joint {
    /// Its name.
    pub name: String,
    /// The index of the parent body.
    pub parent: usize,
    /// The pose of the body in its parent at angle 0.
    pub parent_from_body: Isometry,
    /// The axis in the body.
    pub axis: DVec3,
    /// The smallest and largest angle, in rad.
    pub limits: [f64; 2],
    /// Dry friction, in N m.
    pub friction: f64,
    /// The stall torque of its motor, in N m.
    pub effort: f64,
    /// The speed of its motor without load, in rad/s.
    pub velocity: f64,
}

/// A shape, in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// With these full lengths along its axes.
    Box([f64; 3]),
    /// Along z.
    Cylinder {
        /// In m.
        radius: f64,
        /// In m.
        length: f64,
    },
    /// With this radius.
    Sphere(f64),
}

/// Why a robot cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// A body has no possible mass.
    #[error(transparent)]
    Description(#[from] downbeat_kinematics::DescriptionError),
    /// A joint is not revolute, or follows another one.
    #[error(
        "{file}:{line}: joint \"{joint}\" cannot be simulated: only revolute joints that follow no other one can; make it fixed"
    )]
    Joint {
        /// The file of the description.
        file: String,
        /// The line.
        line: u32,
        /// The name of the joint.
        joint: String,
    },
    /// A collision shape is a mesh.
    #[error(
        "{file}:{line}: the collision shape of link \"{link}\" is a mesh; use boxes, cylinders and spheres"
    )]
    Mesh {
        /// The file of the description.
        file: String,
        /// The line.
        line: u32,
        /// The name of the link.
        link: String,
    },
    /// The first body has no mass.
    #[error("{file}: link \"{link}\" and those fixed to it have no mass; give one of them an <inertial>")]
    Mass {
        /// The file of the description.
        file: String,
        /// The name of the link.
        link: String,
    },
}

impl Model {
    /// The bodies of a robot.
    ///
    /// # Errors
    /// If a joint is not revolute, a body has no mass, or a collision shape is a mesh.
    pub fn new(robot: &Robot) -> Result<Self, ModelError> {
        let file = || robot.file().to_owned();
        let mut model = Self {
            name: robot.name().to_owned(),
            bodies: Vec::new(),
            frames: BTreeMap::new(),
            marks: Marks::default(),
            #[cfg(feature = "mujoco")]
            mjcf: downbeat_kinematics::to_mjcf(robot, downbeat_kinematics::Root::Free)?,
        };
        for body in robot.bodies()? {
            let link = &robot.link(body.link).name;
            let mass = body.mass.ok_or_else(|| ModelError::Mass { file: file(), link: link.clone() })?;
            let joint = body.joint.map(|id| {
                let joint = robot.joint(id);
                let refused =
                    || ModelError::Joint { file: file(), line: joint.line, joint: joint.name.clone() };
                let limits =
                    joint.limits.filter(|_| joint.kind == JointKind::Revolute && joint.mimic.is_none());
                let limits = limits.ok_or_else(refused)?;
                let &(parent, body_from_parent) =
                    model.frames.get(&robot.link(joint.parent).name).ok_or_else(refused)?;
                Ok::<_, ModelError>(Joint {
                    name: joint.name.clone(),
                    parent,
                    parent_from_body: body_from_parent * joint.parent_from_joint,
                    axis: joint.axis,
                    limits: [limits.lower, limits.upper],
                    friction: joint.dynamics.friction,
                    effort: limits.effort,
                    velocity: limits.velocity,
                })
            });
            let joint = joint.transpose()?;
            let mut shapes = Vec::new();
            for &(id, body_from_link) in &body.links {
                let link = robot.link(id);
                model.frames.insert(link.name.clone(), (model.bodies.len(), body_from_link));
                for collision in link.collisions.iter().filter(|shape| shape.geometry.has_volume()) {
                    let shape = match collision.geometry {
                        Geometry::Box { size } => Shape::Box(size.to_array()),
                        Geometry::Cylinder { radius, length } => Shape::Cylinder { radius, length },
                        Geometry::Sphere { radius } => Shape::Sphere(radius),
                        Geometry::Mesh(_) => {
                            let (line, link) = (collision.line, link.name.clone());
                            return Err(ModelError::Mesh { file: file(), line, link });
                        }
                    };
                    shapes.push((body_from_link * collision.link_from_shape, shape));
                }
            }
            let (mass, centre_of_mass, inertia) = (mass.mass, mass.center_of_mass, mass.inertia);
            model.bodies.push(Body { link: link.clone(), mass, centre_of_mass, inertia, shapes, joint });
        }
        Ok(model)
    }

    /// The index of the body that turns about this joint.
    #[must_use]
    pub fn body_of_joint(&self, name: &str) -> Option<usize> {
        self.bodies.iter().position(|body| body.joint.as_ref().is_some_and(|joint| joint.name == name))
    }

    /// The poses of all bodies in the first one at these angles, one for each body (that of the first is
    /// ignored).
    #[must_use]
    pub fn poses(&self, angles: &[f64]) -> Vec<Isometry> {
        let mut poses: Vec<Isometry> = Vec::with_capacity(self.bodies.len());
        for (body, angle) in self.bodies.iter().zip(angles) {
            poses.push(body.joint.as_ref().map_or(Isometry::IDENTITY, |joint| {
                let rotation = glam::DQuat::from_axis_angle(joint.axis, *angle);
                poses[joint.parent] * joint.parent_from_body * Isometry { rotation, translation: DVec3::ZERO }
            }));
        }
        poses
    }
}
