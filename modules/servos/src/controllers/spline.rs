//! Trajectories of joints as splines through the points of a `trajectory_msgs/JointTrajectory`.
//!
//! Between two points of a joint, with t from 0 to T:
//!
//! - linear, if one of them has no velocities;
//! - cubic, if both have velocities: the polynomial that meets positions and velocities at both ends;
//! - quintic, if both have accelerations too: the one that meets these as well.
//!
//! Before the first point the trajectory leads there from the state in which it begins, unless it would
//! swing or jump ([`motion`](super::motion)); after the last one it holds its position.
//!
//! # References
//! `joint_trajectory_controller/src/trajectory.cpp` and `doc/trajectory.rst` of
//! `ros-controls/ros2_controllers`, branch jazzy: the choice among the three, and which trajectories are
//! rejected. The coefficients follow from the conditions.

use std::time::Duration;

use downbeat_msgs::trajectory_msgs::msg::{JointTrajectory, JointTrajectoryPoint};

/// Why a trajectory cannot be followed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// There is nothing to follow.
    #[error("the trajectory has no points")]
    Empty,
    /// A joint that the controller does not command.
    #[error("the trajectory names the joint \"{joint}\", which is none of the controller's: {known}")]
    UnknownJoint {
        /// The joint.
        joint: String,
        /// Those of the controller.
        known: String,
    },
    /// A joint stands in the trajectory more than once.
    #[error("the trajectory names the joint \"{joint}\" twice")]
    JointTwice {
        /// The joint.
        joint: String,
    },
    /// Not all joints of the controller are in the trajectory.
    #[error(
        "the trajectory lacks the joint \"{joint}\"; name all joints of the controller, or set \
         `allow_partial_joints_goal`"
    )]
    MissingJoint {
        /// The first joint that is missing.
        joint: String,
    },
    /// A point has a wrong number of values.
    #[error("point {point} of the trajectory has {found} {what} for {joints} joints")]
    Size {
        /// Counted from 0.
        point: usize,
        /// Positions, velocities or accelerations.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many joints the trajectory names.
        joints: usize,
    },
    /// A point without positions.
    #[error("point {point} of the trajectory has no positions; this controller commands positions")]
    NoPositions {
        /// Counted from 0.
        point: usize,
    },
    /// NaN or infinite.
    #[error("point {point} of the trajectory has a value that is not finite for the joint \"{joint}\"")]
    NotFinite {
        /// Counted from 0.
        point: usize,
        /// The joint.
        joint: String,
    },
    /// Times that do not increase.
    #[error(
        "point {point} of the trajectory is not after the point before it: `time_from_start` must increase"
    )]
    Order {
        /// Counted from 0.
        point: usize,
    },
    /// It would end in motion.
    #[error(
        "the trajectory ends with a velocity of {velocity} for the joint \"{joint}\"; end at rest, or set \
         `allow_nonzero_velocity_at_trajectory_end`"
    )]
    EndsInMotion {
        /// The joint.
        joint: String,
        /// In rad/s or m/s.
        velocity: f64,
    },
}

/// Position (rad or m), velocity and acceleration of one joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointSample {
    /// In rad or m.
    pub position: f64,
    /// In rad/s or m/s.
    pub velocity: f64,
    /// In rad/s² or m/s².
    pub acceleration: f64,
}

/// A checked trajectory, in the order of the controller's joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    /// The controller's joints that it moves.
    moved: Vec<usize>,
    points: Vec<Point>,
}

#[derive(Clone, Debug, PartialEq)]
struct Point {
    /// After the start, in s.
    time: f64,
    /// By the trajectory's order of joints.
    states: Vec<JointSample>,
    has_velocities: bool,
    has_accelerations: bool,
}

/// What a controller allows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Allowed {
    /// Trajectories of some of the joints; the others hold their positions.
    pub partial: bool,
    /// Trajectories that do not end at rest.
    pub moving_end: bool,
}

