//! A cycle allocates no memory in steady state.
#![allow(clippy::unwrap_used, missing_docs)]
// Counting allocations requires an allocator, whose trait is unsafe to implement. This one only counts, and
// forwards to the system's allocator.
#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;
use std::time::Duration;

use downbeat_executor::*;

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: every request is forwarded unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the contract of `dealloc`, and `pointer` came from `System`.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of `realloc`, and `pointer` came from `System`.
        unsafe { System.realloc(pointer, layout, new_size) }
    }
}

/// A thread that is ending has lost its counter; nothing is measured there.
fn count() {
    let _ = ALLOCATIONS.try_with(|allocations| allocations.set(allocations.get() + 1));
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const PERIOD: Duration = Duration::from_millis(1);

/// Publishes a batch of varying, limited size every millisecond, and subscribes to the batches of all nodes.
struct Node {
    out: Option<Publication<[u64; 8]>>,
    rounds: u64,
    sum: u64,
}

impl Module for Node {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        self.out = Some(setup.publish("numbers")?);
        setup.subscribe(
            "numbers",
            |node: &mut Self, numbers: Received<'_, [u64; 8]>, _: &mut Context<'_>| {
                node.sum = node.sum.wrapping_add(numbers[0]);
            },
        )?;
        setup.every(PERIOD, |node: &mut Self, ctx: &mut Context<'_>| {
            node.rounds += 1;
            for number in 0..node.rounds % 50 {
                ctx.publish(node.out.unwrap(), [number; 8]);
            }
        })
    }
}

/// Counts the runs of all modules.
struct RunCounter(usize);

impl Module for RunCounter {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe(CycleRuns::TOPIC, |counter, account: Received<'_, Arc<CycleRuns>>, _| {
            counter.0 += account.runs.len();
        })
    }
}

fn allocations_in_1000_cycles(launcher: impl Launcher + 'static) -> u64 {
    allocations_with(launcher, |_| ())
}

fn allocations_with(launcher: impl Launcher + 'static, prepare: impl FnOnce(&mut Core)) -> u64 {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_launcher(launcher).with_clock(clock.clone());
    prepare(&mut core);
    for number in 0..4 {
        core.add(&format!("node {number}"), Node { out: None, rounds: 0, sum: 0 }).unwrap();
    }
    let mut run = |cycles| {
        for _ in 0..cycles {
            clock.advance(PERIOD);
            core.cycle().unwrap();
        }
    };
    run(1000);
    let before = ALLOCATIONS.get();
    run(1000);
    ALLOCATIONS.get() - before
}

#[test]
fn a_cycle_allocates_nothing_in_steady_state() {
    assert_eq!(allocations_in_1000_cycles(Linear), 0);
}

#[test]
fn a_cycle_of_a_pool_allocates_nothing_in_steady_state() {
    assert_eq!(allocations_in_1000_cycles(Pool::new(2).unwrap()), 0);
}

#[test]
fn a_cycle_with_a_thread_per_module_allocates_nothing_in_steady_state() {
    assert_eq!(allocations_in_1000_cycles(Threads::new()), 0);
}

#[test]
fn a_cycle_whose_runs_are_reported_allocates_nothing_in_steady_state() {
    let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
    let report = |core: &mut Core| core.add_with("run counter", RunCounter(0), options).unwrap();
    assert_eq!(allocations_with(Linear, report), 0);
}

#[test]
fn the_counter_counts() {
    let before = ALLOCATIONS.get();
    drop(std::hint::black_box(Box::new(1)));
    assert_eq!(ALLOCATIONS.get() - before, 1);
}
