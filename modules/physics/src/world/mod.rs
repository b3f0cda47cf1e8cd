//! The rigid bodies of a world and its robot, behind the engines that move them.

#[cfg(feature = "mujoco")]
mod mujoco;
mod rapier;

pub(crate) use rapier::{RapierWorld, overlap};

use crate::model::Model;
use crate::scenery::WorldFile;
use crate::spawned::Spawned;
use downbeat_darwin_op::emulator::FootForces;
use downbeat_transforms::Isometry;
use glam::DVec3;
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// What computes how the bodies move.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Engine {
    /// rapier, which is part of the program: the same options give the same bits, in a world with several
    /// robots only on the same kind of processor.
    #[default]
    Rapier,
    /// MuJoCo, a second opinion. It needs the feature `mujoco` and its library, in the file that
    /// `DOWNBEAT_MUJOCO` names or in the package `mujoco` of a Python environment (that in `VIRTUAL_ENV`, or
    /// `target/venv` in this folder or one above).
    Mujoco,
}

/// Why an engine cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    /// There is no engine of this name.
    #[error("\"{name}\" is no engine; the engines are rapier and mujoco")]
    Unknown {
        /// The name.
        name: String,
    },
    /// The program was built without the engine.
    #[error("this program is built without \"mujoco\": build with --features mujoco")]
    NotBuiltIn,
    /// There is no library.
    #[error(
        "there is no library of MuJoCo in DOWNBEAT_MUJOCO, VIRTUAL_ENV or target/venv; install it with \
         `pip install mujoco=={version}` and set DOWNBEAT_MUJOCO to its libmujoco.so.{version}"
    )]
    NoLibrary {
        /// The version that is needed.
        version: &'static str,
    },
    /// The library cannot be loaded, or is no MuJoCo.
    #[error("{file} cannot be used as MuJoCo: {reason}")]
    Library {
        /// The file.
        file: String,
        /// Why.
        reason: String,
    },
    /// The library has another version.
    #[error("{file} is MuJoCo {found}, but only {version} is supported; `pip install mujoco=={version}`")]
    Version {
        /// The file.
        file: String,
        /// Its version.
        found: String,
        /// The version that is needed.
        version: &'static str,
    },
    /// MuJoCo refuses the robot or its world.
    #[error("MuJoCo refuses the robot \"{robot}\" in the world \"{world}\": {reason}")]
    Refused {
        /// The name of the robot.
        robot: String,
        /// The name of the world.
        world: String,
        /// What MuJoCo says.
        reason: String,
    },
}

impl Engine {
    /// Name and version, which belong to every record of a run.
    #[must_use]
    pub fn version(self) -> &'static str {
        match self {
            Self::Rapier => "rapier3d 0.36.1",
            Self::Mujoco => "MuJoCo 3.17.0",
        }
    }
}

impl Engine {
    /// Returns whether things can be added to its world, and removed from it, while it is simulated.
    pub(crate) fn can_spawn(self) -> bool {
        self == Self::Rapier
    }
}

impl fmt::Display for Engine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.version())
    }
}

impl FromStr for Engine {
    type Err = EngineError;

    fn from_str(name: &str) -> Result<Self, EngineError> {
        match name {
            "rapier" => Ok(Self::Rapier),
            "mujoco" => Ok(Self::Mujoco),
            _ => Err(EngineError::Unknown { name: name.to_owned() }),
        }
    }
}

/// How a robot is at the start.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// The angle of each joint, by its name, in rad; 0 if it is not named.
    pub angles: Vec<(String, f64)>,
    /// On what it stands or lies.
    pub posture: Posture,
    /// Where, in m.
    pub position: [f64; 2],
    /// Its heading, in rad.
    pub yaw: f64,
}

/// On what a robot stands or lies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Posture {
    /// On its soles, which are level; upright if it has none.
    #[default]
    Standing,
    /// On its front.
    Prone,
    /// On its back.
    Supine,
}

/// How the simulated robot differs from its description.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Variation {
    /// By which all masses are multiplied.
    pub mass: f64,
    /// By which the friction of all contacts is multiplied.
    pub friction: f64,
    /// By which the torque of all servos is multiplied.
    pub strength: f64,
    /// How far the trunk's centre of mass is moved forwards, in m.
    pub centre_of_mass: f64,
    /// The free play of each gear, in rad.
    pub backlash: f64,
    /// Between a goal and the motor, in addition to that of the bus.
    pub latency: Duration,
}

