//! A robot in its world: time, servos and sensors around the rigid bodies, as the body of an emulated robot.
//!
//! # Servos
//! The drive of a servo is a share of the supply voltage. It turns its joint with
//!
//! `torque = stall * (drive * supply / 12 V) - stall / speed * velocity` (1)
//!
//! whose second term is the back-EMF of the motor; `stall` and `speed` are `effort` and `velocity` of the
//! joint's limit in the description, both at 12 V. Engines solve (1) as a spring to the goal and a damper:
//! the drive is limited by moving the goal nearer. Within the free play of the gear there is no torque.

use crate::error::SimulationError;
use crate::machine::Machine;
use crate::model::Model;
use crate::scenery::WorldFile;
use crate::spawned::Spawned;
use crate::world::{Engine, EngineError, Motion, Plan, Start, Variation, World};
use downbeat_darwin_op::emulator::{Body, FootForces, ImuMotion, JointMotion, ServoCommand};
use downbeat_transforms::Isometry;
use glam::DVec3;
use parking_lot::Mutex;
use std::sync::Arc;
use std::time::Duration;

/// What is simulated, and how.
#[derive(Clone, Debug)]
pub struct SimulationOptions {
    /// The robot.
    pub model: Model,
    /// The joints that its servos turn, in the order of their commands.
    pub joints: Vec<String>,
    /// What is around it.
    pub world: WorldFile,
    /// How it starts.
    pub start: Start,
    /// The step of the physics, 1 to 10 ms: 4 ms, or 2 ms for twice the price.
    pub step: Duration,
    /// How it differs from its description.
    pub variation: Variation,
    /// What computes how the bodies move.
    pub engine: Engine,
}

/// A robot in its world. Clones are handles to the same one.
#[derive(Clone)]
pub struct Simulation {
    state: Arc<Mutex<State>>,
}

/// Whether time passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunState {
    /// It does.
    Playing,
    /// It does not, except for steps that are asked for.
    Paused,
    /// It does not, and all is as at the start.
    Stopped,
}

/// The world at the beginning of a step of the owner of the bus.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// Simulated time.
    pub elapsed: Duration,
    /// Steps of the physics.
    pub steps: u64,
    /// Whether time passes.
    pub run_state: RunState,
    /// Steps asked for while paused, which are not yet done.
    pub steps_left: u64,
    /// The root link of the robot.
    pub robot: Motion,
    /// The link of the camera, if the robot has one.
    pub camera: Option<Isometry>,
    /// Everything that is not of the robot, except the floor: name, whether it can move, motion.
    pub things: Vec<(String, bool, Motion)>,
    /// The forces on the soles; `None` if the engine does not say.
    pub foot_forces: Option<FootForces>,
}

/// What somebody asks of a simulation; takes effect when the next step of the owner of the bus begins.
#[derive(Clone, Debug, PartialEq)]
pub enum Request {
    /// An impulse on a link of the robot, or on something beside it.
    Push {
        /// The link.
        link: String,
        /// In N s, along the axes of the world.
        impulse: DVec3,
        /// Where, in the link, in m.
        point: DVec3,
    },
    /// Moves the robot (at rest, with its joints as they are) or something else.
    SetMotion {
        /// Of something beside the robot; `None` for the robot.
        thing: Option<String>,
        /// The motion.
        motion: Motion,
    },
    /// Adds something.
    Spawn(Box<Spawned>),
    /// Removes something beside the robot.
    Delete {
        /// Its name.
        thing: String,
    },
    /// Puts everything back to where it started. What was deleted from the world of the options is there
    /// again.
    Reset {
        /// Whether simulated time starts again too.
        time: bool,
    },
    /// Lets time pass or stand still.
    Run(RunState),
    /// Steps of the physics to do while paused.
    Steps(u64),
}

/// The most requests that wait.
const MOST_REQUESTS: usize = 1000;

