//! Robot descriptions: links, joints and shapes, read from URDF.

mod bodies;
mod error;
mod urdf;
mod warning;

use downbeat_files::lines::line_of;
use downbeat_files::suggestion;
use downbeat_transforms::Isometry;
use glam::{DMat3, DVec3};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

pub use bodies::{Body, MassProperties};
pub use error::{DescriptionError, Problem};
pub use warning::{DescriptionWarning, Oddity};

/// A robot: a tree of links connected by joints.
///
/// Links and joints are in tree order: a link comes after its parent, and the children of a link in the order
/// of the file. Link 0 is the root, and joint *i* leads to link *i* + 1.
///
/// ```
/// use downbeat_kinematics::Robot;
///
/// let urdf = r#"<robot name="lamp">
///   <link name="base"/>
///   <joint name="tilt" type="revolute">
///     <parent link="base"/> <child link="shade"/>
///     <origin xyz="0 0 0.3"/> <axis xyz="0 1 0"/>
///     <limit lower="-1" upper="1" effort="1" velocity="2"/>
///   </joint>
///   <link name="shade"/>
/// </robot>"#;
/// let lamp = Robot::from_urdf(urdf, "lamp.urdf")?;
/// assert_eq!(lamp.root().name, "base");
/// assert_eq!(lamp.joints()[0].name, "tilt");
///
/// let error = Robot::from_urdf(&urdf.replace("1 0\"/>", "x 0\"/>"), "lamp.urdf").unwrap_err();
/// assert_eq!(
///     error.to_string(),
///     "lamp.urdf:5: xyz=\"0 x 0\" of joint \"tilt\" is not 3 finite numbers"
/// );
/// # Ok::<(), downbeat_kinematics::DescriptionError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    file: String,
    name: String,
    links: Vec<Link>,
    joints: Vec<Joint>,
    coordinates: Vec<JointId>,
    warnings: Vec<DescriptionWarning>,
}

/// The position of a link in [`Robot::links`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LinkId(pub(crate) usize);

/// The position of a joint in [`Robot::joints`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct JointId(pub(crate) usize);

/// A rigid part of a robot, which is also a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Link {
    /// The name, which is also that of its frame.
    pub name: String,
    /// The joint that leads to it; `None` for the root.
    pub parent: Option<JointId>,
    /// Its mass; `None` if the description has none.
    pub inertial: Option<Inertial>,
    /// What it looks like.
    pub visuals: Vec<Shape>,
    /// What it collides with.
    pub collisions: Vec<Shape>,
    /// The line of the file.
    pub line: u32,
}

/// The mass of a link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertial {
    /// The frame at the centre of mass, in the link.
    pub link_from_inertial: Isometry,
    /// In kg.
    pub mass: f64,
    /// About the centre of mass, in the axes of the inertial frame, in kg m².
    pub inertia: DMat3,
}

/// A shape of a link.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// The name; empty if it has none.
    pub name: String,
    /// Where it is.
    pub link_from_shape: Isometry,
    /// What it is.
    pub geometry: Geometry,
    /// Its colour, of visual shapes.
    pub material: Option<Material>,
    /// The line of the file.
    pub line: u32,
}

/// The geometry of a shape, centred in its frame. Lengths in m.
#[derive(Clone, Debug, PartialEq)]
pub enum Geometry {
    /// A box with these edges.
    Box {
        /// The lengths of the edges.
        size: DVec3,
    },
    /// A cylinder about z.
    Cylinder {
        /// The radius.
        radius: f64,
        /// The length along z.
        length: f64,
    },
    /// A sphere.
    Sphere {
        /// The radius.
        radius: f64,
    },
    /// A mesh in another file.
    Mesh(Mesh),
}

/// A mesh in another file.
#[derive(Clone, Debug, PartialEq)]
pub struct Mesh {
    /// The file as named in the description: `package://name/path`, `file:///path`, or a path; see
    /// [`Robot::mesh_file`].
    pub file_name: String,
    /// By which the mesh is multiplied, along each of its axes.
    pub scale: DVec3,
}

/// What a visual shape looks like.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// The name; empty if it has none.
    pub name: String,
    /// Red, green, blue and opacity, from 0 to 1.
    pub rgba: Option<[f32; 4]>,
    /// An image file, named like that of a mesh.
    pub texture: Option<String>,
}

/// A connection of two links.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// The name.
    pub name: String,
    /// How the child moves relative to the parent.
    pub kind: JointKind,
    /// The link nearer to the root.
    pub parent: LinkId,
    /// The other link.
    pub child: LinkId,
    /// The frame of the child at position 0.
    pub parent_from_joint: Isometry,
    /// The axis in the frame of the child, of planar joints the normal of the plane; has length 1.
    pub axis: DVec3,
    /// The limits; always `Some` for revolute and prismatic joints.
    pub limits: Option<Limits>,
    /// Friction.
    pub dynamics: Dynamics,
    /// The coordinate that determines its position; `None` for fixed, floating and planar joints.
    pub drive: Option<Drive>,
    /// The joint that this one follows, as in the description.
    pub mimic: Option<Mimic>,
    /// The line of the file.
    pub line: u32,
}

