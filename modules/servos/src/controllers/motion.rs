//! How joints come onto a trajectory from the state in which it finds them.
//!
//! The spline to the first point leads on from position, velocity and acceleration of the command so far. Two
//! cases need more than that:
//!
//! - **Swing.** A joint at velocity v that has the time T to come to rest at the same place leaves it, on the
//!   cubic, by 4/27 v T: 1.5 m at 1 m/s and 10 s. To stop it takes only v²/2a with a deceleration a.
//! - **Late.** A trajectory whose stamp is past, or whose first point is at its start, would be joined in the
//!   middle of a segment: the command would jump there.
//!
//! There the joint brakes and blends onto the trajectory. With the state p, v of the command when it meets
//! the trajectory, and the trajectory R that starts at rest where the brakes end:
//!
//! (1)  B(t) = p + v t - sgn(v) a t² / 2 up to the time |v| / a, then at rest at p + v |v| / 2a
//!
//! (2)  x(t) = (1 - w) B(t) + w R(t),  w = 3 s² - 2 s³,  s = (t - b) / D
//!
//! from b on, which is when it meets the trajectory, or when the trajectory starts if that is later. A
//! weighted mean leaves the range of neither B nor R: a joint stays between its position and those of the
//! points, except for the way that it takes to brake, and for what the velocities of the points demand. D is
//! the time in which the distance d = |R(b) - B(b)| is covered from rest to rest with accelerations up to a,
//! or in which the velocity changes by the difference u = |R'(b) - B'(b)|:
//!
//! (3)  D = max(√(6 d / a), u / a)
//!
//! The spline leads on alone if it does not leave that range, and the trajectory is not later than by half of
//! its first segment: then velocities are at most twice those that were sent.
//!
//! # References
//! For (1) `joint_trajectory_controller/doc/decelerate_on_cancel.rst` of `ros-controls/ros2_controllers`,
//! branch jazzy, which stops joints this way. 4/27 is the largest value of s (1 - s)², the basis function of
//! the first velocity in the cubic Hermite spline, and 6 in (3) the largest second derivative of w.

use std::time::Duration;

use super::spline::{JointSample, Trajectory};

/// A trajectory as it is followed from a state.
#[derive(Clone, Debug)]
pub struct Motion {
    trajectory: Trajectory,
    /// When it is joined, in s after its start; negative before that.
    joined_at: f64,
    /// By joint of the controller.
    onsets: Vec<Onset>,
}

/// How one joint comes onto the trajectory.
#[derive(Clone, Copy, Debug)]
enum Onset {
    /// On the spline from this state, at this time after the start.
    Spline { from: JointSample, at: f64 },
    /// By braking, and blending onto the trajectory in this time.
    Blend { brakes: Brakes, time: f64 },
    /// The trajectory does not move it.
    Stop { brakes: Brakes },
}

/// A joint that brakes; equation (1).
#[derive(Clone, Copy, Debug)]
struct Brakes {
    from: JointSample,
    deceleration: f64,
}

impl Motion {
    /// A trajectory that finds the joints in the states `begin`, of which there is one per joint of the
    /// controller, at the time `joined_at` in s after its start, which is negative before that. Joints brake
    /// with `deceleration`, in rad/s² or m/s².
    #[must_use]
    pub fn new(trajectory: Trajectory, begin: &[JointSample], joined_at: f64, deceleration: f64) -> Self {
        let onsets = begin.iter().enumerate().map(|(joint, from)| {
            let brakes = Brakes { from: *from, deceleration };
            match trajectory.place_of(joint) {
                Some(nth) => onset(&trajectory, nth, brakes, joined_at),
                None => Onset::Stop { brakes },
            }
        });
        Self { onsets: onsets.collect(), trajectory, joined_at }
    }

    /// How long it takes from the start of the trajectory until all joints are where its last point is.
    #[must_use]
    pub fn duration(&self) -> Duration {
        let ends = self.onsets.iter().map(|onset| match onset {
            Onset::Spline { .. } => 0.0,
            Onset::Blend { time, .. } => self.joined_at.max(0.0) + time,
            Onset::Stop { brakes } => self.joined_at + brakes.time(),
        });
        let longest = Duration::try_from_secs_f64(ends.fold(0.0, f64::max)).unwrap_or(Duration::ZERO);
        self.trajectory.duration().max(longest)
    }

