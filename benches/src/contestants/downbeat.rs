//! The executor of downbeat.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use anyhow::Context as _;
use downbeat_executor::{Context, Core, ManualClock, Module, Publication, Received, Setup, SetupError, Time};

use super::Contestant;
use crate::launchers::LauncherUnderTest;
use crate::{Load, Reading, Sum};

const PERIOD: Duration = Duration::from_millis(1);

/// The executor, under one of its launchers.
pub struct Downbeat {
    core: Core,
    clock: ManualClock,
    cycles: u64,
    total: Arc<AtomicU64>,
}

impl Downbeat {
    /// Creates the core and its modules and starts them, which is not part of a trial.
    ///
    /// # Errors
    /// If the launcher cannot start its threads.
    pub fn new(load: Load, launcher: &LauncherUnderTest) -> anyhow::Result<Self> {
        let clock = ManualClock::new(Time::ZERO);
        let mut core = (launcher.launch)(Core::new().with_clock(clock.clone()))
            .with_context(|| format!("cannot make a core with the launcher {}", launcher.name))?;
        let total = Arc::new(AtomicU64::new(0));
        core.add("publisher", Publisher::new(load))?;
        for number in 0..load.modules {
            let subscriber = Subscriber { sum: Sum::default(), total: Arc::clone(&total) };
            core.add(&format!("subscriber {number}"), subscriber)?;
        }
        core.cycle()?;
        // A message is received in the cycle after the one in which it is published.
        let cycles = load.batches().count() as u64 + 1;
        Ok(Self { core, clock, cycles, total })
    }
}

impl Contestant for Downbeat {
    fn trial(&mut self) {
        for _ in 0..self.cycles {
            self.clock.advance(PERIOD);
            // Fails only at the start, and the core has started. Lost messages show in the sum.
            let _ = self.core.cycle();
        }
    }

    fn finish(mut self: Box<Self>) -> u64 {
        self.core.stop();
        self.total.load(Ordering::Relaxed)
    }
}

/// Publishes one batch per cycle, and skips one cycle after the last batch of a trial.
struct Publisher {
    batches: Vec<Range<u64>>,
    next: usize,
    out: Option<Publication<Reading>>,
}

impl Publisher {
    fn new(load: Load) -> Self {
        Self { batches: load.batches().collect(), next: 0, out: None }
    }

    fn tick(&mut self, ctx: &mut Context<'_>) {
        let (Some(batch), Some(out)) = (self.batches.get(self.next), self.out) else {
            self.next = 0;
            return;
        };
        ctx.publish_all(out, batch.clone().map(Reading::new));
        self.next += 1;
    }
}

impl Module for Publisher {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        self.out = Some(setup.publish("readings")?);
        setup.every(PERIOD, Self::tick)
    }
}

struct Subscriber {
    sum: Sum,
    total: Arc<AtomicU64>,
}

impl Module for Subscriber {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe(
            "readings",
            |module: &mut Self, reading: Received<'_, Reading>, _: &mut Context<'_>| {
                module.sum.add(&reading);
            },
        )
    }

    fn shutdown(&mut self, _: &mut Context<'_>) {
        self.total.fetch_add(self.sum.value(), Ordering::Relaxed);
    }
}
