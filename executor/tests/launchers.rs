//! The contract of launchers, and the particulars of each.
#![allow(clippy::unwrap_used, missing_docs)]

use std::collections::HashSet;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Condvar, Mutex};
use std::thread::ThreadId;
use std::time::Duration;

use downbeat_executor::*;

const PERIOD: Duration = Duration::from_millis(1);
/// Longer than any wait of these tests on a busy machine.
const WATCHDOG: Duration = Duration::from_secs(60);

/// Calls a function at every multiple of a period.
struct Ticker {
    periods: u32,
    tick: Box<dyn FnMut() + Send>,
}

impl Module for Ticker {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.every(PERIOD * self.periods, |ticker: &mut Self, _: &mut Context<'_>| (ticker.tick)())
    }
}

fn every(periods: u32, tick: impl FnMut() + Send + 'static) -> Ticker {
    Ticker { periods, tick: Box::new(tick) }
}

/// Checks the contract of the wrapped launcher.
struct Watched<L>(L);

impl<L: Launcher> Launcher for Watched<L> {
    fn attach(&mut self) -> Result<(), ThreadError> {
        self.0.attach()
    }

    fn process(&mut self, stage: &mut Arc<Stage>) {
        self.0.process(stage);
        assert!(Arc::get_mut(stage).is_some(), "the launcher kept a clone of the stage");
    }

    fn slot_freed(&mut self, slot: usize) {
        self.0.slot_freed(slot);
    }
}

struct Robot {
    core: Core,
    clock: ManualClock,
    modules: usize,
}

impl Robot {
    fn new(launcher: impl Launcher + 'static) -> Self {
        let clock = ManualClock::new(Time::ZERO);
        let core = Core::new().with_launcher(Watched(launcher)).with_clock(clock.clone());
        Self { core, clock, modules: 0 }
    }

    fn add(&mut self, module: impl Module) {
        self.core.add(&format!("module {}", self.modules), module).unwrap();
        self.modules += 1;
    }

    fn cycle(&mut self) {
        self.core.cycle().unwrap();
        self.clock.advance(PERIOD);
    }
}

/// The numbers of runs of several modules with different periods, after each of several cycles.
fn runs_by_cycle(launcher: impl Launcher + 'static) -> Vec<Vec<u64>> {
    let mut robot = Robot::new(launcher);
    let counts: Vec<_> = (0..10).map(|_| Arc::new(AtomicU64::new(0))).collect();
    for (periods, count) in [1, 1, 1, 2, 3, 1, 5, 7, 1, 1].into_iter().zip(&counts) {
        let count = Arc::clone(count);
        robot.add(every(periods, move || {
            count.fetch_add(1, Ordering::Relaxed);
        }));
    }
    let mut cycle = || {
        robot.cycle();
        counts.iter().map(|count| count.load(Ordering::Relaxed)).collect()
    };
    (0..100).map(|_| cycle()).collect()
}

fn runs_each_module_that_is_due_exactly_once(launcher: impl Launcher + 'static) {
    let runs = runs_by_cycle(launcher);
    for (before, after) in runs.iter().zip(&runs[1..]) {
        assert_eq!(after[0], before[0] + 1, "a module of every cycle");
    }
    assert_eq!(runs, runs_by_cycle(Linear));
}

/// Forwards a number.
struct Relay {
    from: &'static str,
    to: &'static str,
}

impl Module for Relay {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let out = setup.publish(self.to)?;
        setup.subscribe(self.from, move |_: &mut Self, number: Received<'_, u64>, ctx: &mut Context<'_>| {
            ctx.publish(out, *number + 1);
        })
    }
}

/// Fails the test if `run` hangs.
fn watched(run: impl FnOnce() + Send + 'static) {
    let (done, is_done) = channel();
    let thread = std::thread::spawn(move || {
        run();
        done.send(()).unwrap();
    });
    if is_done.recv_timeout(WATCHDOG) == Err(std::sync::mpsc::RecvTimeoutError::Timeout) {
        panic!("hangs");
    }
    thread.join().unwrap();
}

fn runs_many_cycles_in_a_row(launcher: impl Launcher + 'static, cycles: u64) {
    watched(move || {
        let mut robot = Robot::new(launcher);
        let (sender, numbers) = channel();
        for (from, to) in [("a", "b"), ("b", "c"), ("c", "a"), ("d", "e"), ("e", "d")] {
            robot.add(Relay { from, to });
        }
        robot.add(Listener { sender });
        for start in ["a", "b", "c", "d", "e"] {
            robot.core.inlet::<u64>(start).unwrap().publish(0).unwrap();
        }
        for _ in 0..cycles {
            robot.cycle();
        }
        // One hop per cycle, after the cycle that takes the first numbers.
        assert_eq!(numbers.try_iter().last(), Some(cycles - 2));
    });
}

