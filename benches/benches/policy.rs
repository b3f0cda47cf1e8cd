//! One run of a policy's network, a perceptron with 48 inputs, three layers of 256 and 12 outputs; beside it
//! the products of its matrices alone, by nalgebra.
#![allow(missing_docs, clippy::unwrap_used)]

#[allow(dead_code)]
#[path = "../../modules/policy/tests/policy/onnx.rs"]
mod onnx;

use criterion::{Criterion, criterion_group, criterion_main};
use downbeat_policy::Network;
use nalgebra::{DMatrix, DVector};
use std::hint::black_box;

const SIZES: [usize; 5] = [48, 256, 256, 256, 12];

fn policy(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("a perceptron of 3 x 256");
    let observation = [0.3; SIZES[0]];
    for activation in ["Relu", "Elu", "Tanh"] {
        let mut state = 1_u32;
        let number = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32 * 0.2 - 0.1
        };
        let mut network =
            Network::parse(&onnx::perceptron(&SIZES, activation, number), "perceptron").unwrap();
        group.bench_function(activation, |bencher| {
            bencher.iter(|| network.run(&[black_box(&observation)]).unwrap());
        });
    }
    let matrices: Vec<DMatrix<f32>> =
        SIZES.windows(2).map(|pair| DMatrix::from_element(pair[1], pair[0], 0.1)).collect();
    group.bench_function("its products by nalgebra", |bencher| {
        bencher.iter(|| {
            let mut row = DVector::from_column_slice(black_box(&observation));
            for matrix in &matrices {
                row = matrix * row;
            }
            row
        });
    });
}

criterion_group!(benches, policy);
criterion_main!(benches);
