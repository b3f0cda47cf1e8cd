//! Kinematics of the Darwin OP: what a control cycle of 8 ms computes.
#![allow(missing_docs, clippy::unwrap_used)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use downbeat_kinematics::darwin_op::{Leg, Side};

/// Angles of a step, in rad.
const ANGLES: [f64; 6] = [0.1, 0.05, -0.6, 0.9, 0.5, 0.02];

fn leg(criterion: &mut Criterion) {
    let leg = Leg::new(Side::Right);
    let hip_from_sole = leg.forward(&ANGLES);
    let mut group = criterion.benchmark_group("leg");
    group.bench_function("inverse", |bencher| bencher.iter(|| leg.inverse(black_box(&hip_from_sole))));
    group.bench_function("forward", |bencher| bencher.iter(|| leg.forward(black_box(&ANGLES))));
    group.finish();
}

criterion_group!(benches, leg);
criterion_main!(benches);
