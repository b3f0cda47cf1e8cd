//! The executor, compared with the lower limit and with the usual design; one hop under each launcher.
#![allow(missing_docs, clippy::unwrap_used)]

use std::num::NonZeroU64;
use std::thread::sleep;
use std::time::{Duration, Instant};

use benches::contestants::{Contestant, Downbeat, Limit, LockFree, Queues};
use benches::launchers::{LAUNCHERS, LINEAR};
use benches::{Load, Relay};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};

fn fan_out(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("fan_out");
    for (modules, messages) in [(10, 100), (100, 100), (100, 1000)] {
        let load = Load { modules, messages, batch: NonZeroU64::new(1000).unwrap() };
        group.throughput(Throughput::Elements(load.deliveries()));
        let mut contestants: Vec<(&str, Box<dyn Contestant>)> =
            vec![("limit", Box::new(Limit::new(load))), ("queue", Box::new(Queues::<LockFree>::new(load)))];
        for launcher in LAUNCHERS {
            contestants.push((launcher.name, Box::new(Downbeat::new(load, launcher).unwrap())));
        }
        for (name, mut contestant) in contestants {
            let id = BenchmarkId::new(name, format!("{modules}x{messages}"));
            group.bench_function(id, |bencher| bencher.iter(|| contestant.trial()));
        }
    }
    group.finish();
}

/// One module publishes in a cycle, another receives in the next. `hop` measures this alone: two modules pass
/// a message back and forth, and one of them runs in each cycle.
fn hop(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("hop");
    for launcher in LAUNCHERS {
        let mut relay = Box::new(Relay::new(launcher.launch).unwrap());
        group.bench_function(launcher.name, |bencher| bencher.iter(|| relay.trial()));
        assert!(relay.finish() > 0);
    }
    group.finish();
}

/// A publisher publishes on a timer in one cycle, and a subscriber receives in the next: two cycles. The
/// publisher also runs in the second one, so that a launcher with threads has two modules to distribute.
fn shared_hop(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("shared_hop");
    let load = Load { modules: 1, messages: 1, batch: NonZeroU64::MIN };
    for launcher in LAUNCHERS {
        let mut core = Downbeat::new(load, launcher).unwrap();
        group
            .bench_function(BenchmarkId::new(launcher.name, "busy"), |bencher| bencher.iter(|| core.trial()));
        if launcher.name != LINEAR {
            group.bench_function(BenchmarkId::new(launcher.name, "parked"), |bencher| {
                bencher.iter_custom(|hops| (0..hops).map(|_| hop_after_a_rest(&mut core)).sum());
            });
        }
    }
    group.finish();
}

/// Long enough for the threads of every launcher to park.
const REST: Duration = Duration::from_millis(2);

fn hop_after_a_rest(core: &mut Downbeat) -> Duration {
    sleep(REST);
    let begin = Instant::now();
    core.trial();
    begin.elapsed()
}

fn short() -> Criterion {
    Criterion::default().warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(2))
}

criterion_group! {
    name = benches;
    config = short();
    targets = fan_out, hop, shared_hop
}
criterion_main!(benches);
