//! A match: players on a pitch, and a referee.

use crate::pitch::{Entrant, Pitch, PitchError, START};
use crate::referee::{Event, Order, Referee, Rules, Seat, Team, Truth};
use downbeat_executor::{Core, SetupError};
use downbeat_football::Field;
use downbeat_modules::darwin_op_emulator::MemoryBus;
use downbeat_msgs::builtin_interfaces;
use downbeat_physics::{ArenaRobot, ArenaSnapshot, Variation};
use glam::DVec3;
use std::time::Duration;

/// A match in lock-step.
pub struct Game {
    pitch: Pitch,
    referee: Referee,
    seats: Vec<Seat>,
    /// When the players are told the state of the game, even if nothing has happened.
    tell_at: Duration,
}

/// What a match is played with.
#[derive(Clone, Debug)]
pub struct GameOptions {
    /// The field.
    pub field: Field,
    /// How long things take.
    pub rules: Rules,
    /// Who plays.
    pub seats: Vec<Seat>,
    /// Of all noise, and of how the robots differ from their description.
    pub seed: u64,
}

/// How often the referee looks.
const LOOK: Duration = Duration::from_millis(100);
/// How often the players hear the referee at least.
const TELL: Duration = Duration::from_millis(500);

impl Game {
    /// A match before it starts, with the players at their places. `build` adds the modules of each player to its core, with
    /// the bus of its hardware and its seed.
    ///
    /// # Errors
    /// If the world cannot be simulated, or a module cannot join.
    pub fn new(
        options: GameOptions,
        mut build: impl FnMut(Seat, Core, MemoryBus, u64) -> Result<Core, SetupError>,
    ) -> Result<Self, PitchError> {
        let GameOptions { field, rules, seats, seed } = options;
        let referee = Referee::new(field.clone(), rules, seats.clone());
        let seed_of = |robot: usize| seed.wrapping_mul(1000).wrapping_add(robot as u64 + 1);
        let entrants = seats.iter().enumerate().map(|(robot, seat)| {
            let (position, heading) = referee.place_of(robot);
            let mut entrant = ArenaRobot::named(&format!("{}_{}", seat.team, seat.number));
            (entrant.start.position, entrant.start.yaw) = (position.to_array(), heading);
            entrant.seed = seed_of(robot);
            entrant.variation = Variation::of_seed(seed_of(robot));
            entrant.colour = match seat.team {
                Team::Blue => [30, 60, 200],
                Team::Red => [190, 30, 40],
            };
            Entrant { robot: entrant, defends_right: referee.defends_right(seat.team) }
        });
        let pitch = Pitch::new(&field, entrants.collect(), |robot, core, bus| {
            build(seats[robot], core, bus, seed_of(robot))
        })?;
        Ok(Self { pitch, referee, seats, tell_at: Duration::ZERO })
    }

    /// The referee.
    #[must_use]
    pub fn referee(&self) -> &Referee {
        &self.referee
    }

    /// Who plays.
    #[must_use]
    pub fn seats(&self) -> &[Seat] {
        &self.seats
    }

    /// The players.
    pub fn pitch(&mut self) -> &mut Pitch {
        &mut self.pitch
    }

    /// The time since the start.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        self.pitch.now().saturating_since(START)
    }

    /// Runs until the referee has looked once more, a tenth of a second, and returns what happened.
    ///
    /// # Errors
    /// If a core cannot run.
    pub fn step(&mut self) -> Result<Vec<Event>, PitchError> {
        let now = self.elapsed();
        let (events, orders) = self.referee.step(now, &truth_of(&self.pitch.snapshot()));
        for order in &orders {
            match *order {
                Order::Ball(at) => self.pitch.arena().place_ball(at.to_array()),
                Order::Robot { robot, position, heading } => {
                    self.pitch.arena().place_robot(robot, position.to_array(), heading);
                }
            }
        }
        if events.contains(&Event::HalfTime) {
            for (robot, seat) in self.seats.iter().enumerate() {
                self.pitch.set_side(robot, self.referee.defends_right(seat.team));
            }
        }
        if !events.is_empty() || now >= self.tell_at {
            self.tell_at = now + TELL;
            let stamp = builtin_interfaces::msg::Time::from_nanos(self.pitch.now().as_nanos());
            for robot in 0..self.seats.len() {
                let mut state = self.referee.game_state(robot, now);
                state.header.stamp = stamp;
                self.pitch.tell(robot, state)?;
            }
        }
        self.pitch.run_for(LOOK)?;
        Ok(events)
    }
}

fn truth_of(snapshot: &ArenaSnapshot) -> Truth {
    let ball = snapshot.ball.map_or(DVec3::ZERO, |ball| ball.world_from_body.translation);
    let robot = |truth: &downbeat_physics::RobotTruth| {
        let pose = truth.root.world_from_body;
        (pose.translation.truncate(), (pose.rotation * DVec3::Z).z > 0.5)
    };
    Truth {
        ball: ball.truncate(),
        ball_height: ball.z,
        last_touch: snapshot.last_touch,
        robots: snapshot.robots.iter().map(robot).collect(),
    }
}
