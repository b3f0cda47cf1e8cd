//! Several robots in one world, each behind the bytes of its own bus.
//!
//! The devices of all robots and the bodies advance together, by 1 ms: first the devices of each robot, then
//! the world. What the devices of a robot do while its bus is spoken to may lie ahead of the world by the
//! time on the wire; it waits for the world and is measured from the world as it is. So cores may drive their
//! robots in any order, or at once on several threads, and get the same answers, as long as the world
//! advances in between and never meanwhile.
//!
//! ```
//! use downbeat_executor::Time;
//! use downbeat_physics::{Arena, ArenaOptions, ArenaRobot, Ball};
//!
//! let mut options = ArenaOptions::darwin_op(["blue_1", "red_1"].map(ArenaRobot::named));
//! options.robots[1].start.position = [1.0, 0.0];
//! options.world.ball = Some(Ball { position: [0.5, 0.0], ..Ball::default() });
//! let arena = Arena::new(options)?;
//! arena.advance_to(Time::from_nanos(1_000_000));
//! assert_eq!(arena.snapshot().robots.len(), 2);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::camera::{Camera, Scene};
use crate::error::SimulationError;
use crate::harness::{DARWIN_OP, joint_names};
use crate::machine::Machine;
use crate::model::Model;
use crate::scenery::WorldFile;
use crate::world::{Motion, Posture, RapierWorld, RobotBodies, Start, Variation, World};
use downbeat_darwin_op::emulator::{
    self, Body, Emulator, EmulatorOptions, FootForces, ImuMotion, JointMotion, ServoCommand, Timing,
};
use downbeat_darwin_op::hardware::tables::joints::{COUNT, JOINTS};
use downbeat_executor::Time;
use downbeat_kinematics::Robot;
use downbeat_transforms::Isometry;
use glam::DVec3;
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// Who is in which world.
#[derive(Clone, Debug)]
pub struct ArenaOptions {
    /// Of all robots.
    pub model: Model,
    /// What is around them.
    pub world: WorldFile,
    /// The step of the physics, 1 to 10 ms.
    pub step: Duration,
    /// The robots.
    pub robots: Vec<ArenaRobot>,
}

/// A robot of an arena.
#[derive(Clone, Debug)]
pub struct ArenaRobot {
    /// Its name.
    pub name: String,
    /// How it starts.
    pub start: Start,
    /// How it differs from its description.
    pub variation: Variation,
    /// Of the noise of its sensors.
    pub seed: u64,
    /// What it wears in pictures: red, green, blue.
    pub colour: [u8; 3],
    /// The path of its port, whose owner lives in real time; `None` for a bus in memory.
    pub link: Option<PathBuf>,
}

/// A world with robots and their emulated devices. Only rapier moves it. Clones share it.
#[derive(Clone)]
pub struct Arena {
    shared: Arc<Mutex<State>>,
    devices: Arc<Devices>,
}

struct Devices {
    emulators: Vec<Emulator>,
    /// Until when the arena was advanced.
    advanced: Mutex<Option<Time>>,
    /// The world follows the clock of the machine, as the owners of its ports do.
    is_measured: bool,
    left_out: Mutex<Duration>,
}

/// The world of an arena.
#[derive(Clone, Debug, PartialEq)]
pub struct ArenaSnapshot {
    /// The time for which the world has moved.
    pub elapsed: Duration,
    /// The robots, in the order of the options.
    pub robots: Vec<RobotTruth>,
    /// The centre of the ball, if there is one.
    pub ball: Option<Motion>,
    /// The robot that touched the ball last.
    pub last_touch: Option<usize>,
}

/// Where a robot is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotTruth {
    /// Its root link.
    pub root: Motion,
    /// Its optical frame, if it has a camera.
    pub camera: Option<Isometry>,
}

/// A picture that is still to be rendered, on any thread.
pub struct Picture {
    scene: Scene,
    camera: Isometry,
}

struct State {
    options: ArenaOptions,
    world: RapierWorld,
    robots: Vec<RobotState>,
    camera: Option<(usize, Isometry)>,
    elapsed: Duration,
    since_step: Duration,
    last_touch: Option<usize>,
    /// What is placed when the world moves next.
    placed: Vec<Placed>,
    /// For how long the world was held for robots without torque.
    waited: Duration,
}

enum Placed {
    Ball([f64; 2]),
    Robot { robot: usize, position: [f64; 2], yaw: f64 },
}

struct RobotState {
    machine: Machine,
    /// What the devices commanded for each coming millisecond, oldest first.
    ahead: VecDeque<Vec<ServoCommand>>,
    last: Vec<ServoCommand>,
    held: Option<Held>,
}

/// A robot that somebody holds upright, until its servos hold it.
struct Held {
    start: Start,
    held_for: Duration,
    /// For how long its servos have been driven to about the stand.
    stood_for: Duration,
}