    /// The states of the controller's joints at this time after the start of the trajectory, which is not
    /// before it was joined. Writes into `sample`, which has one entry per joint of the controller.
    pub fn sample(&self, time: f64, sample: &mut [JointSample]) {
        for (joint, (onset, state)) in self.onsets.iter().zip(sample).enumerate() {
            let nth = self.trajectory.place_of(joint);
            *state = match (*onset, nth) {
                (Onset::Spline { from, at }, Some(nth)) => self.trajectory.state(nth, from, at, time),
                (Onset::Blend { brakes, time: over }, Some(nth)) => {
                    let towards = self.trajectory.state(nth, brakes.end(), 0.0, time);
                    blend(brakes.at(time - self.joined_at), towards, time - self.joined_at.max(0.0), over)
                }
                (Onset::Stop { brakes } | Onset::Blend { brakes, .. }, _) => brakes.at(time - self.joined_at),
                (Onset::Spline { from, .. }, None) => from,
            };
        }
    }
}

fn onset(trajectory: &Trajectory, nth: usize, brakes: Brakes, joined_at: f64) -> Onset {
    let Brakes { from, deceleration } = brakes;
    let is_at_rest = from.velocity == 0.0 && from.acceleration == 0.0;
    let first = trajectory.first_time();
    let is_in_time = if joined_at < 0.0 { is_at_rest } else { joined_at <= 0.5 * first };
    let at = joined_at.max(0.0);
    if is_in_time && at < first {
        let rest = JointSample { position: from.position, ..JointSample::default() };
        let [low, high] = trajectory.range_of_first(nth, rest, at);
        let [least, most] = trajectory.range_of_first(nth, from, at);
        // Rounding is not a swing.
        let beyond = brakes.distance() + 1e-9;
        if least >= low - beyond && most <= high + beyond {
            return Onset::Spline { from, at };
        }
    }
    let (braked, towards) = (brakes.at(at - joined_at), trajectory.state(nth, brakes.end(), 0.0, at));
    let distance = (towards.position - braked.position).abs();
    // A line has its velocity at once, as between any two points.
    let change = if trajectory.is_line(at) { 0.0 } else { (towards.velocity - braked.velocity).abs() };
    Onset::Blend { brakes, time: (6.0 * distance / deceleration).sqrt().max(change / deceleration) }
}

/// Equation (2) and its derivatives, `since` the blend of the duration `over` began.
fn blend(brakes: JointSample, towards: JointSample, since: f64, over: f64) -> JointSample {
    if since < 0.0 {
        return brakes;
    }
    if since >= over {
        return towards;
    }
    let s = since / over;
    let weight = s * s * (3.0 - 2.0 * s);
    let (rate, bend) = (6.0 * s * (1.0 - s) / over, 6.0 * (1.0 - 2.0 * s) / (over * over));
    let mean = |from: f64, to: f64| from + weight * (to - from);
    let ahead = towards.position - brakes.position;
    JointSample {
        position: mean(brakes.position, towards.position),
        velocity: mean(brakes.velocity, towards.velocity) + rate * ahead,
        acceleration: mean(brakes.acceleration, towards.acceleration)
            + 2.0 * rate * (towards.velocity - brakes.velocity)
            + bend * ahead,
    }
}

impl Brakes {
    fn time(&self) -> f64 {
        self.from.velocity.abs() / self.deceleration
    }

    fn distance(&self) -> f64 {
        0.5 * self.from.velocity.abs() * self.time()
    }

    /// Where it comes to rest.
    fn end(&self) -> JointSample {
        let position = self.from.position + self.distance().copysign(self.from.velocity);
        JointSample { position, ..JointSample::default() }
    }

