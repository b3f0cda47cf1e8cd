//! The core's container of a module: its runs and its lifecycle.

use std::any::Any;
use std::collections::VecDeque;
use std::fmt::{self, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use super::behaviour::Behaviour;
use super::causes::{Asked, Causes, MODULES, TIMERS};
use super::id::Place;
use super::input::Input;
use super::link::Delivery;
use super::port::{ModuleChange, ModuleIo, Port, Views};
use crate::observe::{Badge, ModuleMeter, Span};
use crate::threads::{ReceiptSender, Watch, end_of, sentence};
use crate::{Context, LifeStep, LifecycleState, Role, SettingValue, Time, Transition, TransitionRefused};

pub(crate) struct ModuleCell {
    pub(crate) io: ModuleIo,
    /// `Some` until the cell is dropped.
    behaviour: Option<Box<dyn Behaviour>>,
    /// True if the module is active and its callbacks can run without preparation.
    is_plain: bool,
    /// The kinds of callbacks that every run calls.
    always: Causes,
    /// The causes of the next run, collected while the module is inactive or paused.
    waiting: Causes,
    state: LifecycleState,
    hold: Hold,
    transitions: VecDeque<(Transition, TransitionReceipt)>,
    watch: Option<Watch>,
    badge: Badge,
    panic: Option<String>,
    /// The message of the panic in one sentence.
    failure: Option<Arc<str>>,
    pub(crate) meter: ModuleMeter,
    /// The last run in a measured cycle.
    pub(crate) span: Option<Span>,
    /// The causes of the last run; none if no callback was called.
    ran: Causes,
    /// Answers of a module on another thread that are sent once its run has been.
    answers: Vec<Box<dyn FnOnce() + Send>>,
}

type TransitionReceipt = Option<ReceiptSender<Result<LifecycleState, TransitionRefused>>>;

/// Whether a module is paused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Hold {
    Free,
    Held,
    /// Paused after the next run.
    Step,
}

impl ModuleCell {
    /// A new module, with transitions to `initial`.
    pub(crate) fn new(
        io: ModuleIo,
        behaviour: Box<dyn Behaviour>,
        initial: LifecycleState,
        watch: Option<Watch>,
        meter: ModuleMeter,
    ) -> Self {
        let transitions: &[_] = match initial {
            LifecycleState::Unconfigured => &[],
            LifecycleState::Inactive => &[Transition::Configure],
            LifecycleState::Active => &[Transition::Configure, Transition::Activate],
            LifecycleState::Finalized => &[Transition::Shutdown],
        };
        let badge = Badge::new(Arc::clone(&io.name));
        Self {
            io,
            is_plain: false,
            always: behaviour.always(),
            behaviour: Some(behaviour),
            waiting: Causes::NONE,
            state: LifecycleState::Unconfigured,
            hold: Hold::Free,
            transitions: transitions.iter().map(|&transition| (transition, None)).collect(),
            watch,
            badge,
            panic: None,
            failure: None,
            meter,
            span: None,
            ran: Causes::NONE,
            answers: Vec::new(),
        }
    }

    pub(crate) fn name(&self) -> &Arc<str> {
        &self.io.name
    }

    #[inline]
    pub(crate) fn port<P: Port>(&mut self, mechanism: usize) -> Option<&mut P> {
        self.io.port(mechanism)
    }

    pub(crate) fn state(&self) -> LifecycleState {
        self.state
    }

    /// True after the last callback or a panic.
    pub(crate) fn has_ended(&self) -> bool {
        self.state == LifecycleState::Finalized
    }

    /// Takes the message of the panic that ended the module.
    pub(crate) fn take_panic(&mut self) -> Option<String> {
        self.panic.take()
    }

    /// Takes the causes of the last run, and those of callbacks outside of runs.
    #[inline]
    pub(crate) fn take_ran(&mut self) -> Causes {
        std::mem::take(&mut self.ran)
    }

    pub(crate) fn hold(&mut self, hold: Hold) {
        self.hold = hold;
        self.is_plain = false;
    }

    pub(crate) fn is_paused(&self) -> bool {
        self.hold != Hold::Free
    }

