//! The walking engine: time and a wanted velocity in, poses of the feet out. It knows neither joints nor
//! messages.
//!
//! The robot walks by a rhythm of period T. In the first half of a period the left foot swings, in the second
//! half the right one. All trajectories are sines and cosines of the phase:
//!
//! - the body sways sideways over the supporting foot, once in a period, and nods down in double support;
//! - in single support the swinging foot is lifted, and both feet move by the same amount in opposite
//!   directions with respect to the body, from their separation at the start of the half period to a new one.
//!
//! With u from 0 to 1 during the single support, A the amplitudes and t the time in the half period:
//!
//! (1)  lift        = A (1 - cos 2πu) / 2
//! (2)  separation  = from + (to - from) (1 - cos πu) / 2
//! (3)  sway        = A sin(2π phase)
//! (4)  nod         = A (1 + cos(4π t/T))
//! (5)  body swing  = r x sin(4π t/T - π)
//!
//! A new velocity takes effect at the start of a half period. Since (2) starts from the separation that there
//! is, the feet never jump, whatever the velocities are. With a constant velocity the trajectories are those
//! of the walking module of the DARwIn-OP framework, except that (1) starts at 0.
//!
//! A [placement](Correction) puts the swinging foot elsewhere. In the next half period the body moves over
//! it. In a step that [kicks](Engine::kick) and has a period of its own, the swinging foot swings back,
//! forward, and to where it lands. A robot that stands and has to step skips the growth of the sway: it lifts
//! a foot at once.
//!
//! # References
//! I. Ha, Y. Tamura, H. Asama, "Gait pattern generation and stabilization for humanoid robot based on coupled
//! oscillators", IROS 2011; ROBOTIS DARwIn-OP framework 1.6, module `Walking`, for the amplitudes.

use downbeat_kinematics::leg::Side;
use glam::DVec2;
use std::f64::consts::{PI, TAU};

/// Parameters of the engine, in m, rad and s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters {
    /// The duration of two steps.
    pub period: f64,
    /// The fraction of the period in which both feet are on the ground.
    pub double_support: f64,
    /// How high a foot is lifted.
    pub foot_height: f64,
    /// How far the body sways to each side.
    pub sway: f64,
    /// How far the body goes down in double support, half of it.
    pub nod: f64,
    /// How far the body swings forward and back in a step, as a fraction of the step.
    pub body_swing: f64,
    /// By how much the hip of the supporting leg rolls to keep the pelvis level.
    pub pelvis_roll: f64,
    /// Where the feet are below the hips: forward, outward, and up from where they are with straight legs.
    pub stance: [f64; 3],
    /// How much further forward the feet are while the robot walks.
    pub walking_shift: f64,
    /// The duration of two steps of a robot that stood and has to step to stay on its feet.
    pub catching_period: f64,
    /// How far a foot that kicks swings ahead of its way.
    pub kick_length: f64,
    /// The duration of two steps of which one kicks, while it kicks.
    pub kick_period: f64,
    /// How high a foot that kicks is lifted: if it touches the ground while it swings back, it turns the
    /// robot.
    pub kick_height: f64,
    /// How far the trunk leans ahead of the standing foot against the swing of a kick.
    pub kick_lean: f64,
    /// The largest velocities.
    pub limits: Limits,
}

/// The largest velocities and accelerations, in m/s, rad/s, m/s² and rad/s².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Forward.
    pub forward: f64,
    /// Backward, positive.
    pub backward: f64,
    /// To the side.
    pub side: f64,
    /// Of a turn.
    pub turn: f64,
    /// Of forward and backward walking and of side steps.
    pub acceleration: f64,
    /// Of a turn.
    pub turn_acceleration: f64,
    /// How many times faster the robot slows down.
    pub braking: f64,
}

/// What keeps the robot on its feet.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Correction {
    /// The foot that a robot that stands has to lift.
    pub must_step: Option<Side>,
    /// Where the swinging foot lands, beside where the velocity leads it, in m.
    pub placement: DVec2,
    /// How much faster the present step goes, 0 to stay as it is.
    pub haste: f64,
}

/// A velocity of the body.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Velocity {
    /// Forward, in m/s.
    pub forward: f64,
    /// To the left, in m/s.
    pub left: f64,
    /// To the left, in rad/s.
    pub turn: f64,
}

/// A foot, in a level frame below its hip: x forward, y left, z up, origin where the sole is if the leg is
/// straight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Foot {
    /// Forward, in m.
    pub x: f64,
    /// To the left, in m.
    pub y: f64,
    /// Up, in m.
    pub z: f64,
    /// To the left, in rad.
    pub yaw: f64,
}

