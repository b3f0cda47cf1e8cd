//! Modules are added, removed, restarted and panic under load, for the time given by
//! `DOWNBEAT_STRESS_SECONDS` (5 by default). No message is lost, duplicated or reordered, and neither objects
//! nor threads remain at the end.
//!
//! ```sh
//! DOWNBEAT_STRESS_SECONDS=600 cargo test -p downbeat-executor --test stress -- --nocapture
//! ```
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::collections::HashMap;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use common::*;
use downbeat_executor::*;

/// Counts live objects and events.
#[derive(Default)]
struct Counts {
    alive: AtomicI64,
    heard: AtomicU64,
    calls: AtomicU64,
    replies: AtomicU64,
    jobs: AtomicU64,
    results: AtomicU64,
    panics: AtomicU64,
    joined: AtomicU64,
}

impl Counts {
    fn add(counter: &AtomicU64) {
        counter.fetch_add(1, Ordering::Relaxed);
    }
}

/// Counts as alive while it exists: in a message, a module, a request or an answer.
struct Life(Arc<Counts>);

impl Life {
    fn new(counts: &Arc<Counts>) -> Self {
        counts.alive.fetch_add(1, Ordering::Relaxed);
        Self(Arc::clone(counts))
    }
}

impl Drop for Life {
    fn drop(&mut self) {
        self.0.alive.fetch_sub(1, Ordering::Relaxed);
    }
}

/// A message with its source and its number in the source's sequence.
struct Numbered {
    source: u64,
    number: u64,
    _life: Life,
}

/// For each source, the number of the next message that the listener expects; each must arrive in order.
type Heard = Arc<Mutex<HashMap<u64, (u64, u64)>>>;

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The number of messages published by each source. Messages of a run that panicked are discarded, and not
/// counted here.
type Published = Arc<Mutex<HashMap<u64, u64>>>;

/// Faults, collected for the end of the test: a panic in a module would only end the module.
type Faults = Arc<Mutex<Vec<String>>>;

#[derive(Clone, Default)]
struct World {
    counts: Arc<Counts>,
    published: Published,
    heard: Heard,
    faults: Faults,
    sources: Arc<AtomicU64>,
}

impl World {
    fn message(&self, source: u64, number: u64) -> Numbered {
        Numbered { source, number, _life: Life::new(&self.counts) }
    }

    fn hear(&self, message: &Numbered) {
        Counts::add(&self.counts.heard);
        let mut heard = lock(&self.heard);
        let (next, _) = heard.entry(message.source).or_insert((0, 0));
        if message.number != *next {
            let fault = format!("source {}: {} where {next} was due", message.source, message.number);
            lock(&self.faults).push(fault);
        }
        *next = message.number + 1;
    }
}

/// A small pseudo-random number generator, which makes runs repeatable.
struct Dice(u64);

impl Dice {
    fn roll(&mut self, sides: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % sides
    }
}

/// Publishes, calls, starts jobs, panics and leaves at random.
struct Busy {
    world: World,
    dice: Dice,
    /// A new number for each instance.
    source: u64,
    next: u64,
    _life: Life,
}

impl Busy {
    fn new(world: &World, seed: u64) -> Self {
        let source = world.sources.fetch_add(1, Ordering::Relaxed);
        Counts::add(&world.counts.joined);
        Self {
            world: world.clone(),
            dice: Dice(seed ^ source << 20),
            source,
            next: 0,
            _life: Life::new(&world.counts),
        }
    }

    fn run(&mut self, keys: &Keys, ctx: &mut Context<'_>) {
        if self.dice.roll(40) == 0 {
            Counts::add(&self.world.counts.panics);
            // Discarded with the run.
            ctx.publish(keys.out, self.world.message(self.source, u64::MAX));
            panic!("a module that panics, as this test wants it");
        }
        for _ in 0..self.dice.roll(4) {
            ctx.publish(keys.out, self.world.message(self.source, self.next));
            self.next += 1;
        }
        lock(&self.world.published).insert(self.source, self.next);
        match self.dice.roll(12) {
            0 => {
                Counts::add(&self.world.counts.calls);
                ctx.call(keys.client, Life::new(&self.world.counts));
            }
            1 => {
                let life = Life::new(&self.world.counts);
                Counts::add(&self.world.counts.jobs);
                ctx.spawn(keys.job, move || drop(life));
            }
            2 if self.dice.roll(6) == 0 => ctx.remove_self(),
            3 => ctx.set("server", "gain", 1_i64),
            _ => {}
        }
    }
}

