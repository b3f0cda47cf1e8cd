//! The mechanism "messaging": topics, the outboxes of publishers, the batches of subscribers.

mod inlet;
mod outlet;
mod runs;

use std::any::Any;
use std::collections::VecDeque;
use std::sync::Arc;

use inlet::AnyInlet;
pub use inlet::{Inlet, InletError};
use outlet::Outlets;
pub use outlet::{Outlet, OutletGate, OutletInbox};
use runs::RunLog;
pub use runs::{CycleRuns, ModuleRun, Published, RunCause, RunCauses, WiredModule, Wiring};

use super::Services;
use crate::cycle::{Agenda, CoreState, DetachedModule, Mechanisms};
use crate::module::{
    Asked, Causes, Delivery, Direction, Host, Input, MESSAGES, Place, SERVICES, StepOutcome, Use, UseEnds,
};
use crate::topics::{AnyBatch, AnyOutbox, Batch, Outboxes, Report, Subscriber, Topics, for_each_message};
use crate::{
    AnyMessage, AnyPublication, AnyReceived, Context, Core, CoreHandle, Mechanism, MessageType, Module,
    ModuleChange, ModuleId, OutletStatistics, Port, Publication, Receipt, Received, Role, Setup, SetupError,
    Stage, Step, SyncPhase, Time, TopicInfo, TraceCause, Version,
};

/// The order of messages is: those of inlets, in the order in which the inlets were made; those of detached
/// modules, in the order of their runs; those of the other modules, in the order of registration.
#[derive(Default)]
pub(crate) struct Messages {
    inlets: Vec<Box<dyn AnyInlet>>,
    outlets: Outlets,
    /// Messages of detached modules since the last sync phase.
    joined: VecDeque<(Step, Vec<Box<dyn AnyOutbox>>)>,
    /// The account of runs, if it has receivers.
    runs: Option<Box<RunLog>>,
}

impl Mechanism for Messages {
    type View = Topics;
    type Port = Outboxes;

    const NAME: &'static str = "messaging";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) -> Topics {
        Topics::default()
    }

    #[inline]
    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        let are_inlets_announced = phase.is_announced(MESSAGES);
        let SyncPhase { stage, state, mechanisms, now, .. } = &mut *phase;
        let topics = &mut stage.views.topics;
        topics.begin();
        let notes_runs = topics.hears::<Arc<CycleRuns>>();
        if notes_runs {
            self.begin_account(topics, state, mechanisms, *now);
        }
        if are_inlets_announced {
            self.take_inlets(topics, *now, &mut state.agenda);
        }
        if topics.has_reports() {
            topics.take_reports(*now, &mut |slot| state.agenda.wake(slot, Causes::MESSAGES));
        }
        if !state.steps.is_empty() {
            self.join_steps(topics, state, *now);
        }
        let messaging = Asked::of(MESSAGES);
        if notes_runs {
            self.take_runs(stage, state, *now);
            // An account includes runs that published nothing, so it does not wait for messages.
            mechanisms.next.add(messaging);
        } else {
            for asker in &state.askers.list {
                if asker.asked.has(messaging)
                    && let Some(cell) = stage.cells.get(asker.slot)
                {
                    let mut messages = 0;
                    cell.io.outboxes.drain(|topic, outbox| {
                        let wake = |slot| state.agenda.wake(slot, Causes::MESSAGES);
                        messages += topics.absorb_for(topic, outbox, *now, wake);
                    });
                    cell.meter.published(messages);
                }
            }
        }
        let topics = &mut stage.views.topics;
        topics.finish();
        if topics.is_any_fresh() {
            // The fresh messages must be retired in the next sync phase.
            mechanisms.next.add(messaging);
        }
        if !topics.shared().is_empty() && self.share(topics, state) {
            mechanisms.begin.add(messaging);
        }
    }

    fn started(&mut self, phase: &mut SyncPhase<'_>) {
        phase.topics().open_report::<Arc<CycleRuns>>();
        phase.mechanisms.next.add(Asked::of(MESSAGES));
    }

    fn join(&mut self, step: Step, part: Box<dyn Any + Send>) {
        if let Ok(outboxes) = part.downcast() {
            self.joined.push_back((step, *outboxes));
        }
    }

    fn process_begins(&mut self) {
        self.outlets.run_waiting();
    }

    fn stopped(&mut self) {
        self.outlets.stop();
    }
}