impl Trajectory {
    /// Checks a trajectory for a controller of these joints.
    ///
    /// # Errors
    /// See [`TrajectoryError`].
    pub fn new(
        message: &JointTrajectory,
        joints: &[String],
        allowed: Allowed,
    ) -> Result<Self, TrajectoryError> {
        let names = &message.joint_names;
        let mut moved = Vec::with_capacity(names.len().min(joints.len()));
        for joint in names {
            let Some(index) = joints.iter().position(|known| known == joint) else {
                return Err(TrajectoryError::UnknownJoint { joint: joint.clone(), known: joints.join(", ") });
            };
            if moved.contains(&index) {
                return Err(TrajectoryError::JointTwice { joint: joint.clone() });
            }
            moved.push(index);
        }
        if !allowed.partial
            && let Some(joint) = joints.iter().find(|joint| !names.contains(joint))
        {
            return Err(TrajectoryError::MissingJoint { joint: joint.clone() });
        }
        let points = message.points.iter().enumerate();
        let points =
            points.map(|(number, point)| Point::new(number, point, names)).collect::<Result<Vec<_>, _>>()?;
        let is_late = |pair: &[Point]| pair[1].time <= pair[0].time;
        if let Some(before) = points.windows(2).position(is_late) {
            return Err(TrajectoryError::Order { point: before + 1 });
        }
        let last = points.last().ok_or(TrajectoryError::Empty)?;
        if !allowed.moving_end
            && let Some(joint) =
                last.states.iter().position(|state| state.velocity.abs() > f64::from(f32::EPSILON))
        {
            let velocity = last.states[joint].velocity;
            return Err(TrajectoryError::EndsInMotion { joint: names[joint].clone(), velocity });
        }
        Ok(Self { moved, points })
    }

    /// How long it takes from its start to its last point.
    #[must_use]
    pub fn duration(&self) -> Duration {
        let seconds = self.points.last().map_or(0.0, |last| last.time);
        Duration::try_from_secs_f64(seconds).unwrap_or(Duration::ZERO)
    }

    /// The place in the trajectory of a joint of the controller; `None` if it does not move that.
    pub(super) fn place_of(&self, joint: usize) -> Option<usize> {
        self.moved.iter().position(|moved| *moved == joint)
    }

    /// When its first point is, in s after the start.
    pub(super) fn first_time(&self) -> f64 {
        self.points.first().map_or(0.0, |first| first.time)
    }

    /// The state of the trajectory's nth joint at `time`, in s after the start, if it is in the state `from`
    /// at `from_time`. Stays there before that.
    pub(super) fn state(&self, nth: usize, from: JointSample, from_time: f64, time: f64) -> JointSample {
        match self.points.iter().position(|point| time < point.time) {
            Some(0) if time < from_time => from,
            // The state in which it begins has all derivatives.
            Some(0) => self.points[0].between(from_time, from, (true, true), nth, time),
            Some(next) => {
                let before = &self.points[next - 1];
                let has = (before.has_velocities, before.has_accelerations);
                self.points[next].between(before.time, before.states[nth], has, nth, time)
            }
            None => self.points.last().map_or(from, |last| JointSample {
                position: last.states[nth].position,
                ..JointSample::default()
            }),
        }
    }

    /// Whether joints move on a line at this time after the start.
    pub(super) fn is_line(&self, time: f64) -> bool {
        let Some(next) = self.points.iter().position(|point| time < point.time) else {
            return false;
        };
        let has_first = next == 0 || self.points[next - 1].has_velocities;
        !(has_first && self.points[next].has_velocities)
    }

    /// The smallest and the largest position of the trajectory's nth joint on the way to the first point,
    /// from the state `from` at `from_time`.
    pub(super) fn range_of_first(&self, nth: usize, from: JointSample, from_time: f64) -> [f64; 2] {
        let Some(first) = self.points.first() else { return [from.position; 2] };
        let ends = [from.position, first.states[nth].position];
        let mut range = [ends[0].min(ends[1]), ends[0].max(ends[1])];
        let span = first.time - from_time;
        if let (Some(coefficients), true) = (first.spline_from(from, (true, true), nth, span), span > 0.0) {
            for t in turning_points(&coefficients, span) {
                let position = evaluate(&coefficients, t).position;
                range = [range[0].min(position), range[1].max(position)];
            }
        }
        range
    }
}