/// Which foot carries the robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Support {
    /// Both feet.
    #[default]
    Both,
    /// The left foot.
    Left,
    /// The right foot.
    Right,
}

/// What the limbs should do now.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Targets {
    /// The left foot.
    pub left: Foot,
    /// The right foot.
    pub right: Foot,
    /// How far the left and the right hip should roll outwards in addition, in rad.
    pub hip_roll: [f64; 2],
    /// How far the left foot is ahead of the middle, in m: the arms swing with it.
    pub stride: f64,
    /// Which foot carries the robot.
    pub support: Support,
}

/// Half the separation of the feet: the left foot has these coordinates, the right one the opposite.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Separation {
    x: f64,
    y: f64,
    yaw: f64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Stage {
    #[default]
    Standing,
    /// The sway grows, the feet stay on the ground.
    Starting,
    /// The sway grows while a foot is already in the air.
    Catching,
    Walking,
    /// The sway fades, the feet stay on the ground.
    Stopping,
}

/// The walking engine; see the [module page](self).
#[derive(Clone, Debug, Default)]
pub struct Engine {
    stage: Stage,
    /// From 0 to 1 in a period.
    phase: f64,
    /// The velocity of the present half period, slewed towards the wanted one.
    velocity: Velocity,
    from: Separation,
    to: Separation,
    /// Where the left and the right foot are beside that: at the start of the half period, and at its end.
    placed_from: [DVec2; 2],
    placed_to: [DVec2; 2],
    /// Whether the steps are those of a robot that catches itself.
    is_catching: bool,
    /// The foot that kicks with its next step, and whether the present step kicks.
    kick: Option<Side>,
    is_kicking: bool,
    /// The amplitude of (5).
    swing: f64,
}

/// The fastest change of a placement, in m/s.
const PLACING_SPEED: f64 = 1.0;
/// How far from its place a foot may stay when the robot stops, in m.
const TOGETHER: f64 = 0.002;

impl Engine {
    /// Returns true while the feet or the body move.
    #[must_use]
    pub fn is_walking(&self) -> bool {
        self.stage != Stage::Standing
    }

    /// The present velocity, limited in speed and acceleration.
    #[must_use]
    pub fn velocity(&self) -> Velocity {
        self.velocity
    }

    /// Lets a foot kick with its next step, for which a robot that stands begins to walk.
    pub fn kick(&mut self, side: Side) {
        self.kick = Some(side);
    }

    /// Returns true while the robot steps because it stood and had to.
    #[must_use]
    pub fn is_catching(&self) -> bool {
        self.is_catching
    }

    /// Where the robot is in a step: the side of the swinging foot, and the time since the start of the half
    /// period and its duration, in s; `None` while both feet stay on the ground.
    #[must_use]
    pub fn step_in_progress(&self, parameters: &Parameters) -> Option<(Side, f64, f64)> {
        let duration = self.period(parameters) / 2.0;
        let side = if self.phase < 0.5 { Side::Left } else { Side::Right };
        let is_stepping = matches!(self.stage, Stage::Walking | Stage::Catching);
        is_stepping.then_some((side, (self.phase * 2.0).fract() * duration, duration))
    }

    /// Advances by `dt` in s. Walking starts when a velocity is wanted, and stops with the feet side by side
    /// when none is wanted any more.
    pub fn step(
        &mut self,
        dt: f64,
        wanted: Velocity,
        correction: Correction,
        parameters: &Parameters,
    ) -> Targets {
        self.velocity = parameters.limits.slewed(self.velocity, parameters.limits.limited(wanted), dt);
        let is_wanted =
            wanted != Velocity::default() || correction.must_step.is_some() || self.kick.is_some();
        if self.stage == Stage::Standing {
            let (velocity, kick) = (self.velocity, self.kick);
            *self = match correction.must_step {
                Some(side) => {
                    let phase = if side == Side::Left { 0.0 } else { 0.5 };
                    Self {
                        stage: Stage::Catching,
                        is_catching: true,
                        phase,
                        velocity,
                        kick,
                        ..Self::default()
                    }
                }
                None if is_wanted => Self { stage: Stage::Starting, velocity, kick, ..Self::default() },
                None => return self.targets(parameters),
            };
        }
        if let Some((side, ..)) = self.step_in_progress(parameters) {
            let placed = &mut self.placed_to[usize::from(side == Side::Right)];
            *placed += (correction.placement - *placed).clamp_length_max(PLACING_SPEED * dt);
        }
        let half_before = self.phase >= 0.5;
        let hastened = dt * (1.0 + correction.haste);
        self.phase = (self.phase + hastened / self.period(parameters)).fract();
        if (self.phase >= 0.5) != half_before {
            self.begin_half_period(is_wanted, parameters);
        }
        self.targets(parameters)
    }

