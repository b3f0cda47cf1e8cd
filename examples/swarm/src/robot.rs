//! A robot with two wheels, a sensor for ranges and directions, and a light.
//!
//! **Gathering**: go to the centre of gravity of all robots in sight. With unlimited sight this converges
//! however the robots are synchronised: R. Cohen, D. Peleg, "Convergence properties of the gravitational
//! algorithm in asynchronous robot systems", SIAM Journal on Computing 34(6), 2005.
//!
//! **Splitting**: a population protocol, in which two that meet change their states together (D. Angluin et
//! al., "Computation in networks of passively mobile finite-state sensors", Distributed Computing 18(4),
//! 2006): of two undecided robots one becomes red and one blue, so that the groups never differ. H. Yasumi et
//! al. study the problem in "Constant-space population protocols for uniform bipartition", OPODIS 2017. A
//! meeting is two messages here, a proposal and its answer; a robot that waits for an answer refuses all
//! proposals, so that it is in one meeting at a time.

use std::time::Duration;

use downbeat::executor::{Context, Module, Publication, Received, Setup, SetupError, Task};
use downbeat::modules::servo_emulator::Random;
use glam::DVec2;

use crate::messages::{Command, Heard, Light, Neighbour, Sight, Word};

/// The distance between the wheels, m.
pub(crate) const TRACK: f64 = 0.05;

/// The greatest speed of a wheel, m/s.
pub(crate) const MAX_SPEED: f64 = 0.5;

/// A robot decides only while all that it sees are as close as this, m: after all have gathered.
const MEETING_RANGE: f64 = 0.3;

/// How far apart the centres of the two groups settle, m.
const GROUP_DISTANCE: f64 = 1.2;

/// A robot that is as close to its target as this rests, m.
const REST_DISTANCE: f64 = 0.02;

/// When a robot acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// With every new sight: all robots in the same cycle (in the literature FSYNC).
    EveryCycle,
    /// With a period between 80 and 160 ms that differs from robot to robot: in a cycle some act (SSYNC).
    Timer,
    /// After random times between 50 and 250 ms (ASYNC).
    Random,
}

/// The module: decides where to go and which group to join, from what it senses and hears.
///
/// Its name is `robot_N`. Receives `robot_N/sight`, publishes `robot_N/command`. Setting: `seed`.
pub struct Robot {
    pace: Pace,
    random: Random,
    light: u8,
    is_waiting_for_answer: bool,
    is_awake: bool,
    /// The latest that it has not acted on.
    neighbours: Option<Vec<Neighbour>>,
    /// All that it has not answered.
    heard: Vec<Heard>,
}

/// What a robot uses of the core.
pub struct RobotPorts {
    command: Publication<Command>,
    next_act: Task,
}

impl Module for Robot {
    type Ports = RobotPorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<RobotPorts, SetupError> {
        let name = setup.module_name().to_owned();
        let number: Option<u64> = name.strip_prefix("robot_").and_then(|number| number.parse().ok());
        let number = number.ok_or_else(|| setup.refuse("a robot has a name such as robot_07"))?;
        let seed = setup.setting("seed", 1_i64, "same seed, same choices; robots differ by their numbers")?;
        let seed = setup.value(seed).copied().unwrap_or_default();
        self.random = Random::new(seed as u64, number + 1);

        setup.subscribe(&format!("{name}/sight"), Self::look)?;
        let next_act = setup.task(|robot: &mut Self, ctx| {
            robot.act(ctx);
            robot.sleep(ctx);
        });
        match self.pace {
            Pace::EveryCycle => setup.each_run(Self::act),
            Pace::Timer => setup.every(self.duration(80, 160), Self::act)?,
            Pace::Random => {} // its first sight wakes it
        }
        Ok(RobotPorts { command: setup.publish(&format!("{name}/command"))?, next_act })
    }
}

impl Robot {
    /// Creates a robot that acts at this pace.
    #[must_use]
    pub fn new(pace: Pace) -> Self {
        Self {
            pace,
            random: Random::new(0, 0),
            light: Light::UNDECIDED,
            is_waiting_for_answer: false,
            is_awake: false,
            neighbours: None,
            heard: Vec::new(),
        }
    }

