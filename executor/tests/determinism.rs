//! The same robot computes the same under every launcher.
#![allow(clippy::unwrap_used, missing_docs)]

use std::sync::{Arc, Mutex};
use std::time::Duration;

use downbeat_executor::*;
use proptest::prelude::*;

/// A module of a random robot: what it hears it mixes into its state and passes on.
#[derive(Clone, Debug)]
struct Node {
    listens: Vec<u8>,
    publishes: Vec<u8>,
    period_ms: u8,
}

#[derive(Clone, Debug, PartialEq)]
struct Event {
    time: Time,
    topic: u8,
    value: u64,
}

struct RandomModule {
    node: Node,
    state: u64,
    outs: Vec<Publication<u64>>,
    /// The time of the last publication, and how many there were: feedback must not grow without bound.
    published: (Time, u32),
    trace: Arc<Mutex<Vec<Event>>>,
}

const TOPICS: [&str; 4] = ["north", "east", "south", "west"];

impl RandomModule {
    /// Publishes on one of its topics, chosen by its state: every order of events leaves its own trace.
    fn absorb(&mut self, value: u64, ctx: &mut Context<'_>) {
        self.state = (self.state ^ value).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(17);
        if self.published.0 != ctx.now() {
            self.published = (ctx.now(), 0);
        }
        if !self.outs.is_empty() && !self.state.is_multiple_of(3) && self.published.1 < 4 {
            self.published.1 += 1;
            let out = self.outs[self.state as usize % self.outs.len()];
            ctx.publish(out, self.state);
        }
    }
}

impl Module for RandomModule {
    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        for &topic in &self.node.publishes {
            self.outs.push(setup.publish(TOPICS[topic as usize])?);
        }
        for &topic in &self.node.listens {
            setup.subscribe(
                TOPICS[topic as usize],
                move |module: &mut Self, value: Received<'_, u64>, ctx: &mut Context<'_>| {
                    let event = Event { time: ctx.now(), topic, value: *value };
                    module.trace.lock().unwrap().push(event);
                    module.absorb(*value, ctx);
                },
            )?;
        }
        let period = Duration::from_millis(u64::from(self.node.period_ms));
        setup.every(period, |module: &mut Self, ctx: &mut Context<'_>| module.absorb(1, ctx))
    }
}

fn traces(nodes: &[Node], launcher: impl Launcher + 'static) -> Vec<Vec<Event>> {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_launcher(launcher).with_clock(clock.clone());
    let mut traces = Vec::new();
    for (number, node) in (0..).zip(nodes) {
        let trace = Arc::<Mutex<Vec<Event>>>::default();
        traces.push(Arc::clone(&trace));
        let module = RandomModule {
            node: node.clone(),
            state: number,
            outs: Vec::new(),
            published: Default::default(),
            trace,
        };
        core.add(&format!("module {number}"), module).unwrap();
    }
    for _ in 0..40 {
        core.cycle().unwrap();
        clock.advance(Duration::from_millis(1));
    }
    core.stop();
    traces.into_iter().map(|trace| trace.lock().unwrap().clone()).collect()
}

fn nodes() -> impl Strategy<Value = Vec<Node>> {
    let topics = || proptest::collection::vec(0..4_u8, 0..3);
    let node = (topics(), topics(), 1..5_u8);
    let node = node.prop_map(|(listens, publishes, period_ms)| Node { listens, publishes, period_ms });
    proptest::collection::vec(node, 1..8)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

    #[test]
    fn random_robots_leave_the_same_trace_under_every_launcher(nodes in nodes()) {
        let expected = traces(&nodes, Linear);
        for threads in 1..=4 {
            let pool = Pool::new(threads).unwrap();
            prop_assert_eq!(&traces(&nodes, pool), &expected, "under Pool({})", threads);
        }
        prop_assert_eq!(&traces(&nodes, Threads::new()), &expected, "under Threads");
    }
}