struct State {
    options: SimulationOptions,
    machine: Machine,
    camera: Option<(usize, Isometry)>,
    world: Box<dyn World>,
    run: RunState,
    steps_left: u64,
    elapsed: Duration,
    /// The time since the last step.
    since_step: Duration,
    requests: Vec<Request>,
    /// What was spawned and not deleted, as it started.
    spawned: Vec<Spawned>,
    snapshot: Snapshot,
}

impl Simulation {
    /// Builds the world, with the robot at its start.
    ///
    /// # Errors
    /// If the robot lacks the joint of a servo or the mass of a link, starts inside something, or step or
    /// engine is not possible.
    pub fn new(options: SimulationOptions) -> Result<Self, SimulationError> {
        let SimulationOptions { model, joints, step, variation, .. } = &options;
        if !(1..=10).contains(&step.as_millis()) || step.subsec_nanos() % 1_000_000 != 0 {
            return Err(SimulationError::Step { found: *step });
        }
        let machine = Machine::new(model, joints, *variation)?;
        let camera = model.frames.get(&model.marks.camera).copied();
        let world = options.new_world()?;
        if let Some((other, depth)) = world.overlap_of_robot() {
            let (world, other) = (options.world.name.clone(), other.to_owned());
            return Err(SimulationError::Overlap { world, other, depth });
        }
        let snapshot = Snapshot {
            elapsed: Duration::ZERO,
            steps: 0,
            run_state: RunState::Playing,
            steps_left: 0,
            robot: Motion { world_from_body: Isometry::IDENTITY, linear: DVec3::ZERO, angular: DVec3::ZERO },
            camera: None,
            things: Vec::new(),
            foot_forces: None,
        };
        let mut state = State {
            machine,
            camera,
            world,
            run: RunState::Playing,
            steps_left: 0,
            elapsed: Duration::ZERO,
            since_step: Duration::ZERO,
            requests: Vec::new(),
            spawned: Vec::new(),
            snapshot,
            options,
        };
        state.machine.measure_at_rest(&*state.world);
        state.snapshot = state.look();
        Ok(Self { state: Arc::new(Mutex::new(state)) })
    }

    /// The body for the emulated devices of the robot.
    #[must_use]
    pub fn body(&self) -> Box<dyn Body> {
        Box::new(self.clone())
    }

    /// The options.
    #[must_use]
    pub fn options(&self) -> SimulationOptions {
        self.state.lock().options.clone()
    }

    /// The world at the beginning of the current step of the owner of the bus.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        self.state.lock().snapshot.clone()
    }

    /// Asks for something, which takes effect when the next step of the owner of the bus begins. Returns
    /// false if too much waits.
    pub fn request(&self, request: Request) -> bool {
        let mut state = self.state.lock();
        let has_room = state.requests.len() < MOST_REQUESTS;
        if has_room {
            state.requests.push(request);
        }
        has_room
    }

    /// What this would be inside of now, if one of the two can move, and how deep in m: it would be thrown
    /// out.
    #[must_use]
    pub fn overlap_of(&self, spawned: &Spawned) -> Option<(String, f64)> {
        let state = self.state.lock();
        state.world.overlap_of(spawned).map(|(other, depth)| (other.to_owned(), depth))
    }

    /// A hash of the poses of all bodies now, bit for bit: equal for equal runs.
    #[must_use]
    pub fn hash(&self) -> u64 {
        self.state.lock().world.hash()
    }
}

impl SimulationOptions {
    fn new_world(&self) -> Result<Box<dyn World>, EngineError> {
        let Self { model, world: file, start, step, variation, engine, .. } = self;
        crate::world::build(*engine, Plan { file, model, start, step: *step, variation })
    }
}

impl Body for Simulation {
    fn advance(&mut self, dt: Duration, commands: &[ServoCommand]) {
        self.state.lock().advance(dt, commands);
    }

    fn joint(&self, index: usize) -> JointMotion {
        self.state.lock().machine.joint(index)
    }

    fn imu(&self) -> ImuMotion {
        self.state.lock().machine.imu()
    }

    fn foot_forces(&self) -> Option<FootForces> {
        self.state.lock().world.foot_forces()
    }

