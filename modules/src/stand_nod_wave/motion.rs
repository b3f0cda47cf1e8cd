//! The motion: poses, and the path from one to the next.
//!
//! The path has minimum jerk: with s from 0 to 1 over the time of a step, the fraction of the path is
//!
//! (1)  10 s^3 - 15 s^4 + 6 s^5
//!
//! It starts and ends at rest. It uses only additions and multiplications, so it is the same on every
//! machine.
//!
//! # References
//! T. Flash, N. Hogan, "The coordination of arm movements", Journal of Neuroscience 5 (1985), for (1).

use crate::darwin_op::tables::joints::{COUNT, JOINTS};
use crate::darwin_op::tables::units::radians_from_ticks;
use std::f64::consts::PI;
use std::time::Duration;

/// Angles of all joints in the order of their ids, in rad.
pub(super) type Pose = [f64; COUNT];

/// Servo ids of the moving joints.
const R_SHO_PITCH: usize = 1;
const R_SHO_ROLL: usize = 3;
const R_ELBOW: usize = 5;
const HEAD_TILT: usize = 20;

/// The repeated steps after standing up: duration, and the joints that differ from the stand, in degrees.
const STEPS: [(Duration, &[(usize, f64)]); 12] = [
    // Nod.
    (Duration::from_millis(500), &[(HEAD_TILT, -15.0)]),
    (Duration::from_millis(500), &[(HEAD_TILT, 25.0)]),
    (Duration::from_millis(500), &[(HEAD_TILT, -15.0)]),
    (Duration::from_millis(500), &[]),
    // Raise the right arm, wave, lower it.
    (Duration::from_millis(2000), &[(R_SHO_PITCH, 130.0), (R_ELBOW, -40.0)]),
    (Duration::from_millis(400), &[(R_SHO_PITCH, 130.0), (R_ELBOW, -40.0), (R_SHO_ROLL, 20.0)]),
    (Duration::from_millis(400), &[(R_SHO_PITCH, 130.0), (R_ELBOW, -40.0), (R_SHO_ROLL, -20.0)]),
    (Duration::from_millis(400), &[(R_SHO_PITCH, 130.0), (R_ELBOW, -40.0), (R_SHO_ROLL, 20.0)]),
    (Duration::from_millis(400), &[(R_SHO_PITCH, 130.0), (R_ELBOW, -40.0), (R_SHO_ROLL, -20.0)]),
    (Duration::from_millis(400), &[(R_SHO_PITCH, 130.0), (R_ELBOW, -40.0)]),
    (Duration::from_millis(2000), &[]),
    (Duration::from_millis(1000), &[]),
];

/// The walking-ready stand.
pub(super) fn stand() -> Pose {
    JOINTS.map(|joint| radians_from_ticks(joint.walking_ready_ticks, 0))
}

/// The pose at `elapsed` after the motion started at `start`.
pub(super) fn pose(start: &Pose, standing_up: Duration, elapsed: Duration) -> Pose {
    if elapsed < standing_up {
        return between(start, &stand(), elapsed, standing_up);
    }
    let round: Duration = STEPS.iter().map(|(time, _)| *time).sum();
    let since = (elapsed - standing_up).as_nanos() % round.as_nanos();
    // Less than a round, so it fits.
    let mut left = Duration::from_nanos(since as u64);
    let mut from = stand();
    for (time, changes) in STEPS {
        let to = changed(changes);
        if left < time {
            return between(&from, &to, left, time);
        }
        left -= time;
        from = to;
    }
    from
}

fn changed(changes: &[(usize, f64)]) -> Pose {
    let mut pose = stand();
    for &(id, degrees) in changes {
        pose[id - 1] = degrees * (PI / 180.0);
    }
    pose
}

fn between(from: &Pose, to: &Pose, elapsed: Duration, time: Duration) -> Pose {
    let s = elapsed.as_secs_f64() / time.as_secs_f64();
    let share = s * s * s * (10.0 + s * (-15.0 + s * 6.0));
    std::array::from_fn(|joint| from[joint] + (to[joint] - from[joint]) * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STANDING_UP: Duration = Duration::from_secs(3);
    const CYCLE: Duration = Duration::from_millis(8);

    #[test]
    fn it_starts_at_the_robots_pose_and_reaches_the_stand() {
        let start = [0.3; COUNT];
        assert_eq!(pose(&start, STANDING_UP, Duration::ZERO), start);
        assert_eq!(pose(&start, STANDING_UP, STANDING_UP), stand());
    }

    #[test]
    fn no_joint_exceeds_the_servo_speed_or_its_limits() {
        let start = [0.0; COUNT];
        let mut last = start;
        for cycle in 1..2500 {
            let now = pose(&start, STANDING_UP, CYCLE * cycle);
            for (index, joint) in JOINTS.iter().enumerate() {
                let speed = (now[index] - last[index]).abs() / CYCLE.as_secs_f64();
                assert!(speed < 5.0, "{} goes {speed} rad/s in cycle {cycle}", joint.name);
                assert!((joint.min_rad()..=joint.max_rad()).contains(&now[index]), "{}", joint.name);
            }
            last = now;
        }
    }

    #[test]
    fn it_nods_and_waves_forever_without_moving_the_legs() {
        let at = |seconds: u64| pose(&stand(), STANDING_UP, Duration::from_secs(seconds));
        let round: Duration = STEPS.iter().map(|(time, _)| *time).sum();
        let late = Duration::from_secs(4) + round * 1000;
        assert_eq!(pose(&stand(), STANDING_UP, late), at(4));
        let moved = |id: usize| {
            (0..200).any(|step| {
                let now = pose(&stand(), STANDING_UP, Duration::from_millis(3000 + 50 * step));
                now[id - 1] != stand()[id - 1]
            })
        };
        assert!(moved(HEAD_TILT) && moved(R_SHO_PITCH) && moved(R_SHO_ROLL) && moved(R_ELBOW));
        assert!(!(7..=18).any(moved));
    }
}