/// A robot of an arena as the body of its devices.
struct ArenaBody {
    shared: Arc<Mutex<State>>,
    robot: usize,
    is_measured: bool,
}

/// How often devices and world meet.
const TICK: Duration = Duration::from_millis(1);
/// The most commands that wait for the world: the time on the wire of any exchange.
const MOST_AHEAD: usize = 100;
/// How far a world in real time may be behind before time is left out.
const MOST_BEHIND: Duration = Duration::from_millis(100);
/// How long a world in real time is held for robots that do not come.
const PATIENCE: Duration = Duration::from_secs(30);

impl ArenaRobot {
    /// A robot at the origin, as described.
    #[must_use]
    pub fn named(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            start: Start::walking_ready(),
            variation: Variation::default(),
            seed: 1,
            colour: [90, 90, 90],
            link: None,
        }
    }
}

impl ArenaOptions {
    /// Darwin OPs on a floor, in steps of 4 ms.
    ///
    /// # Panics
    /// Never: the description is part of the program.
    #[must_use]
    pub fn darwin_op(robots: impl IntoIterator<Item = ArenaRobot>) -> Self {
        let robot = Robot::from_urdf(DARWIN_OP, "darwin_op.urdf").expect("a description");
        Self {
            model: Model::new(&robot).expect("a model"),
            world: WorldFile::default(),
            step: Duration::from_millis(4),
            robots: robots.into_iter().collect(),
        }
    }
}

impl Arena {
    /// Builds the world, with all robots at their starts. It is held until each robot has had torque for half
    /// a second.
    ///
    /// The steps of any robot's bus in memory advance the arena, as [`Arena::advance_to`] does.
    ///
    /// # Errors
    /// If a robot lacks the joint of a servo or starts inside something, the step is not possible, or a port
    /// cannot be opened.
    pub fn new(options: ArenaOptions) -> Result<Self, SimulationError> {
        let ArenaOptions { model, world: file, step, robots } = &options;
        if !(1..=10).contains(&step.as_millis()) || step.subsec_nanos() % 1_000_000 != 0 {
            return Err(SimulationError::Step { found: *step });
        }
        let starts: Vec<_> = robots.iter().map(|robot| (&robot.start, &robot.variation)).collect();
        let world = RapierWorld::with_robots(file, model, *step, &starts);
        let in_the_way = (0..robots.len()).find_map(|robot| world.overlap_with_things(robot));
        if let Some((other, depth)) = in_the_way {
            let (world, other) = (file.name.clone(), other.to_owned());
            return Err(SimulationError::Overlap { world, other, depth });
        }
        let mut machines = Vec::with_capacity(robots.len());
        for (index, robot) in robots.iter().enumerate() {
            let mut machine = Machine::new(model, &joint_names(), robot.variation)?;
            machine.measure_at_rest(&world.robot(index));
            let last = vec![ServoCommand::OFF; COUNT];
            machines.push(RobotState { machine, ahead: VecDeque::new(), last, held: None });
        }
        let camera = model.frames.get(&model.marks.camera).copied();
        let entrants: Vec<_> = robots.iter().map(|robot| (robot.seed, robot.link.clone())).collect();
        let state = State {
            options,
            world,
            robots: machines,
            camera,
            elapsed: Duration::ZERO,
            since_step: Duration::ZERO,
            last_touch: None,
            placed: Vec::new(),
            waited: Duration::ZERO,
        };
        let is_measured = entrants.iter().any(|(_, link)| link.is_some());
        let shared = Arc::new(Mutex::new(state));
        let emulators = entrants.into_iter().enumerate().map(|(robot, (seed, link))| {
            let is_measured = link.is_some();
            let body = Box::new(ArenaBody { shared: Arc::clone(&shared), robot, is_measured });
            let timing = if is_measured { Timing::Measured } else { Timing::Stepped };
            let options = EmulatorOptions { seed, timing, link, ..EmulatorOptions::default() };
            match timing {
                Timing::Measured => emulator::start_with(options, body),
                _ => Ok(emulator::in_memory(&options, Some(body))),
            }
        });
        let emulators = emulators.collect::<Result<_, _>>()?;
        let (advanced, left_out) = (Mutex::default(), Mutex::default());
        let devices = Devices { emulators, advanced, is_measured, left_out };
        let arena = Self { devices: Arc::new(devices), shared };
        for emulator in arena.emulators() {
            let (shared, devices) = (Arc::clone(&arena.shared), Arc::downgrade(&arena.devices));
            emulator.lead_by(move |now| {
                if let Some(devices) = devices.upgrade() {
                    Self { shared: Arc::clone(&shared), devices }.advance_to(now);
                }
            });
        }
        Ok(arena)
    }

