//! Robots whose messages carry what they were made from, against what the accounts of their runs say.
#![allow(clippy::unwrap_used)]

mod written;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use downbeat_edge::Interfaces;
use downbeat_executor::{
    Caller, Client, Context, Core, CoreHandle, CycleRuns, DetachedStep, Idle, Inbox, Inlet, Launcher, Linear,
    ManualClock, Module, ModuleEvent, ModuleOptions, Pool, Publication, Received, Reply, Responder, Restart,
    Role, SettingsChange, Setup, SetupError, Synchrony, Threads, Time,
};
use downbeat_msgs::downbeat_interfaces::msg::{
    CycleMessages, CycleTimes, ModuleEvent as EventMessage, ModuleRuns, ModuleSettings, ModuleStep,
};
use parking_lot::Mutex;
use proptest::prelude::*;

use super::*;
use crate::journal;
use crate::playback::journals::MessageCycles;

const TOPICS: usize = 6;
/// Every run publishes on it; no module receives it.
const TRACE: usize = TOPICS;
/// The first modules may each serve one.
const SERVICES: usize = 4;
const STEP: Duration = Duration::from_millis(1);
const NEVER: Duration = Duration::from_secs(1_000_000);

fn topic(number: usize) -> String {
    format!("topic_{number}")
}

fn service(number: usize) -> String {
    format!("service_{number}")
}

/// A message that knows its true causes.
#[derive(Clone, Debug)]
struct Made {
    id: u64,
    /// The module; `None` if the message came from outside.
    by: Option<String>,
    /// Tells the runs of all modules apart.
    run: u64,
    /// What the run that made it received.
    from: BTreeSet<u64>,
    /// The last message of each other topic that the module had received before.
    remembered: BTreeSet<u64>,
    /// The requests and answers that the run received.
    calls: Vec<CallSeen>,
    /// Whether a setting had another value than in the run before.
    has_new_setting: bool,
    /// All messages on which it depends, also by the state of modules.
    ancestors: BTreeSet<u64>,
}

/// A request or an answer as its receiver saw it.
#[derive(Clone, Debug)]
struct CallSeen {
    service: String,
    is_answer: bool,
    /// The run that made it; `None` if it came from outside, or tells that there is no answer.
    run: Option<u64>,
}

/// A request or an answer, which knows the run that made it.
#[derive(Clone, Debug)]
struct Token {
    run: Option<u64>,
    ancestors: BTreeSet<u64>,
}

static NEXT_ID: AtomicU64 = AtomicU64::new(0);

fn next_id() -> u64 {
    NEXT_ID.fetch_add(1, Ordering::Relaxed)
}

/// What a module does.
#[derive(Clone, Debug)]
struct Plan {
    subscribes: BTreeSet<usize>,
    publishes: BTreeSet<usize>,
    /// In steps; 0 for no timer.
    period: u32,
    inbox: Option<Inbox>,
    /// Publishes only in each of so many runs.
    rate: u64,
    /// The run that panics.
    panics: Option<u64>,
    works_for: Duration,
    serves: bool,
    /// The services that it calls when it publishes.
    calls: BTreeSet<usize>,
}

type Asked = Responder<Arc<Token>, Arc<Token>>;

/// Publishes what it was made from, in runs that received messages or for which its timer was due, and calls
/// services in these. Each run that had a reason is on the topic [`TRACE`].
struct Worker {
    number: usize,
    plan: Plan,
    outlets: Vec<Publication<Arc<Made>>>,
    trace: Option<Publication<Arc<Made>>>,
    clients: Vec<Client<Arc<Token>, Arc<Token>>>,
    asked: Vec<Asked>,
    calls: Vec<CallSeen>,
    has_new_setting: bool,
    received: BTreeMap<usize, Vec<u64>>,
    last: BTreeMap<usize, u64>,
    ancestors: BTreeSet<u64>,
    is_due: bool,
    runs: u64,
}

