//! Deliveries per second against the number of modules, of topics and of threads, and the size of messages.
#![allow(missing_docs, clippy::unwrap_used)]

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use downbeat_executor::{
    Context, Core, ManualClock, Module, Pool, Publication, Received, Setup, SetupError, Time,
};

const PERIOD: Duration = Duration::from_millis(1);

/// A message of N bytes.
#[derive(Clone, Copy)]
struct Bytes<const N: usize>([u8; N]);

struct Source<const N: usize> {
    topic: String,
    batch: u8,
    out: Option<Publication<Bytes<N>>>,
}

impl<const N: usize> Module for Source<N> {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        self.out = Some(setup.publish(&self.topic)?);
        setup.every(PERIOD, |source: &mut Self, ctx: &mut Context<'_>| {
            for number in 0..source.batch {
                ctx.publish(source.out.unwrap(), Bytes([number; N]));
            }
        })
    }
}

struct Sink<const N: usize> {
    topic: String,
    sum: u64,
}

impl<const N: usize> Module for Sink<N> {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let topic = self.topic.clone();
        setup.subscribe(&topic, |sink: &mut Self, bytes: Received<'_, Bytes<N>>, _: &mut Context<'_>| {
            sink.sum = black_box(sink.sum + u64::from(bytes.0[0]));
        })
    }
}

/// The work of a cycle.
#[derive(Clone, Copy)]
struct Shape {
    topics: u64,
    subscribers_per_topic: u64,
    batch: u8,
}

/// Measures a steady cycle: one batch is published on each topic, and the previous batch is received.
fn measure<const N: usize>(criterion: &mut Criterion, core: Core, id: BenchmarkId, shape: Shape) {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = core.with_clock(clock.clone());
    for topic in 0..shape.topics {
        let name = format!("topic_{topic}");
        core.add(
            &format!("source {topic}"),
            Source::<N> { topic: name.clone(), batch: shape.batch, out: None },
        )
        .unwrap();
        for number in 0..shape.subscribers_per_topic {
            core.add(&format!("sink {topic} {number}"), Sink::<N> { topic: name.clone(), sum: 0 }).unwrap();
        }
    }
    let mut cycle = || {
        clock.advance(PERIOD);
        core.cycle().unwrap();
    };
    (0..10).for_each(|_| cycle());
    let mut group = criterion.benchmark_group("scaling");
    group.throughput(Throughput::Elements(
        shape.topics * shape.subscribers_per_topic * u64::from(shape.batch),
    ));
    group.bench_function(id, |bencher| bencher.iter(&mut cycle));
    group.finish();
}

fn modules(criterion: &mut Criterion) {
    for subscribers_per_topic in [1, 10, 100, 1000, 10_000] {
        let shape = Shape { topics: 1, subscribers_per_topic, batch: 100 };
        measure::<32>(criterion, Core::new(), BenchmarkId::new("modules", subscribers_per_topic), shape);
    }
}

/// One publisher and one subscriber for each topic.
fn topics(criterion: &mut Criterion) {
    for topics in [1, 10, 100, 1000] {
        let shape = Shape { topics, subscribers_per_topic: 1, batch: 1 };
        measure::<32>(criterion, Core::new(), BenchmarkId::new("topics", topics), shape);
    }
}

fn message_size(criterion: &mut Criterion) {
    fn size<const N: usize>(criterion: &mut Criterion) {
        let shape = Shape { topics: 1, subscribers_per_topic: 10, batch: 100 };
        measure::<N>(criterion, Core::new(), BenchmarkId::new("message_bytes", N), shape);
    }
    size::<8>(criterion);
    size::<64>(criterion);
    size::<512>(criterion);
    size::<4096>(criterion);
}

fn threads(criterion: &mut Criterion) {
    let available = std::thread::available_parallelism().map_or(1, usize::from);
    for threads in 1..=available {
        let shape = Shape { topics: 1, subscribers_per_topic: 1000, batch: 100 };
        let core = Core::new().with_launcher(Pool::new(threads).unwrap());
        measure::<32>(criterion, core, BenchmarkId::new("threads", threads), shape);
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().warm_up_time(Duration::from_millis(300)).measurement_time(Duration::from_secs(1));
    targets = modules, topics, message_size, threads
}
criterion_main!(benches);