/// How a joint moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// It rotates about its axis between two limits. Positions are in rad, as everywhere.
    Revolute,
    /// It rotates about its axis without limits.
    Continuous,
    /// It slides along its axis between two limits, in m.
    Prismatic,
    /// It does not move.
    Fixed,
    /// Its child moves freely, as a robot in its world. No position of a joint describes that, so it has no
    /// coordinate: its pose comes from elsewhere, such as odometry, and is `parent_from_joint` here.
    Floating,
    /// Its child moves in a plane. Like `Floating`, it has no coordinate.
    Planar,
}

/// The limits of a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// The smallest position, in rad or m; not meaningful for continuous joints.
    pub lower: f64,
    /// The greatest position, in rad or m; not meaningful for continuous joints.
    pub upper: f64,
    /// The maximum torque in N m, or force in N.
    pub effort: f64,
    /// The maximum speed, in rad/s or m/s.
    pub velocity: f64,
}

/// The friction of a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Dynamics {
    /// Viscous friction, in N m s/rad or N s/m.
    pub damping: f64,
    /// Dry friction, in N m or N.
    pub friction: f64,
}

/// A joint that follows another one: `position = multiplier * position of the other + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mimic {
    /// The joint that it follows.
    pub joint: JointId,
    /// Its speed relative to that of the other joint.
    pub multiplier: f64,
    /// Its position when that of the other joint is 0, in rad or m.
    pub offset: f64,
}

/// How the position of a joint follows from the coordinates of the robot: `multiplier * coordinate + offset`.
/// Other than 1 and 0 for joints that follow others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// The index of the coordinate.
    pub coordinate: usize,
    /// By which the coordinate is multiplied.
    pub multiplier: f64,
    /// What is added, in rad or m.
    pub offset: f64,
}

impl Robot {
    /// Reads a URDF. `file` names it in error messages.
    ///
    /// Elements that say nothing about links and joints, such as `<transmission>` and `<gazebo>`, are
    /// ignored. Where a part is not as the format demands but its meaning is clear, there is a
    /// [warning](Self::warnings).
    ///
    /// # Errors
    /// The first [`Problem`] of the description, with its line.
    pub fn from_urdf(text: &str, file: impl Into<String>) -> Result<Self, DescriptionError> {
        urdf::read(text, file.into())
    }

    /// Reads a URDF file.
    ///
    /// # Errors
    /// As [`Robot::from_urdf`]; a file that cannot be read or has more than 64 MiB.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, DescriptionError> {
        Ok(read_urdf(path.as_ref())?.0)
    }

    /// Reads a URDF file, or a text that contains a line break. Returns the text too.
    ///
    /// # Errors
    /// As [`Robot::read`].
    pub fn load(path_or_text: &str) -> Result<(Self, String), DescriptionError> {
        if path_or_text.contains('\n') {
            return Ok((Self::from_urdf(path_or_text, "robot_description")?, path_or_text.to_owned()));
        }
        read_urdf(Path::new(path_or_text))
    }

    /// The name of the robot.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The file, as given to [`Robot::from_urdf`].
    #[must_use]
    pub fn file(&self) -> &str {
        &self.file
    }

    /// The parts of the description that are not as the format demands, with what they were taken for.
    #[must_use]
    pub fn warnings(&self) -> &[DescriptionWarning] {
        &self.warnings
    }

    /// The link from which all others hang.
    #[must_use]
    pub fn root(&self) -> &Link {
        &self.links[0]
    }

    /// All links, in tree order.
    #[must_use]
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// All joints, in tree order.
    #[must_use]
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// The id of a link.
    ///
    /// # Errors
    /// [`Problem::UnknownLink`], with the most similar name.
    pub fn link_id(&self, name: &str) -> Result<LinkId, DescriptionError> {
        self.links.iter().position(|link| link.name == name).map(LinkId).ok_or_else(|| {
            let hint = suggestion(name, self.links.iter().map(|link| &link.name));
            self.error(None, Problem::UnknownLink { link: name.to_owned(), hint })
        })
    }

    /// The id of a joint.
    ///
    /// # Errors
    /// [`Problem::UnknownJoint`], with the most similar name.
    pub fn joint_id(&self, name: &str) -> Result<JointId, DescriptionError> {
        self.joints.iter().position(|joint| joint.name == name).map(JointId).ok_or_else(|| {
            let hint = suggestion(name, self.joints.iter().map(|joint| &joint.name));
            self.error(None, Problem::UnknownJoint { joint: name.to_owned(), hint })
        })
    }

    /// A link.
    #[must_use]
    pub fn link(&self, id: LinkId) -> &Link {
        &self.links[id.0]
    }

    /// A joint.
    #[must_use]
    pub fn joint(&self, id: JointId) -> &Joint {
        &self.joints[id.0]
    }

    /// The joints whose positions can be chosen, in tree order: all but those that are fixed or follow
    /// another one.
    ///
    /// Positions of the robot are slices with one number for each of them, in rad or m.
    #[must_use]
    pub fn coordinates(&self) -> &[JointId] {
        &self.coordinates
    }

    /// The index of a joint's coordinate; `None` if there is no such joint, it is fixed or it follows another
    /// one.
    #[must_use]
    pub fn coordinate(&self, joint: &str) -> Option<usize> {
        self.coordinates.iter().position(|&id| self.joint(id).name == joint)
    }

    /// The file of a mesh. `package://name/path` is looked up in `share/name/path` of each of these prefixes,
    /// which are like those in `AMENT_PREFIX_PATH`; paths are relative to the folder of the description.
    ///
    /// # Errors
    /// [`Problem::MissingMesh`] if there is no such file.
    pub fn mesh_file(
        &self,
        shape: &Shape,
        mesh: &Mesh,
        prefixes: &[PathBuf],
    ) -> Result<PathBuf, DescriptionError> {
        let name = &mesh.file_name;
        let candidates: Vec<PathBuf> = if let Some(path) = name.strip_prefix("package://") {
            prefixes.iter().map(|prefix| prefix.join("share").join(path)).collect()
        } else {
            let path = Path::new(name.strip_prefix("file://").unwrap_or(name));
            vec![Path::new(&self.file).parent().map_or_else(|| path.to_owned(), |folder| folder.join(path))]
        };
        candidates.iter().find(|path| path.is_file()).cloned().ok_or_else(|| {
            let looked = candidates.iter().map(|path| path.display().to_string()).collect();
            self.error(Some(shape.line), Problem::MissingMesh { mesh: name.clone(), looked })
        })
    }

    pub(crate) fn error(&self, line: Option<u32>, problem: Problem) -> DescriptionError {
        DescriptionError { file: self.file.clone(), line, problem: problem.into() }
    }
}

