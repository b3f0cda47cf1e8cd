//! Footsteps that answer pushes: where the swinging foot has to land, and how soon.
//!
//! The robot is a mass at the height h on a leg without mass, a linear inverted pendulum. With ω = √(g/h),
//! the position x of the centre of mass with respect to the sole that carries the robot, and its velocity v,
//! the point on the floor above which the robot comes to rest if a foot is put there is the capture point
//!
//! (1)  ξ = x + v/ω
//!
//! which runs away from the sole: ξ(t) = ξ(0) exp(ωt). In a walk with steps of the duration T, the length L
//! and the width W it repeats itself if it begins each step at
//!
//! (2)  ξ = (L / (exp(ωT) - 1), W / (1 + exp(ωT)))
//!
//! ahead of the sole and towards the other one. A robot with soft joints walks otherwise: what it usually
//! does in each part of a step is learned, and the rest Δ is what came from outside. The foot is put aside by
//! what Δ will have become when it lands:
//!
//! (3)  placement = gain Δ exp(ω (T - t))
//!
//! To the side of the foot that carries it, the robot cannot step. It waits for the return of its body, and
//! hurries if the body falls to the other side:
//!
//! (4)  haste = gain Δ towards the swinging foot
//!
//! # References
//! J. Pratt, J. Carff, S. Drakunov, A. Goswami, "Capture Point: A Step toward Humanoid Push Recovery",
//! Humanoids 2006, for (1). J. Englsberger, C. Ott, A. Albu-Schäffer, "Three-Dimensional Bipedal Walking
//! Control Based on Divergent Component of Motion", IEEE Transactions on Robotics 31 (2015), for (2) and (3).
//! M. Missura, S. Behnke, "Lateral Capture Steps for Bipedal Walking", Humanoids 2011, for (4).

use super::engine::Correction;
use downbeat_kinematics::leg::Side;
use downbeat_servos::servo_bus::models::STANDARD_GRAVITY;
use glam::{DQuat, DVec2, DVec3};

/// How the robot answers pushes, in m, s and rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CaptureParameters {
    /// The gain of (3).
    pub(super) gain: f64,
    /// Smaller placements are left out.
    pub(super) dead_zone: f64,
    /// The largest placement forward and backward, and outward.
    pub(super) longest: [f64; 2],
    /// The gain of (4), in 1/m.
    pub(super) haste: f64,
    /// How far the capture point of a robot that stands may go forward, backward and to a side.
    pub(super) stand: [f64; 3],
    /// Half the distance of the feet.
    pub(super) half_width: f64,
}

/// Follows the capture point of a robot; see the [module page](self).
#[derive(Clone, Debug, Default)]
pub(super) struct Capture {
    /// The centre of mass with respect to the left and the right sole, in the axes of the base, at the last
    /// measurement.
    last: Option<[DVec3; 2]>,
    /// Of the joints' part of the velocity with respect to each sole.
    smoothed: [DVec3; 2],
    /// With respect to each sole, in axes that are level and turned as the robot: forward, left.
    points: Option<[DVec2; 2]>,
    height: f64,
    /// Where the capture point is while the robot stands, with respect to the middle of the soles.
    stands_at: Option<DVec2>,
    /// Beside (2), while the left and while the right foot carries the robot.
    usual: [[DVec2; PARTS]; 2],
    /// How long the robot has not had to step, in s.
    calm: f64,
}

/// The parts of a step in which the usual is learned.
const PARTS: usize = 8;
/// The share of what is new that is learned in a s.
const LEARNING: f64 = 3.0;
/// The share of what is new that a robot that stands learns in a s.
const SETTLING: f64 = 1.0;
/// From farther away a robot that stands learns no more, in m.
const NEAR: f64 = 0.01;
/// Time constant of the joints' part of the velocity, in s.
const SMOOTHING: f64 = 0.02;
/// How much of a placement goes inward, in m: the feet must not meet.
const INWARD: f64 = 0.01;
/// The least and the most haste.
const HASTE: [f64; 2] = [-0.7, 0.8];
/// For how long a robot steps after it has caught itself, in s.
const CALM: f64 = 0.5;
/// The least height of a centre of mass, in m.
const LEAST_HEIGHT: f64 = 0.05;