    /// The devices of each robot, in the order of the options.
    #[must_use]
    pub fn emulators(&self) -> &[Emulator] {
        &self.devices.emulators
    }

    /// Advances devices and world to the time `now` of the cores. The first call sets the start time. Calls
    /// with a time that was already reached have no effect, so any core of the arena may call first.
    ///
    /// With robots at ports, which live in real time, a world that is more than 100 ms behind stays behind:
    /// see [`Arena::left_out`].
    pub fn advance_to(&self, now: Time) {
        let mut advanced = self.devices.advanced.lock();
        let begin = |at| self.emulators().iter().for_each(|emulator| emulator.begin_step(at));
        let mut last = *advanced.get_or_insert_with(|| {
            begin(now);
            now
        });
        let behind = now.saturating_since(last);
        if self.devices.is_measured && behind > MOST_BEHIND {
            let left_out = behind - MOST_BEHIND;
            *self.devices.left_out.lock() += left_out;
            last = last + left_out;
        }
        while last + TICK <= now {
            last = last + TICK;
            begin(last);
            self.shared.lock().tick();
        }
        *advanced = Some(last);
    }

    /// For how long a world in real time stood still because the machine was too slow.
    #[must_use]
    pub fn left_out(&self) -> Duration {
        *self.devices.left_out.lock()
    }

    /// The world now.
    #[must_use]
    pub fn snapshot(&self) -> ArenaSnapshot {
        let state = self.shared.lock();
        let rest = Motion { world_from_body: Isometry::IDENTITY, linear: DVec3::ZERO, angular: DVec3::ZERO };
        let truth = |robot| {
            let bodies = state.world.robot(robot);
            let camera = state.camera.and_then(|(body, at)| bodies.motion_of(body, &at));
            RobotTruth {
                root: bodies.motion_of(0, &Isometry::IDENTITY).unwrap_or(rest),
                camera: camera.map(|motion| motion.world_from_body),
            }
        };
        ArenaSnapshot {
            elapsed: state.elapsed,
            robots: (0..state.robots.len()).map(truth).collect(),
            ball: state.world.motion_of_thing("ball"),
            last_touch: state.last_touch,
        }
    }

    /// Puts the ball on the floor, at rest, as if nobody had touched it, when the world moves next: so it
    /// does not matter which robots were driven before.
    pub fn place_ball(&self, position: [f64; 2]) {
        self.shared.lock().placed.push(Placed::Ball(position));
    }

    /// Puts a robot on its feet in the walking-ready stand, at rest, when the world moves next; the heading
    /// is in rad. It is held there until its servos hold it: for a second, or for up to 15 s if it was about
    /// to get up.
    pub fn place_robot(&self, robot: usize, position: [f64; 2], yaw: f64) {
        self.shared.lock().placed.push(Placed::Robot { robot, position, yaw });
    }

    /// What the camera of a robot sees now: field, ball and the other robots.
    #[must_use]
    pub fn picture(&self, robot: usize) -> Option<Picture> {
        let state = self.shared.lock();
        let (body, at) = state.camera?;
        let camera = state.world.robot(robot).motion_of(body, &at)?.world_from_body;
        let pose_of = |name: &str| Some(state.world.motion_of_thing(name)?.world_from_body);
        let mut scene = Scene::new(&state.options.world, pose_of);
        for (index, other) in state.options.robots.iter().enumerate().filter(|(index, _)| *index != robot) {
            let bodies = state.world.robot(index);
            let pose_of = |body| Some(bodies.motion_of(body, &Isometry::IDENTITY)?.world_from_body);
            scene = scene.with_robot(&state.options.model, pose_of, other.colour);
        }
        Some(Picture { scene, camera })
    }

    /// A hash of the poses of all bodies, bit for bit: equal for equal runs.
    #[must_use]
    pub fn hash(&self) -> u64 {
        self.shared.lock().world.hash()
    }
}

impl Picture {
    /// Renders it: rgb8, row by row from the top.
    #[must_use]
    pub fn render(&self, camera: &Camera) -> Vec<u8> {
        self.scene.render(camera, &self.camera)
    }
}

impl Held {
    const SHORTEST: Duration = Duration::from_secs(1);
    const LONGEST: Duration = Duration::from_secs(15);
    /// How far servos may be driven from the stand by a robot that stands or walks, in rad.
    const ABOUT: f64 = 0.6;

    /// After a step more with these commands.
    fn is_over(&mut self, step: Duration, commands: &[ServoCommand]) -> bool {
        self.held_for += step;
        let is_leg = |joint: &str| ["hip", "knee", "ank"].iter().any(|part| joint.contains(part));
        let stands =
            JOINTS.iter().zip(commands).filter(|(joint, _)| is_leg(joint.name)).all(|(joint, command)| {
                let angle = self.start.angles.iter().find(|(name, _)| name == joint.name);
                let angle = angle.map_or(0.0, |(_, angle)| *angle);
                command.max_drive > 0.0 && (command.goal - angle).abs() < Self::ABOUT
            });
        self.stood_for = if stands { self.stood_for + step } else { Duration::ZERO };
        self.stood_for >= Self::SHORTEST || self.held_for >= Self::LONGEST
    }
}