    fn at(&self, since: f64) -> JointSample {
        if since >= self.time() {
            return self.end();
        }
        let JointSample { position, velocity, .. } = self.from;
        let acceleration = -self.deceleration.copysign(velocity);
        JointSample {
            position: position + velocity * since + 0.5 * acceleration * since * since,
            velocity: velocity + acceleration * since,
            acceleration,
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::super::spline::Allowed;
    use super::*;
    use downbeat_msgs::builtin_interfaces::msg::Duration as DurationMessage;
    use downbeat_msgs::trajectory_msgs::msg::{JointTrajectory, JointTrajectoryPoint};
    use proptest::prelude::*;

    const DECELERATION: f64 = 10.0;
    /// Of the commands, in s.
    const PERIOD: f64 = 0.008;

    /// A point as users send it: its time, and what it has of position, velocity and acceleration.
    type Point = (f64, Vec<f64>);

    fn joints(count: usize) -> Vec<String> {
        (0..count).map(|joint| format!("joint_{joint}")).collect()
    }

    /// A trajectory that moves the first of `known` joints.
    fn trajectory(points: &[Point], known: usize) -> Trajectory {
        let point = |(time, state): &Point| JointTrajectoryPoint {
            positions: vec![state[0]],
            velocities: state.get(1).copied().into_iter().collect(),
            accelerations: state.get(2).copied().into_iter().collect(),
            time_from_start: DurationMessage::from_nanos((time * 1e9).round() as i64),
            ..JointTrajectoryPoint::default()
        };
        let message = JointTrajectory {
            joint_names: joints(1),
            points: points.iter().map(point).collect(),
            ..JointTrajectory::default()
        };
        Trajectory::new(&message, &joints(known), Allowed { partial: true, moving_end: true }).unwrap()
    }

    fn state(position: f64, velocity: f64, acceleration: f64) -> JointSample {
        JointSample { position, velocity, acceleration }
    }

    /// The commands of a joint, one per period, from when the trajectory is joined until it has ended.
    fn commands(points: &[Point], begin: JointSample, joined_at: f64) -> Vec<JointSample> {
        let motion = Motion::new(trajectory(points, 1), &[begin], joined_at, DECELERATION);
        let end = motion.duration().as_secs_f64();
        let count = ((end - joined_at) / PERIOD).ceil() as u32 + 2;
        let at = |period: u32| {
            let mut sample = [JointSample::default()];
            motion.sample(joined_at + f64::from(period) * PERIOD, &mut sample);
            sample[0]
        };
        (0..count).map(at).collect()
    }

    fn most(commands: &[JointSample]) -> f64 {
        commands.iter().map(|state| state.position).fold(f64::MIN, f64::max)
    }

    #[test]
    fn a_joint_in_motion_does_not_swing_on_a_long_segment() {
        for (what, point, begin) in [
            ("cubic", vec![0.0, 0.0], state(0.0, 1.0, 0.0)),
            ("quintic", vec![0.0, 0.0, 0.0], state(0.0, 1.0, 0.0)),
            ("accelerating", vec![0.0, 0.0, 0.0], state(0.0, 1.0, 20.0)),
        ] {
            let commands = commands(&[(10.0, point)], begin, 0.0);
            let most = most(&commands);
            assert!(most <= 0.05 + 1e-9, "{what}: it stops within 0.05 rad at 10 rad/s², not {most}");
            assert_eq!(commands[0].position, 0.0, "{what}");
            assert!((commands[0].velocity - 1.0).abs() < 1e-9, "{what}: {:?}", commands[0]);
            assert_eq!(commands[commands.len() - 1], JointSample::default(), "{what}");
        }
    }

    #[test]
    fn a_spline_that_does_not_swing_is_followed_from_the_velocity_so_far() {
        // The largest T for which 4/27 v T is the way that it takes to stop.
        let commands = commands(&[(0.33, vec![0.0, 0.0])], state(0.0, 1.0, 0.0), 0.0);
        let most = most(&commands);
        assert!((most - 4.0 / 27.0 * 0.33).abs() < 1e-3, "{most}");
    }

    #[test]
    fn a_late_trajectory_is_joined_without_a_jump() {
        // From 0 to 1 within half a second, of which 0.45 s are past.
        let commands =
            commands(&[(0.5, vec![1.0, 0.0]), (2.0, vec![1.2, 0.0])], JointSample::default(), 0.45);
        let fastest = commands.windows(2).map(|pair| pair[1].position - pair[0].position).fold(0.0, f64::max);
        assert!(fastest < 2.5 * PERIOD, "{} rad/s", fastest / PERIOD);
        assert_eq!(commands[commands.len() - 1].position, 1.2);
    }

    #[test]
    fn a_first_point_at_the_start_is_no_jump() {
        // As MoveIt sends it: the first point is the state in which it believes the robot.
        let points: Vec<Point> =
            (0..=10).map(|part| (f64::from(part) * 0.1, vec![f64::from(part) * 0.05, 0.5])).collect();
        for offset in [0.0, 0.009, -0.3] {
            let commands = commands(&points, state(offset, 0.0, 0.0), 0.0);
            assert_eq!(commands[0].position, offset);
            let fastest = commands
                .windows(2)
                .map(|pair| (pair[1].position - pair[0].position).abs())
                .fold(0.0, f64::max);
            assert!(fastest < 2.0 * PERIOD, "from {offset}: {} rad/s", fastest / PERIOD);
            assert_eq!(commands[commands.len() - 1].position, 0.5);
        }
        // One point without a time is as fast as the deceleration allows.
        let commands = commands(&[(0.0, vec![1.0])], JointSample::default(), 0.0);
        let time = commands.len() as f64 * PERIOD;
        assert!((0.7..0.85).contains(&time), "sqrt(6 d / a): {time}");
        assert_eq!(commands[commands.len() - 1].position, 1.0);
    }

    #[test]
    fn a_trajectory_that_begins_later_finds_the_joint_at_rest() {
        let commands = commands(&[(1.0, vec![0.5, 0.0])], state(0.0, 1.0, 0.0), -1.0);
        let waiting = &commands[50..120];
        assert!(waiting.iter().all(|state| (state.position - 0.05).abs() < 1e-9), "{waiting:?}");
        assert_eq!(commands[commands.len() - 1].position, 0.5);
    }

    #[test]
    fn joints_that_are_left_out_brake_and_stay() {
        let begin = [state(0.25, 1.0, 0.0); 2];
        let motion = Motion::new(trajectory(&[(1.0, vec![1.0])], 2), &begin, 0.0, DECELERATION);
        let mut sample = begin;
        motion.sample(0.0, &mut sample);
        assert_eq!(sample[1].position, 0.25);
        motion.sample(1.0, &mut sample);
        assert_eq!(sample.map(|state| state.position), [1.0, 0.3]);
        assert_eq!(sample[1].velocity, 0.0);
    }

    #[test]
    fn a_trajectory_that_is_repeated_with_its_stamp_goes_on_as_it_was() {
        let points = [(0.4, vec![0.3, 0.5]), (2.0, vec![1.0, 0.0])];
        let first = Motion::new(trajectory(&points, 1), &[JointSample::default()], 0.0, DECELERATION);
        let mut now = [JointSample::default()];
        first.sample(0.6, &mut now);
        let again = Motion::new(trajectory(&points, 1), &now, 0.6, DECELERATION);
        for time in [0.6, 0.61, 0.7, 1.5] {
            let mut repeated = now;
            first.sample(time, &mut now);
            again.sample(time, &mut repeated);
            assert!((now[0].position - repeated[0].position).abs() < 1e-9, "{time}: {now:?} {repeated:?}");
        }
    }

    /// Sparse and dense points with all, some or no derivatives, from the start on or later.
    fn points() -> impl Strategy<Value = Vec<Point>> {
        let gap = prop_oneof![Just(0.05), 0.1..0.5, 1.0..12.0];
        let of = |derivatives: usize| {
            (gap.clone(), -1.5..1.5, -1.0..1.0, -2.0..2.0).prop_map(
                move |(gap, position, velocity, acceleration)| {
                    (gap, [position, velocity, acceleration][..derivatives].to_vec())
                },
            )
        };
        let point = prop_oneof![of(1), of(2), of(3)];
        (proptest::collection::vec(point, 1..5), any::<bool>()).prop_map(|(points, is_at_start)| {
            let skipped = if is_at_start { points[0].0 } else { 0.0 };
            let mut time = -skipped;
            let later = |(gap, state)| {
                time += gap;
                (time, state)
            };
            points.into_iter().map(later).collect()
        })
    }

    /// The smallest and the largest of the values that the points and their derivatives demand: splines stay
    /// among their Bézier points.
    fn demanded(points: &[Point], begin: f64) -> [f64; 2] {
        let mut all = vec![begin];
        let mut before: Point = (0.0, vec![begin, 0.0, 0.0]);
        for point in points {
            let span = point.0 - before.0;
            for (state, span) in [(&before.1, span), (&point.1, -span)] {
                let derivative = |which: usize| state.get(which).copied().unwrap_or(0.0);
                all.extend([
                    state[0],
                    state[0] + derivative(1) * span / 3.0,
                    state[0] + derivative(1) * span / 5.0,
                    state[0] + derivative(1) * span * 0.4 + derivative(2) * span * span / 20.0,
                ]);
            }
            before.clone_from(point);
        }
        [all.iter().copied().fold(f64::MAX, f64::min), all.into_iter().fold(f64::MIN, f64::max)]
    }

    /// The largest velocity that the points demand, and that of the blend.
    fn fastest(points: &[Point], begin: JointSample) -> f64 {
        let mut before: Point = (0.0, vec![begin.position, 0.0, 0.0]);
        let mut fastest: f64 = begin.velocity.abs();
        let brakes = Brakes { from: begin, deceleration: DECELERATION };
        let [low, high] = demanded(points, begin.position);
        for point in points {
            let span = point.0 - before.0;
            let value = |point: &Point, which: usize| point.1.get(which).map_or(0.0, |value| value.abs());
            let way = (point.1[0] - before.1[0]).abs() + brakes.distance();
            let ends = [1, 2].map(|which| value(&before, which) + value(point, which));
            if span > 0.0 {
                fastest = fastest.max(1.875 * way / span + ends[0] + ends[1] * span + begin.velocity.abs());
            }
            before.clone_from(point);
        }
        // Twice for a first segment of which half is left, and once more for the weight's own rate.
        let blend = 1.5 * ((high - low + 2.0 * brakes.distance()) * DECELERATION / 6.0).sqrt();
        3.5 * fastest + blend
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 2000, ..ProptestConfig::default() })]

