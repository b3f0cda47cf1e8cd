//! What a bag says about the runs of a robot.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use downbeat_edge::setting_value;
use downbeat_executor::{
    CallError, CallOrigin, CycleRuns, DetachedStep, ModuleCommand, ModuleEvent, ModuleEventKind, Published,
    RunCauses, SettingsChange, StepInput, Time, WiredModule, Wiring,
};
use downbeat_msgs::downbeat_interfaces::msg::{
    CycleTimes, ModuleEvent as EventMessage, ModuleRuns, ModuleSettings, ModuleStep, ModuleWiring,
};

use super::{History, Latency};
use crate::playback::journals::MessageCycles;

/// The journals of a bag, as the executor reported them.
#[derive(Default)]
pub struct Recorded {
    accounts: Vec<CycleRuns>,
    steps: Vec<DetachedStep>,
    events: Vec<ModuleEvent>,
    /// With the cycles in which they took effect, where several cycles ran at their time.
    settings: Vec<(SettingsChange, Option<u64>)>,
}

/// The columns of a message do not fit each other.
const UNEVEN: &str = "its columns have different lengths";

impl Recorded {
    /// Takes the messages of the journals, in the order of the bag, the cycles in which those about settings
    /// joined, and the times of cycles.
    ///
    /// # Errors
    /// If the messages on `module_runs` contradict themselves; the text says how.
    pub(crate) fn new(
        runs: &[ModuleRuns],
        steps: Vec<ModuleStep>,
        events: Vec<EventMessage>,
        settings: Vec<ModuleSettings>,
        joined: MessageCycles,
        cycles: &[CycleTimes],
    ) -> Result<Self, &'static str> {
        // A recording that begins late has tables only after some messages that refer to them.
        let tables = runs.iter().filter(|message| !message.modules.is_empty());
        let tables: BTreeMap<u32, Arc<Wiring>> =
            tables.map(|message| (message.wiring, Arc::new(wiring(message)))).collect();
        let mut accounts = Vec::new();
        for message in runs {
            if let Some(wiring) = tables.get(&message.wiring) {
                read(message, wiring, &mut accounts)?;
            }
        }
        accounts.sort_by_key(|account| account.cycle);
        let mut steps: Vec<_> = steps.into_iter().map(step).collect();
        steps.sort_by_key(|step| step.cycle);
        let mut events: Vec<_> = events.into_iter().filter_map(event).collect();
        events.sort_by_key(|event| event.cycle);
        let times = cycles.iter().flat_map(|message| (message.first..).zip(message.times.iter().copied()));
        let times: HashMap<u64, i64> = times.collect();
        let settings = joined.of_changes(settings, |cycle| times.get(&cycle).copied());
        let settings = settings.map(|(message, cycle)| (change(message), cycle)).collect();
        Ok(Self { accounts, steps, events, settings })
    }

    /// True if the bag has no runs, as those of ROS and those of earlier versions.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.accounts.is_empty()
    }

    /// The names of all modules and topics that the journal knows.
    #[must_use]
    pub fn topics(&self) -> std::collections::BTreeSet<Arc<str>> {
        self.accounts.iter().flat_map(|account| account.wiring.topics.iter().cloned()).collect()
    }

    /// The runs with what they received and published.
    #[must_use]
    pub fn history(&self) -> History {
        let mut history = History::default();
        self.accounts.iter().for_each(|account| history.push(account));
        self.steps.iter().for_each(|step| history.push_step(step));
        self.events.iter().for_each(|event| history.push_event(event));
        self.settings.iter().for_each(|(change, cycle)| history.push_settings(change, *cycle));
        history
    }

    /// Measures a chain over the whole recording.
    pub fn measure(&self, latency: &mut Latency) {
        let (mut steps, mut events) = (self.steps.iter().peekable(), self.events.iter().peekable());
        for account in &self.accounts {
            while let Some(step) = steps.next_if(|step| step.cycle <= account.cycle) {
                latency.step(step);
            }
            while let Some(event) = events.next_if(|event| event.cycle < account.cycle) {
                latency.event(event);
            }
            latency.account(account);
        }
    }
}