impl Default for Variation {
    /// As described, with the free play of an MX-28.
    fn default() -> Self {
        Self {
            mass: 1.0,
            friction: 1.0,
            strength: 1.0,
            centre_of_mass: 0.0,
            backlash: 0.33_f64.to_radians(),
            latency: Duration::ZERO,
        }
    }
}

/// What the motor of a joint does in a step: a spring to a goal, and the damping of its back-EMF.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct JointDrive {
    /// In rad.
    pub(crate) goal: f64,
    /// In N m/rad.
    pub(crate) stiffness: f64,
    /// In N m s/rad.
    pub(crate) damping: f64,
    /// In N m; 0 without torque.
    pub(crate) max_torque: f64,
}

/// Pose and velocity of something, in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// The pose.
    pub world_from_body: Isometry,
    /// Of its origin, along the axes of the world, in m/s.
    pub linear: DVec3,
    /// About the axes of the world, in rad/s.
    pub angular: DVec3,
}

/// What a world and its robot are built from.
#[derive(Clone, Copy)]
pub(crate) struct Plan<'a> {
    pub(crate) file: &'a WorldFile,
    pub(crate) model: &'a Model,
    pub(crate) start: &'a Start,
    pub(crate) step: Duration,
    pub(crate) variation: &'a Variation,
}

/// The bodies of a robot, to be measured.
pub(crate) trait RobotBodies {
    /// Angle and speed of the joint of a body, in rad and rad/s.
    fn joint(&self, body: usize) -> (f64, f64);

    /// The motion of a frame that is fixed in a body.
    fn motion_of(&self, body: usize, body_from_frame: &Isometry) -> Option<Motion>;
}

/// A world with a robot, which starts at rest at its start.
pub(crate) trait World: RobotBodies + Send {
    /// Advances by one step. There is one drive for each body; that of the first is ignored.
    fn step(&mut self, drives: &[JointDrive]);

    fn steps(&self) -> u64;

    /// The names of what is in the world, and whether it can move.
    fn things(&self) -> Vec<(&str, bool)>;

    /// The motion of something beside the robot.
    fn motion_of_thing(&self, name: &str) -> Option<Motion>;

    /// Moves something beside the robot; returns false if there is no such thing, or it is fixed.
    fn set_motion_of_thing(&mut self, name: &str, motion: &Motion) -> bool;

    /// Adds something, at rest; without effect if the engine [cannot](Engine::can_spawn).
    fn spawn(&mut self, _spawned: &Spawned) {}

    /// Removes something beside the robot; returns false if there is no such thing, or the engine cannot.
    fn delete(&mut self, _name: &str) -> bool {
        false
    }

    /// What this would be inside of, if one of the two can move, and how deep in m.
    fn overlap_of(&self, _spawned: &Spawned) -> Option<(&str, f64)> {
        None
    }

    /// Moves the robot without changing the angles of its joints; afterwards it is at rest.
    fn set_pose_of_robot(&mut self, world_from_root: &Isometry);

    /// Gives a body of the robot an impulse at a point, in N s and m, in the world, in the next step.
    fn push(&mut self, body: usize, impulse: DVec3, point: DVec3);

    /// The forces on the corners of the soles, in N; `None` if the engine does not say.
    fn foot_forces(&self) -> Option<FootForces>;

    /// What the robot is inside of, beside the floor, and how deep in m.
    fn overlap_of_robot(&self) -> Option<(&str, f64)>;

    /// A hash of the poses of all bodies, bit for bit.
    fn hash(&self) -> u64;
}

/// Builds a world with its robot at the start.
///
/// # Errors
/// If the engine cannot be used.
pub(crate) fn build(engine: Engine, plan: Plan<'_>) -> Result<Box<dyn World>, EngineError> {
    match engine {
        Engine::Rapier => Ok(Box::new(rapier::RapierWorld::new(plan))),
        #[cfg(feature = "mujoco")]
        Engine::Mujoco => Ok(Box::new(mujoco::MujocoWorld::new(plan)?)),
        #[cfg(not(feature = "mujoco"))]
        Engine::Mujoco => Err(EngineError::NotBuiltIn),
    }
}

/// Reflected inertia of a servo's rotor, in kg m^2. Estimated; without it a multibody of light links is
/// unstable.
const ARMATURE: f64 = 0.005;
/// The distance of the lowest point from the floor at the start, in m.
const START_HEIGHT: f64 = 0.001;

/// A hash of numbers, bit for bit (FNV-1a).
fn hash(bytes: impl Iterator<Item = u8>) -> u64 {
    bytes
        .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}
