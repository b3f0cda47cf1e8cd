//! The path of the joints through the frames of a motion.
//!
//! Between two frames, with s from 0 to 1:
//!
//! (1)  smooth:   10 s^3 - 15 s^4 + 6 s^5, as a fraction of the way
//! (2)  through:  the cubic Hermite spline with the tangents of Fritsch and Butland, which does not overshoot
//! (3)  linear:   s
//!
//! # References
//! T. Flash, N. Hogan, "The coordination of arm movements", Journal of Neuroscience 5 (1985), for (1).
//! F. N. Fritsch, J. Butland, "A Method for Constructing Local Monotone Piecewise Cubic Interpolants", SIAM
//! Journal on Scientific and Statistical Computing 5 (1984), for (2).

use super::motion::{Interpolation, Motion};

/// A motion from a start pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    interpolation: Interpolation,
    /// The start and the frames.
    knots: Vec<Knot>,
    moves: Vec<bool>,
}

#[derive(Clone, Debug, PartialEq)]
struct Knot {
    /// When the frame is reached and when it is left, in s from the start.
    reached: f64,
    left: f64,
    positions: Vec<f64>,
    /// Speeds at the frame, in rad/s, for (2).
    speeds: Vec<f64>,
}

/// The number of points at which a speed is measured.
const SAMPLES: u32 = 64;

impl Path {
    /// Lays out a motion from a start pose. The way to the first frame takes longer than written if a joint
    /// would otherwise turn faster than `max_speed` in rad/s; 0 means no limit.
    #[must_use]
    pub fn new(motion: &Motion, start: &[f64], max_speed: f64) -> Self {
        let first = &motion.frames[0];
        let moves = first.positions.iter().map(Option::is_some).collect();
        let at_rest = vec![0.0; start.len()];
        let start_knot = Knot { reached: 0.0, left: 0.0, positions: start.into(), speeds: at_rest.clone() };
        let mut knots = vec![start_knot];
        let mut time = 0.0;
        for (number, frame) in motion.frames.iter().enumerate() {
            let positions: Vec<f64> = frame
                .positions
                .iter()
                .zip(start)
                .map(|(position, start)| position.unwrap_or(*start))
                .collect();
            let mut duration = frame.duration;
            if number == 0 && max_speed > 0.0 {
                let way =
                    start.iter().zip(&positions).map(|(from, to)| (to - from).abs()).fold(0.0, f64::max);
                // The peak of (1).
                duration = duration.max(1.875 * way / max_speed);
            }
            time += duration;
            knots.push(Knot { reached: time, left: time + frame.pause, positions, speeds: at_rest.clone() });
            time += frame.pause;
        }
        for number in 1..knots.len() - 1 {
            let (before, here, after) = (&knots[number - 1], &knots[number], &knots[number + 1]);
            if here.left > here.reached {
                continue;
            }
            let (h0, h1) = (here.reached - before.left, after.reached - here.left);
            let speed = |joint: usize| {
                let d0 = (here.positions[joint] - before.positions[joint]) / h0;
                let d1 = (after.positions[joint] - here.positions[joint]) / h1;
                if d0 * d1 <= 0.0 {
                    return 0.0;
                }
                let weight = (h0 + 2.0 * h1) / (3.0 * (h0 + h1));
                d0 * d1 / (weight * d1 + (1.0 - weight) * d0)
            };
            knots[number].speeds = (0..start.len()).map(speed).collect();
        }
        Self { interpolation: motion.interpolation, knots, moves }
    }

