//! The orientation filter compared with the package ahrs.
#![allow(clippy::unwrap_used, missing_docs)]

use downbeat_imu_filter::{Gains, OrientationFilter};
use glam::{DQuat, DVec3};
use python_peer::{Python, printed, with_file};
use serde_json::{Value, json};
use std::fs::File;

const DT: f64 = 0.008;
const GAINS: Gains = Gains { proportional: 0.8, integral: 0.05, tolerance: 10.0, max_bias: 10.0 };

/// The results of ahrs; `None` without Python.
fn ahrs(asked: &Value) -> Option<Value> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/imu_filter/mahony.py");
    with_file(&asked.to_string(), |file| {
        let input = File::open(file).unwrap();
        Some(serde_json::from_str(&printed(Python::find()?.command(script).stdin(input))).unwrap())
    })
}

/// Rates and specific forces of an IMU that is turned and shaken for ten seconds, with a bias of the
/// gyroscope.
fn samples() -> Vec<[DVec3; 2]> {
    let mut world_from_imu = DQuat::from_rotation_x(0.4);
    let sample = |number: u32| {
        let t = f64::from(number) * DT;
        let rate = DVec3::new(1.5 * libm::sin(2.1 * t), 1.2 * libm::cos(3.3 * t), 0.7 * libm::sin(0.9 * t));
        world_from_imu = (world_from_imu * DQuat::from_scaled_axis(rate * DT)).normalize();
        let shake = DVec3::new(libm::sin(40.0 * t), libm::cos(31.0 * t), libm::sin(23.0 * t));
        let force = world_from_imu.conjugate() * (DVec3::Z * 9.81 + shake);
        [rate + DVec3::new(0.02, -0.01, 0.03), force]
    };
    (0..1250).map(sample).collect()
}

#[test]
fn every_orientation_agrees_with_ahrs() {
    let samples = samples();
    let mut filter = OrientationFilter::default();
    filter.start(samples[0][1]);
    let first = filter.world_from_imu().unwrap();
    let asked = json!({
        "dt": DT,
        "gain": GAINS.proportional,
        "bias_gain": GAINS.integral,
        "first": [first.w, first.x, first.y, first.z],
        "samples": samples.iter().map(|pair| pair.map(|v| v.to_array())).collect::<Vec<_>>(),
    });
    let Some(answer) = ahrs(&asked) else { return };
    let expected: Vec<[f64; 4]> = serde_json::from_value(answer["orientations"].clone()).unwrap();
    assert_eq!(expected.len(), samples.len());
    let mut largest: f64 = 0.0;
    for ([gyro, force], [w, x, y, z]) in samples.into_iter().zip(expected) {
        filter.update(gyro, force, DT, GAINS);
        let angle = filter.world_from_imu().unwrap().angle_between(DQuat::from_xyzw(x, y, z, w));
        largest = largest.max(angle);
    }
    // ahrs integrates with the first order only, and changes the bias half a step earlier.
    assert!(largest < 2e-3, "{largest} rad");
    let bias: [f64; 3] = serde_json::from_value(answer["bias"].clone()).unwrap();
    assert!((filter.bias - DVec3::from_array(bias)).length() < 1e-3, "{:?} {bias:?}", filter.bias);
}