    fn period(&self, parameters: &Parameters) -> f64 {
        match self {
            Self { is_kicking: true, .. } => parameters.kick_period,
            Self { is_catching: true, .. } => parameters.catching_period,
            _ => parameters.period,
        }
    }

    fn begin_half_period(&mut self, is_wanted: bool, parameters: &Parameters) {
        let are_feet_together = !self.is_kicking
            && self.to == Separation::default()
            && self.placed_to.iter().all(|placed| placed.length() < TOGETHER);
        self.stage = match self.stage {
            Stage::Walking | Stage::Catching
                if !is_wanted && are_feet_together && self.velocity == Velocity::default() =>
            {
                Stage::Stopping
            }
            Stage::Stopping if !is_wanted => {
                *self = Self::default();
                return;
            }
            // A walk that is wanted again while it stops goes on after the sway has faded and grown again.
            Stage::Stopping => Stage::Starting,
            Stage::Standing | Stage::Starting | Stage::Catching | Stage::Walking => Stage::Walking,
        };
        self.is_catching &= self.velocity == Velocity::default();
        self.from = self.to;
        self.placed_from = std::mem::take(&mut self.placed_to);
        self.swing = 0.0;
        if std::mem::take(&mut self.is_kicking) {
            let has_kicked = usize::from(self.phase < 0.5);
            self.placed_from[has_kicked].x += LANDS_AHEAD * parameters.kick_length;
        }
        if self.stage == Stage::Walking {
            let left_swings = self.phase < 0.5;
            let side = if left_swings { Side::Left } else { Side::Right };
            self.is_kicking = self.kick.take_if(|kick| *kick == side).is_some();
            let Velocity { forward, left, turn } = self.velocity;
            let x = forward * parameters.period / 4.0;
            // The feet open in the step towards the side and close in the other one.
            let opening = |velocity: f64| {
                let towards_swing = if left_swings { velocity } else { -velocity };
                towards_swing.max(0.0) * parameters.period / 2.0
            };
            self.to =
                Separation { x: if left_swings { x } else { -x }, y: opening(left), yaw: opening(turn) };
            self.swing = x * parameters.body_swing;
        }
    }

    fn targets(&self, parameters: &Parameters) -> Targets {
        let [stance_x, stance_y, stance_z] = parameters.stance;
        let half = (self.phase * 2.0).fract();
        let level = match self.stage {
            Stage::Standing => 0.0,
            Stage::Starting | Stage::Catching => smooth(half),
            Stage::Walking => 1.0,
            Stage::Stopping => 1.0 - smooth(half),
        };
        // The part of the half period that has both feet on the ground is at its ends.
        let margin = parameters.double_support / 2.0;
        let u = ((half - margin) / (1.0 - 2.0 * margin)).clamp(0.0, 1.0);
        let blend = smooth(u);
        let between = |from: f64, to: f64| from + (to - from) * blend;
        let separation = Separation {
            x: between(self.from.x, self.to.x),
            y: between(self.from.y, self.to.y),
            yaw: between(self.from.yaw, self.to.yaw),
        };
        let left_swings = self.phase < 0.5;
        let is_stepping = matches!(self.stage, Stage::Walking | Stage::Catching);
        let lifting = if is_stepping { (1.0 - libm::cos(TAU * u)) / 2.0 } else { 0.0 };
        let height = if self.is_kicking { parameters.kick_height } else { parameters.foot_height };
        let lift = height * lifting;
        let (left_lift, right_lift) = if left_swings { (lift, 0.0) } else { (0.0, lift) };
        let x = stance_x + parameters.walking_shift * level + self.swing * libm::sin(TAU * half - PI);
        let y = parameters.sway * level * libm::sin(TAU * self.phase);
        let z = stance_z + parameters.nod * level * (1.0 + libm::cos(TAU * half));
        let roll = parameters.pelvis_roll * lifting;
        // The supporting hip rolls fully, the other one by about a third.
        let hip_roll = if left_swings { [0.35 * roll, roll] } else { [roll, 0.35 * roll] };
        let support = match (is_stepping && u > 0.0 && u < 1.0, left_swings) {
            (false, _) => Support::Both,
            (true, true) => Support::Right,
            (true, false) => Support::Left,
        };
        let [left_placed, right_placed] =
            [0, 1].map(|index| self.placed_from[index].lerp(self.placed_to[index], blend));
        let kick = if self.is_kicking { parameters.kick_length * kicking(u) } else { 0.0 };
        let (left_kick, right_kick) = if left_swings { (kick, 0.0) } else { (0.0, kick) };
        let x = x - if self.is_kicking { parameters.kick_lean * leaning(u) } else { 0.0 };
        Targets {
            left: Foot {
                x: x + separation.x + left_placed.x + left_kick,
                y: y + stance_y + separation.y + left_placed.y,
                z: z + left_lift,
                yaw: separation.yaw,
            },
            right: Foot {
                x: x - separation.x + right_placed.x + right_kick,
                y: y - stance_y - separation.y + right_placed.y,
                z: z + right_lift,
                yaw: -separation.yaw,
            },
            hip_roll,
            stride: separation.x,
            support,
        }
    }
}

