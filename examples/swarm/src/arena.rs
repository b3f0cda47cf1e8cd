//! The plane on which the robots drive: moves them, tells each what it senses, and carries what they say.

use std::f64::consts::PI;
use std::time::Duration;

use downbeat::executor::{Context, Module, Publication, Setup, SetupError};
use downbeat::modules::servo_emulator::Random;
use glam::DVec2;

use crate::messages::{Command, Heard, Light, Neighbour, Overview, Pose, Sight};
use crate::robot::{MAX_SPEED, TRACK};

/// The time between two steps of the motion.
const STEP: Duration = Duration::from_millis(20);

/// The robots sense in every fifth step: at 10 Hz.
const STEPS_PER_SIGHT: u32 = 5;

/// Half the side of the square in which the robots start, m.
const HALF_SIDE: f64 = 1.0;

/// The error of a range is at most this part of it.
const RANGE_ERROR: f64 = 0.01;

/// The robots are together if none is farther from their centre than this, m.
const TOGETHER: f64 = 0.15;

/// A robot in the arena: a point, so that robots drive through each other, as in the theory of gathering.
struct Body {
    position: DVec2,
    heading: f64,
    /// Left and right, m/s.
    wheels: [f64; 2],
    light: u8,
    /// What was said to it since its last sight.
    heard: Vec<Heard>,
}

/// The module. Publishes `robot_N/sight` for each robot and `overview`; receives `robot_N/command`.
///
/// Settings: `robots`, their number; `range`, how far they see, m; `seed` of their first poses and of the
/// sensors' errors.
pub struct Arena {
    bodies: Vec<Body>,
    random: Random,
    range: f64,
    steps: u32,
    have_gathered: bool,
    have_split: bool,
}

impl Default for Arena {
    fn default() -> Self {
        let random = Random::new(0, 0);
        Self { bodies: Vec::new(), random, range: 0.0, steps: 0, have_gathered: false, have_split: false }
    }
}

/// What the arena publishes.
pub struct ArenaPorts {
    sights: Vec<Publication<Sight>>,
    overview: Publication<Overview>,
}

impl Module for Arena {
    type Ports = ArenaPorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<ArenaPorts, SetupError> {
        let robots = setup.setting("robots", 50_i64, "how many robots there are")?;
        let range = setup.setting("range", 5.0, "how far a robot sees, m")?;
        let seed = setup.setting("seed", 1_i64, "same seed, same first poses and errors of sensors")?;
        let robots = match setup.value(robots) {
            Some(&robots @ 1..=1000) => robots as usize,
            _ => return Err(setup.refuse("\"robots\" must be between 1 and 1000")),
        };
        self.range = setup.value(range).copied().unwrap_or_default();
        self.random = Random::new(setup.value(seed).copied().unwrap_or_default() as u64, 0);
        self.bodies = (0..robots).map(|_| Body::somewhere(&mut self.random)).collect();

        let mut sights = Vec::new();
        for robot in 0..robots {
            let name = format!("robot_{robot:02}");
            sights.push(setup.publish(&format!("{name}/sight"))?);
            setup.subscribe::<Command, _>(&format!("{name}/command"), move |arena, command, _| {
                arena.obey(robot, &command);
            })?;
        }
        setup.every(STEP, Self::step)?;
        Ok(ArenaPorts { sights, overview: setup.publish("overview")? })
    }
}

impl Arena {
    fn obey(&mut self, robot: usize, command: &Command) {
        let body = &mut self.bodies[robot];
        body.wheels = command.wheels.map(|speed| speed.clamp(-MAX_SPEED, MAX_SPEED));
        body.light = command.light;
        for word in &command.words {
            if let Some(listener) = self.bodies.get_mut(word.to as usize) {
                listener.heard.push(Heard { from: robot as u32, word: word.word });
            }
        }
    }

    fn step(&mut self, ctx: &mut Context<'_, ArenaPorts>) {
        if self.steps.is_multiple_of(STEPS_PER_SIGHT) {
            for robot in 0..self.bodies.len() {
                let sight = self.sight_of(robot);
                ctx.publish(ctx.ports.sights[robot], sight);
            }
            let overview = self.overview();
            ctx.publish(ctx.ports.overview, overview);
        }
        self.bodies.iter_mut().for_each(Body::drive);
        self.steps += 1;
    }

    fn sight_of(&mut self, robot: usize) -> Sight {
        let Body { position, heading, .. } = self.bodies[robot];
        let mut neighbours = Vec::new();
        for (id, body) in self.bodies.iter().enumerate() {
            let offset = body.position - position;
            if id != robot && offset.length() <= self.range {
                neighbours.push(Neighbour {
                    id: id as u32,
                    range: (offset.length() * (1.0 + self.random.within(RANGE_ERROR))) as f32,
                    bearing: DVec2::from_angle(-heading).rotate(offset).to_angle() as f32,
                    light: body.light,
                });
            }
        }
        Sight { neighbours, heard: std::mem::take(&mut self.bodies[robot].heard) }
    }