impl State {
    fn place(&mut self, placed: &Placed) {
        match *placed {
            Placed::Ball([x, y]) => {
                let Some(radius) = self.options.world.ball.map(|ball| ball.radius) else { return };
                let world_from_body = Isometry::from_translation(x, y, radius);
                let motion = Motion { world_from_body, linear: DVec3::ZERO, angular: DVec3::ZERO };
                self.world.set_motion_of_thing("ball", &motion);
                self.last_touch = None;
            }
            Placed::Robot { robot, position, yaw } => {
                let Some(placed) = self.robots.get_mut(robot) else { return };
                let start = Start { posture: Posture::Standing, position, yaw, ..Start::walking_ready() };
                let (held_for, stood_for) = (Duration::ZERO, Duration::ZERO);
                placed.held = Some(Held { start, held_for, stood_for });
            }
        }
    }

    /// A millisecond passes.
    fn tick(&mut self) {
        std::mem::take(&mut self.placed).iter().for_each(|placed| self.place(placed));
        let step = self.options.step;
        self.since_step += TICK;
        let is_step = self.since_step >= step;
        let mut is_held = false;
        for robot in &mut self.robots {
            if let Some(next) = robot.ahead.pop_front() {
                robot.last = next;
            }
            let Some(commands) = robot.machine.command(TICK, &robot.last) else { continue };
            if is_step {
                is_held |= robot.machine.is_held(step, &commands);
                robot.machine.drive(&commands);
            }
        }
        if !is_step {
            return;
        }
        self.since_step -= step;
        // Who has a port may never come, or end before it stands.
        let may_end = self.options.robots.iter().any(|robot| robot.link.is_some());
        if is_held && !(may_end && self.waited >= PATIENCE) {
            self.waited += step;
            return;
        }
        self.elapsed += step;
        self.world.step_all(self.robots.iter().map(|robot| robot.machine.drives()));
        for (index, robot) in self.robots.iter_mut().enumerate() {
            if let Some(held) = &mut robot.held {
                self.world.place(index, &self.options.model, &held.start);
                robot.machine.measure_in_hand(&self.world.robot(index), step);
                if held.is_over(step, &robot.last) {
                    robot.held = None;
                }
            } else {
                robot.machine.measure(&self.world.robot(index), step);
            }
        }
        self.last_touch = self.world.robot_that_touches("ball").or(self.last_touch);
    }
}

impl Body for ArenaBody {
    fn advance(&mut self, _dt: Duration, commands: &[ServoCommand]) {
        let mut state = self.shared.lock();
        if let Some(robot) = state.robots.get_mut(self.robot) {
            // Measured devices follow the clock by themselves: what they commanded before has passed.
            if self.is_measured {
                robot.ahead.clear();
            }
            robot.ahead.push_back(commands.to_vec());
            if robot.ahead.len() > MOST_AHEAD {
                robot.ahead.pop_front();
            }
        }
    }

    fn joint(&self, index: usize) -> JointMotion {
        let state = self.shared.lock();
        state.robots.get(self.robot).map_or_else(JointMotion::default, |robot| robot.machine.joint(index))
    }

    fn imu(&self) -> ImuMotion {
        let state = self.shared.lock();
        state.robots.get(self.robot).map_or_else(ImuMotion::default, |robot| robot.machine.imu())
    }

    fn foot_forces(&self) -> Option<FootForces> {
        Some(self.shared.lock().world.foot_forces_of(self.robot))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn the_camera_of_a_robot_sees_the_other_one_and_not_itself() {
        let mut options = ArenaOptions::darwin_op(["seer", "seen"].map(ArenaRobot::named));
        options.robots[1].start.position = [1.0, 0.0];
        options.robots[1].colour = [0, 0, 250];
        // With a level camera.
        let head = |robot: &mut ArenaRobot| robot.start.angles.retain(|(joint, _)| joint != "head_tilt");
        options.robots.iter_mut().for_each(head);
        options.robots[0].start.angles.push(("head_tilt".to_owned(), 0.8));
        let blue_pixels = |arena: &Arena, robot| {
            let picture = arena.picture(robot).unwrap().render(&Camera::darwin_op());
            picture.chunks_exact(3).filter(|pixel| pixel[2] > 120 && pixel[0] < 60 && pixel[1] < 60).count()
        };
        let arena = Arena::new(options).unwrap();
        assert!(blue_pixels(&arena, 0) > 100);
        assert_eq!(blue_pixels(&arena, 1), 0);
    }
}