impl Limits {
    /// The velocity, scaled down in its direction to what the robot can do.
    #[must_use]
    pub fn limited(&self, wanted: Velocity) -> Velocity {
        let forward = if wanted.forward < 0.0 { self.backward } else { self.forward };
        let share = |velocity: f64, limit: f64| if velocity == 0.0 { 0.0 } else { velocity / limit };
        let [x, y, turn] =
            [share(wanted.forward, forward), share(wanted.left, self.side), share(wanted.turn, self.turn)];
        let load = (x * x + y * y + turn * turn).sqrt();
        if load <= 1.0 {
            return wanted;
        }
        if !load.is_finite() {
            return Velocity::default();
        }
        Velocity { forward: wanted.forward / load, left: wanted.left / load, turn: wanted.turn / load }
    }

    fn slewed(&self, from: Velocity, to: Velocity, dt: f64) -> Velocity {
        let slew = |from: f64, to: f64, limit: f64| {
            let is_slower = to.abs() < from.abs() || from * to < 0.0;
            let limit = if is_slower { limit * self.braking } else { limit };
            from + (to - from).clamp(-limit * dt, limit * dt)
        };
        Velocity {
            forward: slew(from.forward, to.forward, self.acceleration),
            left: slew(from.left, to.left, self.acceleration),
            turn: slew(from.turn, to.turn, self.turn_acceleration),
        }
    }
}

/// Where a foot that kicked lands, as a share of how far it swung ahead; the body follows with the next step.
/// Who swings a foot back to where it began turns and topples.
const LANDS_AHEAD: f64 = 0.3;

/// How far a foot that kicks is ahead in its swing, as a share of the most.
fn kicking(u: f64) -> f64 {
    const BACK: f64 = 0.42;
    const BACK_AT: f64 = 0.2;
    const AHEAD_AT: f64 = 0.57;
    if u < BACK_AT {
        -BACK * smooth(u / BACK_AT)
    } else if u < AHEAD_AT {
        -BACK + (1.0 + BACK) * smooth((u - BACK_AT) / (AHEAD_AT - BACK_AT))
    } else {
        LANDS_AHEAD + (1.0 - LANDS_AHEAD) * smooth((1.0 - u) / (1.0 - AHEAD_AT))
    }
}

/// How far the trunk leans ahead during a kick, as a share of the most: without it, whoever misses the ball
/// falls on its back.
fn leaning(u: f64) -> f64 {
    const FROM: f64 = 0.4;
    (1.0 - libm::cos(TAU * ((u - FROM) / (1.0 - FROM)).clamp(0.0, 1.0))) / 2.0
}