impl Point {
    fn new(number: usize, point: &JointTrajectoryPoint, names: &[String]) -> Result<Self, TrajectoryError> {
        let JointTrajectoryPoint { positions, velocities, accelerations, time_from_start, .. } = point;
        if positions.is_empty() && !names.is_empty() {
            return Err(TrajectoryError::NoPositions { point: number });
        }
        let (point, joints) = (number, names.len());
        for (what, found, is_optional) in [
            ("positions", positions.len(), false),
            ("velocities", velocities.len(), true),
            ("accelerations", accelerations.len(), true),
        ] {
            if found != joints && !(is_optional && found == 0) {
                return Err(TrajectoryError::Size { point, what, found, joints });
            }
        }
        let value = |values: &[f64], joint: usize| values.get(joint).copied().unwrap_or(0.0);
        let states = (0..joints).map(|joint| JointSample {
            position: positions[joint],
            velocity: value(velocities, joint),
            acceleration: value(accelerations, joint),
        });
        let states: Vec<_> = states.collect();
        let is_finite =
            |state: &JointSample| (state.position + state.velocity + state.acceleration).is_finite();
        if let Some(joint) = states.iter().position(|state| !is_finite(state)) {
            return Err(TrajectoryError::NotFinite { point, joint: names[joint].clone() });
        }
        let time = time_from_start.as_nanos() as f64 * 1e-9;
        if time < 0.0 {
            return Err(TrajectoryError::Order { point });
        }
        let has_velocities = !velocities.is_empty();
        let has_accelerations = has_velocities && !accelerations.is_empty();
        Ok(Self { time, states, has_velocities, has_accelerations })
    }

    /// The state of the trajectory's nth joint at `time`, on the way from the state `from` at `from_time` to
    /// this point.
    fn between(
        &self,
        from_time: f64,
        from: JointSample,
        from_has: (bool, bool),
        nth: usize,
        time: f64,
    ) -> JointSample {
        let to = self.states[nth];
        let (span, t) = (self.time - from_time, (time - from_time).max(0.0));
        if span <= 0.0 {
            return to;
        }
        match self.spline_from(from, from_has, nth, span) {
            Some(coefficients) => evaluate(&coefficients, t),
            None => {
                let velocity = (to.position - from.position) / span;
                JointSample { position: from.position + velocity * t, velocity, acceleration: 0.0 }
            }
        }
    }

    /// The polynomial from a state that has velocities and accelerations, or not, to this point; `None` for a
    /// line.
    fn spline_from(
        &self,
        from: JointSample,
        (from_has_velocities, from_has_accelerations): (bool, bool),
        nth: usize,
        span: f64,
    ) -> Option<Coefficients> {
        let to = self.states[nth];
        if !(from_has_velocities && self.has_velocities) {
            None
        } else if from_has_accelerations && self.has_accelerations {
            Some(quintic(from, to, span))
        } else {
            Some(cubic(from, to, span))
        }
    }
}

/// The coefficients of t^0 to t^5.
type Coefficients = [f64; 6];

fn cubic(from: JointSample, to: JointSample, span: f64) -> Coefficients {
    let distance = to.position - from.position;
    let square = (3.0 * distance - (2.0 * from.velocity + to.velocity) * span) / (span * span);
    let cube = (-2.0 * distance + (from.velocity + to.velocity) * span) / (span * span * span);
    [from.position, from.velocity, square, cube, 0.0, 0.0]
}

fn quintic(from: JointSample, to: JointSample, span: f64) -> Coefficients {
    let (span2, span3) = (span * span, span * span * span);
    // What the polynomial of the second degree that meets the state `from` leaves to be made up at the end.
    let position = to.position - from.position - from.velocity * span - 0.5 * from.acceleration * span2;
    let velocity = (to.velocity - from.velocity - from.acceleration * span) * span;
    let acceleration = (to.acceleration - from.acceleration) * span2;
    [
        from.position,
        from.velocity,
        0.5 * from.acceleration,
        (10.0 * position - 4.0 * velocity + 0.5 * acceleration) / span3,
        (-15.0 * position + 7.0 * velocity - acceleration) / (span3 * span),
        (6.0 * position - 3.0 * velocity + 0.5 * acceleration) / (span3 * span2),
    ]
}

fn evaluate(coefficients: &Coefficients, t: f64) -> JointSample {
    let mut sample = JointSample::default();
    for &coefficient in coefficients.iter().rev() {
        sample.acceleration = sample.acceleration * t + 2.0 * sample.velocity;
        sample.velocity = sample.velocity * t + sample.position;
        sample.position = sample.position * t + coefficient;
    }
    sample
}