    /// When the last pause ends, in s from the start.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.knots.last().map_or(0.0, |knot| knot.left)
    }

    /// Which joints the motion commands.
    #[must_use]
    pub fn moves(&self) -> &[bool] {
        &self.moves
    }

    /// The pose at a time in s from the start.
    #[must_use]
    pub fn pose(&self, time: f64) -> Vec<f64> {
        let next = self.knots.partition_point(|knot| knot.left <= time).clamp(1, self.knots.len() - 1);
        (0..self.moves.len()).map(|joint| self.position(next, joint, time)).collect()
    }

    fn position(&self, next: usize, joint: usize, time: f64) -> f64 {
        let (from, to) = (&self.knots[next - 1], &self.knots[next]);
        let duration = to.reached - from.left;
        let s = ((time - from.left) / duration).clamp(0.0, 1.0);
        let (start, end) = (from.positions[joint], to.positions[joint]);
        match self.interpolation {
            Interpolation::Smooth => start + (end - start) * s * s * s * (10.0 + s * (-15.0 + s * 6.0)),
            Interpolation::Linear => start + (end - start) * s,
            Interpolation::Through => {
                let (v0, v1) = (from.speeds[joint] * duration, to.speeds[joint] * duration);
                let way = end - start;
                let (a, b) = (v0 + v1 - 2.0 * way, 3.0 * way - 2.0 * v0 - v1);
                start + s * (v0 + s * (b + s * a))
            }
        }
    }

    /// The largest speed of a joint on the way to a frame, counted from 0, in rad/s.
    pub(super) fn peak_speed(&self, frame: usize, joint: usize) -> f64 {
        let (from, to) = (self.knots[frame].left, self.knots[frame + 1].reached);
        let step = (to - from) / f64::from(SAMPLES);
        let at = |sample: u32| self.position(frame + 1, joint, from + step * f64::from(sample));
        (0..SAMPLES).map(|sample| (at(sample + 1) - at(sample)).abs() / step).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::super::file::Motions;
    use super::*;
    use crate::hardware::tables::joints::COUNT;
    use crate::humanoid::Humanoid;
    use proptest::prelude::*;

    fn motion(interpolation: &str) -> std::sync::Arc<Motion> {
        let text = format!(
            "[m]\ninterpolation = \"{interpolation}\"\n\
             [[m.frame]]\nduration_s = 1\nradians = {{ head_pan = 0.2, r_el = 0.5 }}\n\
             [[m.frame]]\nduration_s = 0.5\nradians = {{ head_pan = 0.6, r_el = -0.5 }}\n\
             [[m.frame]]\nduration_s = 1\npause_s = 0.5\nradians = {{ head_pan = 1.0, r_el = 0.5 }}\n"
        );
        Motions::parse("m.toml", &text, Humanoid::darwin_op().joints()).unwrap().get("m").unwrap().clone()
    }

    const PAN: usize = 18;
    const ELBOW: usize = 4;

    #[test]
    fn it_goes_from_the_start_through_all_frames_and_stays_at_the_last() {
        for interpolation in ["smooth", "through", "linear"] {
            let path = Path::new(&motion(interpolation), &[0.1; COUNT], 0.0);
            assert_eq!(path.duration(), 3.0);
            let pan = |time: f64| (path.pose(time)[PAN] * 1e9).round() / 1e9;
            assert_eq!([0.0, 1.0, 1.5, 2.5, 3.0, 99.0].map(pan), [0.1, 0.2, 0.6, 1.0, 1.0, 1.0]);
            assert_eq!(path.pose(1.2)[0], 0.1, "a joint without angles stays");
            assert_eq!((path.moves()[PAN], path.moves()[0]), (true, false));
        }
    }

    #[test]
    fn only_through_passes_frames_with_speed_and_stops_where_a_joint_turns_back() {
        let speed = |interpolation: &str, joint: usize| {
            let path = Path::new(&motion(interpolation), &[0.0; COUNT], 0.0);
            (path.pose(1.001)[joint] - path.pose(0.999)[joint]) / 0.002
        };
        assert!(speed("smooth", PAN).abs() < 1e-3);
        assert!(speed("through", PAN) > 0.2);
        assert!(speed("through", ELBOW).abs() < 0.02);
    }

    #[test]
    fn a_far_start_makes_the_first_frame_slower() {
        let mut start = [0.0; COUNT];
        start[PAN] = -2.0;
        let path = Path::new(&motion("smooth"), &start, 1.0);
        assert!((path.duration() - (2.0 + 1.875 * 2.2)).abs() < 1e-9);
        assert!(path.peak_speed(0, PAN) <= 1.0);
    }

    proptest! {
        #[test]
        fn no_interpolation_overshoots(time in 0.0..3.0_f64, start in -1.0..1.0_f64) {
            for interpolation in ["smooth", "through", "linear"] {
                let pan = Path::new(&motion(interpolation), &[start; COUNT], 0.0).pose(time)[PAN];
                prop_assert!((start.min(0.2) - 1e-12..=1.0 + 1e-12).contains(&pan));
            }
        }
    }
}
