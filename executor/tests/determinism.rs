//! The same robot computes the same under every launcher, including when its modules manage each other.
#![allow(clippy::unwrap_used, missing_docs)]

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, Once, PoisonError};
use std::time::Duration;

use downbeat_executor::*;
use proptest::prelude::*;

const STEP: Duration = Duration::from_millis(1);
const TOPICS: [&str; 4] = ["north", "east", "south", "west"];
/// Each service is provided by the module of the same index, while that exists.
const SERVICES: [&str; 3] = ["dig", "lift", "carry"];
/// The number of possible module names.
const NAMES: u64 = 10;

/// A module of a random robot: it hashes every event into its state, and its state selects its actions.
#[derive(Clone, Debug)]
struct Node {
    listens: Vec<u8>,
    publishes: Vec<u8>,
    period_ms: u8,
    answers_later: bool,
    backoff_ms: Option<u8>,
    every_cycle: bool,
    /// How many of its 64 actions manage modules.
    meddles: u8,
}

/// An event of a module: its time, its kind and a value.
type Event = (Time, &'static str, u64);
/// By the name of the module, so that concurrent modules write to separate entries.
type Trace = BTreeMap<String, Vec<Event>>;

struct RandomModule {
    node: Node,
    number: u64,
    state: u64,
    /// The time of the last action, and the number of actions at that time, which limits feedback.
    acted: (Time, u32),
    keys: Option<Keys>,
    waiting: Vec<Responder<u64, u64>>,
    trace: Arc<Mutex<Trace>>,
}

#[derive(Clone)]
struct Keys {
    outs: Vec<Publication<u64>>,
    clients: [Client<u64, u64>; 3],
    task: Task,
    job: Job<u64>,
    level: Setting<i64>,
}

fn name(number: u64) -> String {
    format!("module {number}")
}

impl RandomModule {
    fn new(node: &Node, number: u64, trace: &Arc<Mutex<Trace>>) -> Self {
        Self {
            node: node.clone(),
            number,
            state: number,
            acted: (Time::ZERO, 0),
            keys: None,
            waiting: Vec::new(),
            trace: Arc::clone(trace),
        }
    }

    /// Records an event and performs an action selected by the new state, so that every order of events
    /// leaves a distinct trace.
    fn absorb(&mut self, what: &'static str, value: u64, ctx: &mut Context<'_>) {
        let mut trace = self.trace.lock().unwrap_or_else(PoisonError::into_inner);
        trace.entry(name(self.number)).or_default().push((ctx.now(), what, value));
        drop(trace);
        self.state = (self.state ^ value).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(17);
        if self.acted.0 != ctx.now() {
            self.acted = (ctx.now(), 0);
        }
        if self.acted.1 < 4 {
            self.acted.1 += 1;
            match (self.state >> 8) % 64 {
                action if action < u64::from(self.node.meddles) => self.meddle(action, ctx),
                action => self.act(action, ctx),
            }
        }
    }

    fn act(&mut self, action: u64, ctx: &mut Context<'_>) {
        let (Some(keys), state) = (self.keys.clone(), self.state) else { return };
        match action % 8 {
            0 => ctx.schedule_after(keys.task, STEP * (state % 3) as u32),
            1 | 2 => _ = ctx.call(keys.clients[state as usize % 3], state),
            3 => ctx.set(&name(state % NAMES), "level", (state % 100) as i64),
            4 => ctx.spawn(keys.job, move || state.rotate_left(5)),
            5 => self.waiting.drain(..).for_each(|responder| ctx.reply(responder, Ok(state))),
            _ if keys.outs.is_empty() => {}
            _ => ctx.publish(keys.outs[state as usize % keys.outs.len()], state),
        }
    }

    fn meddle(&mut self, action: u64, ctx: &mut Context<'_>) {
        let other = name(self.state % NAMES);
        match action % 8 {
            0 => {
                let number = self.state % NAMES;
                let child = Self { state: self.state, ..Self::new(&self.node, number, &self.trace) };
                ctx.add(&other, child, ModuleOptions::default());
            }
            1 => ctx.remove(&other),
            2 => ctx.remove_self(),
            3 => ctx.pause(&other),
            4 => ctx.resume(&other),
            5 => ctx.transition(&other, Transition::Deactivate),
            6 => ctx.transition(&other, Transition::Activate),
            _ => panic!("a module that panics, as this test wants it"),
        }
    }

    fn answer(&mut self, request: u64, responder: Responder<u64, u64>, ctx: &mut Context<'_>) {
        if self.node.answers_later {
            self.waiting.push(responder);
        } else {
            ctx.reply(responder, if request.is_multiple_of(3) { Err("no".into()) } else { Ok(self.state) });
        }
        self.absorb("request", request, ctx);
    }
}

impl Module for RandomModule {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let outs = self.node.publishes.iter().map(|&topic| setup.publish(TOPICS[topic as usize]));
        let outs = outs.collect::<Result<_, _>>()?;
        for &topic in &self.node.listens {
            let topic = TOPICS[topic as usize];
            setup.subscribe(
                topic,
                move |module: &mut Self, value: Received<'_, u64>, ctx: &mut Context<'_>| {
                    module.absorb(topic, *value, ctx);
                },
            )?;
        }
        if let Some(service) = SERVICES.get(self.number as usize) {
            setup.serve_later(service, Self::answer)?;
        }
        let mut client = |service| {
            setup.client(service, 5 * STEP, |module: &mut Self, reply: Reply<u64>, ctx: &mut Context<'_>| {
                let (what, value) = match reply.result {
                    Ok(value) => ("answer", value),
                    Err(CallError::TimedOut { .. }) => ("time-out", 1),
                    Err(CallError::NoServer { .. }) => ("no server", 2),
                    Err(_) => ("no answer", 3),
                };
                module.absorb(what, value, ctx);
            })
        };
        let clients = [client(SERVICES[0])?, client(SERVICES[1])?, client(SERVICES[2])?];
        let task = setup.task(|module: &mut Self, ctx: &mut Context<'_>| module.absorb("task", 4, ctx));
        let job = setup.job(|module: &mut Self, result: Result<u64, JobError>, ctx: &mut Context<'_>| {
            module.absorb("job", result.unwrap_or(5), ctx);
        });
        let level = setup.setting_in("level", 0_i64, 0.0..=90.0, "of nothing")?;
        setup.on_change(level, move |module: &mut Self, ctx: &mut Context<'_>| {
            let value = *ctx.get(level) as u64;
            module.absorb("level", value, ctx);
        });
        self.keys = Some(Keys { outs, clients, task, job, level });
        let period = STEP * u32::from(self.node.period_ms);
        setup.every(period, |module: &mut Self, ctx: &mut Context<'_>| module.absorb("tick", 1, ctx))
    }

    fn activate(&mut self, ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        self.absorb("activate", 6, ctx);
        Ok(())
    }

    fn deactivate(&mut self, ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        self.absorb("deactivate", 7, ctx);
        Ok(())
    }

    fn shutdown(&mut self, ctx: &mut Context<'_>) {
        let level = self.keys.as_ref().map_or(0, |keys| *ctx.get(keys.level) as u64);
        self.absorb("shutdown", level, ctx);
    }
}