/// A module's part of the mechanism "messaging".
impl Port for Outboxes {
    fn changed(&mut self, change: ModuleChange<'_>) -> bool {
        if let ModuleChange::Panicked = change {
            self.drain(|_, outbox| outbox.discard());
        }
        false
    }

    fn split_off(&mut self) -> Option<Box<dyn Any + Send>> {
        let mut outboxes = Vec::new();
        self.drain(|_, outbox| outboxes.push(outbox.split_off()));
        Some(Box::new(outboxes))
    }
}

impl Messages {
    #[inline(never)] // Together with the rest it makes every sync phase slower.
    fn take_inlets(&mut self, topics: &mut Topics, now: Time, agenda: &mut Agenda) {
        for inlet in &mut self.inlets {
            let messages = inlet.drain(topics, now, &mut |slot| agenda.wake(slot, Causes::MESSAGES));
            if let Some(runs) = &mut self.runs {
                runs.inlet(inlet.topic(), messages);
            }
        }
        self.inlets.retain(|inlet| {
            let is_orphaned = inlet.is_orphaned();
            if is_orphaned {
                topics.release_publisher(inlet.topic());
            }
            !is_orphaned
        });
    }

    #[inline(never)]
    fn begin_account(&mut self, topics: &Topics, state: &CoreState, mechanisms: &Mechanisms, now: Time) {
        if let Some(services) = mechanisms.get::<Services>(SERVICES) {
            self.runs.get_or_insert_default().begin(topics, state, services, now);
        }
    }

    /// Takes the messages of the modules inside the cycle, and publishes the account of runs.
    #[inline(never)]
    fn take_runs(&mut self, stage: &mut Stage, state: &mut CoreState, now: Time) {
        if let Some(runs) = &mut self.runs {
            runs.take_runs(stage, state, now);
            runs.end(&mut stage.views.topics, state, now);
        }
    }

    /// Passes the batches of this cycle to detached modules and outlets. Returns true if sinks have to run in
    /// the next cycle.
    #[inline(never)]
    fn share(&mut self, topics: &mut Topics, state: &mut CoreState) -> bool {
        let (mut is_any_detached, mut is_any_outlet) = (false, false);
        for &topic in topics.shared() {
            for subscriber in topics.others(topic) {
                match *subscriber {
                    Subscriber::Detached(slot) => {
                        is_any_detached = true;
                        if let Some(module) = &mut state.detached[slot] {
                            let (batch, messages) = topics.share(topic);
                            module.deliver(Delivery { topic, batch, messages, missed: 0 });
                        }
                    }
                    Subscriber::Outlet(slot) => {
                        is_any_outlet = true;
                        self.outlets.deliver(topics, slot);
                    }
                    Subscriber::Attached(_) => {}
                }
            }
        }
        if is_any_detached {
            state.detached.iter_mut().flatten().for_each(DetachedModule::dispatch);
        }
        is_any_outlet && self.outlets.dispatch(topics)
    }

    #[inline(never)]
    fn join_steps(&mut self, topics: &mut Topics, state: &mut CoreState, now: Time) {
        let steps = std::mem::take(&mut state.steps);
        for outcome in &steps {
            self.join_step(topics, state, outcome, now);
        }
        state.steps = steps;
    }

