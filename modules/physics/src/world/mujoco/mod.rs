//! The engine MuJoCo, as a second opinion: the robot's MJCF with a floor and what is on it.
//!
//! MuJoCo steps by 1 ms; torques of servos are computed before each of these steps. Contacts are soft, with
//! MuJoCo's parameters, and have no restitution. It does not say which forces act on the soles.

mod library;

use super::rapier::RapierWorld;
use super::{ARMATURE, EngineError, JointDrive, Motion, Plan, RobotBodies, World};
use crate::model::Model;
use crate::scenery::WorldFile;
use downbeat_darwin_op::emulator::FootForces;
use downbeat_servos::servo_bus::models::STANDARD_GRAVITY;
use downbeat_transforms::Isometry;
use glam::{DQuat, DVec3};
use library::{Object, Simulated, Vector};
use std::fmt::Write;

/// A world with a robot.
pub(super) struct MujocoWorld {
    simulated: Simulated,
    model: Model,
    links: Vec<Link>,
    things: Vec<Thing>,
    /// What the robot is inside of at the start.
    overlap: Option<(String, f64)>,
    /// Steps of MuJoCo in a step.
    substeps: u32,
    steps: u64,
    /// The body, force and point of pushes in this step.
    pushes: Vec<(usize, DVec3, DVec3)>,
    positions: Vec<f64>,
    velocities: Vec<f64>,
    /// Of each body of the robot.
    motions: Vec<Motion>,
}

/// A body of the robot.
struct Link {
    /// Its number.
    body: usize,
    /// Where its joint is among the joints of the robot.
    joint: usize,
}

/// Something beside the robot.
struct Thing {
    name: String,
    /// Where its pose is among the positions, and its velocity among the velocities; `None` if it is fixed.
    address: Option<[usize; 2]>,
    pose: Isometry,
}

/// Of the first body, before the joints: position and quaternion, velocity and rate.
const FREE: [usize; 2] = [7, 6];

impl MujocoWorld {
    pub(super) fn new(plan: Plan<'_>) -> Result<Self, EngineError> {
        let Plan { file, model, step, variation, .. } = plan;
        let refused = |reason: String| EngineError::Refused {
            robot: model.name.clone(),
            world: file.name.clone(),
            reason,
        };
        let things = things(file);
        let mass_of_robot: f64 = model.bodies.iter().map(|body| body.mass).sum();
        // The masses of things are written such that they are right after all were multiplied.
        let mass_of_things: f64 = things.iter().filter_map(|(.., mass)| *mass).sum();
        let mjcf = mjcf(plan, &things);
        let total = mass_of_robot * variation.mass + mass_of_things;
        let simulated = Simulated::new(&mjcf, total, refused)?;
        let missing = |what: &str| refused(format!("it has no \"{what}\""));
        let number_of_joints = model.bodies.len() - 1;
        let mut links = Vec::new();
        for body in &model.bodies {
            let id = simulated.id(Object::Body, &body.link).ok_or_else(|| missing(&body.link))?;
            let joint = body.joint.as_ref().map_or(Some(0), |joint| {
                // The first joint is that of the free body.
                simulated.id(Object::Joint, &joint.name)?.checked_sub(1)
            });
            links.push(Link { body: id, joint: joint.ok_or_else(|| missing(&body.link))? });
        }
        let mut placed = Vec::new();
        let [mut position, mut velocity] = FREE.map(|free| free + number_of_joints);
        for (name, pose, _, mass) in things {
            let address = mass.map(|_| [position, velocity]);
            if address.is_some() {
                [position, velocity] = [position + FREE[0], velocity + FREE[1]];
            }
            placed.push(Thing { name, address, pose });
        }
        let (positions, velocities) = (simulated.get(Vector::Positions), simulated.get(Vector::Velocities));
        if [positions.len(), velocities.len()] != [position, velocity] {
            return Err(refused("its bodies have other degrees of freedom than expected".to_owned()));
        }
        // The start does not depend on the engine.
        let start = RapierWorld::new(plan);
        let mut world = Self {
            simulated,
            model: model.clone(),
            links,
            things: placed,
            overlap: start.overlap_of_robot().map(|(name, depth)| (name.to_owned(), depth)),
            substeps: u32::try_from(step.as_millis()).unwrap_or(1),
            steps: 0,
            pushes: Vec::new(),
            positions,
            velocities,
            motions: Vec::new(),
        };
        for (index, link) in world.links.iter().enumerate().skip(1) {
            world.positions[FREE[0] + link.joint] = start.joint(index).0;
        }
        if let Some(root) = start.motion_of(0, &Isometry::IDENTITY) {
            world.set_pose_of_robot(&root.world_from_body);
        }
        Ok(world)
    }