impl Worker {
    fn new(number: usize, plan: Plan) -> Self {
        Self {
            number,
            plan,
            outlets: Vec::new(),
            trace: None,
            clients: Vec::new(),
            asked: Vec::new(),
            calls: Vec::new(),
            has_new_setting: false,
            received: BTreeMap::new(),
            last: BTreeMap::new(),
            ancestors: BTreeSet::new(),
            is_due: false,
            runs: 0,
        }
    }

    fn run(&mut self, ctx: &mut Context<'_>) {
        let received = std::mem::take(&mut self.received);
        let (calls, asked) = (std::mem::take(&mut self.calls), std::mem::take(&mut self.asked));
        let has_new_setting = std::mem::take(&mut self.has_new_setting);
        let is_due = std::mem::take(&mut self.is_due);
        let publishes = is_due || !received.is_empty();
        if !publishes && calls.is_empty() && !has_new_setting {
            return;
        }
        std::thread::sleep(self.plan.works_for);
        let others = self.last.iter().filter(|(topic, _)| !received.contains_key(topic));
        let remembered: BTreeSet<u64> = others.map(|(_, &last)| last).collect();
        for (&topic, received) in &received {
            self.last.extend(received.last().map(|&last| (topic, last)));
        }
        let made = Made {
            id: 0,
            by: Some(ctx.module_name().to_owned()),
            run: next_id(),
            from: received.into_values().flatten().collect(),
            remembered,
            calls,
            has_new_setting,
            ancestors: self.ancestors.clone(),
        };
        let token = Arc::new(Token { run: Some(made.run), ancestors: made.ancestors.clone() });
        asked.into_iter().for_each(|responder| ctx.reply(responder, Ok(Arc::clone(&token))));
        // A run for a call alone only answers: modules that call each other would never rest.
        self.runs += u64::from(publishes);
        if publishes && self.runs.is_multiple_of(self.plan.rate) {
            for &outlet in &self.outlets {
                ctx.publish(outlet, Arc::new(Made { id: next_id(), ..made.clone() }));
            }
            for &client in &self.clients {
                ctx.call(client, Arc::clone(&token));
            }
        }
        if let Some(trace) = self.trace {
            ctx.publish(trace, Arc::new(Made { id: next_id(), ..made }));
        }
        assert!(!publishes || self.plan.panics != Some(self.runs), "as planned");
    }

    fn note_call(&mut self, service: usize, is_answer: bool, token: Option<&Token>) {
        self.ancestors.extend(token.iter().flat_map(|token| &token.ancestors));
        let run = token.and_then(|token| token.run);
        self.calls.push(CallSeen { service: self::service(service), is_answer, run });
    }
}

impl Module for Worker {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        for number in self.plan.publishes.clone() {
            self.outlets.push(setup.publish(&topic(number))?);
        }
        self.trace = Some(setup.publish(&topic(TRACE))?);
        for number in self.plan.subscribes.clone() {
            setup.subscribe(&topic(number), move |worker, made: Received<'_, Arc<Made>>, _| {
                worker.received.entry(number).or_default().push(made.id);
                worker.ancestors.insert(made.id);
                worker.ancestors.extend(&made.ancestors);
            })?;
        }
        if self.plan.serves && self.number < SERVICES {
            let number = self.number;
            setup.serve_later(&service(number), move |worker, token: Arc<Token>, responder: Asked, _| {
                worker.note_call(number, false, Some(&token));
                worker.asked.push(responder);
            })?;
        }
        for number in self.plan.calls.clone() {
            let client =
                setup.client(&service(number), NEVER, move |worker, reply: Reply<Arc<Token>>, _| {
                    worker.note_call(number, true, reply.result.as_deref().ok());
                })?;
            self.clients.push(client);
        }
        let setting = setup.setting("number", 0_i64, "of no meaning")?;
        setup.accept_if(setting, |worker, _| {
            worker.has_new_setting = true;
            Ok(())
        });
        if self.plan.period > 0 {
            setup.every(STEP * self.plan.period, |worker, _| worker.is_due = true)?;
        }
        setup.each_run(Self::run);
        Ok(())
    }
}