    fn join_step(&mut self, topics: &mut Topics, state: &mut CoreState, outcome: &StepOutcome, now: Time) {
        let mut outboxes = Vec::new();
        let is_its = |step: &Step| (step.module, step.number) == (outcome.module, outcome.number);
        if self.joined.front().is_some_and(|(step, _)| is_its(step)) {
            outboxes = self.joined.pop_front().map(|(_, published)| published).unwrap_or_default();
        }
        let Some(member) = state.members.get(outcome.module.order) else { return };
        let (role, module) = (member.role(), Arc::clone(&member.name));
        let cycle = state.cycle;
        let mut wake = |slot| state.agenda.wake(slot, Causes::MESSAGES);
        let mut published = 0;
        for outbox in &mut outboxes {
            let messages = topics.absorb(&mut **outbox, now, &mut wake);
            published += messages;
            if let Some(runs) = &mut self.runs {
                runs.publishes(outbox.topic(), messages);
            }
        }
        if let Some(runs) = &mut self.runs {
            runs.stepped(outcome);
        }
        let mut received = 0;
        for input in &outcome.inputs {
            received += input.received as usize;
            topics.meter_mut(input.topic).dropped(u64::from(input.skipped));
        }
        if let Place::Detached(slot) = outcome.module.place
            && let Some(detached) = state.detached[slot].as_mut()
        {
            let meter = &mut detached.meter;
            meter.ran(received);
            meter.published(published);
            meter.dropped(outcome.inputs.iter().map(|input| u64::from(input.skipped)).sum());
            if let Some(span) = &outcome.span {
                let due = outcome.was_due.then_some(outcome.time);
                let causes = || {
                    let received = outcome.inputs.iter().filter(|input| input.received > 0);
                    let messages =
                        received.map(|input| TraceCause::Messages(Arc::clone(topics.name(input.topic))));
                    messages.chain(due.map(|_| TraceCause::Time)).collect()
                };
                state.inspector.stepped(meter, &module, cycle, span, due, causes);
            }
        }
        // The steps of an observer are no input of the robot, and publishing them would keep an observer that
        // records steps running without end.
        if role != Role::Part || !topics.hears::<DetachedStep>() {
            return;
        }
        let inputs = outcome.inputs.iter().map(|input| StepInput {
            topic: Arc::clone(topics.name(input.topic)),
            skipped: input.skipped,
            received: input.received,
        });
        let step = DetachedStep {
            time: outcome.time,
            module,
            step: outcome.number,
            cycle,
            is_stop: outcome.is_stop,
            inputs: inputs.collect(),
        };
        topics.report(step);
        topics.take_reports(now, &mut |slot| state.agenda.wake(slot, Causes::MESSAGES));
    }

    /// The inboxes of outlets, each with the topics of its outlets.
    pub(crate) fn connections(&self) -> impl Iterator<Item = (&Arc<str>, impl Iterator<Item = usize>)> {
        self.outlets.connections()
    }

    pub(crate) fn outlet_statistics(&self) -> Vec<OutletStatistics> {
        self.outlets.statistics()
    }

    pub(crate) fn has_outlets(&self) -> bool {
        !self.outlets.is_empty()
    }
}

/// One run of a detached module, published on [`DetachedStep::TOPIC`] if the topic has subscribers. A replay
/// uses it to run the module again on the same inputs at the same times.
#[derive(Clone, Debug, PartialEq)]
pub struct DetachedStep {
    /// The time that the module was given.
    pub time: Time,
    /// The module's name.
    pub module: Arc<str>,
    /// The number of the run, from 0.
    pub step: u64,
    /// The cycle in which the messages of the run were published.
    pub cycle: u64,
    /// True for the module's last callback. Neither the first nor the last run receives messages.
    pub is_stop: bool,
    /// The input by topic; topics without messages are left out.
    pub inputs: Vec<StepInput>,
}

/// The messages of one topic in the input of a detached module's run.
#[derive(Clone, Debug, PartialEq)]
pub struct StepInput {
    /// The topic.
    pub topic: Arc<str>,
    /// The number of messages that the full inbox had dropped before.
    pub skipped: u32,
    /// The number of messages that the callback received, after the skipped ones.
    pub received: u32,
}