    /// Takes over positions and velocities that were changed here.
    fn set(&mut self) {
        self.simulated.set(Vector::Positions, &self.positions);
        self.simulated.set(Vector::Velocities, &self.velocities);
        self.simulated.forward();
        self.measure();
    }

    /// Takes over positions and velocities from MuJoCo, and computes the motions of the bodies from them.
    fn measure(&mut self) {
        self.positions = self.simulated.get(Vector::Positions);
        self.velocities = self.simulated.get(Vector::Velocities);
        let mut motions = vec![free_motion(&self.positions, &self.velocities)];
        for (link, body) in self.links.iter().zip(&self.model.bodies).skip(1) {
            let Some(joint) = &body.joint else { continue };
            let [angle, speed] =
                [self.positions[FREE[0] + link.joint], self.velocities[FREE[1] + link.joint]];
            let turned =
                Isometry { rotation: DQuat::from_axis_angle(joint.axis, angle), translation: DVec3::ZERO };
            let parent = motions[joint.parent];
            let mut motion = fixed_in(&parent, &(joint.parent_from_body * turned));
            motion.angular += motion.world_from_body.rotation * joint.axis * speed;
            motions.push(motion);
        }
        self.motions = motions;
    }
}

impl RobotBodies for MujocoWorld {
    fn joint(&self, body: usize) -> (f64, f64) {
        self.links.get(body).filter(|_| body > 0).map_or((0.0, 0.0), |link| {
            (self.positions[FREE[0] + link.joint], self.velocities[FREE[1] + link.joint])
        })
    }

    fn motion_of(&self, body: usize, body_from_frame: &Isometry) -> Option<Motion> {
        Some(fixed_in(self.motions.get(body)?, body_from_frame))
    }
}

impl World for MujocoWorld {
    fn step(&mut self, drives: &[JointDrive]) {
        let pushes = std::mem::take(&mut self.pushes);
        for _ in 0..self.substeps {
            let mut applied = vec![0.0; self.velocities.len()];
            for (link, drive) in self.links.iter().zip(drives).skip(1) {
                let [angle, speed] =
                    [self.positions[FREE[0] + link.joint], self.velocities[FREE[1] + link.joint]];
                let torque = drive.stiffness * (drive.goal - angle) - drive.damping * speed;
                applied[FREE[1] + link.joint] = torque.clamp(-drive.max_torque, drive.max_torque);
            }
            for (body, force, point) in &pushes {
                self.simulated.add_force(*body, force.to_array(), point.to_array(), &mut applied);
            }
            self.simulated.set(Vector::AppliedForces, &applied);
            self.simulated.step();
            self.positions = self.simulated.get(Vector::Positions);
            self.velocities = self.simulated.get(Vector::Velocities);
        }
        self.measure();
        self.steps += 1;
    }

    fn steps(&self) -> u64 {
        self.steps
    }

    fn things(&self) -> Vec<(&str, bool)> {
        self.things.iter().map(|thing| (thing.name.as_str(), thing.address.is_some())).collect()
    }