impl JointKind {
    /// Whether a single number says where the child is: not for fixed, floating and planar joints.
    #[must_use]
    pub fn has_position(self) -> bool {
        matches!(self, Self::Revolute | Self::Continuous | Self::Prismatic)
    }
}

impl Geometry {
    /// Whether the shape has an extent along each of its axes; meshes count as such.
    #[must_use]
    pub fn has_volume(&self) -> bool {
        match self {
            Self::Box { size } => size.min_element() > 0.0,
            Self::Cylinder { radius, length } => *radius > 0.0 && *length > 0.0,
            Self::Sphere { radius } => *radius > 0.0,
            Self::Mesh(_) => true,
        }
    }
}

impl LinkId {
    /// The root of the robot.
    pub const ROOT: Self = Self(0);

    /// The position in [`Robot::links`].
    #[must_use]
    pub fn index(self) -> usize {
        self.0
    }
}

impl JointId {
    /// The position in [`Robot::joints`].
    #[must_use]
    pub fn index(self) -> usize {
        self.0
    }
}

impl Joint {
    /// The positions that the joint can take; without limits if it is continuous, 0 if it has no coordinate.
    #[must_use]
    pub fn range(&self) -> RangeInclusive<f64> {
        match (self.kind, self.limits) {
            (JointKind::Fixed | JointKind::Floating | JointKind::Planar, _) => 0.0..=0.0,
            (JointKind::Revolute | JointKind::Prismatic, Some(limits)) => limits.lower..=limits.upper,
            _ => f64::NEG_INFINITY..=f64::INFINITY,
        }
    }
}

/// The maximum size of a URDF file. Those of real robots have less than a megabyte.
const LONGEST_FILE: u64 = 16 << 20;

/// A URDF file as a robot, and its text.
fn read_urdf(path: &Path) -> Result<(Robot, String), DescriptionError> {
    let file = path.display().to_string();
    let refuse =
        |problem: Problem| DescriptionError { file: file.clone(), line: None, problem: problem.into() };
    let unreadable = |error: std::io::Error| refuse(Problem::Unreadable(error.to_string()));
    let length = std::fs::metadata(path).map_err(unreadable)?.len();
    if length > LONGEST_FILE {
        return Err(refuse(Problem::TooLong { length, limit: LONGEST_FILE }));
    }
    let bytes = downbeat_msgs::user_file::read_within(path, LONGEST_FILE).map_err(unreadable)?;
    // Often a degree sign or a name in a comment, in Latin-1.
    let (text, line) = match String::from_utf8(bytes) {
        Ok(text) => (text, None),
        Err(error) => {
            let line = line_of(error.as_bytes(), error.utf8_error().valid_up_to());
            (String::from_utf8_lossy(error.as_bytes()).into_owned(), Some(line))
        }
    };
    let mut robot = Robot::from_urdf(&text, &*file)?;
    if let Some(line) = line {
        let line = u32::try_from(line).unwrap_or(u32::MAX);
        robot.warnings.insert(0, DescriptionWarning { file, line, oddity: Oddity::NotUtf8 });
    }
    Ok((robot, text))
}