/// The trace of a robot's run, and the modules that exist at its end.
fn traced(nodes: &[Node], launcher: impl Launcher + 'static) -> (Trace, Vec<ModuleInfo>) {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_launcher(launcher).with_clock(clock.clone());
    let trace = Arc::<Mutex<Trace>>::default();
    for (number, node) in (0..).zip(nodes) {
        let (node, trace) = (node.clone(), Arc::clone(&trace));
        let restart =
            node.backoff_ms.map_or(Restart::Never, |ms| Restart::Always { backoff: STEP * u32::from(ms) });
        let synchrony = if node.every_cycle { Synchrony::EveryCycle } else { Synchrony::WhenDue };
        let options = ModuleOptions { restart, synchrony, ..ModuleOptions::default() };
        core.add_restartable(&name(number), move || RandomModule::new(&node, number, &trace), options)
            .unwrap();
    }
    for _ in 0..60 {
        core.cycle().unwrap();
        clock.advance(STEP);
    }
    let modules = core.modules();
    core.stop();
    let trace = trace.lock().unwrap_or_else(PoisonError::into_inner).clone();
    (trace, modules)
}

fn nodes() -> impl Strategy<Value = Vec<Node>> {
    let topics = || proptest::collection::vec(0..4_u8, 0..3);
    let node =
        (topics(), topics(), 1..5_u8, any::<bool>(), proptest::option::of(0..4_u8), any::<bool>(), 0..24_u8);
    let node =
        node.prop_map(|(listens, publishes, period_ms, answers_later, backoff_ms, every_cycle, meddles)| {
            Node { listens, publishes, period_ms, answers_later, backoff_ms, every_cycle, meddles }
        });
    proptest::collection::vec(node, 1..8)
}

/// Suppresses the output of intended panics.
fn silence_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let usual = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            let said = info.payload().downcast_ref::<&str>();
            if said.is_none_or(|said| !said.ends_with("as this test wants it")) {
                usual(info);
            }
        }));
    });
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn random_robots_leave_the_same_trace_under_every_launcher(nodes in nodes()) {
        silence_panics();
        let expected = traced(&nodes, Linear);
        for threads in 1..=4 {
            let pool = Pool::new(threads).unwrap();
            prop_assert_eq!(&traced(&nodes, pool), &expected, "under Pool({})", threads);
        }
        prop_assert_eq!(&traced(&nodes, Threads::new()), &expected, "under Threads");
    }
}

/// Guards against a vacuous property: every kind of event must occur.
#[test]
fn random_robots_do_everything_they_can() {
    silence_panics();
    let node = |number: u8| Node {
        listens: vec![number % 4, (number + 1) % 4],
        publishes: vec![(number + 2) % 4, (number + 3) % 4],
        period_ms: 1 + number % 3,
        answers_later: number % 2 == 1,
        backoff_ms: (!number.is_multiple_of(3)).then_some(number % 3),
        every_cycle: number == 4,
        meddles: 16,
    };
    let mut kinds = std::collections::BTreeSet::new();
    let (mut restarts, mut added) = (0, 0);
    for first in 0..20 {
        let nodes: Vec<_> = (first..first + 7).map(node).collect();
        let (trace, modules) = traced(&nodes, Linear);
        kinds.extend(trace.values().flatten().map(|&(_, what, _)| what));
        restarts += modules.iter().map(|module| module.restarts).sum::<u32>();
        added += trace.keys().filter(|module| !(0..7).any(|number| name(number) == **module)).count();
    }
    let expected = [
        "activate",
        "answer",
        "deactivate",
        "east",
        "job",
        "level",
        "no answer",
        "no server",
        "north",
        "request",
        "shutdown",
        "south",
        "task",
        "tick",
        "time-out",
        "west",
    ];
    assert_eq!(kinds.into_iter().collect::<Vec<_>>(), expected);
    assert!(restarts > 0 && added > 0, "{restarts} restarts, {added} modules added");
}