fn wiring(message: &ModuleRuns) -> Wiring {
    let topics = message.topics.iter().map(|topic| Arc::from(&**topic)).collect();
    let positions = |topics: &[u16]| topics.iter().map(|&topic| u32::from(topic)).collect();
    let names = |services: &[String]| services.iter().map(|service| Arc::from(&**service)).collect();
    let module = |module: &ModuleWiring| WiredModule {
        name: Arc::from(&*module.name),
        is_detached: module.is_detached,
        since: module.since,
        subscribes: positions(&module.subscribes),
        publishes: positions(&module.publishes),
        serves: names(&module.serves),
        calls: names(&module.calls),
    };
    Wiring { modules: message.modules.iter().map(module).collect(), topics }
}

/// Reads the cycles of a message.
fn read(
    message: &ModuleRuns,
    wiring: &Arc<Wiring>,
    accounts: &mut Vec<CycleRuns>,
) -> Result<(), &'static str> {
    let cycles = message.cycles.len();
    let is_even = [message.times.len(), message.inlets.len(), message.sizes.len()] == [cycles; 3]
        && [message.causes.len(), message.outputs.len()] == [message.ran.len(); 2]
        && message.published.len() == message.counts.len();
    if !is_even {
        return Err(UNEVEN);
    }
    let published = message.published.iter().zip(&message.counts);
    let mut published = published.map(|(&topic, &count)| Published { topic: u32::from(topic), count });
    let mut runs = message.ran.iter().zip(message.causes.iter().zip(&message.outputs));
    let mut steps = message.steps.iter().copied();
    for cycle in 0..cycles {
        let inlets: Vec<_> = published.by_ref().take(usize::from(message.inlets[cycle])).collect();
        let time = Time::from_nanos(message.times[cycle]);
        let mut account = CycleRuns::new(time, message.cycles[cycle], Arc::clone(wiring), inlets);
        for _ in 0..message.sizes[cycle] {
            let (&module, (&causes, &outputs)) = runs.next().ok_or(UNEVEN)?;
            let step = match causes & ModuleRuns::DETACHED {
                0 => None,
                _ => Some(steps.next().ok_or(UNEVEN)?),
            };
            let outputs: Vec<_> = published.by_ref().take(usize::from(outputs)).collect();
            let causes = RunCauses::from_bits(causes & !ModuleRuns::DETACHED);
            account.add(u32::from(module), causes, step, &outputs);
        }
        accounts.push(account);
    }
    Ok(())
}

fn step(message: ModuleStep) -> DetachedStep {
    let counts = message.skipped.into_iter().zip(message.counts);
    let inputs = message.topics.into_iter().zip(counts);
    let input =
        |(topic, (skipped, received)): (String, _)| StepInput { topic: topic.into(), skipped, received };
    DetachedStep {
        time: Time::from_nanos(message.stamp.as_nanos()),
        module: message.module.into(),
        step: message.step,
        cycle: message.cycle,
        is_stop: message.is_stop,
        inputs: inputs.map(input).collect(),
    }
}

/// What of an event matters for causes.
fn event(message: EventMessage) -> Option<ModuleEvent> {
    let module: Arc<str> = message.module.into();
    let origin = |module: Arc<str>| CallOrigin {
        client: (!module.is_empty()).then_some(module),
        port: message.port,
        number: message.number,
    };
    let kind = match message.kind {
        EventMessage::REQUEST => {
            ModuleEventKind::Request { service: message.service.into(), origin: origin(module), body: None }
        }
        EventMessage::ANSWER => {
            let service: Arc<str> = message.service.into();
            let result = match message.outcome {
                EventMessage::NO_SERVER | EventMessage::SERVER_GONE => {
                    Err(CallError::NoServer { service: Arc::clone(&service) })
                }
                _ => Ok(None),
            };
            ModuleEventKind::Answer { service, origin: origin(module), result }
        }
        // Which command it was does not matter here.
        EventMessage::COMMAND => ModuleEventKind::Command { module, command: ModuleCommand::Step, by: None },
        EventMessage::RESULT => {
            ModuleEventKind::JobResult { module, job: message.port, number: message.number }
        }
        EventMessage::TAKEN => ModuleEventKind::Taken { module, step: message.number, count: message.count },
        _ => return None,
    };
    Some(ModuleEvent { time: Time::from_nanos(message.stamp.as_nanos()), cycle: message.cycle, kind })
}

fn change(message: ModuleSettings) -> SettingsChange {
    let settings = message.settings.into_iter();
    let settings = settings.filter_map(|setting| Some((setting.name, setting_value(setting.value).ok()?)));
    SettingsChange {
        time: Time::from_nanos(message.stamp.as_nanos()),
        module: message.module.into(),
        step: Some(message.step).filter(|step| *step > 0),
        settings: settings.collect(),
    }
}
