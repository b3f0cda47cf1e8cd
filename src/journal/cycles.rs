//! The times of a robot's cycles, which a replay runs again.

use std::time::Duration;

use downbeat_executor::{
    Context, Core, Module, ModuleOptions, Publication, Setup, SetupError, Synchrony, Time,
};
use downbeat_msgs::downbeat_interfaces::msg::CycleTimes;

use super::{CYCLE_JOURNAL, CYCLES};

/// Publishes the times of all cycles on [`CYCLES`], many at once.
///
/// It is to be the last part that joins a core: then it is the first to stop, and its last message tells which cycles
/// there were before the end began.
#[derive(Default)]
pub struct CycleJournal {
    first: u64,
    times: Vec<i64>,
}

/// Times are published when there are so many, or the first of them is so old.
const MOST: usize = 256;
const OLDEST: Duration = Duration::from_millis(250);

impl CycleJournal {
    /// Adds the journal to a core.
    ///
    /// # Errors
    /// If another module has the name or the topic.
    pub fn add(core: &mut Core) -> Result<(), SetupError> {
        let options = ModuleOptions { synchrony: Synchrony::EveryCycle, ..ModuleOptions::default() };
        core.add_with(CYCLE_JOURNAL, Self::default(), options)
    }

    fn on_cycle(&mut self, ctx: &mut Context<'_, Publication<CycleTimes>>) {
        let now = ctx.now();
        let since = self.times.first().map_or(now, |&first| Time::from_nanos(first));
        self.times.push(now.as_nanos());
        if self.times.len() >= MOST || now.saturating_since(since) >= OLDEST {
            self.publish(false, ctx);
        }
    }

    fn publish(&mut self, is_end: bool, ctx: &mut Context<'_, Publication<CycleTimes>>) {
        let times = std::mem::replace(&mut self.times, Vec::with_capacity(MOST));
        let first = self.first;
        self.first += times.len() as u64;
        ctx.publish(*ctx.ports, CycleTimes { first, is_end, times });
    }
}

impl Module for CycleJournal {
    type Ports = Publication<CycleTimes>;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Self::Ports, SetupError> {
        setup.each_run(Self::on_cycle);
        setup.publish(CYCLES)
    }

    fn shutdown(&mut self, ctx: &mut Context<'_, Publication<CycleTimes>>) {
        self.publish(true, ctx);
    }
}