impl DetachedStep {
    /// The topic on which steps are published.
    pub const TOPIC: &'static str = "executor/steps";
}

impl Report for DetachedStep {
    const TOPIC: &'static str = Self::TOPIC;
    const NUMBER: usize = 0;
}

impl SyncPhase<'_> {
    /// The mechanism, unless it is running.
    fn messages(&mut self) -> Option<&mut Messages> {
        self.mechanisms.get_mut(MESSAGES)
    }

    pub(crate) fn topics(&mut self) -> &mut Topics {
        &mut self.stage.views.topics
    }

    /// Publishes a report of the executor with the messages of this cycle, or of the next if this cycle's
    /// messages have been published.
    pub(crate) fn report<R: Report>(&mut self, report: R) {
        self.topics().report(report);
        self.mechanisms.next.add(Asked::of(MESSAGES));
        self.take_part(MESSAGES);
    }
}

fn topics_of(host: &mut dyn Host) -> &mut Topics {
    match host.view(MESSAGES).and_then(|view| view.downcast_mut()) {
        Some(topics) => topics,
        None => unreachable!("every core has topics"),
    }
}

fn subscriber(module: ModuleId) -> Subscriber {
    match module.place {
        Place::Attached(slot) => Subscriber::Attached(slot),
        Place::Detached(slot) => Subscriber::Detached(slot),
    }
}