/// What was heard of a robot.
#[derive(Default)]
struct Heard {
    /// By topic.
    messages: Vec<Vec<(Time, Arc<Made>)>>,
    accounts: Vec<Arc<CycleRuns>>,
    steps: Vec<DetachedStep>,
    events: Vec<ModuleEvent>,
    journal: Vec<ModuleRuns>,
    step_journal: Vec<ModuleStep>,
    event_journal: Vec<EventMessage>,
    setting_journal: Vec<ModuleSettings>,
    cycle_journal: Vec<CycleMessages>,
    time_journal: Vec<CycleTimes>,
}

struct Listener(Arc<Mutex<Heard>>);

impl Module for Listener {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        self.0.lock().messages = vec![Vec::new(); TOPICS + 1];
        for number in 0..=TRACE {
            setup.subscribe(&topic(number), move |listener, made: Received<'_, Arc<Made>>, _| {
                listener.0.lock().messages[number].push((made.time(), Arc::clone(&made)));
            })?;
        }
        setup.subscribe(DetachedStep::TOPIC, |listener, step: Received<'_, DetachedStep>, _| {
            listener.0.lock().steps.push(step.clone());
        })?;
        setup.subscribe(CycleRuns::TOPIC, |listener, account: Received<'_, Arc<CycleRuns>>, _| {
            // A copy, because the executor uses the account again.
            listener.0.lock().accounts.push(Arc::new((**account).clone()));
        })?;
        setup.subscribe(journal::RUNS, |listener, message: Received<'_, ModuleRuns>, _| {
            listener.0.lock().journal.push(message.clone());
        })?;
        setup.subscribe(journal::STEPS, |listener, message: Received<'_, ModuleStep>, _| {
            listener.0.lock().step_journal.push(message.clone());
        })?;
        setup.subscribe(ModuleEvent::TOPIC, |listener, event: Received<'_, ModuleEvent>, _| {
            listener.0.lock().events.push(event.clone());
        })?;
        setup.subscribe(journal::EVENTS, |listener, message: Received<'_, EventMessage>, _| {
            listener.0.lock().event_journal.push(message.clone());
        })?;
        setup.subscribe(journal::SETTINGS, |listener, message: Received<'_, ModuleSettings>, _| {
            listener.0.lock().setting_journal.push(message.clone());
        })?;
        setup.subscribe(journal::MESSAGES, |listener, message: Received<'_, CycleMessages>, _| {
            listener.0.lock().cycle_journal.push(message.clone());
        })?;
        setup.subscribe(journal::CYCLES, |listener, message: Received<'_, CycleTimes>, _| {
            listener.0.lock().time_journal.push(message.clone());
        })
    }
}

struct Robot {
    core: Core,
    inlets: Vec<Inlet<Arc<Made>>>,
    callers: Vec<Caller<Arc<Token>, Arc<Token>>>,
    heard: Arc<Mutex<Heard>>,
}

fn launcher(number: usize) -> Box<dyn Launcher> {
    match number {
        0 => Box::new(Linear),
        1 => Box::new(Pool::new(2).unwrap()),
        _ => Box::new(Threads::new()),
    }
}

impl Robot {
    fn new(core: Core, plans: &[Plan]) -> Self {
        let mut core = core;
        for (number, plan) in plans.iter().enumerate() {
            let synchrony = plan.inbox.map_or(Synchrony::WhenDue, Synchrony::Detached);
            let restart = Restart::Always { backoff: STEP * 2 };
            let options = ModuleOptions { synchrony, restart, ..ModuleOptions::default() };
            let plan = plan.clone();
            core.add_restartable(
                &format!("module_{number}"),
                move || Worker::new(number, plan.clone()),
                options,
            )
            .unwrap();
        }
        let inlets = (0..TOPICS).map(|number| core.inlet(&topic(number)).unwrap()).collect();
        let callers = (0..SERVICES).map(|number| core.caller(&service(number)).unwrap()).collect();
        journal::add(&mut core, &Interfaces::carried(), Idle::Park).unwrap();
        let heard = Arc::default();
        let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
        core.add_with("listener", Listener(Arc::clone(&heard)), options).unwrap();
        Self { core, inlets, callers, heard }
    }