impl Capture {
    /// Takes where the centre of mass is with respect to the left and the right sole, in axes of the base,
    /// the tilt of the base without its heading, and its rate in rad/s, `dt` in s after the last measurement.
    pub(super) fn measure(&mut self, masses: [DVec3; 2], level_from_base: DQuat, rate: DVec3, dt: f64) {
        let last = self.last.replace(masses);
        let Some(last) = last.filter(|_| dt > 0.0) else { return };
        let share = (dt / SMOOTHING).min(1.0);
        let turning = level_from_base * rate;
        // The heading is that of the robot: its axes turn with it.
        let turning = DVec3::new(turning.x, turning.y, 0.0);
        let level = masses.map(|mass| level_from_base * mass);
        self.height = level[0].z.max(level[1].z).max(LEAST_HEIGHT);
        let omega = self.omega();
        let mut points = [DVec2::ZERO; 2];
        for foot in 0..2 {
            let raw = (masses[foot] - last[foot]) / dt;
            self.smoothed[foot] += (raw - self.smoothed[foot]) * share;
            let velocity = level_from_base * self.smoothed[foot] + turning.cross(level[foot]);
            points[foot] = (level[foot] + velocity / omega).truncate();
        }
        self.points = Some(points);
    }

    /// Forgets what a robot that fell was doing; what is usual remains.
    pub(super) fn reset(&mut self) {
        let usual = self.usual;
        *self = Self { usual, ..Self::default() };
    }

    fn omega(&self) -> f64 {
        (STANDARD_GRAVITY / self.height.max(LEAST_HEIGHT)).sqrt()
    }

    /// For a robot that stands: which foot it has to lift, if any. `dt` in s after the last call.
    pub(super) fn standing(&mut self, dt: f64, parameters: &CaptureParameters) -> Correction {
        let Some([left, right]) = self.points.filter(|_| parameters.gain > 0.0) else {
            return Correction::default();
        };
        let point = (left + right) / 2.0;
        let usual = self.stands_at.get_or_insert(point);
        let away = point - *usual;
        *usual += away.clamp_length_max(NEAR) * (SETTLING * dt).min(1.0);
        let [forward, backward, aside] = parameters.stand;
        let is_caught = (-backward..=forward).contains(&away.x) && away.y.abs() <= aside;
        if is_caught {
            return Correction::default();
        }
        self.calm = 0.0;
        // The foot from which the body falls away carries less.
        let side = if away.y > 0.0 { Side::Right } else { Side::Left };
        Correction { must_step: Some(side), ..Correction::default() }
    }

