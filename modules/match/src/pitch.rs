//! Robots on a field, in lock-step.

use downbeat_executor::{Clock, Core, Inlet, InletError, ManualClock, RunError, SetupError, Time};
use downbeat_football::Field;
use downbeat_football::football_interfaces::msg::GameState;
use downbeat_modules::darwin_op_emulator::MemoryBus;
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::geometry_msgs::msg::{Point, Pose, PoseStamped, Quaternion};
use downbeat_msgs::nav_msgs::msg::Odometry;
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_physics::{Arena, ArenaOptions, ArenaRobot, ArenaSnapshot, Motion, SimulationError};
use glam::{DQuat, DVec3};
use std::f64::consts::PI;
use std::time::Duration;

/// When the cores start: not at 0, which is no time in ROS 2.
pub const START: Time = Time::from_nanos(1_000_000_000);

/// A field with a ball and robots, each in a core of its own, in lock-step on one clock.
///
/// Each core receives the truth as its player would have it, in the frame `map` in which its own goal is at -x: `ground_truth/odom`,
/// `ground_truth/ball`, 50 times a second; and `game_state` from whoever referees.
pub struct Pitch {
    arena: Arena,
    clock: ManualClock,
    players: Vec<Player>,
    truth_at: Time,
}

/// A robot that enters the pitch.
#[derive(Clone, Debug)]
pub struct Entrant {
    /// Its name, colour, start in the world, and noise.
    pub robot: ArenaRobot,
    /// Whether its own goal is at +x of the world.
    pub defends_right: bool,
}

/// Why a pitch cannot be built, or its robots cannot run on.
#[derive(Debug, thiserror::Error)]
pub enum PitchError {
    /// The world cannot be simulated.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
    /// A module cannot join the core of a robot.
    #[error("{robot}: {source}")]
    Setup {
        /// The name of the robot.
        robot: String,
        /// Why not.
        source: SetupError,
    },
    /// A core cannot run.
    #[error("{robot}: {source}")]
    Run {
        /// The name of the robot.
        robot: String,
        /// Why not.
        source: Box<RunError>,
    },
    /// A core takes no messages.
    #[error("{robot}: {source}")]
    Inlet {
        /// The name of the robot.
        robot: String,
        /// Why not.
        source: InletError,
    },
    /// The modules of a core never wait.
    #[error(
        "{robot}: {MOST_CYCLES} cycles at {at}, and there is still something to do: do modules answer each other without end?"
    )]
    Restless {
        /// The name of the robot.
        robot: String,
        /// The time of the core.
        at: Time,
    },
}

struct Player {
    name: String,
    core: Core,
    odometry: Inlet<Odometry>,
    ball: Inlet<PoseStamped>,
    game: Inlet<GameState>,
    defends_right: bool,
}

impl PitchError {
    /// What becomes of an error while something is added to the core of a robot.
    pub fn setup(robot: &str) -> impl FnOnce(SetupError) -> Self + use<> {
        let robot = robot.to_owned();
        move |source| Self::Setup { robot, source }
    }
}

/// The most cycles of a core at one time.
const MOST_CYCLES: u32 = 10_000;
const TRUTH_PERIOD: Duration = Duration::from_millis(20);

impl Pitch {
    /// Robots on a field with a ball in its centre. `build` adds the modules of each robot to its core, with the bus of its
    /// hardware.
    ///
    /// # Errors
    /// If the world cannot be simulated, or a module cannot join.
    pub fn new(
        field: &Field,
        entrants: Vec<Entrant>,
        mut build: impl FnMut(usize, Core, MemoryBus) -> Result<Core, SetupError>,
    ) -> Result<Self, PitchError> {
        let mut options = ArenaOptions::darwin_op(entrants.iter().map(|entrant| entrant.robot.clone()));
        options.world = crate::world_of(field);
        let arena = Arena::new(options)?;
        let clock = ManualClock::new(START);
        let mut players = Vec::with_capacity(entrants.len());
        for (index, (entrant, emulator)) in entrants.into_iter().zip(arena.emulators()).enumerate() {
            let name = entrant.robot.name;
            let core = build(index, Core::new().with_clock(clock.clone()), emulator.bus());
            let joined = core.and_then(|mut core| {
                let (odometry, ball) = (core.inlet("ground_truth/odom")?, core.inlet("ground_truth/ball")?);
                Ok((core.inlet("game_state")?, odometry, ball, core))
            });
            let (game, odometry, ball, core) = joined.map_err(PitchError::setup(&name))?;
            let defends_right = entrant.defends_right;
            players.push(Player { name, core, odometry, ball, game, defends_right });
        }
        Ok(Self { arena, clock, players, truth_at: START })
    }