    fn look(&mut self, sight: Received<'_, Sight>, ctx: &mut Context<'_, RobotPorts>) {
        self.heard.extend_from_slice(&sight.heard);
        self.neighbours = Some(sight.neighbours.clone());
        if self.pace == Pace::Random && !self.is_awake {
            self.is_awake = true;
            self.sleep(ctx);
        }
    }

    fn sleep(&mut self, ctx: &mut Context<'_, RobotPorts>) {
        let duration = self.duration(50, 250);
        ctx.schedule_after(ctx.ports.next_act, duration);
    }

    /// A random duration between these, ms.
    fn duration(&mut self, least: u64, most: u64) -> Duration {
        Duration::from_millis(least + self.random.next_u64() % (most - least + 1))
    }

    /// Decides and moves, if it has seen anything new.
    fn act(&mut self, ctx: &mut Context<'_, RobotPorts>) {
        let Some(neighbours) = self.neighbours.take() else { return };
        let words = self.talk(&neighbours);
        let wheels = steer(self.target(&neighbours));
        ctx.publish(ctx.ports.command, Command { wheels, light: self.light, words });
    }

    /// True if it may enter a meeting.
    fn is_free(&self) -> bool {
        self.light == Light::UNDECIDED && !self.is_waiting_for_answer
    }

    /// Answers what it has heard, and may propose to another robot.
    fn talk(&mut self, neighbours: &[Neighbour]) -> Vec<Word> {
        let mut words = Vec::new();
        for Heard { from: to, word } in std::mem::take(&mut self.heard) {
            match word {
                Word::PROPOSE if self.is_free() => {
                    self.light = Light::BLUE;
                    words.push(Word { to, word: Word::ACCEPT });
                }
                Word::PROPOSE => words.push(Word { to, word: Word::REFUSE }),
                Word::ACCEPT if self.is_waiting_for_answer => {
                    self.light = Light::RED;
                    self.is_waiting_for_answer = false;
                }
                _ => self.is_waiting_for_answer = false,
            }
        }
        if self.is_free() {
            let is_undecided = |neighbour: &&Neighbour| neighbour.light == Light::UNDECIDED;
            let partners: Vec<_> = neighbours.iter().filter(is_undecided).collect();
            let have_gathered = neighbours.iter().all(|near| f64::from(near.range) < MEETING_RANGE);
            if partners.is_empty() {
                // The last one of an odd number.
                self.light = Light::RED;
            } else if have_gathered && self.random.unit() < 0.5 {
                // Only half of them propose at a time, so that the others are free to accept.
                let chosen = (self.random.next_u64() % partners.len() as u64) as usize;
                words.push(Word { to: partners[chosen].id, word: Word::PROPOSE });
                self.is_waiting_for_answer = true;
            }
        }
        words
    }

    /// Where to go, in its own frame: x forward, y to the left, m.
    fn target(&self, neighbours: &[Neighbour]) -> DVec2 {
        let seen = neighbours.iter().map(|neighbour| {
            let direction = DVec2::from_angle(f64::from(neighbour.bearing));
            (direction * f64::from(neighbour.range), neighbour.light)
        });
        let all: Vec<_> = seen.chain([(DVec2::ZERO, self.light)]).collect();
        let all_have_decided = all.iter().all(|&(_, light)| light != Light::UNDECIDED);
        let (own, others): (Vec<_>, Vec<_>) =
            all.into_iter().partition(|&(_, light)| !all_have_decided || light == self.light);
        let own_centre = centre(&own);
        if others.is_empty() {
            return own_centre;
        }
        // Both groups compute the same line and leave along it in opposite directions.
        let away = own_centre - centre(&others);
        own_centre + away.normalize_or_zero() * (GROUP_DISTANCE - away.length()) / 2.0
    }
}

fn centre(robots: &[(DVec2, u8)]) -> DVec2 {
    robots.iter().map(|&(position, _)| position).sum::<DVec2>() / robots.len() as f64
}

/// Wheel speeds, m/s, towards a target in the robot's frame, m: it turns first and slows down close to the
/// target.
fn steer(target: DVec2) -> [f64; 2] {
    if target.length() < REST_DISTANCE {
        return [0.0; 2];
    }
    let ahead = (target.x / target.length()).max(0.0);
    let forward = (1.5 * target.length()).min(0.8 * MAX_SPEED) * ahead;
    let turn = 2.0 * target.to_angle() * TRACK / 2.0;
    [forward - turn, forward + turn]
}