    fn motion_of_thing(&self, name: &str) -> Option<Motion> {
        let thing = self.things.iter().find(|thing| thing.name == name)?;
        Some(match thing.address {
            Some([position, velocity]) => {
                free_motion(&self.positions[position..], &self.velocities[velocity..])
            }
            None => Motion { world_from_body: thing.pose, linear: DVec3::ZERO, angular: DVec3::ZERO },
        })
    }

    fn set_motion_of_thing(&mut self, name: &str, motion: &Motion) -> bool {
        let thing = self.things.iter().find(|thing| thing.name == name);
        let Some([position, velocity]) = thing.and_then(|thing| thing.address) else { return false };
        set_free_motion(motion, &mut self.positions[position..], &mut self.velocities[velocity..]);
        self.set();
        true
    }

    fn set_pose_of_robot(&mut self, world_from_root: &Isometry) {
        let (linear, angular) = (DVec3::ZERO, DVec3::ZERO);
        let motion = Motion { world_from_body: *world_from_root, linear, angular };
        set_free_motion(&motion, &mut self.positions, &mut self.velocities);
        let joints = self.links.len() - 1;
        self.velocities[FREE[1]..FREE[1] + joints].fill(0.0);
        self.set();
    }

    fn push(&mut self, body: usize, impulse: DVec3, point: DVec3) {
        if let Some(link) = self.links.get(body) {
            let seconds = f64::from(self.substeps) / 1000.0;
            self.pushes.push((link.body, impulse / seconds, point));
        }
    }

    fn foot_forces(&self) -> Option<FootForces> {
        None
    }

    fn overlap_of_robot(&self) -> Option<(&str, f64)> {
        self.overlap.as_ref().map(|(name, depth)| (name.as_str(), *depth))
    }

    fn hash(&self) -> u64 {
        super::hash(self.positions.iter().flat_map(|number| number.to_bits().to_le_bytes()))
    }
}

/// The motion of a free body. MuJoCo has its quaternion with w first, and its rate along its own axes.
fn free_motion(positions: &[f64], velocities: &[f64]) -> Motion {
    let p = positions;
    let rotation = DQuat::from_xyzw(p[4], p[5], p[6], p[3]).normalize();
    let world_from_body = Isometry { rotation, translation: DVec3::new(p[0], p[1], p[2]) };
    let [linear, rate] = [0, 3].map(|first| DVec3::from_slice(&velocities[first..]));
    Motion { world_from_body, linear, angular: rotation * rate }
}

fn set_free_motion(motion: &Motion, positions: &mut [f64], velocities: &mut [f64]) {
    let Isometry { rotation, translation } = motion.world_from_body;
    let DQuat { x, y, z, w } = rotation;
    positions[..3].copy_from_slice(&translation.to_array());
    positions[3..7].copy_from_slice(&[w, x, y, z]);
    velocities[..3].copy_from_slice(&motion.linear.to_array());
    velocities[3..6].copy_from_slice(&(rotation.conjugate() * motion.angular).to_array());
}

/// The motion of a frame that is fixed in a body.
fn fixed_in(body: &Motion, body_from_frame: &Isometry) -> Motion {
    let arm = body.world_from_body.rotation * body_from_frame.translation;
    Motion {
        world_from_body: body.world_from_body * *body_from_frame,
        linear: body.linear + body.angular.cross(arm),
        angular: body.angular,
    }
}

/// Name, pose, shape as attributes of MJCF with its inertia for each kg, and mass of a thing; `None` if it is
/// fixed.
type Described = (String, Isometry, (String, [f64; 3]), Option<f64>);

