//! What is wrong with a robot description.

use thiserror::Error;

/// A robot description cannot be used.
#[derive(Clone, Debug, PartialEq)]
pub struct DescriptionError {
    /// The file.
    pub file: String,
    /// The line, if the problem has one.
    pub line: Option<u32>,
    /// The problem.
    pub problem: Box<Problem>,
}

impl std::fmt::Display for DescriptionError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.line {
            Some(line) => write!(f, "{}:{line}: {}", self.file, self.problem),
            None => write!(f, "{}: {}", self.file, self.problem),
        }
    }
}

impl std::error::Error for DescriptionError {}

/// What is wrong with a robot description. Messages end with the remedy.
#[derive(Clone, Debug, PartialEq, Error)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum Problem {
    /// The file cannot be read.
    #[error("the robot description cannot be read: {0}")]
    Unreadable(String),
    /// The file is too long.
    #[error(
        "the robot description has {length} bytes, more than the {limit} that are read: move meshes to files of their own"
    )]
    TooLong { length: u64, limit: u64 },
    /// There is too much of something.
    #[error("the robot description has {found}; at most {most} are possible")]
    TooMany { found: String, most: usize },
    /// It is not XML.
    #[error("the robot description is not valid XML: {0}")]
    NotXml(String),
    /// It is XML of another kind.
    #[error("the root is <{root}>, that of a URDF is <robot>")]
    NotUrdf { root: String },
    /// It has macros.
    #[error("<{element}> is a macro of xacro: expand the file with `xacro FILE > robot.urdf`")]
    Xacro { element: String },
    /// An element lacks something that it must have.
    #[error("{owner} has no {missing}: add {remedy}")]
    Missing { owner: String, missing: String, remedy: String },
    /// A number is missing or is not one.
    #[error("{attribute}=\"{text}\" of {owner} is not {expected}")]
    BadNumber { owner: String, attribute: String, text: String, expected: String },
    /// A number is outside its range.
    #[error("{attribute} of {owner} is {value}, and must be {expected}")]
    OutOfRange { owner: String, attribute: String, value: f64, expected: String },
    /// An axis without a direction.
    #[error("the axis of joint \"{joint}\" has length 0: write a direction, such as \"0 0 1\"")]
    NoAxis { joint: String },
    /// A name is used twice.
    #[error("{kind} \"{name}\" is already defined in line {first}: rename one of them")]
    Duplicate { kind: &'static str, name: String, first: u32 },
    /// A joint type that is unknown or not supported.
    #[error(
        "joint \"{joint}\" has type \"{kind}\": supported are revolute, continuous, prismatic, fixed, floating and planar"
    )]
    JointKind { joint: String, kind: String },
    /// A name of a link that does not exist.
    #[error("there is no link \"{link}\"{hint}")]
    UnknownLink { link: String, hint: String },
    /// A name of a joint that does not exist.
    #[error("there is no joint \"{joint}\"{hint}")]
    UnknownJoint { joint: String, hint: String },
    /// A link hangs from two joints.
    #[error(
        "link \"{link}\" is the child of joint \"{second}\" and of joint \"{first}\" (line {first_line}): links form a tree, so remove one of the two"
    )]
    TwoParents { link: String, first: String, first_line: u32, second: String },
    /// Joints form a loop.
    #[error("the joints {} form a loop: links form a tree, so remove one of them", quoted(joints))]
    Loop { joints: Vec<String> },
    /// More than one link has no parent.
    #[error("the links {} have no parent: connect them with joints to a single root", quoted(links))]
    SeveralRoots { links: Vec<String> },
    /// There are no links.
    #[error("the robot has no links: add <link name=\"base_link\"/>")]
    NoLinks,
    /// A joint follows one that cannot lead it.
    #[error("joint \"{joint}\" mimics \"{other}\", which {reason}")]
    Mimic { joint: String, other: String, reason: &'static str },
    /// A mesh file does not exist.
    #[error(
        "there is no mesh \"{mesh}\"{}: install its package and set AMENT_PREFIX_PATH, or correct the name",
        looked_in(looked)
    )]
    MissingMesh { mesh: String, looked: Vec<String> },
    /// A body has no mass.
    #[error(
        "link \"{link}\" has no <inertial>, nor has any link fixed to it, but its mass is needed: add one with mass in kg and inertia in kg m²"
    )]
    NoInertia { link: String },
    /// No rigid body has this inertia.
    #[error(
        "the inertia of link \"{link}\" is not that of a rigid body: its principal moments are {moments} kg m², of which each must be positive and at most the sum of the others"
    )]
    ImpossibleInertia { link: String, moments: String },
    /// A joint that MJCF cannot express.
    #[error("joint \"{joint}\" is {kind}, which MJCF has below the world only: leave out the links above it")]
    NotInMjcf { joint: String, kind: &'static str },
    /// Two links are not connected as required.
    #[error("link \"{tip}\" does not move relative to \"{base}\": all joints between them are fixed")]
    NotMovable { base: String, tip: String },
}

/// The first names.
fn quoted(names: &[String]) -> String {
    const MOST: usize = 10;
    let first: Vec<String> = names.iter().take(MOST).map(|name| format!("\"{name}\"")).collect();
    let rest = names.len().saturating_sub(MOST);
    if rest > 0 { format!("{} and {rest} others", first.join(", ")) } else { first.join(", ") }
}

fn looked_in(paths: &[String]) -> String {
    if paths.is_empty() { String::new() } else { format!(" (looked for {})", paths.join(", ")) }
}