    /// Publishes a message from outside.
    fn send(&self, topic: usize) {
        let nothing = BTreeSet::new;
        let made = Made {
            id: next_id(),
            by: None,
            run: 0,
            from: nothing(),
            remembered: nothing(),
            calls: Vec::new(),
            has_new_setting: false,
            ancestors: nothing(),
        };
        self.inlets[topic].publish(Arc::new(made)).unwrap();
    }

    /// Calls a service from outside.
    fn call(&self, service: usize) {
        let token = Token { run: None, ancestors: BTreeSet::new() };
        self.callers[service].call(Arc::new(token), NEVER, drop).unwrap();
    }

    fn end(mut self) -> Heard {
        self.core.stop();
        std::mem::take(&mut *self.heard.lock())
    }
}

impl Heard {
    fn recorded(&self) -> Recorded {
        let joined =
            MessageCycles::of(self.cycle_journal.clone(), |topic| topic == journal::SETTINGS).unwrap();
        let (steps, events) = (self.step_journal.clone(), self.event_journal.clone());
        Recorded::new(&self.journal, steps, events, self.setting_journal.clone(), joined, &self.time_journal)
            .unwrap()
    }

    /// Compares the causes of every message with the true ones. Returns how many messages were compared.
    fn check(&self) -> usize {
        let mut direct = History::default();
        self.accounts.iter().for_each(|account| direct.push(account));
        self.steps.iter().for_each(|step| direct.push_step(step));
        self.events.iter().for_each(|event| direct.push_event(event));
        let messages = self.check_history(&direct);
        // The journal says the same as the reports of the executor, and the cycles of changed settings.
        let recorded = self.recorded().history();
        assert_eq!(self.check_history(&recorded), messages);
        for (message, made) in self.made(&recorded) {
            let Some(run) = recorded.publisher(message) else { continue };
            assert_eq!(recorded.settings_of(run).count(), usize::from(made.has_new_setting), "of {made:?}");
        }
        messages
    }

    /// All messages, and what they carry.
    fn made(&self, history: &History) -> Vec<(MessageId, &Made)> {
        let all = self.messages.iter().enumerate();
        let all = all
            .flat_map(|(number, messages)| (0..).zip(messages).map(move |(nth, made)| (number, nth, made)));
        all.map(|(number, nth, (_, made))| (history.message(&topic(number), nth).unwrap(), &**made)).collect()
    }

    fn check_history(&self, history: &History) -> usize {
        let id_of = |message: MessageId| {
            let number: usize = history.topic(message).strip_prefix("topic_").unwrap().parse().unwrap();
            self.messages[number][usize::try_from(message.number).unwrap()].1.id
        };
        let published = self.made(history).into_iter();
        let published = published.filter_map(|(id, made)| Some((history.publisher(id)?, made.run)));
        let runs: HashMap<RunId, u64> = published.collect();
        let by_number: HashMap<u64, RunId> = runs.iter().map(|(run, number)| (*number, *run)).collect();
        // Runs of a detached module that joined in one cycle are not told apart.
        let joined = |run: RunId| (history.module(run).to_owned(), history.runs[run.0].cycle);
        let traced: BTreeSet<_> = runs.keys().map(|run| joined(*run)).collect();
        let mut compared = 0;
        for (number, messages) in self.messages.iter().enumerate() {
            for (nth, (time, made)) in (0..).zip(messages) {
                let message = history.message(&topic(number), nth).unwrap();
                let at_once = messages.iter().filter(|(other, _)| other == time).count();
                let before = messages[..nth as usize].iter().filter(|(other, _)| other == time).count();
                let at_time = history.message_at(&topic(number), *time, before as u64, at_once as u64);
                assert_eq!(at_time, Ok(message), "a message is found by its time");
                let run = history.publisher(message);
                assert_eq!(run.map(|run| history.module(run)), made.by.as_deref());
                let Some(run) = run else { continue };
                let received: BTreeSet<u64> = history.received(run).map(id_of).collect();
                assert_eq!(received, made.from, "of {made:?}");
                let remembered: BTreeSet<u64> = history.remembered(run).into_iter().map(id_of).collect();
                assert_eq!(remembered, made.remembered, "of {made:?}");
                assert_eq!(runs[&run], made.run, "all that a run publishes is of one run");
                let calls = history.calls_of(run).into_iter().map(|call| {
                    let maker = history.run_behind(call).map(joined).filter(|run| traced.contains(run));
                    (call.service.to_string(), call.is_answer, maker)
                });
                let seen = made.calls.iter().map(|call| {
                    let maker = call.run.map(|run| joined(by_number[&run]));
                    (call.service.clone(), call.is_answer, maker)
                });
                // A module calls its callbacks in the order in which it declared them.
                let (mut calls, mut seen): (Vec<_>, Vec<_>) = (calls.collect(), seen.collect());
                calls.sort();
                seen.sort();
                assert_eq!(calls, seen, "of {made:?}");
                compared += 1;
            }
            let messages = messages.len() as u64;
            assert!(history.message(&topic(number), messages).is_none(), "no message is made up");
        }
        compared
    }