        #[test]
        fn no_command_leaves_the_range_of_the_points_or_jumps(
            points in points(),
            begin in (-1.5..1.5, -3.0..3.0, prop_oneof![Just(0.0), -30.0..30.0]),
            joined_at in prop_oneof![Just(0.0), -2.0..0.0, 0.0..0.5],
            repetitions in 1_usize..4,
        ) {
            let mut begin = state(begin.0, begin.1, begin.2);
            for _ in 0..repetitions {
                let commands = commands(&points, begin, joined_at);
                let stop = Brakes { from: begin, deceleration: DECELERATION }.distance() + 1e-6;
                let [low, high] = demanded(&points, begin.position);
                let largest_step = fastest(&points, begin) * PERIOD + 1e-6;
                let mut before = begin.position;
                for (period, command) in commands.iter().enumerate() {
                    prop_assert!(
                        (low - stop..=high + stop).contains(&command.position),
                        "{command:?} in period {period} is not within {low} to {high} and {stop}"
                    );
                    let step = (command.position - before).abs();
                    prop_assert!(step <= largest_step, "{step} in period {period}, at most {largest_step}");
                    before = command.position;
                }
                let (end, last) = (commands[commands.len() - 1], &points[points.len() - 1].1);
                prop_assert_eq!(end, state(last[0], 0.0, 0.0));
                // The next one comes when half of it is done.
                begin = commands[commands.len() / 2];
            }
        }
    }
}