/// Where the position on a polynomial turns, from 0 to `span`.
fn turning_points(coefficients: &Coefficients, span: f64) -> Vec<f64> {
    let mut roots = Vec::new();
    // Between two roots of its derivative a polynomial has at most one root: from the highest derivative,
    // which is constant, down to the velocity.
    for order in (1..coefficients.len()).rev() {
        let value = |t: f64| {
            let falling = |power: usize| (0..order).map(|less| (power - less) as f64).product::<f64>();
            let terms = (order..coefficients.len()).rev();
            terms.fold(0.0, |sum, power| sum * t + falling(power) * coefficients[power])
        };
        let ends: Vec<f64> = [0.0].into_iter().chain(roots).chain([span]).collect();
        roots = ends.windows(2).filter_map(|pair| root_between(value, pair[0], pair[1])).collect();
    }
    roots
}

/// The root of a function that rises or falls all the way, by bisection.
fn root_between(value: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> Option<f64> {
    let is_negative = value(low) < 0.0;
    if is_negative == (value(high) < 0.0) {
        return None;
    }
    // As many halves as a number has bits.
    for _ in 0..53 {
        let middle = 0.5 * (low + high);
        if (value(middle) < 0.0) == is_negative { low = middle } else { high = middle }
    }
    Some(0.5 * (low + high))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_msgs::builtin_interfaces::msg::Duration as DurationMessage;

    fn joints(names: &[&str]) -> Vec<String> {
        names.iter().map(ToString::to_string).collect()
    }

    fn point(
        seconds: f64,
        positions: &[f64],
        velocities: &[f64],
        accelerations: &[f64],
    ) -> JointTrajectoryPoint {
        JointTrajectoryPoint {
            positions: positions.into(),
            velocities: velocities.into(),
            accelerations: accelerations.into(),
            time_from_start: DurationMessage::from_nanos((seconds * 1e9) as i64),
            ..JointTrajectoryPoint::default()
        }
    }

    fn trajectory(names: &[&str], points: Vec<JointTrajectoryPoint>) -> JointTrajectory {
        JointTrajectory { joint_names: joints(names), points, ..JointTrajectory::default() }
    }

    fn sample(trajectory: &Trajectory, begin: &[JointSample], seconds: f64) -> Vec<JointSample> {
        let state = |joint: usize| {
            let nth = trajectory.place_of(joint).unwrap();
            trajectory.state(nth, begin[joint], 0.0, seconds)
        };
        (0..begin.len()).map(state).collect()
    }

    #[test]
    fn a_trajectory_of_positions_is_a_line_from_the_state_in_which_it_begins() {
        let message = trajectory(&["a"], vec![point(1.0, &[1.0], &[], &[]), point(2.0, &[0.0], &[], &[])]);
        let line = Trajectory::new(&message, &joints(&["a"]), Allowed::default()).unwrap();
        let begin = [JointSample { position: 0.5, ..JointSample::default() }];
        assert_eq!(sample(&line, &begin, 0.0)[0].position, 0.5);
        assert_eq!(
            sample(&line, &begin, 0.5)[0],
            JointSample { position: 0.75, velocity: 0.5, acceleration: 0.0 }
        );
        assert_eq!(sample(&line, &begin, 1.25)[0].velocity, -1.0);
        assert_eq!(sample(&line, &begin, 9.0)[0], JointSample::default());
    }

    #[test]
    fn each_kind_of_spline_meets_all_that_its_points_have() {
        let ends = [
            JointSample { position: -0.3, velocity: 0.7, acceleration: -2.0 },
            JointSample { position: 1.1, velocity: -0.4, acceleration: 3.0 },
        ];
        for (coefficients, has_accelerations) in
            [(cubic(ends[0], ends[1], 0.8), false), (quintic(ends[0], ends[1], 0.8), true)]
        {
            for (end, t) in ends.into_iter().zip([0.0, 0.8]) {
                let found = evaluate(&coefficients, t);
                assert!((found.position - end.position).abs() < 1e-12, "{found:?}");
                assert!((found.velocity - end.velocity).abs() < 1e-12, "{found:?}");
                let error = (found.acceleration - end.acceleration).abs();
                assert!(!has_accelerations || error < 1e-11, "{found:?}");
            }
        }
    }

    #[test]
    fn joints_may_come_in_another_order_and_be_left_out() {
        let message = trajectory(&["c", "a"], vec![point(1.0, &[3.0, 1.0], &[], &[])]);
        let known = joints(&["a", "b", "c"]);
        let refused = Trajectory::new(&message, &known, Allowed::default());
        assert_eq!(refused, Err(TrajectoryError::MissingJoint { joint: "b".into() }));
        let partial = Allowed { partial: true, ..Allowed::default() };
        let accepted = Trajectory::new(&message, &known, partial).unwrap();
        let places = [0, 1, 2].map(|joint| accepted.place_of(joint));
        assert_eq!(places, [Some(1), None, Some(0)]);
        let end = |nth| accepted.state(nth, JointSample::default(), 0.0, 1.0).position;
        assert_eq!([end(0), end(1)], [3.0, 1.0]);
    }

    #[test]
    fn the_range_of_a_spline_is_where_it_turns() {
        // x = t (1 - t)^2 turns at 1/3, and reaches 4/27.
        let message = trajectory(&["a"], vec![point(1.0, &[0.0], &[0.0], &[])]);
        let cubic = Trajectory::new(&message, &joints(&["a"]), Allowed::default()).unwrap();
        let begin = JointSample { velocity: 1.0, ..JointSample::default() };
        let [low, high] = cubic.range_of_first(0, begin, 0.0);
        assert!(low == 0.0 && (high - 4.0 / 27.0).abs() < 1e-12, "{low} {high}");
        let mut random = fuzzing::Random::new(3);
        for _ in 0..200 {
            let mut number = || (random.bits() >> 11) as f64 / (1_u64 << 51) as f64 - 2.0;
            let message = trajectory(&["a"], vec![point(1.5, &[number()], &[number()], &[number()])]);
            let allowed = Allowed { moving_end: true, ..Allowed::default() };
            let quintic = Trajectory::new(&message, &joints(&["a"]), allowed).unwrap();
            let begin = JointSample { position: number(), velocity: number(), acceleration: 9.0 * number() };
            let found = quintic.range_of_first(0, begin, 0.0);
            let seen: Vec<f64> = (0..1500)
                .map(|step| quintic.state(0, begin, 0.0, f64::from(step) / 1000.0).position)
                .chain([quintic.points[0].states[0].position])
                .collect();
            let [low, high] = [
                seen.iter().copied().fold(f64::MAX, f64::min),
                seen.iter().copied().fold(f64::MIN, f64::max),
            ];
            assert!(found[0] <= low && found[1] >= high, "{found:?} {low} {high}");
            assert!(found[0] > low - 1e-4 && found[1] < high + 1e-4, "{found:?} {low} {high}");
        }
    }

    #[test]
    fn what_cannot_be_followed_is_refused_with_its_point_and_joint() {
        let refused = |names: &[&str], points| {
            let refused =
                Trajectory::new(&trajectory(names, points), &joints(&["a", "b"]), Allowed::default());
            refused.unwrap_err().to_string()
        };
        let at = |seconds| point(seconds, &[0.0, 0.0], &[], &[]);
        for (error, part) in [
            (refused(&["a", "b"], vec![]), "no points"),
            (refused(&["a", "x"], vec![at(1.0)]), "\"x\", which is none of the controller's: a, b"),
            (refused(&["a", "a"], vec![at(1.0)]), "\"a\" twice"),
            (refused(&["a", "b"], vec![at(1.0), at(1.0)]), "point 1 of the trajectory is not after"),
            (refused(&["a", "b"], vec![at(-1.0)]), "point 0 of the trajectory is not after"),
            (refused(&["a", "b"], vec![point(1.0, &[0.0], &[], &[])]), "has 1 positions for 2 joints"),
            (refused(&["a", "b"], vec![point(1.0, &[], &[1.0, 1.0], &[])]), "has no positions"),
            (
                refused(&["a", "b"], vec![point(1.0, &[0.0, 0.0], &[1.0], &[])]),
                "has 1 velocities for 2 joints",
            ),
            (
                refused(&["a", "b"], vec![point(1.0, &[0.0, f64::NAN], &[], &[])]),
                "not finite for the joint \"b\"",
            ),
            (
                refused(&["a", "b"], vec![point(1.0, &[0.0; 2], &[0.0, 0.5], &[])]),
                "velocity of 0.5 for the joint \"b\"",
            ),
        ] {
            assert!(error.contains(part), "{error}");
        }
    }
}