    /// The world, for the referee.
    #[must_use]
    pub fn arena(&self) -> &Arena {
        &self.arena
    }

    /// The world now.
    #[must_use]
    pub fn snapshot(&self) -> ArenaSnapshot {
        self.arena.snapshot()
    }

    /// The core of a robot, for outlets; `None` if there is no such robot.
    pub fn core(&mut self, robot: usize) -> Option<&mut Core> {
        self.players.get_mut(robot).map(|player| &mut player.core)
    }

    /// The time of all cores.
    #[must_use]
    pub fn now(&self) -> Time {
        self.clock.now()
    }

    /// Says which goal a robot defends from now on.
    pub fn set_side(&mut self, robot: usize, defends_right: bool) {
        if let Some(player) = self.players.get_mut(robot) {
            player.defends_right = defends_right;
        }
    }

    /// Tells a robot the state of the game.
    ///
    /// # Errors
    /// If its core takes no messages.
    pub fn tell(&self, robot: usize, state: GameState) -> Result<(), PitchError> {
        let Some(player) = self.players.get(robot) else { return Ok(()) };
        player.sent(player.game.publish(state))
    }

    /// Runs all that is due in this simulated time.
    ///
    /// # Errors
    /// If a core cannot run.
    pub fn run_for(&mut self, duration: Duration) -> Result<(), PitchError> {
        let end = self.now() + duration;
        while let Some(next) = self.next_event().filter(|next| *next < end) {
            self.clock.set(next);
            self.arena.advance_to(next);
            if self.truth_at <= next {
                self.truth_at = next + TRUTH_PERIOD;
                self.tell_truth(next)?;
            }
            for player in &mut self.players {
                player.run_until(next)?;
            }
        }
        self.clock.set(end);
        Ok(())
    }

    fn next_event(&mut self) -> Option<Time> {
        let now = self.now();
        let of_cores = self.players.iter_mut().filter_map(|player| player.core.next_event());
        of_cores.chain([self.truth_at]).min().map(|next| next.max(now))
    }

    fn tell_truth(&self, now: Time) -> Result<(), PitchError> {
        let snapshot = self.arena.snapshot();
        let stamp = builtin_interfaces::msg::Time::from_nanos(now.as_nanos());
        let header = Header { stamp, frame_id: "map".to_owned() };
        for (player, truth) in self.players.iter().zip(&snapshot.robots) {
            let mut odometry = Odometry {
                header: header.clone(),
                child_frame_id: "base_link".to_owned(),
                ..Odometry::default()
            };
            odometry.pose.pose = player.pose(&truth.root);
            player.sent(player.odometry.publish(odometry))?;
            if let Some(ball) = &snapshot.ball {
                let pose = player.pose(ball);
                player.sent(player.ball.publish(PoseStamped { header: header.clone(), pose }))?;
            }
        }
        Ok(())
    }
}

impl Player {
    /// In the frame in which the own goal is at -x.
    fn pose(&self, motion: &Motion) -> Pose {
        let turn = DQuat::from_rotation_z(if self.defends_right { PI } else { 0.0 });
        let DVec3 { x, y, z } = turn * motion.world_from_body.translation;
        let q = turn * motion.world_from_body.rotation;
        Pose { position: Point { x, y, z }, orientation: Quaternion { x: q.x, y: q.y, z: q.z, w: q.w } }
    }

    fn sent(&self, result: Result<(), InletError>) -> Result<(), PitchError> {
        result.map_err(|source| PitchError::Inlet { robot: self.name.clone(), source })
    }

    fn run_until(&mut self, now: Time) -> Result<(), PitchError> {
        let mut cycles = 0;
        while self.core.next_event().is_some_and(|next| next <= now) {
            cycles += 1;
            if cycles > MOST_CYCLES {
                return Err(PitchError::Restless { robot: self.name.clone(), at: now });
            }
            let ran = self.core.cycle();
            ran.map_err(|source| PitchError::Run { robot: self.name.clone(), source: Box::new(source) })?;
        }
        Ok(())
    }
}