struct Listener {
    sender: Sender<u64>,
}

impl Module for Listener {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe("a", |listener: &mut Self, number: Received<'_, u64>, _: &mut Context<'_>| {
            listener.sender.send(*number).unwrap();
        })
    }
}

fn goes_on_when_a_module_panics(launcher: impl Launcher + 'static) {
    watched(move || {
        let mut robot = Robot::new(launcher);
        let count = Arc::new(AtomicU64::new(0));
        for number in 0..6 {
            let count = Arc::clone(&count);
            robot.add(every(1, move || {
                count.fetch_add(1, Ordering::Relaxed);
                assert!(number % 2 == 0, "as the test wants it");
            }));
        }
        robot.cycle();
        robot.cycle();
        let after_panics = count.load(Ordering::Relaxed);
        for _ in 0..100 {
            robot.cycle();
        }
        assert_eq!(count.load(Ordering::Relaxed), after_panics + 3 * 100);
    });
}

thread_local! {
    static SIGN: std::cell::RefCell<Option<SignOfLife>> = const { std::cell::RefCell::new(None) };
}

/// Counts the threads that are alive.
struct SignOfLife(Arc<AtomicUsize>);

impl Drop for SignOfLife {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

fn leave_sign_of_life(alive: &Arc<AtomicUsize>) {
    SIGN.with_borrow_mut(|sign| {
        sign.get_or_insert_with(|| {
            alive.fetch_add(1, Ordering::SeqCst);
            SignOfLife(Arc::clone(alive))
        });
    });
}

fn ends_its_threads_when_it_is_dropped(launcher: impl Launcher + 'static) {
    let alive = Arc::new(AtomicUsize::new(0));
    let of_launcher = Arc::clone(&alive);
    watched(move || {
        let alive = of_launcher;
        let mut robot = Robot::new(launcher);
        for _ in 0..8 {
            let alive = Arc::clone(&alive);
            robot.add(every(1, move || leave_sign_of_life(&alive)));
        }
        for _ in 0..100 {
            robot.cycle();
        }
        drop(robot);
        // The core's own thread continues.
        leave_sign_of_life(&alive);
        assert_eq!(alive.load(Ordering::SeqCst), 1);
    });
    assert_eq!(alive.load(Ordering::SeqCst), 0);
}

/// The first module waits for the others of its cycle.
fn does_not_let_a_long_module_hold_up_the_rest(launcher: impl Launcher + 'static) {
    watched(move || {
        let mut robot = Robot::new(launcher);
        let others = Arc::new((Mutex::new(0), Condvar::new()));
        let waits_for = Arc::clone(&others);
        robot.add(every(1, move || {
            let (count, changed) = &*waits_for;
            let mut count = changed.wait_while(count.lock().unwrap(), |count| *count < 20).unwrap();
            *count = 0;
        }));
        for _ in 0..20 {
            let others = Arc::clone(&others);
            robot.add(every(1, move || {
                *others.0.lock().unwrap() += 1;
                others.1.notify_one();
            }));
        }
        for _ in 0..50 {
            robot.cycle();
        }
    });
}

macro_rules! conforms {
    ($name:ident, $launcher:expr, $cycles:expr) => {
        mod $name {
            use super::*;

            #[test]
            fn runs_each_module_that_is_due_exactly_once() {
                super::runs_each_module_that_is_due_exactly_once($launcher);
            }

            #[test]
            fn runs_many_cycles_in_a_row() {
                super::runs_many_cycles_in_a_row($launcher, $cycles);
            }

            #[test]
            fn goes_on_when_a_module_panics() {
                super::goes_on_when_a_module_panics($launcher);
            }

            #[test]
            fn ends_its_threads_when_it_is_dropped() {
                super::ends_its_threads_when_it_is_dropped($launcher);
            }
        }
    };
}

macro_rules! divides_the_work {
    ($name:ident, $launcher:expr) => {
        #[test]
        fn $name() {
            does_not_let_a_long_module_hold_up_the_rest($launcher);
        }
    };
}

fn pool(threads: usize, spin: Spin) -> Pool {
    Pool::with_options(threads, ThreadOptions { spin, ..ThreadOptions::default() }).unwrap()
}

fn cpus() -> usize {
    std::thread::available_parallelism().unwrap().get()
}

fn threads(spin: Spin) -> Threads {
    Threads::with_options(ThreadOptions { spin, ..ThreadOptions::default() }).unwrap()
}

conforms!(linear, Linear, 50_000);
conforms!(pool_of_1, Pool::new(1).unwrap(), 50_000);
conforms!(pool_of_2, Pool::new(2).unwrap(), 50_000);
conforms!(pool_of_3, Pool::new(3).unwrap(), 20_000);
conforms!(pool_of_4, Pool::new(4).unwrap(), 20_000);
conforms!(pool_that_parks, pool(2, Spin::Never), 20_000);
conforms!(pool_that_spins_briefly, pool(3, Spin::For(Duration::from_micros(2))), 20_000);
conforms!(pool_that_spins, pool(cpus().min(2), Spin::Always), 2_000);
conforms!(a_thread_per_module, Threads::new(), 10_000);
conforms!(a_thread_per_module_that_spins, threads(Spin::For(Duration::from_micros(2))), 10_000);

divides_the_work!(a_long_module_does_not_hold_up_the_rest_of_a_pool_of_2, Pool::new(2).unwrap());
divides_the_work!(a_long_module_does_not_hold_up_the_rest_of_a_pool_of_4, Pool::new(4).unwrap());
divides_the_work!(a_long_module_does_not_hold_up_the_rest_with_a_thread_each, Threads::new());

#[test]
fn a_pool_of_no_threads_is_refused() {
    let error = Pool::new(0).unwrap_err();
    assert!(matches!(error, PoolError::NoThreads));
    assert!(error.to_string().starts_with("a pool of 0 threads cannot run modules: give it at least 1"));
}

/// The threads on which each of `modules` modules ran in 20 cycles.
fn threads_of_modules(launcher: impl Launcher + 'static, modules: usize) -> Vec<HashSet<ThreadId>> {
    let mut robot = Robot::new(launcher);
    let seen: Vec<_> = (0..modules).map(|_| Arc::<Mutex<HashSet<ThreadId>>>::default()).collect();
    for seen in &seen {
        let seen = Arc::clone(seen);
        robot.add(every(1, move || {
            seen.lock().unwrap().insert(std::thread::current().id());
        }));
    }
    (0..20).for_each(|_| robot.cycle());
    seen.iter().map(|seen| seen.lock().unwrap().clone()).collect()
}

#[test]
fn a_module_always_runs_on_its_own_thread() {
    let threads = threads_of_modules(Threads::new(), 4);
    assert!(threads.iter().all(|threads| threads.len() == 1), "{threads:?}");
    let all: HashSet<_> = threads.iter().flatten().collect();
    assert_eq!(all.len(), 4);
    assert!(!all.contains(&std::thread::current().id()));
}

#[test]
fn a_cycle_with_one_module_wakes_nobody_of_a_pool() {
    assert_eq!(threads_of_modules(Pool::new(4).unwrap(), 1), [HashSet::from([std::thread::current().id()])]);
}

#[test]
fn the_thread_of_a_removed_module_ends_and_the_next_one_gets_its_own() {
    let alive = Arc::new(AtomicUsize::new(0));
    let ticker = || {
        let alive = Arc::clone(&alive);
        every(1, move || leave_sign_of_life(&alive))
    };
    let mut robot = Robot::new(Threads::new());
    robot.add(ticker());
    robot.add(ticker());
    let run = |robot: &mut Robot| (0..5).for_each(|_| robot.cycle());
    run(&mut robot);
    assert_eq!(alive.load(Ordering::SeqCst), 2);
    let handle = robot.core.handle();
    drop(handle.remove("module 0"));
    run(&mut robot);
    assert_eq!(alive.load(Ordering::SeqCst), 1);
    drop(handle.add("another", ticker(), ModuleOptions::default()));
    run(&mut robot);
    assert_eq!(alive.load(Ordering::SeqCst), 2);
}

/// The payload of a panic, which panics itself when dropped.
struct Bomb;

impl Drop for Bomb {
    fn drop(&mut self) {
        panic!("the panic panics");
    }
}

#[test]
fn a_panic_that_panics_when_it_is_dropped_ends_no_thread_of_a_launcher() {
    watched(|| {
        let mut robot = Robot::new(Threads::new());
        let count = Arc::new(AtomicU64::new(0));
        let counted = Arc::clone(&count);
        robot.add(every(1, || std::panic::panic_any(Bomb)));
        robot.add(every(1, move || {
            counted.fetch_add(1, Ordering::Relaxed);
        }));
        (0..20).for_each(|_| robot.cycle());
        assert!(count.load(Ordering::Relaxed) >= 19);
    });
}
