//! One update of the filter: a step of odometry and what a picture shows. The goal is 2 ms.
#![allow(missing_docs)]

#[path = "../tests/walk/mod.rs"]
mod walk;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use downbeat_localisation::Filter;
use walk::Walk;

fn update(c: &mut Criterion) {
    let mut walk = Walk::new(1);
    let mut filter = Filter::new(&walk.field, &[walk.truth], (0.3, 0.2), 1);
    c.bench_function("update", |bencher| {
        bencher.iter_batched(
            || (walk.step(), walk.see()),
            |(step, seen)| {
                filter.walk(step);
                filter.see(&seen)
            },
            BatchSize::SmallInput,
        );
    });
}

criterion_group!(benches, update);
criterion_main!(benches);
