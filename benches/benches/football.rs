//! A cycle of a football robot under each launcher.
#![allow(missing_docs, clippy::unwrap_used)]

use std::time::Duration;

use benches::Football;
use benches::contestants::Contestant;
use benches::launchers::LAUNCHERS;
use criterion::{Criterion, criterion_group, criterion_main};

fn football(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("football");
    for launcher in LAUNCHERS {
        let mut football = Box::new(Football::new(launcher.launch).unwrap());
        group.bench_function(launcher.name, |bencher| bencher.iter(|| football.trial()));
        assert!(football.finish() > 0);
    }
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default().warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(2));
    targets = football
}
criterion_main!(benches);
