//! A module with its callbacks, as the executor runs it without knowing its type.

use std::any::Any;
use std::marker::PhantomData;
use std::sync::Arc;

use crate::messaging::{Batch, Position, Topics};
use crate::service::{Incoming, Reply};
use crate::setting::SettingType;
use crate::{Context, Job, JobError, Module, Received, Responder, SettingValue, Transition, TransitionError};

/// One call per callback, or per batch: what is inside is known to the compiler and can be inlined.
pub(crate) trait Behaviour: Send {
    fn transition(&mut self, transition: Transition, ctx: &mut Context<'_>) -> Result<(), TransitionError>;
    /// Calls a subscription with the batch its topic holds.
    fn receive(&mut self, subscription: usize, topics: &Topics, ctx: &mut Context<'_>);
    /// Calls a subscription with a batch of an earlier cycle.
    fn receive_shared(
        &mut self,
        subscription: usize,
        batch: Arc<dyn Any + Send + Sync>,
        missed: u32,
        ctx: &mut Context<'_>,
    );
    fn serve(&mut self, server: usize, ctx: &mut Context<'_>);
    fn replied(&mut self, client: usize, ctx: &mut Context<'_>);
    fn finished(&mut self, job: usize, ctx: &mut Context<'_>);
    fn task(&mut self, task: usize, ctx: &mut Context<'_>);
    fn tick(&mut self, timer: usize, ctx: &mut Context<'_>);
    fn accept_setting(&mut self, setting: usize, value: &SettingValue) -> Result<(), String>;
    fn setting_changed(&mut self, setting: usize, ctx: &mut Context<'_>);
    fn has_each_run(&self) -> bool;
    fn run_ends(&mut self, ctx: &mut Context<'_>);
}

pub(crate) type Callback<M> = Box<dyn FnMut(&mut M, &mut Context<'_, <M as Module>::Ports>) + Send>;
pub(crate) type Check<M> = Box<dyn FnMut(&mut M, &SettingValue) -> Result<(), String> + Send>;

/// A module and its callbacks.
pub(crate) struct ModuleBehaviour<M: Module> {
    pub(crate) module: M,
    pub(crate) ports: M::Ports,
    pub(crate) callbacks: Callbacks<M>,
}

/// The callbacks of a module, by what they are for and in the order in which they were declared.
pub(crate) struct Callbacks<M: Module> {
    pub(crate) subscriptions: Vec<Box<dyn AnySubscription<M>>>,
    pub(crate) servers: Vec<Callback<M>>,
    pub(crate) clients: Vec<Callback<M>>,
    pub(crate) jobs: Vec<Callback<M>>,
    pub(crate) tasks: Vec<Callback<M>>,
    pub(crate) timers: Vec<Callback<M>>,
    pub(crate) checks: Vec<(usize, Check<M>)>,
    pub(crate) settings: Vec<(usize, Callback<M>)>,
    pub(crate) each_run: Vec<Callback<M>>,
}

impl<M: Module> Default for Callbacks<M> {
    fn default() -> Self {
        Self {
            subscriptions: Vec::new(),
            servers: Vec::new(),
            clients: Vec::new(),
            jobs: Vec::new(),
            tasks: Vec::new(),
            timers: Vec::new(),
            checks: Vec::new(),
            settings: Vec::new(),
            each_run: Vec::new(),
        }
    }
}

impl<M: Module> Behaviour for ModuleBehaviour<M> {
    fn transition(&mut self, transition: Transition, ctx: &mut Context<'_>) -> Result<(), TransitionError> {
        let Self { module, ports, .. } = self;
        let ctx = &mut ctx.with_ports(ports);
        match transition {
            Transition::Configure => module.configure(ctx),
            Transition::Activate => module.activate(ctx),
            Transition::Deactivate => module.deactivate(ctx),
            Transition::Cleanup => module.cleanup(ctx),
            Transition::Shutdown => {
                module.shutdown(ctx);
                Ok(())
            }
        }
    }

    fn receive(&mut self, subscription: usize, topics: &Topics, ctx: &mut Context<'_>) {
        self.callbacks.subscriptions[subscription].receive(
            &mut self.module,
            topics,
            &mut ctx.with_ports(&self.ports),
        );
    }

    fn receive_shared(
        &mut self,
        subscription: usize,
        batch: Arc<dyn Any + Send + Sync>,
        missed: u32,
        ctx: &mut Context<'_>,
    ) {
        self.callbacks.subscriptions[subscription].receive_shared(
            &mut self.module,
            batch,
            missed,
            &mut ctx.with_ports(&self.ports),
        );
    }

    fn serve(&mut self, server: usize, ctx: &mut Context<'_>) {
        self.callbacks.servers[server](&mut self.module, &mut ctx.with_ports(&self.ports));
    }

    fn replied(&mut self, client: usize, ctx: &mut Context<'_>) {
        self.callbacks.clients[client](&mut self.module, &mut ctx.with_ports(&self.ports));
    }

    fn finished(&mut self, job: usize, ctx: &mut Context<'_>) {
        self.callbacks.jobs[job](&mut self.module, &mut ctx.with_ports(&self.ports));
    }

    fn task(&mut self, task: usize, ctx: &mut Context<'_>) {
        self.callbacks.tasks[task](&mut self.module, &mut ctx.with_ports(&self.ports));
    }

    fn tick(&mut self, timer: usize, ctx: &mut Context<'_>) {
        self.callbacks.timers[timer](&mut self.module, &mut ctx.with_ports(&self.ports));
    }

    fn accept_setting(&mut self, setting: usize, value: &SettingValue) -> Result<(), String> {
        let mut checks = self.callbacks.checks.iter_mut().filter(|(index, _)| *index == setting);
        checks.try_for_each(|(_, check)| check(&mut self.module, value))
    }

    fn setting_changed(&mut self, setting: usize, ctx: &mut Context<'_>) {
        for (_, callback) in self.callbacks.settings.iter_mut().filter(|(index, _)| *index == setting) {
            callback(&mut self.module, &mut ctx.with_ports(&self.ports));
        }
    }

    fn has_each_run(&self) -> bool {
        !self.callbacks.each_run.is_empty()
    }

    fn run_ends(&mut self, ctx: &mut Context<'_>) {
        for callback in &mut self.callbacks.each_run {
            callback(&mut self.module, &mut ctx.with_ports(&self.ports));
        }
    }
}

/// A callback for the messages of one topic.
pub(crate) trait AnySubscription<M: Module>: Send {
    fn receive(&mut self, module: &mut M, topics: &Topics, ctx: &mut Context<'_, M::Ports>);
    fn receive_shared(
        &mut self,
        module: &mut M,
        batch: Arc<dyn Any + Send + Sync>,
        missed: u32,
        ctx: &mut Context<'_, M::Ports>,
    );
}

pub(crate) struct Subscription<T, F> {
    pub(crate) topic: usize,
    pub(crate) callback: F,
    pub(crate) message: PhantomData<fn(T)>,
}

impl<M: Module, T, F> AnySubscription<M> for Subscription<T, F>
where
    T: Send + Sync + 'static,
    F: FnMut(&mut M, Received<'_, T>, &mut Context<'_, M::Ports>) + Send,
{
    fn receive(&mut self, module: &mut M, topics: &Topics, ctx: &mut Context<'_, M::Ports>) {
        if let Some(topic) = topics.get::<T>(self.topic) {
            for_each_message(topic.batch(), 0, |message| (self.callback)(module, message, ctx));
        }
    }

    fn receive_shared(
        &mut self,
        module: &mut M,
        batch: Arc<dyn Any + Send + Sync>,
        missed: u32,
        ctx: &mut Context<'_, M::Ports>,
    ) {
        if let Ok(batch) = batch.downcast::<Batch<T>>() {
            for_each_message(&batch, missed, |message| (self.callback)(module, message, ctx));
        }
    }
}

/// The first message says how many were missed before it.
#[inline]
pub(crate) fn for_each_message<T>(
    batch: &Arc<Batch<T>>,
    missed: u32,
    mut consume: impl FnMut(Received<'_, T>),
) {
    let mut missed = missed;
    for (segment, messages) in (0_u32..).zip(batch.segments()) {
        for (index, message) in (0_u32..).zip(messages) {
            let missed = std::mem::take(&mut missed);
            consume(Received::new(message, batch, Position { segment, index }, missed));
        }
    }
}

/// The callback for the requests of a service that answers each at once.
pub(crate) fn answering<M: Module, Q, R, F>(port: u32, mut answer: F) -> Callback<M>
where
    Q: Send + 'static,
    R: Send + 'static,
    F: FnMut(&mut M, &Q, &mut Context<'_, M::Ports>) -> Result<R, String> + Send + 'static,
{
    serving::<M, Q, R>(port, move |module, Incoming { to, request }, ctx| {
        let result = answer(module, &request, ctx);
        ctx.reply(Responder::<Q, R> { port, to, types: PhantomData }, result);
    })
}

/// The callback for the requests of a service that answers them when it can.
pub(crate) fn answering_later<M: Module, Q, R, F>(port: u32, mut take: F) -> Callback<M>
where
    Q: Send + 'static,
    R: Send + 'static,
    F: FnMut(&mut M, Q, Responder<Q, R>, &mut Context<'_, M::Ports>) + Send + 'static,
{
    serving::<M, Q, R>(port, move |module, Incoming { to, request }, ctx| {
        take(module, request, Responder { port, to, types: PhantomData }, ctx);
    })
}

fn serving<M: Module, Q: Send + 'static, R: Send + 'static>(
    port: u32,
    mut take: impl FnMut(&mut M, Incoming<Q>, &mut Context<'_, M::Ports>) + Send + 'static,
) -> Callback<M> {
    // The type of the answer is fixed by the port, which the callers opened.
    Box::new(move |module, ctx| {
        let Some(server) = ctx.io().server::<Q, R>(port) else { return };
        let mut requests = server.take_requests();
        for request in requests.drain(..) {
            take(module, request, ctx);
        }
        if let Some(server) = ctx.io().server::<Q, R>(port) {
            server.give_back(requests);
        }
    })
}

/// The callback for the answers to calls.
pub(crate) fn replying<M: Module, Q, R, F>(port: u32, mut take: F) -> Callback<M>
where
    Q: Send + 'static,
    R: Send + 'static,
    F: FnMut(&mut M, Reply<R>, &mut Context<'_, M::Ports>) + Send + 'static,
{
    let mut spare = Vec::new();
    Box::new(move |module, ctx| {
        let now = ctx.now();
        let Some(client) = ctx.io().client::<Q, R>(port) else { return };
        let mut replies = client.take_replies(now, std::mem::take(&mut spare));
        for reply in replies.drain(..) {
            take(module, reply, ctx);
        }
        spare = replies;
    })
}

/// The callback for the results of a job.
pub(crate) fn finishing<M: Module, T, F>(job: Job<T>, mut take: F) -> Callback<M>
where
    T: Send + 'static,
    F: FnMut(&mut M, Result<T, JobError>, &mut Context<'_, M::Ports>) + Send + 'static,
{
    Box::new(move |module, ctx| {
        for result in ctx.io().take_results(job) {
            take(module, result, ctx);
        }
    })
}

/// The check of a value that a setting is to have.
pub(crate) fn checking<M, T, F>(mut check: F) -> Check<M>
where
    T: SettingType,
    F: FnMut(&mut M, &T) -> Result<(), String> + Send + 'static,
{
    Box::new(move |module, value| T::from_value(value).map_or(Ok(()), |value| check(module, value)))
}