    /// Compares the ages along every chain with the true ones.
    fn check_latency(&self) {
        let (steps, recorded) = (&self.steps, self.recorded());
        let numbers: HashMap<u64, (usize, u64)> = (0..=TRACE)
            .flat_map(|topic| {
                (0..).zip(&self.messages[topic]).map(move |(nth, (_, made))| (made.id, (topic, nth)))
            })
            .collect();
        for (from, to) in (0..TOPICS).flat_map(|from| (0..=TRACE).map(move |to| (from, to))) {
            if from == to {
                continue;
            }
            let age = |(time, made): &(Time, Arc<Made>)| {
                let origins = made.ancestors.iter().map(|id| numbers[id]).filter(|&(topic, _)| topic == from);
                let newest = origins.map(|(_, nth)| nth).max()?;
                Some(time.saturating_since(self.messages[from][newest as usize].0))
            };
            let expected: Vec<_> = self.messages[to].iter().map(age).collect();
            let mut latency = Latency::new(&topic(from), &topic(to));
            recorded.measure(&mut latency);
            let samples: Vec<_> = latency.take_samples().collect();
            let ages =
                samples.iter().flat_map(|sample| std::iter::repeat_n(sample.age, sample.count as usize));
            let expected_ages: Vec<_> = expected.iter().copied().flatten().collect();
            assert_eq!(ages.collect::<Vec<_>>(), expected_ages, "from {from} to {to} with {steps:?}");
            assert_eq!(latency.without_origin(), expected.iter().filter(|age| age.is_none()).count() as u64);
            for sample in samples {
                let hops = sample.hops();
                assert_eq!(&*hops[0].by, &*topic(from));
                assert!(
                    hops.is_sorted_by(|one, next| one.published == next.sent && one.sent <= one.received)
                );
                assert_eq!(hops.last().unwrap().published, sample.time);
            }
        }
    }
}

fn topics() -> impl Strategy<Value = BTreeSet<usize>> {
    prop::collection::btree_set(0..TOPICS, 0..3)
}

fn plan() -> impl Strategy<Value = Plan> {
    let panics = prop::option::weighted(0.2, 1..8_u64);
    let services = (any::<bool>(), prop::collection::btree_set(0..SERVICES, 0..3));
    (topics(), topics(), 0..4_u32, 1..3_u64, panics, services).prop_map(
        |(subscribes, publishes, period, rate, panics, (serves, calls))| Plan {
            subscribes,
            publishes,
            period,
            inbox: None,
            rate,
            panics,
            works_for: Duration::ZERO,
            // What a panic answers comes from a run that says nothing.
            serves: serves && panics.is_none(),
            calls,
        },
    )
}

/// What happens between two cycles.
#[derive(Clone, Debug)]
enum Happening {
    Nothing,
    Message(usize),
    Call(usize),
    Set(usize),
    Time,
    Pause(usize),
    Resume(usize),
}