#[derive(Clone, Copy)]
struct Keys {
    out: Publication<Numbered>,
    client: Client<Life, Life>,
    job: Job<()>,
}

impl Module for Busy {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let out = setup.publish("numbers")?;
        let client =
            setup.client("serve", 20 * STEP, |busy: &mut Self, _: Reply<Life>, _: &mut Context<'_>| {
                Counts::add(&busy.world.counts.replies);
            })?;
        let job = setup.job(|busy: &mut Self, _: Result<(), JobError>, _: &mut Context<'_>| {
            Counts::add(&busy.world.counts.results);
        });
        let keys = Keys { out, client, job };
        setup.every(STEP, move |busy: &mut Self, ctx: &mut Context<'_>| busy.run(&keys, ctx))
    }
}

/// Answers some requests at once, some later, and some never.
fn server(world: &World) -> Scripted {
    let (life, counts) = (Life::new(&world.counts), Arc::clone(&world.counts));
    module(move |setup| {
        setup.setting("gain", 0_i64, "of nothing")?;
        let (mut waiting, mut number) = (Vec::new(), 0_u64);
        setup.serve_later("serve", move |_, request: Life, responder, ctx| {
            let _held = &life;
            number += 1;
            match number % 4 {
                0 => drop(request),
                1 => ctx.reply(responder, Err("not this one".into())),
                2 => waiting.push(responder),
                _ => {
                    ctx.reply(responder, Ok(Life::new(&counts)));
                    waiting.drain(..).for_each(|responder| ctx.reply(responder, Ok(Life::new(&counts))));
                }
            }
        })
    })
}