    /// Checks a new value of a setting with the module's closures.
    pub(crate) fn accept_setting(&mut self, setting: usize, value: &SettingValue) -> Result<(), String> {
        let Some(behaviour) = &mut self.behaviour else { return Ok(()) };
        let check = AssertUnwindSafe(|| behaviour.accept_setting(setting, value));
        catch_unwind(check)
            .unwrap_or_else(|panic| Err(format!("the module's check of it panicked: {}", end_of(panic))))
    }

    /// The module as it describes itself; `None` if it does not.
    pub(crate) fn debug(&self) -> Option<String> {
        let behaviour = self.behaviour.as_ref()?;
        let describe = || {
            let mut text = Limited::default();
            // An error is the end of the space.
            let _ = write!(text, "{:#?}", behaviour.debug()?);
            Some(text.finish())
        };
        catch_unwind(AssertUnwindSafe(describe))
            .unwrap_or_else(|panic| Some(format!("its Debug panicked: {}", end_of(panic))))
    }

    /// Adds causes of a run. Returns true if the module has to run now, regardless of due times.
    pub(crate) fn has_work(&mut self, causes: Causes) -> bool {
        if !causes.is_empty() {
            self.waiting.add(causes);
            self.is_plain = false;
        }
        match self.hold {
            Hold::Held => false,
            Hold::Step => true,
            Hold::Free => {
                // A module that is not active has to refuse its requests.
                let is_active = self.state == LifecycleState::Active;
                let has_cause =
                    if is_active { !self.waiting.is_empty() } else { self.waiting.has(Causes::REQUESTS) };
                has_cause || !self.transitions.is_empty()
            }
        }
    }

    /// Adjusts the timers after the clock has gone back to `now`.
    #[cold]
    pub(crate) fn go_back(&mut self, now: Time) {
        self.io.changed(ModuleChange::ClockWentBack(now));
    }

    /// The earliest time at which a timer fires, a task is due or a call times out.
    pub(crate) fn next_due(&self) -> Time {
        if self.state != LifecycleState::Active || self.hold == Hold::Held {
            return Time::MAX;
        }
        self.io.due()
    }

    /// As [`run`](Self::run), in a span of `tracing`.
    #[cold]
    pub(crate) fn run_in_span(&mut self, causes: Causes, views: &Views, now: Time) -> Asked {
        let _span = tracing::trace_span!("run", module = &*self.io.name).entered();
        self.run(causes, views, now)
    }

    /// Runs the module inside a cycle. Returns the mechanisms that received requests.
    #[inline(always)]
    pub(crate) fn run(&mut self, causes: Causes, views: &Views, now: Time) -> Asked {
        self.io.received = 0;
        self.run_with(causes, Input::Views(views), now, |behaviour, causes, ctx| behaviour.run(causes, ctx));
        self.meter.ran(self.io.received);
        self.take_asked()
    }

    /// The mechanisms that received requests since the last call.
    #[inline]
    pub(crate) fn take_asked(&mut self) -> Asked {
        std::mem::take(&mut self.io.asked)
    }

    /// Runs the module outside of a cycle, on shared batches.
    ///
    /// Batches of several cycles may arrive together. A part receives them in the order of subscription, as
    /// if they belonged to one cycle, because a replay delivers them in this order. An observer, which is not
    /// replayed but may record its input, receives them in the order of the cycles.
    pub(crate) fn run_detached(&mut self, causes: Causes, deliveries: &[Delivery], role: Role, now: Time) {
        let _span = tracing::trace_span!("run", module = &*self.io.name).entered();
        self.run_with(causes, Input::Batches(deliveries), now, |behaviour, causes, ctx| {
            if role == Role::Part || deliveries.len() < 2 {
                return behaviour.run(causes, ctx);
            }
            let before = causes.before(Causes::MESSAGES);
            behaviour.run(before, ctx);
            for delivery in deliveries {
                let ctx = &mut ctx.with_input(Input::Batches(std::slice::from_ref(delivery)));
                behaviour.run(Causes::MESSAGES, ctx);
            }
            behaviour.run(causes.without(before.and(Causes::MESSAGES)), ctx);
        });
    }