fn happening() -> impl Strategy<Value = Happening> {
    prop_oneof![
        2 => Just(Happening::Nothing),
        4 => (0..TOPICS).prop_map(Happening::Message),
        2 => (0..SERVICES).prop_map(Happening::Call),
        2 => (0..5_usize).prop_map(Happening::Set),
        6 => Just(Happening::Time),
        1 => (0..5_usize).prop_map(Happening::Pause),
        2 => (0..5_usize).prop_map(Happening::Resume),
    ]
}

/// A module on its own thread, or inside the cycle, that passes messages only to later topics: an endless
/// circle would keep the core from sleeping.
fn threaded_plan() -> impl Strategy<Value = Plan> {
    let inbox = prop_oneof![
        1 => Just(None),
        2 => Just(Some(Inbox::KeepAll)),
        1 => (1..3_usize).prop_map(|last| Some(Inbox::KeepLast(NonZeroUsize::new(last).unwrap()))),
    ];
    (plan(), inbox, 0..3_u64).prop_map(|(plan, inbox, works_for)| {
        let first = plan.subscribes.last().map_or(0, |last| last + 1);
        Plan {
            publishes: plan
                .publishes
                .iter()
                .map(|topic| topic + first)
                .filter(|&topic| topic < TOPICS)
                .collect(),
            works_for: Duration::from_millis(if inbox.is_some() { works_for } else { 0 }),
            panics: None,
            inbox,
            ..plan
        }
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, ..ProptestConfig::default() })]

    #[test]
    fn the_causes_of_messages_are_those_they_carry(
        plans in prop::collection::vec(plan(), 1..5),
        happenings in prop::collection::vec(happening(), 1..60),
        launched in 0..3_usize,
    ) {
        let clock = ManualClock::new(Time::ZERO);
        let core = Core::new().with_launcher(launcher(launched)).with_clock(clock.clone());
        let mut robot = Robot::new(core, &plans);
        for happening in happenings {
            match happening {
                Happening::Nothing => {}
                Happening::Message(topic) => robot.send(topic),
                Happening::Call(service) => robot.call(service),
                Happening::Set(module) => drop(robot.core.handle().set(&format!("module_{module}"), "number", 1_i64)),
                Happening::Time => clock.advance(STEP),
                Happening::Pause(module) => drop(robot.core.handle().pause_module(&format!("module_{module}"))),
                Happening::Resume(module) => drop(robot.core.handle().resume_module(&format!("module_{module}"))),
            }
            robot.core.cycle().unwrap();
        }
        let heard = robot.end();
        heard.check();
        // A latency takes it that a module that has started again gets answers to what it asked before.
        if plans.iter().all(|plan| plan.calls.is_empty() || plan.panics.is_none()) {
            heard.check_latency();
        }
    }
}

proptest! {
    // Each case takes some 60 ms of real time.
    #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

    #[test]
    fn the_causes_of_messages_of_detached_modules_are_those_they_carry(
        plans in prop::collection::vec(threaded_plan(), 2..6),
        has_calls: bool,
        launched in 0..3_usize,
    ) {
        struct End(u32, CoreHandle);

        impl Module for End {
            type Ports = ();

            fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
                setup.every(STEP, |end, _| {
                    end.0 += 1;
                    if end.0 == 50 {
                        end.1.stop();
                    }
                })
            }
        }

        let mut plans = plans;
        if !has_calls {
            plans.iter_mut().for_each(|plan| plan.calls.clear());
        }
        let mut robot = Robot::new(Core::new().with_launcher(launcher(launched)), &plans);
        robot.core.add("end", End(0, robot.core.handle())).unwrap();
        (0..TOPICS).for_each(|topic| robot.send(topic));
        (0..SERVICES).for_each(|service| robot.call(service));
        robot.core.run().unwrap();
        let heard = robot.end();
        heard.check();
        // A latency takes it that the next run of a detached module has an answer, though that may have begun
        // before.
        if !has_calls {
            heard.check_latency();
        }
    }
}
