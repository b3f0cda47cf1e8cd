//! Kinematics of the Darwin OP: the computations of a control cycle of 8 ms.
#![allow(missing_docs, clippy::unwrap_used)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use downbeat_kinematics::darwin_op;
use downbeat_kinematics::leg::Side;
use downbeat_kinematics::nalgebra::{Matrix3xX, Matrix6xX};
use downbeat_kinematics::{InverseKinematics, Masses, Pose, Robot, Search};

/// The angles of a step, in rad.
const ANGLES: [f64; 6] = [0.1, 0.05, -0.6, 0.9, 0.5, 0.02];

fn leg(criterion: &mut Criterion) {
    let leg = darwin_op::leg(Side::Right);
    let hip_from_sole = leg.forward(&ANGLES);
    let mut group = criterion.benchmark_group("leg");
    group.bench_function("inverse", |bencher| bencher.iter(|| leg.inverse(black_box(&hip_from_sole))));
    group.bench_function("forward", |bencher| bencher.iter(|| leg.forward(black_box(&ANGLES))));
    group.finish();
}

fn robot(criterion: &mut Criterion) {
    let robot = Robot::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/darwin_op.urdf")).unwrap();
    let [base, sole] = ["base_link", "r_sole"].map(|name| robot.link_id(name).unwrap());
    let positions = [0.1; 20];
    let (mut pose, mut masses) = (Pose::new(&robot), Masses::new(&robot).unwrap());
    let mut group = criterion.benchmark_group("robot of 20 joints");
    group.bench_function("forward, all frames", |bencher| {
        bencher.iter(|| pose.update(&robot, black_box(&positions)))
    });
    group
        .bench_function("centre of mass", |bencher| bencher.iter(|| masses.center_of_mass(black_box(&pose))));
    let mut jacobian = Matrix3xX::zeros(20);
    group.bench_function("jacobian of the centre of mass", |bencher| {
        bencher.iter(|| masses.jacobian(&robot, black_box(&pose), &mut jacobian));
    });
    let mut jacobian = Matrix6xX::zeros(20);
    group.bench_function("jacobian of the sole", |bencher| {
        bencher.iter(|| pose.jacobian(&robot, black_box(sole), &mut jacobian));
    });
    // From a pose that differs by the motion of one control cycle.
    let mut chain = InverseKinematics::new(&robot, base, sole).unwrap();
    let target = pose.target_from_source(base, sole);
    let start = [0.11; 20];
    group.bench_function("inverse of a leg, numeric", |bencher| {
        bencher.iter(|| {
            let mut positions = start;
            chain.solve(black_box(&target), &mut positions, &Search::default())
        });
    });
    group.finish();
}

criterion_group!(benches, leg, robot);
criterion_main!(benches);
