//! Measures the memory of a core with 1000 modules and 100 topics.
// Counting allocations requires an allocator, whose trait is unsafe to implement. This one only counts, and
// forwards to the system's allocator.
#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::io::Write as _;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use benches::{Reading, Sum};
use downbeat_executor::{Context, Core, ManualClock, Module, Publication, Received, Setup, SetupError, Time};

struct Counting;

/// The bytes that are allocated and not freed.
static LIVE: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every request is forwarded unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LIVE.fetch_add(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller keeps the contract of `dealloc`, and `pointer` came from `System`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const MODULES: usize = 1000;
const TOPICS: usize = 100;
const MESSAGES_PER_CYCLE: u64 = 10;
const PERIOD: Duration = Duration::from_millis(1);

/// Every tenth module publishes on a separate topic; each subscribes to one topic.
struct Part {
    tells: Option<String>,
    hears: String,
    out: Option<Publication<Reading>>,
    sum: Sum,
}

impl Module for Part {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe(
            &self.hears,
            |part: &mut Self, reading: Received<'_, Reading>, _: &mut Context<'_>| {
                part.sum.add(&reading);
            },
        )?;
        let Some(topic) = &self.tells else { return Ok(()) };
        self.out = Some(setup.publish(topic)?);
        setup.every(PERIOD, |part: &mut Self, ctx: &mut Context<'_>| {
            let Some(out) = part.out else { return };
            for number in 0..MESSAGES_PER_CYCLE {
                ctx.publish(out, Reading::new(number));
            }
        })
    }
}

fn main() -> anyhow::Result<()> {
    let mut out = std::io::stdout();
    writeln!(
        out,
        "{MODULES} modules, {TOPICS} topics, {MESSAGES_PER_CYCLE} messages of {} bytes per topic and cycle, Linear",
        size_of::<Reading>()
    )?;
    let messages = 2 * TOPICS * usize::try_from(MESSAGES_PER_CYCLE)? * size_of::<Reading>();
    for (what, prepare) in [
        ("with times", Ok as fn(Core) -> anyhow::Result<Core>),
        ("without times", |core| Ok(core.without_times())),
    ] {
        let Sizes { empty, before, running } = measure(prepare)?;
        writeln!(out, "{what}")?;
        writeln!(out, "{empty:>9} bytes  a core without modules")?;
        writeln!(out, "{before:>9} bytes  with modules and topics, before the first cycle")?;
        writeln!(out, "{running:>9} bytes  after 100 cycles: {} per module", running / MODULES)?;
        writeln!(
            out,
            "{messages:>9} bytes  of these are messages at least: a batch being read and one being written"
        )?;
    }
    Ok(())
}

struct Sizes {
    empty: usize,
    before: usize,
    running: usize,
}

fn measure(prepare: fn(Core) -> anyhow::Result<Core>) -> anyhow::Result<Sizes> {
    let live = LIVE.load(Ordering::Relaxed);
    let since = || LIVE.load(Ordering::Relaxed) - live;
    let clock = ManualClock::new(Time::ZERO);
    let mut core = prepare(Core::new().with_clock(clock.clone()))?;
    let empty = since();
    for number in 0..MODULES {
        let topic = format!("topic_{}", number % TOPICS);
        let tells = (number < TOPICS).then(|| topic.clone());
        core.add(&format!("part {number}"), Part { tells, hears: topic, out: None, sum: Sum::default() })?;
    }
    let before = since();
    for _ in 0..100 {
        clock.advance(PERIOD);
        core.cycle()?;
    }
    Ok(Sizes { empty, before, running: since() })
}