fn listener(world: &World) -> Scripted {
    let world = world.clone();
    module(move |setup| {
        setup.subscribe("numbers", move |_, message: Received<'_, Numbered>, _| world.hear(&message))
    })
}

fn options(dice: &mut Dice) -> ModuleOptions {
    let restart = match dice.roll(3) {
        0 => Restart::Never,
        1 => Restart::Times { limit: 2, backoff: STEP },
        _ => Restart::Always { backoff: Duration::ZERO },
    };
    let synchrony = match dice.roll(5) {
        0 => Synchrony::Detached(Inbox::KeepAll),
        1 => Synchrony::EveryCycle,
        _ => Synchrony::WhenDue,
    };
    ModuleOptions { restart, synchrony, ..ModuleOptions::default() }
}

/// Adds, removes and pauses modules and requests transitions, on a separate thread.
fn meddle(world: World, handle: CoreHandle, until: Instant, seed: u64) {
    let mut dice = Dice(seed);
    while Instant::now() < until {
        let name = format!("busy {}", dice.roll(24));
        match dice.roll(8) {
            0..=3 => {
                let (world, options) = (world.clone(), options(&mut dice));
                let seed = dice.roll(u64::MAX);
                drop(handle.add_restartable(&name, move || Busy::new(&world, seed), options));
            }
            4 => drop(handle.remove(&name)),
            5 => {
                drop(handle.pause_module(&name));
                drop(handle.resume_module(&name));
            }
            6 => {
                drop(handle.transition(&name, Transition::Deactivate));
                drop(handle.transition(&name, Transition::Activate));
            }
            _ => {
                handle.modules().wait(WATCHDOG).expect("the core answers");
            }
        }
        std::thread::sleep(Duration::from_micros(200));
    }
}

/// Publishes through an inlet on a separate thread.
fn feed(world: &World, inlet: &Inlet<Numbered>, until: Instant) {
    let source = world.sources.fetch_add(1, Ordering::Relaxed);
    let mut number = 0;
    while Instant::now() < until {
        for _ in 0..10 {
            if inlet.publish(world.message(source, number)).is_ok() {
                number += 1;
                lock(&world.published).insert(source, number);
            }
        }
        std::thread::sleep(Duration::from_micros(300));
    }
}

#[cfg(target_os = "linux")]
fn threads() -> usize {
    std::fs::read_dir("/proc/self/task").unwrap().count()
}

#[cfg(not(target_os = "linux"))]
fn threads() -> usize {
    0
}

fn stress(name: &str, launcher: impl Launcher + 'static, duration: Duration) {
    let before = threads();
    let (world, mut core) = (World::default(), Core::new().with_launcher(launcher));
    core.add("listener", listener(&world)).unwrap();
    let made = world.clone();
    let restart = Restart::Always { backoff: Duration::ZERO };
    let always = ModuleOptions { restart, ..ModuleOptions::default() };
    core.add_restartable("server", move || server(&made), always).unwrap();
    let inlets = [core.inlet("numbers").unwrap(), core.inlet("numbers").unwrap()];
    let (handle, until) = (core.handle(), Instant::now() + duration);
    std::thread::scope(|scope| {
        let core = &mut core;
        let runner = scope.spawn(move || core.run());
        let meddlers = [1, 2].map(|seed| {
            let (world, handle) = (world.clone(), handle.clone());
            scope.spawn(move || meddle(world, handle, until, seed))
        });
        let world = &world;
        let feeders = inlets.each_ref().map(|inlet| scope.spawn(move || feed(world, inlet, until)));
        feeders.into_iter().for_each(|feeder| feeder.join().unwrap());
        meddlers.into_iter().for_each(|meddler| meddler.join().unwrap());
        handle.stop();
        runner.join().unwrap().unwrap();
    });
    drop((inlets, handle));
    drop(core);
    check(name, &world, before);
}

/// The conditions at the end.
fn check(name: &str, world: &World, threads_before: usize) {
    assert_eq!(*lock(&world.faults), [""; 0], "under {name}");
    let (published, heard) = (lock(&world.published), lock(&world.heard));
    for (source, &number) in published.iter().filter(|&(_, &number)| number > 0) {
        let received = heard.get(source).map_or(0, |&(next, _)| next);
        assert_eq!(
            received, number,
            "under {name}: source {source} published {number}, {received} were received"
        );
    }
    wait_until("the threads of jobs end", || threads() <= threads_before);
    wait_until("all objects are gone", || world.counts.alive.load(Ordering::Relaxed) == 0);
    let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
    let Counts { heard, calls, replies, jobs, results, panics, joined, .. } = &*world.counts;
    assert!(
        count(panics) > 0 && count(replies) > 0 && count(results) > 0,
        "under {name}: too little happened"
    );
    assert!(count(replies) <= count(calls) && count(results) <= count(jobs), "under {name}: doubled");
    println!(
        "{name}: {} modules joined, {} panics, {} messages received in order, {} of {} calls and {} of {} jobs answered \
         (the others' modules were gone)",
        count(joined),
        count(panics),
        count(heard),
        count(replies),
        count(calls),
        count(results),
        count(jobs)
    );
}

#[test]
fn nothing_is_lost_doubled_reordered_or_left_while_modules_come_and_go() {
    let seconds = std::env::var("DOWNBEAT_STRESS_SECONDS").ok().and_then(|seconds| seconds.parse().ok());
    let duration = Duration::from_secs(seconds.unwrap_or(5)) / 4;
    // Suppresses the output of intended panics.
    std::panic::set_hook(Box::new(|info| {
        let said = info.payload().downcast_ref::<&str>();
        if said.is_none_or(|said| !said.ends_with("as this test wants it")) {
            eprintln!("{info}");
        }
    }));
    stress("Linear", Linear, duration);
    stress("Pool(2)", Pool::new(2).unwrap(), duration);
    stress("Pool(4)", Pool::new(4).unwrap(), duration);
    stress("Threads", Threads::new(), duration);
}