impl<M: Module> Setup<'_, M> {
    /// The topics that have been declared so far.
    pub fn topics(&self) -> impl Iterator<Item = &TopicInfo> {
        let topics = self.host.look(MESSAGES).and_then(|view| view.downcast_ref::<Topics>());
        topics.into_iter().flat_map(Topics::infos)
    }

    /// Declares that the module publishes messages of type `T` on a topic; the key is for
    /// [`Context::publish`].
    ///
    /// # Errors
    /// If the name is invalid, or the topic carries another type.
    pub fn publish<T: Send + Sync + 'static>(&mut self, topic: &str) -> Result<Publication<T>, SetupError> {
        let index = self.open_topic(topic, MessageType::of::<T>())?;
        self.use_to_publish(index);
        Ok(self.io.outboxes.open(index))
    }

    /// As [`publish`](Self::publish), for a message type known only at run time, as in modules in other
    /// languages. The key is for [`Context::publish_any`].
    ///
    /// # Errors
    /// As for [`publish`](Self::publish).
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, MessageType, Module, Setup, SetupError, Time};
    /// /// Repeats the messages of one topic on another, whatever their type.
    /// struct Relay(MessageType);
    ///
    /// impl Module for Relay {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         let out = setup.publish_of(self.0, "out")?;
    ///         setup.subscribe_of(self.0, "in", move |_, received, ctx| {
    ///             if let Some(metres) = received.message.downcast_ref::<f64>() {
    ///                 ctx.publish_any(out, Box::new(*metres));
    ///             }
    ///         })
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("relay", Relay(MessageType::of::<f64>()))?;
    /// core.inlet("in")?.publish(1.5)?;
    /// (0..2).try_for_each(|_| core.cycle())?;
    /// assert_eq!(core.topics().find(|topic| &*topic.name == "out").unwrap().counter.messages(), 1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn publish_of(&mut self, message: MessageType, topic: &str) -> Result<AnyPublication, SetupError> {
        let index = self.open_topic(topic, message)?;
        self.use_to_publish(index);
        Ok(self.io.outboxes.open_any(index, |topic| message.outbox(topic)))
    }

    fn use_to_publish(&mut self, index: usize) {
        topics_of(self.host).add_publisher(index);
        self.uses.push(Use {
            of: MESSAGES,
            direction: Direction::Out,
            index,
            ends: UseEnds::AtEnd,
            give_back: |host, _, used| topics_of(host).release_publisher(used.index),
        });
    }

    /// Calls `callback` with each message of a topic, in the cycle after it was published.
    ///
    /// # Errors
    /// If the name is invalid, or the topic carries another type.
    pub fn subscribe<T, F>(&mut self, topic: &str, mut callback: F) -> Result<(), SetupError>
    where
        T: Send + Sync + 'static,
        F: FnMut(&mut M, Received<'_, T>, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        let index = self.open_topic(topic, MessageType::of::<T>())?;
        self.use_to_receive(index);
        self.steps.add(Causes::MESSAGES, move |module, ctx| match ctx.input() {
            Input::Views(views) => {
                if let Some(batch) = views.topics.batch::<T>(index) {
                    ctx.io().received += batch.len();
                    for_each_message(batch, 0, |message| callback(module, message, ctx));
                }
            }
            Input::Batches(deliveries) => {
                for delivery in deliveries.iter().filter(|delivery| delivery.topic == index) {
                    let batch = Arc::clone(&delivery.batch) as Arc<dyn Any + Send + Sync>;
                    if let Ok(batch) = batch.downcast::<Batch<T>>() {
                        for_each_message(&batch, delivery.missed, |message| callback(module, message, ctx));
                    }
                }
            }
        });
        Ok(())
    }

    /// As [`subscribe`](Self::subscribe), for a message type known only at run time; see
    /// [`publish_of`](Self::publish_of).
    ///
    /// # Errors
    /// If the name is invalid, or the topic carries another type.
    pub fn subscribe_of<F>(
        &mut self,
        message: MessageType,
        topic: &str,
        mut callback: F,
    ) -> Result<(), SetupError>
    where
        F: FnMut(&mut M, AnyReceived<'_>, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        let index = self.open_topic(topic, message)?;
        self.use_to_receive(index);
        let mut each =
            move |module: &mut M, ctx: &mut Context<'_, M::Ports>, batch: &dyn AnyBatch, missed| {
                let mut missed = missed;
                batch.visit(&mut |received| {
                    callback(module, AnyReceived { missed: std::mem::take(&mut missed), ..received }, ctx);
                });
            };
        self.steps.add(Causes::MESSAGES, move |module, ctx| match ctx.input() {
            Input::Views(views) => {
                if let Some((batch, messages)) = views.topics.batch_of(index) {
                    ctx.io().received += messages as usize;
                    each(module, ctx, &*batch, 0);
                }
            }
            Input::Batches(deliveries) => {
                for delivery in deliveries.iter().filter(|delivery| delivery.topic == index) {
                    each(module, ctx, &*delivery.batch, delivery.missed);
                }
            }
        });
        Ok(())
    }

    fn use_to_receive(&mut self, index: usize) {
        let topics = topics_of(self.host);
        topics.add_user(index);
        topics.subscribe(index, subscriber(self.io.id));
        self.uses.push(Use {
            of: MESSAGES,
            direction: Direction::In,
            index,
            ends: UseEnds::AtEnd,
            give_back: |host, module, used| {
                topics_of(host).unsubscribe(used.index, subscriber(module));
                topics_of(host).release(used.index);
            },
        });
    }

    fn open_topic(&mut self, name: &str, message: MessageType) -> Result<usize, SetupError> {
        let name = self.remapped(name);
        message.open(topics_of(self.host), &name, &self.io.name)
    }
}