    /// For a robot that steps: where its foot lands, and when. `side` is that of the swinging foot, `time`
    /// the time in the step of the given `duration`, and `forward` the velocity of the walk in m/s;
    /// `is_catching` while nothing but a push makes it step.
    pub(super) fn stepping(
        &mut self,
        (side, time, duration): (Side, f64, f64),
        forward: f64,
        is_catching: bool,
        dt: f64,
        parameters: &CaptureParameters,
    ) -> Correction {
        let Some(points) = self.points.filter(|_| parameters.gain > 0.0) else {
            return Correction::default();
        };
        let (stance, outward) = match side {
            Side::Left => (1, 1.0),
            Side::Right => (0, -1.0),
        };
        let omega = self.omega();
        let (grown, whole) = (libm::exp(omega * time), libm::exp(omega * duration));
        let repeats = DVec2::new(
            forward * duration / (whole - 1.0),
            outward * 2.0 * parameters.half_width / (1.0 + whole),
        ) * grown;
        let part = ((time / duration * PARTS as f64) as usize).min(PARTS - 1);
        let found = points[stance] - repeats;
        let usual = &mut self.usual[stance][part];
        let rest = found - *usual;
        if !is_catching {
            *usual += rest * (LEARNING * dt).min(1.0);
        }
        let landing = rest * parameters.gain * whole / grown;
        let beyond = |value: f64| value.signum() * (value.abs() - parameters.dead_zone).max(0.0);
        let [longest, widest] = parameters.longest;
        let placement = DVec2::new(
            beyond(landing.x).clamp(-longest, longest),
            outward * beyond(landing.y * outward).clamp(-INWARD.min(widest), widest),
        );
        let is_calm = beyond(landing.x) == 0.0 && beyond(landing.y) == 0.0;
        self.calm = if is_calm { self.calm + dt } else { 0.0 };
        Correction {
            must_step: (is_catching && self.calm < CALM).then_some(side),
            placement,
            haste: (parameters.haste * rest.y * outward).clamp(HASTE[0], HASTE[1]),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    const PARAMETERS: CaptureParameters = CaptureParameters {
        gain: 1.0,
        dead_zone: 0.01,
        longest: [0.08, 0.04],
        haste: 20.0,
        stand: [0.04, 0.04, 0.06],
        half_width: 0.04,
    };
    const DT: f64 = 0.008;
    const HEIGHT: f64 = 0.21;

    /// A robot whose centre of mass is there with respect to the middle of its feet, and turns about its
    /// soles with this rate.
    fn moving(capture: &mut Capture, [x, y]: [f64; 2], rate: DVec3) {
        let masses = [-0.04, 0.04].map(|to_middle| DVec3::new(x, y + to_middle, HEIGHT));
        capture.measure(masses, DQuat::IDENTITY, rate, DT);
        capture.measure(masses, DQuat::IDENTITY, rate, DT);
    }

    fn standing(rate: DVec3) -> Correction {
        let mut capture = Capture::default();
        moving(&mut capture, [0.0; 2], DVec3::ZERO);
        assert_eq!(capture.standing(DT, &PARAMETERS), Correction::default());
        moving(&mut capture, [0.0; 2], rate);
        capture.standing(DT, &PARAMETERS)
    }

    #[test]
    fn a_robot_that_stands_steps_if_its_capture_point_leaves_its_feet() {
        let omega = (STANDARD_GRAVITY / HEIGHT).sqrt();
        let rate_of = |point: f64| point * omega / HEIGHT;
        assert_eq!(standing(DVec3::Y * rate_of(0.035)).must_step, None);
        assert!(standing(DVec3::Y * rate_of(0.045)).must_step.is_some());
        assert!(standing(DVec3::Y * rate_of(-0.045)).must_step.is_some());
        assert_eq!(standing(DVec3::X * rate_of(-0.065)).must_step, Some(Side::Right), "it falls to the left");
        assert_eq!(standing(DVec3::X * rate_of(0.065)).must_step, Some(Side::Left), "it falls to the right");
    }

    /// What a robot does that has got used to its walk, in the middle of a step of its left foot.
    fn stepping(rate: DVec3) -> Correction {
        let mut capture = Capture::default();
        let step = (Side::Left, 0.15, 0.3);
        for _ in 0..1000 {
            moving(&mut capture, [0.0, -0.02], DVec3::ZERO);
            capture.stepping(step, 0.0, false, DT, &PARAMETERS);
        }
        moving(&mut capture, [0.0, -0.02], rate);
        capture.stepping(step, 0.0, false, DT, &PARAMETERS)
    }

    #[test]
    fn a_foot_lands_where_the_push_leads() {
        let usual = stepping(DVec3::ZERO);
        assert_eq!((usual.placement, usual.must_step), (DVec2::ZERO, None));
        assert!(usual.haste.abs() < 1e-3);
        assert!(stepping(DVec3::Y).placement.x > 0.05, "forward");
        assert!(stepping(-DVec3::Y).placement.x < -0.05, "backward");
        let (outward, inward) = (stepping(-DVec3::X), stepping(DVec3::X));
        assert!(outward.placement.y > 0.03 && outward.haste > 0.3, "{outward:?}");
        assert!((inward.placement.y + INWARD).abs() < 1e-9 && inward.haste < -0.3, "{inward:?}");
        assert_eq!(stepping(DVec3::Y * 100.0).placement.x, PARAMETERS.longest[0]);
    }

    #[test]
    fn a_robot_that_caught_itself_steps_until_it_is_calm() {
        let mut capture = Capture::default();
        moving(&mut capture, [0.0; 2], DVec3::ZERO);
        capture.standing(DT, &PARAMETERS);
        moving(&mut capture, [0.0; 2], DVec3::Y * 3.0);
        assert!(capture.standing(DT, &PARAMETERS).must_step.is_some());
        let mut steps = |rate: DVec3| {
            // The robot is where (2) has it at the start of a step.
            let omega = (STANDARD_GRAVITY / HEIGHT).sqrt();
            let y = 0.08 / (1.0 + libm::exp(omega * 0.2)) - 0.04;
            moving(&mut capture, [0.0, y], rate);
            capture.stepping((Side::Left, 0.0, 0.2), 0.0, true, 0.1, &PARAMETERS).must_step.is_some()
        };
        assert!(steps(DVec3::Y * 2.0));
        let calm = (0..10).map(|_| steps(DVec3::ZERO)).take_while(|steps| *steps).count();
        assert!((3..=7).contains(&calm), "{calm}");
    }
}