    fn begin_step(&mut self) {
        let mut state = self.state.lock();
        for request in std::mem::take(&mut state.requests) {
            state.obey(request);
        }
        state.snapshot = state.look();
    }
}

impl State {
    fn advance(&mut self, dt: Duration, commands: &[ServoCommand]) {
        let Some(commands) = self.machine.command(dt, commands) else { return };
        match self.run {
            RunState::Playing => {
                self.since_step += dt;
                if self.since_step >= self.options.step {
                    self.since_step -= self.options.step;
                    self.step(&commands);
                }
            }
            RunState::Paused if self.steps_left > 0 => {
                self.steps_left -= 1;
                self.step(&commands);
            }
            RunState::Paused | RunState::Stopped => {}
        }
    }

    fn step(&mut self, commands: &[ServoCommand]) {
        let step = self.options.step;
        self.elapsed += step;
        if self.machine.is_held(step, commands) {
            return;
        }
        self.machine.drive(commands);
        self.world.step(self.machine.drives());
        self.machine.measure(&*self.world, step);
    }

    fn look(&self) -> Snapshot {
        let rest = Motion { world_from_body: Isometry::IDENTITY, linear: DVec3::ZERO, angular: DVec3::ZERO };
        let camera = self.camera.and_then(|(body, at)| self.world.motion_of(body, &at));
        let others = self.world.things().into_iter().filter(|(name, _)| *name != "floor");
        let things = others.filter_map(|(name, can_move)| {
            Some((name.to_owned(), can_move, self.world.motion_of_thing(name)?))
        });
        Snapshot {
            elapsed: self.elapsed,
            steps: self.world.steps(),
            run_state: self.run,
            steps_left: self.steps_left,
            robot: self.world.motion_of(0, &Isometry::IDENTITY).unwrap_or(rest),
            camera: camera.map(|motion| motion.world_from_body),
            things: things.collect(),
            foot_forces: self.world.foot_forces(),
        }
    }

    fn obey(&mut self, request: Request) {
        match request {
            Request::Push { link, impulse, point } => match self.options.model.frames.get(&link) {
                Some(&(body, body_from_link)) => {
                    if let Some(motion) = self.world.motion_of(body, &body_from_link) {
                        self.world.push(body, impulse, motion.world_from_body.transform_point(point));
                    }
                }
                None => tracing::warn!("a push names the link \"{link}\", which the robot does not have"),
            },
            Request::SetMotion { thing: None, motion } => {
                self.world.set_pose_of_robot(&motion.world_from_body);
                self.machine.measure_at_rest(&*self.world);
            }
            Request::SetMotion { thing: Some(name), motion } => {
                if !self.world.set_motion_of_thing(&name, &motion) {
                    tracing::warn!("\"{name}\" cannot be moved");
                }
            }
            Request::Spawn(spawned) => {
                self.world.spawn(&spawned);
                self.spawned.push(*spawned);
            }
            Request::Delete { thing } => {
                self.spawned.retain(|spawned| spawned.name != thing);
                if !self.world.delete(&thing) {
                    tracing::warn!("\"{thing}\" cannot be deleted: there is no such thing");
                }
            }
            Request::Reset { time } => self.reset(time),
            Request::Run(run) => {
                self.steps_left = 0;
                if run == RunState::Stopped {
                    self.reset(true);
                }
                self.run = run;
            }
            Request::Steps(steps) => {
                if self.run == RunState::Paused {
                    self.steps_left += steps;
                }
            }
        }
    }

    fn reset(&mut self, time: bool) {
        match self.options.new_world() {
            Ok(world) => self.world = world,
            Err(error) => tracing::error!("the world is not reset: {error}"),
        }
        self.spawned.iter().for_each(|spawned| self.world.spawn(spawned));
        self.machine.hold();
        self.since_step = Duration::ZERO;
        if time {
            self.elapsed = Duration::ZERO;
        }
        self.machine.measure_at_rest(&*self.world);
    }
}
