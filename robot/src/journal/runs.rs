//! Runs of modules with their causes, many cycles in a message.

use std::sync::Arc;
use std::time::Duration;

use downbeat_executor::{
    Context, Core, CycleRuns, Module, ModuleOptions, Publication, Published, Received, Role, Setup,
    SetupError, Time, WiredModule, Wiring,
};
use downbeat_msgs::downbeat_interfaces::msg::{ModuleRuns, ModuleWiring};

use super::{MOST, OLDEST, RUN_JOURNAL, RUNS};

/// Publishes the accounts of the executor on [`RUNS`], many at once.
#[derive(Default)]
pub(super) struct RunJournal {
    message: ModuleRuns,
    /// The tables to which the numbers in `message` refer.
    wiring: Option<Arc<Wiring>>,
    /// When the tables were last published.
    told: Option<Time>,
}

/// The tables are repeated after this time.
const REPEATED: Duration = Duration::from_secs(10);

/// A position that the message can hold.
fn position(index: u32) -> u16 {
    u16::try_from(index).unwrap_or(ModuleRuns::UNKNOWN)
}

/// A number of entries of one cycle or run.
fn entries(number: usize) -> u16 {
    u16::try_from(number).unwrap_or(u16::MAX)
}

impl RunJournal {
    /// Adds the journal to a core, as an observer, which also receives the last runs of all modules.
    pub(super) fn add(core: &mut Core) -> Result<(), SetupError> {
        let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
        core.add_with(RUN_JOURNAL, Self::default(), options)
    }

    fn on_cycle(&mut self, account: &CycleRuns, ctx: &mut Context<'_, Publication<ModuleRuns>>) {
        let is_known = self.wiring.as_ref().is_some_and(|wiring| Arc::ptr_eq(wiring, &account.wiring));
        if !is_known {
            self.publish(ctx);
            self.message.wiring = self.message.wiring.wrapping_add(u32::from(self.wiring.is_some()));
            self.wiring = Some(Arc::clone(&account.wiring));
            self.told = None;
        }
        if self.told.is_none_or(|told| account.time.saturating_since(told) >= REPEATED) {
            self.message.modules = account.wiring.modules.iter().map(module).collect();
            self.message.topics = account.wiring.topics.iter().map(|topic| topic.to_string()).collect();
            self.told = Some(account.time);
        }
        self.note(account);
        let since = self.message.times.first().map_or(account.time, |&first| Time::from_nanos(first));
        if self.message.cycles.len() >= MOST || account.time.saturating_since(since) >= OLDEST {
            self.publish(ctx);
        }
    }

    fn note(&mut self, account: &CycleRuns) {
        let message = &mut self.message;
        message.cycles.push(account.cycle);
        message.times.push(account.time.as_nanos());
        // More entries than the message can count are left out, as are their messages.
        let (inlets, sizes) = (entries(account.from_inlets.len()), entries(account.runs.len()));
        message.inlets.push(inlets);
        message.sizes.push(sizes);
        let mut publish = |published: &[Published]| {
            let published = &published[..usize::from(entries(published.len()))];
            message.published.extend(published.iter().map(|published| position(published.topic)));
            message.counts.extend(published.iter().map(|published| published.count));
        };
        publish(&account.from_inlets);
        for run in &account.runs[..usize::from(sizes)] {
            let published = account.published(run);
            message.ran.push(position(run.module));
            let detached = if run.step.is_some() { ModuleRuns::DETACHED } else { 0 };
            message.causes.push(run.causes.bits() | detached);
            message.outputs.push(entries(published.len()));
            message.steps.extend(run.step);
            publish(published);
        }
    }

    fn publish(&mut self, ctx: &mut Context<'_, Publication<ModuleRuns>>) {
        if self.message.cycles.is_empty() {
            return;
        }
        let (cycles, runs, published) =
            (self.message.cycles.len(), self.message.ran.len(), self.message.published.len());
        let next = ModuleRuns {
            wiring: self.message.wiring,
            cycles: Vec::with_capacity(cycles),
            times: Vec::with_capacity(cycles),
            inlets: Vec::with_capacity(cycles),
            sizes: Vec::with_capacity(cycles),
            ran: Vec::with_capacity(runs),
            causes: Vec::with_capacity(runs),
            outputs: Vec::with_capacity(runs),
            published: Vec::with_capacity(published),
            counts: Vec::with_capacity(published),
            ..ModuleRuns::default()
        };
        ctx.publish(*ctx.ports, std::mem::replace(&mut self.message, next));
    }
}

fn module(module: &WiredModule) -> ModuleWiring {
    let positions = |topics: &[u32]| topics.iter().map(|&topic| position(topic)).collect();
    let names = |services: &[Arc<str>]| services.iter().map(|service| service.to_string()).collect();
    ModuleWiring {
        name: module.name.to_string(),
        is_detached: module.is_detached,
        since: module.since,
        subscribes: positions(&module.subscribes),
        publishes: positions(&module.publishes),
        serves: names(&module.serves),
        calls: names(&module.calls),
    }
}

impl Module for RunJournal {
    type Ports = Publication<ModuleRuns>;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Self::Ports, SetupError> {
        setup.subscribe(CycleRuns::TOPIC, |journal, account: Received<'_, Arc<CycleRuns>>, ctx| {
            journal.on_cycle(&account, ctx);
        })?;
        setup.publish(RUNS)
    }

    fn shutdown(&mut self, ctx: &mut Context<'_, Self::Ports>) {
        self.publish(ctx);
    }
}
