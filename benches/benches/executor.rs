//! The executor beside its limit and beside the usual design.
#![allow(missing_docs, clippy::unwrap_used)]

use std::hint::black_box;
use std::sync::Arc;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use crossbeam::queue::SegQueue;
use downbeat_executor::{Context, Core, ManualClock, Module, Publication, Received, Setup, SetupError, Time};

/// Eight numbers, as a small sensor message has.
#[derive(Clone, Copy)]
struct Message {
    values: [u64; 8],
}

impl Message {
    fn new(number: u64) -> Self {
        Self { values: [number; 8] }
    }
}

/// What every callback does, ours and peers'.
#[derive(Default)]
struct Sum(u64);

impl Sum {
    #[inline]
    fn add(&mut self, message: &Message) {
        self.0 = black_box(self.0.wrapping_add(message.values[0]));
    }
}

const PERIOD: Duration = Duration::from_millis(1);

struct Source {
    batch: u64,
    out: Option<Publication<Message>>,
}

impl Module for Source {
    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        self.out = Some(setup.publish("numbers")?);
        setup.every(PERIOD, |source: &mut Self, ctx: &mut Context<'_>| {
            for number in 0..source.batch {
                ctx.publish(source.out.unwrap(), Message::new(number));
            }
        })
    }
}

struct Sink(Sum);

impl Module for Sink {
    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe("numbers", |sink: &mut Self, message: Received<'_, Message>, _: &mut Context<'_>| {
            sink.0.add(&message);
        })
    }
}

fn core(subscribers: usize, batch: u64) -> (Core, ManualClock) {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_clock(clock.clone());
    core.add("source", Source { batch, out: None }).unwrap();
    for number in 0..subscribers {
        core.add(&format!("sink {number}"), Sink(Sum::default())).unwrap();
    }
    core.cycle().unwrap();
    (core, clock)
}

/// One batch is published and the one before it delivered.
fn cycle(core: &mut Core, clock: &ManualClock) {
    clock.advance(PERIOD);
    core.cycle().unwrap();
}

type Subscriber = Box<dyn FnMut(&[Message])>;

/// The limit: what must be done at least, one indirect call per subscriber and batch.
struct Limit {
    messages: Vec<Message>,
    subscribers: Vec<Subscriber>,
}

impl Limit {
    fn new(subscribers: usize) -> Self {
        let subscriber = || {
            let mut sum = Sum::default();
            Box::new(move |messages: &[Message]| messages.iter().for_each(|message| sum.add(message)))
                as Subscriber
        };
        Self { messages: Vec::new(), subscribers: (0..subscribers).map(|_| subscriber()).collect() }
    }

    fn cycle(&mut self, batch: u64) {
        self.messages.clear();
        self.messages.extend((0..batch).map(Message::new));
        self.subscribers.iter_mut().for_each(|subscriber| subscriber(&self.messages));
    }
}

/// The usual design: each delivery is an entry with a shared pointer in the subscriber's queue.
struct Queues(Vec<(SegQueue<Arc<Message>>, Sum)>);

impl Queues {
    fn new(subscribers: usize) -> Self {
        Self((0..subscribers).map(|_| (SegQueue::new(), Sum::default())).collect())
    }

    fn cycle(&mut self, batch: u64) {
        for number in 0..batch {
            let message = Arc::new(Message::new(number));
            self.0.iter().for_each(|(queue, _)| queue.push(Arc::clone(&message)));
        }
        for (queue, sum) in &mut self.0 {
            while let Some(message) = queue.pop() {
                sum.add(&message);
            }
        }
    }
}

fn fan_out(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("fan_out");
    for (subscribers, batch) in [(10, 100), (100, 100), (100, 1000)] {
        let name = format!("{subscribers}x{batch}");
        group.throughput(Throughput::Elements(subscribers as u64 * batch));
        let (mut core, clock) = core(subscribers, batch);
        group.bench_function(BenchmarkId::new("downbeat", &name), |bencher| {
            bencher.iter(|| cycle(&mut core, &clock));
        });
        let mut limit = Limit::new(subscribers);
        group.bench_function(BenchmarkId::new("limit", &name), |bencher| bencher.iter(|| limit.cycle(batch)));
        let mut queues = Queues::new(subscribers);
        group
            .bench_function(BenchmarkId::new("queue", &name), |bencher| bencher.iter(|| queues.cycle(batch)));
    }
    group.finish();
}

fn hop(criterion: &mut Criterion) {
    let (mut core, clock) = core(1, 1);
    criterion.bench_function("hop", |bencher| bencher.iter(|| cycle(&mut core, &clock)));
}

fn short() -> Criterion {
    Criterion::default().warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(2))
}

criterion_group! {
    name = benches;
    config = short();
    targets = fan_out, hop
}
criterion_main!(benches);