    /// Measures the swarm, and logs it when it starts, has gathered, and has split.
    fn overview(&mut self) -> Overview {
        let group = |light| -> Vec<DVec2> {
            self.bodies.iter().filter(|body| body.light == light).map(|body| body.position).collect()
        };
        let groups = [Light::UNDECIDED, Light::RED, Light::BLUE].map(group);
        let spread = spread(&groups.concat());
        let group_spreads = [&groups[1], &groups[2]].map(|group| self::spread(group));
        let pairs = groups[1].iter().flat_map(|red| groups[2].iter().map(|blue| red.distance(*blue)));
        let gap = pairs.reduce(f64::min).unwrap_or(0.0);
        let are_together = spread < TOGETHER;
        let are_apart = groups[0].is_empty()
            && gap > 2.0 * TOGETHER
            && group_spreads.iter().all(|&spread| spread < TOGETHER);
        let sizes = groups.map(|group| group.len() as u32);

        let seconds = (STEP * self.steps).as_secs_f64();
        if self.steps == 0 {
            tracing::info!("{} robots, spread {spread:.2} m\n{}", self.bodies.len(), self.picture());
        }
        if are_together && !self.have_gathered {
            self.have_gathered = true;
            tracing::info!("gathered after {seconds:.1} s, spread {spread:.2} m\n{}", self.picture());
        }
        if are_apart && !self.have_split {
            self.have_split = true;
            tracing::info!(
                "split after {seconds:.1} s into {} red and {} blue, {gap:.2} m apart\n{}",
                sizes[1],
                sizes[2],
                self.picture()
            );
        }
        Overview {
            poses: self.bodies.iter().map(Body::pose).collect(),
            lights: self.bodies.iter().map(|body| body.light).collect(),
            sizes,
            spread,
            group_spreads,
            gap,
            have_gathered: self.have_gathered,
            have_split: self.have_split,
        }
    }

    /// Draws the swarm around its centre: `o` undecided, `r` red, `b` blue, capital for several. A character
    /// is 5 cm wide and 10 cm high.
    fn picture(&self) -> String {
        const COLUMNS: usize = 60;
        const ROWS: usize = 30;
        let positions: Vec<_> = self.bodies.iter().map(|body| body.position).collect();
        let corner = centre(&positions) + DVec2::new(-1.5, 1.5);
        let mut rows = [[' '; COLUMNS]; ROWS];
        for body in &self.bodies {
            let offset = (body.position - corner) / DVec2::new(0.05, -0.1);
            // A position left of the corner or above it becomes 0, at the edge.
            let (column, row) = (offset.x as usize, offset.y as usize);
            let cell = &mut rows[row.min(ROWS - 1)][column.min(COLUMNS - 1)];
            let letter = match body.light {
                Light::RED => 'r',
                Light::BLUE => 'b',
                _ => 'o',
            };
            *cell = if *cell == ' ' { letter } else { letter.to_ascii_uppercase() };
        }
        let is_used = |row: &[char; COLUMNS]| row.iter().any(|&cell| cell != ' ');
        let first = rows.iter().position(is_used).unwrap_or(0);
        let end = rows.iter().rposition(is_used).map_or(0, |last| last + 1);
        let lines = rows[first..end].iter().map(|row| format!("|{}|", String::from_iter(row)));
        lines.collect::<Vec<_>>().join("\n")
    }
}

impl Body {
    fn somewhere(random: &mut Random) -> Self {
        let position = DVec2::new(random.within(HALF_SIDE), random.within(HALF_SIDE));
        let heading = random.within(PI);
        Self { position, heading, wheels: [0.0; 2], light: Light::UNDECIDED, heard: Vec::new() }
    }

    /// One step of a differential drive, with the heading in the middle of the step.
    fn drive(&mut self) {
        let [left, right] = self.wheels;
        let turned = (right - left) / TRACK * STEP.as_secs_f64();
        let moved = (left + right) / 2.0 * STEP.as_secs_f64();
        self.position += DVec2::from_angle(self.heading + turned / 2.0) * moved;
        self.heading = (self.heading + turned + PI).rem_euclid(2.0 * PI) - PI;
    }

    fn pose(&self) -> Pose {
        Pose { x: self.position.x, y: self.position.y, heading: self.heading }
    }
}

fn centre(positions: &[DVec2]) -> DVec2 {
    positions.iter().sum::<DVec2>() / positions.len().max(1) as f64
}

/// The greatest distance from the centre, m.
fn spread(positions: &[DVec2]) -> f64 {
    let centre = centre(positions);
    positions.iter().map(|position| position.distance(centre)).fold(0.0, f64::max)
}