fn things(file: &WorldFile) -> Vec<Described> {
    let mut all = Vec::new();
    if let Some(field) = &file.field {
        let (radius, half) = (field.post_diameter / 2.0, field.goal_height / 2.0);
        let shape = format!("type=\"cylinder\" size=\"{radius} {half}\"");
        for (name, at) in file.posts() {
            let pose = Isometry::from_translation(at.x, at.y, half);
            all.push((name.to_owned(), pose, (shape.clone(), [0.0; 3]), None));
        }
    }
    for block in &file.boxes {
        let translation = DVec3::from(block.position);
        let pose = Isometry { translation, rotation: DQuat::from_rotation_z(block.yaw) };
        let [x, y, z] = block.size;
        let inertia = [y * y + z * z, x * x + z * z, x * x + y * y].map(|squares| squares / 12.0);
        let shape = format!("type=\"box\" size=\"{} {} {}\"", x / 2.0, y / 2.0, z / 2.0);
        all.push((block.name.clone(), pose, (shape, inertia), block.mass));
    }
    if let Some(ball) = &file.ball {
        let pose = Isometry::from_translation(ball.position[0], ball.position[1], ball.radius);
        let shape = format!("type=\"sphere\" size=\"{}\" condim=\"6\"", ball.radius);
        let inertia = [0.4 * ball.radius * ball.radius; 3];
        all.push(("ball".to_owned(), pose, (shape, inertia), Some(ball.mass)));
    }
    all
}

/// The robot's MJCF with what it lacks. Links of the robot touch the floor and things, but not each other.
fn mjcf(plan: Plan<'_>, things: &[Described]) -> String {
    let Plan { file, model, variation, .. } = plan;
    let friction = file.floor.friction * variation.friction;
    // The torque of rolling friction is its coefficient, in m, times the force.
    let rolling = file.ball.as_ref().map_or(0.0, |ball| ball.rolling_friction * ball.radius);
    let mut world = String::new();
    for (index, (_, pose, (shape, inertia), mass)) in things.iter().enumerate() {
        let ([x, y, z], DQuat { x: qx, y: qy, z: qz, w }) = (pose.translation.to_array(), pose.rotation);
        let inertial = mass.map(|mass| mass / variation.mass).map_or_else(String::new, |mass| {
            let [ix, iy, iz] = inertia.map(|share| share * mass);
            format!("<freejoint/><inertial pos=\"0 0 0\" mass=\"{mass}\" diaginertia=\"{ix} {iy} {iz}\"/>")
        });
        let _ = write!(
            world,
            "<body name=\"thing {index}\" pos=\"{x} {y} {z}\" quat=\"{w} {qx} {qy} {qz}\">{inertial}\
             <geom {shape} contype=\"2\" conaffinity=\"3\"/></body>"
        );
    }
    let added = format!(
        "<option timestep=\"0.001\" gravity=\"0 0 -{STANDARD_GRAVITY}\" cone=\"elliptic\" impratio=\"10\"/>\
         <default><joint armature=\"{ARMATURE}\"/>\
         <geom contype=\"1\" conaffinity=\"2\" friction=\"{friction} 0.005 {rolling}\"/></default>\
         <worldbody><geom type=\"plane\" size=\"0 0 1\" contype=\"2\" conaffinity=\"3\"/>{world}</worldbody>\
         </mujoco>"
    );
    with_moved_trunk(model, variation.centre_of_mass).replace("</mujoco>", &added)
}

/// The robot's MJCF, with the centre of mass of the first body moved forwards by this length, in m: that of
/// its first link with a mass moves further, so that all of the body is right.
fn with_moved_trunk(model: &Model, shift: f64) -> String {
    const START: &str = "<inertial pos=\"";
    let moved = || {
        let (before, after) = model.mjcf.split_once(START)?;
        let (x, rest) = after.split_once(' ')?;
        let (mass, _) = rest.split_once("mass=\"")?.1.split_once('"')?;
        let (x, mass) = (x.parse::<f64>().ok()?, mass.parse::<f64>().ok()?);
        let x = x + shift * model.bodies.first()?.mass / mass;
        Some(format!("{before}{START}{x} {rest}"))
    };
    moved().unwrap_or_else(|| model.mjcf.clone())
}
