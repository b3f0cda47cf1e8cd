//! A simulated Darwin OP for tests: hardware module and world in one core, the bus in memory, time as fast as
//! it can be computed.

use crate::error::SimulationError;
use crate::model::Model;
use crate::scenery::WorldFile;
use crate::simulation::{Request, Simulation, SimulationOptions, Snapshot};
use crate::world::{Engine, Posture, Start, Variation};
use downbeat_darwin_op::emulator::{self, Emulator, EmulatorOptions, Timing};
use downbeat_darwin_op::hardware::DarwinOp;
use downbeat_darwin_op::hardware::tables::joints::JOINTS;
use downbeat_darwin_op::humanoid::Humanoid;
use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, RunError, SetupError, Time};
use downbeat_kinematics::Robot;
use std::time::Duration;

/// The description of the Darwin OP that comes with downbeat; the file is a link to that of the robot files.
pub const DARWIN_OP: &str = include_str!("../darwin_op.urdf");

impl SimulationOptions {
    /// A Darwin OP in the walking-ready stand on a floor, in steps of 4 ms.
    ///
    /// # Panics
    /// Never: the description is part of the program.
    #[must_use]
    pub fn darwin_op() -> Self {
        let robot = Robot::from_urdf(DARWIN_OP, "darwin_op.urdf").expect("a description");
        Self {
            model: Model::new(&robot).expect("a model"),
            joints: joint_names(),
            world: WorldFile::default(),
            start: Start::walking_ready(),
            step: Duration::from_millis(4),
            variation: Variation::default(),
            engine: Engine::default(),
        }
    }
}

/// The joints of the Darwin OP, in the order of their ids.
pub(crate) fn joint_names() -> Vec<String> {
    JOINTS.iter().map(|joint| joint.name.to_owned()).collect()
}

impl Start {
    /// The Darwin OP's walking-ready stand, at the origin.
    #[must_use]
    pub fn walking_ready() -> Self {
        Self::standing(&Humanoid::darwin_op())
    }

    /// As a robot stands, at the origin.
    #[must_use]
    pub fn standing(humanoid: &Humanoid) -> Self {
        let angles = humanoid.joints().iter().map(|joint| (joint.name.clone(), joint.stand)).collect();
        Self { angles, posture: Posture::Standing, position: [0.0; 2], yaw: 0.0 }
    }
}

/// A Darwin OP in a world, in a core with a manual clock. The hardware module is the one that drives a real
/// robot, under the name `hardware`; other modules are added to [`SimulatedRobot::core`] or with
/// [`SimulatedRobot::add`].
///
/// ```
/// use std::time::Duration;
/// use downbeat_darwin_op::stand_nod_wave::StandNodWave;
/// use downbeat_physics::{SimulatedRobot, SimulationOptions};
///
/// let mut robot = SimulatedRobot::new(SimulationOptions::darwin_op(), 1)?;
/// robot.hardware_listens_to("motion/joint_commands")?;
/// robot.add("motion", StandNodWave::default())?;
/// robot.run_for(Duration::from_secs(2))?;
/// assert!(robot.is_upright());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct SimulatedRobot {
    core: Core,
    clock: ManualClock,
    emulator: Emulator,
    simulation: Simulation,
    has_hardware: bool,
}

/// Why a simulated robot cannot run on.
#[derive(Debug, thiserror::Error)]
pub enum SimulatedRunError {
    /// The core cannot run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The hardware module cannot join.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The modules never wait.
    #[error(
        "{MOST_CYCLES} cycles at {at}, and there is still something to do: do modules answer each other without end?"
    )]
    Restless {
        /// The time of the core.
        at: Time,
    },
}

/// The most cycles at one time.
const MOST_CYCLES: u32 = 10_000;
/// When a simulated robot starts, so that no time is 0.
const START: Time = Time::from_nanos(1_000_000_000);

impl SimulatedRobot {
    /// A robot. The seed is that of the noise of its sensors and of the bus.
    ///
    /// # Errors
    /// If the robot cannot be simulated.
    pub fn new(options: SimulationOptions, seed: u64) -> Result<Self, SimulationError> {
        let simulation = Simulation::new(options)?;
        let options = EmulatorOptions { seed, timing: Timing::Stepped, ..EmulatorOptions::default() };
        let emulator = emulator::in_memory(&options, Some(simulation.body()));
        let clock = ManualClock::new(START);
        let core = Core::new().with_clock(clock.clone());
        Ok(Self { core, clock, emulator, simulation, has_hardware: false })
    }

    /// Adds the hardware module, with commands from this topic. Without it, [`SimulatedRobot::run_for`] adds
    /// it, with commands from `joint_commands`.
    ///
    /// # Errors
    /// If it has joined already.
    pub fn hardware_listens_to(&mut self, topic: &str) -> Result<(), SetupError> {
        let mut options = ModuleOptions::default();
        options.remaps.insert("joint_commands".to_owned(), topic.to_owned());
        self.add_hardware(options)
    }

    /// Adds the hardware module with these options.
    ///
    /// # Errors
    /// If it has joined already, or an option does not fit.
    pub fn add_hardware(&mut self, options: ModuleOptions) -> Result<(), SetupError> {
        self.core.add_with("hardware", DarwinOp::new(Box::new(self.emulator.bus())), options)?;
        self.has_hardware = true;
        Ok(())
    }

    /// Adds a module.
    ///
    /// # Errors
    /// If it cannot join.
    pub fn add(&mut self, name: &str, module: impl Module) -> Result<(), SetupError> {
        self.core.add(name, module).map(drop)
    }

    /// The core, for modules with options, launchers, inlets and outlets.
    pub fn core(&mut self) -> &mut Core {
        &mut self.core
    }

    /// The emulated devices, for faults and buttons.
    #[must_use]
    pub fn emulator(&self) -> &Emulator {
        &self.emulator
    }

    /// The world.
    #[must_use]
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }

    /// The world at the last run of the hardware module.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        self.simulation.snapshot()
    }

    /// Pushes a link of the robot with an impulse in N s, at its origin, when the hardware module runs next.
    pub fn push(&self, link: &str, impulse: [f64; 3]) {
        let (impulse, point) = (impulse.into(), glam::DVec3::ZERO);
        self.simulation.request(Request::Push { link: link.to_owned(), impulse, point });
    }

    /// Returns whether the trunk is less than 60 degrees from upright.
    #[must_use]
    pub fn is_upright(&self) -> bool {
        (self.snapshot().robot.world_from_body.rotation * glam::DVec3::Z).z > 0.5
    }

    /// The time of the core.
    #[must_use]
    pub fn now(&self) -> Time {
        downbeat_executor::Clock::now(&self.clock)
    }

    /// Runs all that is due in this simulated time.
    ///
    /// # Errors
    /// If the core cannot run.
    pub fn run_for(&mut self, duration: Duration) -> Result<(), SimulatedRunError> {
        if !self.has_hardware {
            self.add_hardware(ModuleOptions::default())?;
        }
        let end = self.now() + duration;
        let mut cycles = 0;
        while let Some(next) = self.core.next_event().filter(|next| *next < end) {
            cycles = if next > self.now() { 0 } else { cycles + 1 };
            if cycles > MOST_CYCLES {
                return Err(SimulatedRunError::Restless { at: next });
            }
            self.clock.set(next);
            self.core.cycle()?;
        }
        self.clock.set(end);
        Ok(())
    }
}
