//! The splines of trajectories compared with those of scipy.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_msgs::builtin_interfaces::msg::Duration as DurationMessage;
use downbeat_msgs::trajectory_msgs::msg::{JointTrajectory, JointTrajectoryPoint};
use downbeat_servos::controllers::motion::Motion;
use downbeat_servos::controllers::spline::{Allowed, JointSample, Trajectory};
use fuzzing::Random;
use python_peer::{Python, printed, with_file};
use serde_json::{Value, json};
use std::fs::File;
use std::time::Duration;

/// From -2 to 2.
fn number(random: &mut Random) -> f64 {
    (random.bits() >> 11) as f64 / (1_u64 << 51) as f64 - 2.0
}

/// The samples of scipy; `None` without Python.
fn scipy(asked: &Value) -> Option<Vec<Vec<[f64; 3]>>> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/controllers/scipy_splines.py");
    let answer = with_file(&asked.to_string(), |file| {
        let input = File::open(file).unwrap();
        Some(printed(Python::find()?.command(script).stdin(input)))
    })?;
    Some(serde_json::from_str(&answer).unwrap())
}

#[test]
fn every_sample_agrees_with_scipy() {
    let mut random = Random::new(7);
    let (mut trajectories, mut asked) = (Vec::new(), Vec::new());
    for case in 0..90 {
        // Of what each point has: positions, velocities, accelerations.
        let derivatives = 1 + case % 3;
        let begin = JointSample { position: number(&mut random), ..JointSample::default() };
        let mut points = vec![(0.0, [begin.position, 0.0, 0.0])];
        for _ in 0..4 {
            let time = points.last().unwrap().0 + 0.1 + (2.0 + number(&mut random)) / 2.0;
            // To nanoseconds, as in messages.
            let time = (time * 1e9_f64).round() * 1e-9;
            points.push((time, std::array::from_fn(|_| number(&mut random))));
        }
        let message_point = |&(time, state): &(f64, [f64; 3])| JointTrajectoryPoint {
            positions: vec![state[0]],
            velocities: state[1..2.min(derivatives).max(1)].into(),
            accelerations: if derivatives > 2 { vec![state[2]] } else { Vec::new() },
            time_from_start: DurationMessage::from_nanos((time * 1e9).round() as i64),
            ..JointTrajectoryPoint::default()
        };
        let message = JointTrajectory {
            joint_names: vec!["joint".into()],
            points: points[1..].iter().map(message_point).collect(),
            ..JointTrajectory::default()
        };
        let allowed = Allowed { moving_end: true, ..Allowed::default() };
        let trajectory = Trajectory::new(&message, &["joint".to_owned()], allowed).unwrap();
        let end = points.last().unwrap().0;
        let at: Vec<f64> = (0..200).map(|part| end * f64::from(part) / 200.0).collect();
        let point = |(time, state): &(f64, [f64; 3])| json!({"time": time, "state": state[..derivatives]});
        asked.push(json!({"points": points.iter().map(point).collect::<Vec<_>>(), "at": at}));
        // The joint begins at rest, so no spline swings.
        trajectories.push((Motion::new(trajectory, &[begin], 0.0, 10.0), at));
    }
    let Some(answers) = scipy(&json!(asked)) else { return };
    let mut worst = 0.0_f64;
    for ((motion, at), theirs) in trajectories.iter().zip(answers) {
        for (&seconds, theirs) in at.iter().zip(theirs) {
            let mut sample = [JointSample::default()];
            // A sample lies within the segment of its time, also where that is rounded to nanoseconds.
            motion.sample(Duration::from_secs_f64(seconds).as_secs_f64(), &mut sample);
            let ours = [sample[0].position, sample[0].velocity, sample[0].acceleration];
            for (ours, theirs) in ours.into_iter().zip(theirs) {
                worst = worst.max((ours - theirs).abs() / (1.0 + theirs.abs()));
            }
        }
    }
    // Times are rounded to nanoseconds, which at these accelerations is less than this.
    assert!(worst < 1e-5, "{worst}");
}