/// Rises from 0 to 1, level at both ends.
fn smooth(u: f64) -> f64 {
    (1.0 - libm::cos(PI * u)) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    const PARAMETERS: Parameters = Parameters {
        period: 0.6,
        double_support: 0.1,
        foot_height: 0.04,
        sway: 0.02,
        nod: 0.005,
        body_swing: 0.28,
        pelvis_roll: 0.05,
        stance: [-0.01, 0.0025, 0.02],
        walking_shift: -0.01,
        catching_period: 0.4,
        kick_length: 0.06,
        kick_period: 0.8,
        kick_height: 0.05,
        kick_lean: 0.01,
        limits: Limits {
            forward: 0.2,
            backward: 0.1,
            side: 0.08,
            turn: 1.0,
            acceleration: 0.2,
            turn_acceleration: 2.0,
            braking: 1.0,
        },
    };

    const DT: f64 = 0.008;

    fn velocity(forward: f64, left: f64, turn: f64) -> Velocity {
        Velocity { forward, left, turn }
    }

    /// The targets of a time in s with a wanted velocity.
    fn run(engine: &mut Engine, seconds: f64, wanted: Velocity) -> Vec<Targets> {
        (0..(seconds / DT).round() as usize)
            .map(|_| engine.step(DT, wanted, Correction::default(), &PARAMETERS))
            .collect()
    }

    /// How far the supporting feet have pushed the body: forward, left, turned.
    fn way(targets: &[Targets]) -> [f64; 3] {
        let mut way = [0.0; 3];
        for pair in targets.windows(2) {
            let feet = match pair[1].support {
                // Both feet move alike.
                Support::Both | Support::Left => (pair[0].left, pair[1].left),
                Support::Right => (pair[0].right, pair[1].right),
            };
            let (before, after) = feet;
            way[0] += before.x - after.x;
            way[1] += before.y - after.y;
            way[2] += before.yaw - after.yaw;
        }
        way
    }

    #[test]
    fn it_stands_until_a_velocity_is_wanted() {
        let mut engine = Engine::default();
        let standing = run(&mut engine, 1.0, Velocity::default());
        assert!(standing.iter().all(|targets| *targets == standing[0]) && !engine.is_walking());
        assert_eq!(standing[0].left, Foot { x: -0.01, y: 0.0025, z: 0.02, yaw: 0.0 });
        assert_eq!(standing[0].right, Foot { x: -0.01, y: -0.0025, z: 0.02, yaw: 0.0 });
    }

    #[test]
    fn it_goes_as_fast_as_wanted_in_all_directions() {
        let cases = [
            velocity(0.1, 0.0, 0.0),
            velocity(-0.08, 0.0, 0.0),
            velocity(0.0, 0.05, 0.0),
            velocity(0.0, -0.05, 0.0),
            velocity(0.0, 0.0, 0.6),
            velocity(0.05, -0.03, -0.4),
        ];
        for wanted in cases {
            let mut engine = Engine::default();
            run(&mut engine, 3.0, wanted);
            let [forward, left, turn] = way(&run(&mut engine, 6.0, wanted)).map(|way| way / 6.0);
            assert!((forward - wanted.forward).abs() < 0.03 * 0.1, "{forward} {wanted:?}");
            assert!((turn - wanted.turn).abs() < 0.05, "{turn} {wanted:?}");
            assert!((left - wanted.left).abs() < 0.2 * 0.05, "{left} {wanted:?}");
        }
    }

    #[test]
    fn no_foot_jumps_whatever_is_wanted() {
        let mut engine = Engine::default();
        let wishes = [
            velocity(0.2, 0.0, 0.0),
            velocity(-0.1, 0.05, 0.5),
            velocity(0.0, -0.08, -1.0),
            Velocity::default(),
            velocity(0.1, 0.0, 1.0),
            velocity(f64::INFINITY, 0.0, 0.0),
            Velocity::default(),
        ];
        let targets: Vec<Targets> = wishes.iter().flat_map(|wish| run(&mut engine, 1.37, *wish)).collect();
        for pair in targets.windows(2) {
            for (before, after) in [(pair[0].left, pair[1].left), (pair[0].right, pair[1].right)] {
                let [x, y, z] = [after.x - before.x, after.y - before.y, after.z - before.z];
                assert!(x.abs() < 0.006 && y.abs() < 0.005 && z.abs() < 0.005, "{before:?} to {after:?}");
                assert!((after.yaw - before.yaw).abs() < 0.05, "{before:?} to {after:?}");
            }
        }
    }

    #[test]
    fn it_stops_with_both_feet_on_the_ground_and_side_by_side() {
        for stop_after in [0.1, 0.31, 0.5, 1.0, 2.17] {
            let mut engine = Engine::default();
            run(&mut engine, stop_after, velocity(0.1, 0.03, 0.3));
            let stopping = run(&mut engine, 4.0, Velocity::default());
            assert!(!engine.is_walking());
            let (last, standing) =
                (stopping[stopping.len() - 1], run(&mut Engine::default(), DT, Velocity::default()));
            assert_eq!(last, standing[0]);
        }
    }

    #[test]
    fn one_foot_is_always_on_the_ground_and_the_feet_take_turns() {
        let mut engine = Engine::default();
        let targets = run(&mut engine, 6.0, velocity(0.1, 0.0, 0.0));
        let mut supports: Vec<Support> = targets.iter().map(|targets| targets.support).collect();
        supports.dedup();
        supports.retain(|support| *support != Support::Both);
        assert!(supports.len() >= 18, "{}", supports.len());
        assert!(supports.windows(2).all(|pair| pair[0] != pair[1]));
        for Targets { left, right, support, .. } in targets {
            let lift = (left.z - right.z).abs();
            assert!(lift < 1e-12 || support != Support::Both);
        }
    }

    #[test]
    fn a_robot_that_has_to_step_lifts_a_foot_at_once_and_stands_again() {
        for (side, support) in [(Side::Left, Support::Right), (Side::Right, Support::Left)] {
            let mut engine = Engine::default();
            let caught = Correction {
                must_step: Some(side),
                placement: DVec2::new(0.05, 0.0),
                ..Correction::default()
            };
            let step: Vec<Targets> =
                (0..20).map(|_| engine.step(DT, Velocity::default(), caught, &PARAMETERS)).collect();
            assert_eq!(step[5].support, support);
            let landed = step[19];
            let ahead = landed.left.x - landed.right.x;
            let ahead = if side == Side::Left { ahead } else { -ahead };
            assert!((ahead - 0.05).abs() < 0.01, "{ahead}");
            let after = run(&mut engine, 3.0, Velocity::default());
            assert!(!engine.is_walking());
            let ends = after[after.len() - 1];
            assert_eq!((ends.left.x, ends.right.x), (PARAMETERS.stance[0], PARAMETERS.stance[0]));
            for pair in [step, after].concat().windows(2) {
                let moved = [pair[1].left.x - pair[0].left.x, pair[1].right.x - pair[0].right.x];
                assert!(moved.iter().all(|moved| moved.abs() < 0.01), "{moved:?}");
            }
        }
    }

    #[test]
    fn a_foot_kicks_once_with_its_next_step_and_the_walk_goes_on() {
        for is_walking in [true, false] {
            let mut engine = Engine::default();
            let wanted = velocity(if is_walking { 0.1 } else { 0.0 }, 0.0, 0.0);
            run(&mut engine, 2.0, wanted);
            let usual = run(&mut engine, 1.2, wanted).iter().map(|step| step.right.x).fold(-1.0, f64::max);
            engine.kick(Side::Right);
            let kicked = run(&mut engine, 1.2, wanted);
            let ahead = kicked.iter().map(|step| step.right.x).fold(-1.0, f64::max);
            assert!(ahead > usual + 0.03, "{ahead} {usual}");
            let highest = kicked.iter().map(|step| step.right.z - step.left.z).fold(0.0, f64::max);
            assert!((highest - PARAMETERS.kick_height).abs() < 1e-3, "{highest}");
            // The step that kicks takes longer.
            let after = run(&mut engine, 1.5 + (PARAMETERS.kick_period - PARAMETERS.period) / 2.0, wanted);
            for pair in [kicked, after.clone()].concat().windows(2) {
                let apart = [0, 1].map(|at: usize| pair[at].right.x - pair[at].left.x);
                let moved = (apart[1] - apart[0]).abs();
                let is_on_both = pair.iter().all(|step| step.support == Support::Both);
                assert!(moved < if is_on_both { 1e-9 } else { 0.011 }, "{pair:?}");
            }
            let after = &after[after.len() - (1.2 / DT) as usize..];
            let ahead = after.iter().map(|step| step.right.x).fold(-1.0, f64::max);
            assert!(ahead < usual + 1e-3 && engine.is_walking() == is_walking, "{ahead} {usual}");
        }
    }

    #[test]
    fn velocities_are_limited_together() {
        let limits = PARAMETERS.limits;
        let limited = limits.limited(velocity(0.2, 0.08, 0.0));
        assert!((limited.forward / 0.2 - 0.5_f64.sqrt()).abs() < 1e-12);
        assert_eq!(limits.limited(velocity(-0.3, 0.0, 0.0)).forward, -0.1);
        assert_eq!(limits.limited(velocity(f64::NAN, 0.0, 0.0)), Velocity::default());
        let backward = Limits { backward: 0.0, ..limits };
        assert_eq!(backward.limited(velocity(-0.3, 0.0, 0.0)), Velocity::default());
        assert_eq!(backward.limited(velocity(0.1, 0.0, 0.0)), velocity(0.1, 0.0, 0.0));
    }
}