impl<P> Context<'_, P> {
    /// Publishes a message, which subscribers receive in the next cycle.
    #[inline]
    pub fn publish<T: Send + Sync + 'static>(&mut self, publication: Publication<T>, message: T) {
        self.publish_with(publication, |outbox| outbox.push(message));
    }

    /// Publishes several messages; cheaper than one call of [`publish`](Self::publish) for each.
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
    /// # struct Lidar;
    /// # impl Module for Lidar {
    /// #     type Ports = ();
    /// #     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    /// let ranges = setup.publish::<f32>("ranges")?;
    /// setup.subscribe::<Vec<u16>, _>("millimetres", move |_, scan, ctx| {
    ///     ctx.publish_all(ranges, scan.iter().map(|&range| f32::from(range) / 1000.0));
    /// })
    /// #     }
    /// # }
    /// # let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// # core.add("lidar", Lidar)?;
    /// # core.inlet("millimetres")?.publish(vec![100_u16, 200, 300])?;
    /// # (0..2).try_for_each(|_| core.cycle())?;
    /// # assert_eq!(core.topics().find(|topic| &*topic.name == "ranges").unwrap().counter.messages(), 3);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[inline]
    pub fn publish_all<T: Send + Sync + 'static>(
        &mut self,
        publication: Publication<T>,
        messages: impl IntoIterator<Item = T>,
    ) {
        self.publish_with(publication, |outbox| outbox.extend(messages));
    }

    /// Publishes a message whose type is known only at run time.
    ///
    /// # Panics
    /// If the message is not of the type for which the key was made; this stops the module.
    pub fn publish_any(&mut self, publication: AnyPublication, message: AnyMessage) {
        let io = self.io();
        match io.outboxes.add_any(publication, message) {
            Some(true) => io.ask(MESSAGES),
            Some(false) => {}
            None => self.foreign("published a message of another type, or with"),
        }
    }

    /// The topics that carry messages in this cycle (published in the previous one), each with the number of
    /// messages. Empty in a detached module.
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, Setup, SetupError, Synchrony, Time};
    /// /// Counts the messages of all topics.
    /// #[derive(Default)]
    /// struct Count(usize);
    ///
    /// impl Module for Count {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.each_run(|count, ctx| count.0 += ctx.carried().map(|(_topic, messages)| messages).sum::<usize>());
    /// #       setup.each_run(|count, ctx| assert_eq!(count.0, if ctx.now() == Time::ZERO { 0 } else { 2 }));
    ///         Ok(())
    ///     }
    /// }
    ///
    /// # let clock = ManualClock::new(Time::ZERO);
    /// # let mut core = Core::new().with_clock(clock.clone());
    /// let options = ModuleOptions { synchrony: Synchrony::EveryCycle, ..ModuleOptions::default() };
    /// core.add_with("count", Count::default(), options)?;
    /// # let range = core.inlet("range")?;
    /// # [1.0, 1.5].into_iter().try_for_each(|metres| range.publish(metres))?;
    /// # core.cycle()?;
    /// # clock.set(Time::from_nanos(1));
    /// # core.cycle()?;
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn carried(&self) -> impl Iterator<Item = (&Arc<str>, usize)> {
        let topics = match self.input() {
            Input::Views(views) => Some(&views.topics),
            Input::Batches(_) => None,
        };
        topics.into_iter().flat_map(Topics::carried)
    }

    #[inline]
    fn publish_with<T: Send + Sync + 'static>(
        &mut self,
        publication: Publication<T>,
        add: impl FnOnce(&mut Vec<T>),
    ) {
        let io = self.io();
        match io.outboxes.add(publication, add) {
            Some(true) => io.ask(MESSAGES),
            Some(false) => {}
            None => self.foreign("published with"),
        }
    }
}

impl Core {
    /// The topics, in the order in which they were first declared.
    pub fn topics(&self) -> impl Iterator<Item = &TopicInfo> {
        self.stage.views.topics.infos()
    }

    /// Passes the messages of the last cycle to the sinks of outlets now, not in the next cycle: for programs
    /// that look at a core between cycles. Concerns only a core whose clock does not run by itself; other
    /// sinks have threads.
    pub fn run_sinks(&mut self) {
        if let Some(messages) = self.mechanisms.get_mut::<Messages>(MESSAGES) {
            messages.outlets.run_waiting();
        }
    }
}

impl CoreHandle {
    /// The topics, in the order in which they were first declared.
    #[must_use = "the answer is in the receipt"]
    pub fn topics(&self) -> Receipt<Vec<TopicInfo>> {
        self.ask(|phase| phase.topics().infos().cloned().collect())
    }
}
