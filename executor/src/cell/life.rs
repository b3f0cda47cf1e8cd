//! A module's life: transitions, and its end by the last callback or by a panic.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use super::{Hold, ModuleCell, TransitionReceipt};
use crate::asked::Asked;
use crate::behaviour::Behaviour;
use crate::guard::{drop_guarded, end_of};
use crate::module_io::Shared;
use crate::{Context, LifeStep, LifecycleState, Time, Transition, TransitionRefused};

impl ModuleCell {
    pub(crate) fn transition_later(&mut self, transition: Transition, receipt: TransitionReceipt) {
        self.transitions.push_back((transition, receipt));
    }

    /// Runs the module's last callback.
    pub(crate) fn shutdown(&mut self, shared: Option<&Shared>, now: Time) {
        if self.has_ended() {
            return;
        }
        let transition = Transition::Shutdown;
        self.tell(LifeStep::Begins { transition, from: self.state });
        self.guarded(transition, now, shared, |behaviour, ctx| {
            // Has no way to fail.
            let _ = behaviour.transition(transition, ctx);
        });
        if !self.has_ended() {
            self.end();
            self.tell(LifeStep::Made { transition, to: self.state });
        }
    }

    /// What comes before the callbacks of a run, where there is something. False if none may run.
    #[cold]
    pub(super) fn prepare(&mut self, now: Time, shared: Option<&Shared>) -> bool {
        match self.hold {
            Hold::Free => {}
            Hold::Held => return false,
            Hold::Step => self.hold = Hold::Held,
        }
        if !self.transitions.is_empty() {
            self.make_transitions(now, shared);
        }
        let is_active = self.state == LifecycleState::Active;
        if !is_active {
            self.abandon();
        }
        is_active
    }

    fn make_transitions(&mut self, now: Time, shared: Option<&Shared>) {
        self.io.asked.add(Asked::STATE);
        while let Some((transition, receipt)) = self.transitions.pop_front() {
            let outcome = self.make_transition(transition, now, shared);
            if let Err(refused) = &outcome {
                tracing::error!("{refused}");
                // What was to follow it has no ground to stand on; who waits for an answer is told so in turn.
                self.transitions.retain(|(_, receipt)| receipt.is_some());
            }
            if let Some(receipt) = receipt {
                receipt.send(outcome);
            }
        }
    }

    fn make_transition(
        &mut self,
        transition: Transition,
        now: Time,
        shared: Option<&Shared>,
    ) -> Result<LifecycleState, TransitionRefused> {
        let module = Arc::clone(self.name());
        let Some(target) = transition.from(self.state) else {
            return Err(TransitionRefused::WrongState { module, transition, state: self.state });
        };
        self.tell(LifeStep::Begins { transition, from: self.state });
        let mut result = Ok(());
        self.guarded(transition, now, shared, |behaviour, ctx| {
            result = behaviour.transition(transition, ctx)
        });
        if self.has_ended() {
            return Err(TransitionRefused::Panicked { module, transition });
        }
        if let Err(reason) = result {
            self.tell(LifeStep::Failed { transition, state: self.state });
            let (state, reason) = (self.state, reason.to_string());
            return Err(TransitionRefused::ByModule { module, transition, state, reason });
        }
        tracing::debug!(module = &*module, "{transition}: {} to {target}", self.state);
        match transition {
            Transition::Activate => self.io.timers.iter_mut().for_each(|timer| timer.start(now)),
            Transition::Deactivate => {
                self.io.timers.iter_mut().for_each(|timer| timer.stop());
                self.io.tasks.cancel_all();
                self.abandon();
            }
            Transition::Shutdown => self.abandon(),
            Transition::Configure | Transition::Cleanup => {}
        }
        self.state = target;
        self.tell(LifeStep::Made { transition, to: target });
        Ok(target)
    }

    /// A panic ends the module, and only it: what it asked for in this run is discarded.
    fn guarded(
        &mut self,
        transition: Transition,
        now: Time,
        shared: Option<&Shared>,
        run: impl FnOnce(&mut dyn Behaviour, &mut Context<'_>),
    ) {
        let _worn = self.badge.wear();
        let Self { io, behaviour: Some(behaviour), watch, .. } = self else { return };
        if let Some(watch) = watch {
            watch.begin();
        }
        let outcome =
            catch_unwind(AssertUnwindSafe(|| run(&mut **behaviour, &mut Context::new(io, now, shared))));
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
    pub(super) fn end_by_panic(&mut self, panic: Box<dyn Any + Send>, transition: Option<Transition>) {
        let from = self.state;
        drop_guarded("a message", || self.io.discard());
        self.io.asked = Asked::PANIC;
        self.meter.panicked();
        self.panic = Some(end_of(panic));
        self.end();
        self.tell(LifeStep::Panicked { transition, from });
    }

    fn tell(&self, step: LifeStep) {
        self.io.queue.listeners.tell(&self.io.name, step);
    }

    fn end(&mut self) {
        self.state = LifecycleState::Finalized;
        self.io.asked.add(Asked::STATE);
        self.abandon();
        for (transition, receipt) in self.transitions.drain(..) {
            if let Some(receipt) = receipt {
                let (module, state) = (Arc::clone(&self.io.name), LifecycleState::Finalized);
                receipt.send(Err(TransitionRefused::WrongState { module, transition, state }));
            }
        }
    }

    /// Those who wait for an answer of this module are told that there will be none.
    fn abandon(&mut self) {
        for server in &mut self.io.servers {
            drop_guarded("a request", || server.abandon(&self.io.name));
            if server.has_answers() {
                self.io.asked.add(Asked::ANSWERS);
            }
        }
    }
}