    #[inline(always)]
    fn run_with(
        &mut self,
        mut causes: Causes,
        input: Input<'_>,
        now: Time,
        run: impl FnOnce(&mut dyn Behaviour, Causes, &mut Context<'_>),
    ) {
        if !self.is_plain {
            match self.prepare(causes, input, now) {
                Some(all) => causes = all,
                None => return,
            }
        }
        causes.add(self.always);
        self.ran = causes;
        let Self { io, behaviour: Some(behaviour), watch, badge, .. } = self else { return };
        io.run += 1;
        let _worn = badge.wear();
        if let Some(watch) = watch {
            watch.begin();
        }
        let outcome = catch_unwind(AssertUnwindSafe(|| {
            run(&mut **behaviour, causes, &mut Context::new(io, now, input));
        }));
        badge.end();
        if let Some(watch) = watch
            && watch.end()
        {
            self.meter.overran(1);
        }
        if let Err(panic) = outcome {
            self.end_by_panic(panic, None);
        }
    }

    pub(crate) fn transition_later(&mut self, transition: Transition, receipt: TransitionReceipt) {
        self.transitions.push_back((transition, receipt));
        self.is_plain = false;
    }

    /// Runs the module's last callback.
    pub(crate) fn shutdown(&mut self, input: Input<'_>, now: Time) {
        if self.has_ended() {
            return;
        }
        let transition = Transition::Shutdown;
        self.ran.add(Causes::STOP);
        self.report(LifeStep::Begins { transition, from: self.state });
        self.guarded(transition, input, now, |behaviour, ctx| {
            // A shutdown cannot fail.
            let _ = behaviour.transition(transition, ctx);
        });
        if !self.has_ended() {
            self.end();
            self.report(LifeStep::Made { transition, to: self.state });
        }
    }

    /// Prepares a run that is not plain. Returns `None` if no callback may run.
    #[cold]
    fn prepare(&mut self, causes: Causes, input: Input<'_>, now: Time) -> Option<Causes> {
        self.ran = Causes::NONE;
        // Messages to a paused or inactive module are dropped.
        self.waiting.add(causes.without(Causes::MESSAGES));
        match self.hold {
            Hold::Free => {}
            Hold::Held => return None,
            Hold::Step => self.hold = Hold::Held,
        }
        if !self.transitions.is_empty() {
            self.make_transitions(input, now);
        }
        if self.state != LifecycleState::Active {
            self.refuse_requests();
            self.waiting = self.waiting.without(Causes::REQUESTS);
            return None;
        }
        self.is_plain = self.hold == Hold::Free;
        let mut all = std::mem::take(&mut self.waiting);
        all.add(causes);
        all.add(self.ran);
        Some(all)
    }

    fn make_transitions(&mut self, input: Input<'_>, now: Time) {
        self.io.ask(TIMERS);
        self.ran.add(Causes::TRANSITION);
        while let Some((transition, receipt)) = self.transitions.pop_front() {
            let outcome = self.make_transition(transition, input, now);
            if let Err(refused) = &outcome {
                tracing::error!("{refused}");
                // Later transitions are impossible too; only those with a receipt need an answer.
                self.transitions.retain(|(_, receipt)| receipt.is_some());
            }
            if let Some(receipt) = receipt {
                self.answer(|| receipt.send(outcome));
            }
        }
    }

    /// Gives an answer to what another thread has asked of the module. Whoever has it must find in the core
    /// what it says, so a detached module answers after its run has been posted there.
    pub(crate) fn answer(&mut self, answer: impl FnOnce() + Send + 'static) {
        match self.io.id.place {
            Place::Attached(_) => answer(),
            Place::Detached(_) => self.answers.push(Box::new(answer)),
        }
    }

    /// Gives the answers that wait for the end of a run.
    pub(crate) fn give_answers(&mut self) {
        self.answers.drain(..).for_each(|answer| answer());
    }

    fn make_transition(
        &mut self,
        transition: Transition,
        input: Input<'_>,
        now: Time,
    ) -> Result<LifecycleState, TransitionRefused> {
        let module = Arc::clone(self.name());
        let Some(target) = transition.from(self.state) else {
            return Err(TransitionRefused::WrongState { module, transition, state: self.state });
        };
        self.report(LifeStep::Begins { transition, from: self.state });
        let mut result = Ok(());
        self.guarded(transition, input, now, |behaviour, ctx| result = behaviour.transition(transition, ctx));
        if self.has_ended() {
            return Err(TransitionRefused::Panicked { module, transition });
        }
        if let Err(reason) = result {
            self.report(LifeStep::Failed { transition, state: self.state });
            let (state, reason) = (self.state, reason.to_string());
            return Err(TransitionRefused::ByModule { module, transition, state, reason });
        }
        tracing::debug!(module = &*module, "{transition}: {} to {target}", self.state);
        match transition {
            Transition::Activate => self.io.changed(ModuleChange::Activated(now)),
            Transition::Deactivate => {
                self.io.changed(ModuleChange::Deactivated);
                self.refuse_requests();
            }
            Transition::Shutdown => self.refuse_requests(),
            Transition::Configure | Transition::Cleanup => {}
        }
        self.state = target;
        self.report(LifeStep::Made { transition, to: target });
        Ok(target)
    }

    /// Runs a callback and catches its panic. A panic ends only this module, and discards the requests of the
    /// run.
    fn guarded(
        &mut self,
        transition: Transition,
        input: Input<'_>,
        now: Time,
        run: impl FnOnce(&mut dyn Behaviour, &mut Context<'_>),
    ) {
        let Self { io, behaviour: Some(behaviour), watch, badge, .. } = self else { return };
        let _worn = badge.wear();
        if let Some(watch) = watch {
            watch.begin();
        }
        let outcome =
            catch_unwind(AssertUnwindSafe(|| run(&mut **behaviour, &mut Context::new(io, now, input))));
        badge.end();
        if let Some(watch) = watch
            && watch.end()
        {
            self.meter.overran(1);
        }
        if let Err(panic) = outcome {
            self.end_by_panic(panic, Some(transition));
        }
    }

    #[cold]
    fn end_by_panic(&mut self, panic: Box<dyn Any + Send>, transition: Option<Transition>) {
        let from = self.state;
        self.io.asked = Asked::of(MODULES);
        self.io.changed(ModuleChange::Panicked);
        self.meter.panicked();
        self.failure = Some(sentence(&*panic).into());
        self.panic = Some(end_of(panic));
        self.end();
        self.report(LifeStep::Panicked { transition, from });
    }

    fn report(&self, step: LifeStep) {
        self.io.link.listeners.report(&self.io.name, step);
    }

    fn end(&mut self) {
        self.state = LifecycleState::Finalized;
        self.is_plain = false;
        self.io.ask(TIMERS);
        self.refuse_requests();
        for (transition, receipt) in self.transitions.drain(..) {
            if let Some(receipt) = receipt {
                let (module, state) = (Arc::clone(&self.io.name), LifecycleState::Finalized);
                receipt.send(Err(TransitionRefused::WrongState { module, transition, state }));
            }
        }
    }

    /// Answers the open requests to this module with an error.
    pub(crate) fn refuse_requests(&mut self) {
        let name = Arc::clone(&self.io.name);
        self.is_plain = false;
        self.io.changed(ModuleChange::Inactive { module: &name, failure: self.failure.as_ref() });
    }
}

/// The most bytes of a description.
const MOST_DESCRIBED: usize = 64 * 1024;

/// Text up to [`MOST_DESCRIBED`] bytes.
#[derive(Default)]
struct Limited {
    text: String,
    is_cut: bool,
}

impl Limited {
    fn finish(mut self) -> String {
        if self.is_cut {
            self.text.push_str("\n…");
        }
        self.text
    }
}

impl Write for Limited {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let room = MOST_DESCRIBED.saturating_sub(self.text.len());
        let end = (0..=room.min(text.len())).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0);
        self.text.push_str(&text[..end]);
        self.is_cut = end < text.len();
        if self.is_cut { Err(fmt::Error) } else { Ok(()) }
    }
}

impl Drop for ModuleCell {
    /// Catches a panic in the module's destructor, which must not affect other modules or the core.
    fn drop(&mut self) {
        let behaviour = self.behaviour.take();
        if let Err(panic) = catch_unwind(AssertUnwindSafe(|| drop(behaviour))) {
            tracing::error!(module = &*self.io.name, "panicked while it was dropped: {}", end_of(panic));
        }
        self.io.changed(ModuleChange::Panicked);
    }
}
