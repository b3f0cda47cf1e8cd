//! A module with its callbacks, as the executor runs it without knowing its type.

use std::any::Any;
use std::sync::Arc;

use crate::batch::{Batch, Position};
use crate::topic::Topics;
use crate::{Context, Module, Received};

/// One call per callback, or per batch: what is inside is known to the compiler and can be inlined.
pub(crate) trait Behaviour: Send {
    fn start(&mut self, ctx: &mut Context<'_>);
    /// Calls a subscription with the batch its topic holds.
    fn receive(&mut self, subscription: usize, topics: &Topics, ctx: &mut Context<'_>);
    /// Calls a subscription with a batch of an earlier cycle.
    fn receive_shared(
        &mut self,
        subscription: usize,
        batch: Arc<dyn Any + Send + Sync>,
        ctx: &mut Context<'_>,
    );
    fn tick(&mut self, timer: usize, ctx: &mut Context<'_>);
    fn setting_changed(&mut self, setting: usize, ctx: &mut Context<'_>);
    fn stop(&mut self, ctx: &mut Context<'_>);
}

pub(crate) type Callback<M> = Box<dyn FnMut(&mut M, &mut Context<'_>) + Send>;

/// A module and its callbacks.
pub(crate) struct ModuleBehaviour<M> {
    pub(crate) module: M,
    pub(crate) callbacks: Callbacks<M>,
}

pub(crate) struct Callbacks<M> {
    pub(crate) subscriptions: Vec<Box<dyn AnySubscription<M>>>,
    pub(crate) timers: Vec<Callback<M>>,
    pub(crate) settings: Vec<(usize, Callback<M>)>,
}

impl<M> Default for Callbacks<M> {
    fn default() -> Self {
        Self { subscriptions: Vec::new(), timers: Vec::new(), settings: Vec::new() }
    }
}

impl<M: Module> Behaviour for ModuleBehaviour<M> {
    fn start(&mut self, ctx: &mut Context<'_>) {
        self.module.start(ctx);
    }

    fn receive(&mut self, subscription: usize, topics: &Topics, ctx: &mut Context<'_>) {
        self.callbacks.subscriptions[subscription].receive(&mut self.module, topics, ctx);
    }

    fn receive_shared(
        &mut self,
        subscription: usize,
        batch: Arc<dyn Any + Send + Sync>,
        ctx: &mut Context<'_>,
    ) {
        self.callbacks.subscriptions[subscription].receive_shared(&mut self.module, batch, ctx);
    }

    fn tick(&mut self, timer: usize, ctx: &mut Context<'_>) {
        self.callbacks.timers[timer](&mut self.module, ctx);
    }

    fn setting_changed(&mut self, setting: usize, ctx: &mut Context<'_>) {
        for (_, callback) in self.callbacks.settings.iter_mut().filter(|(index, _)| *index == setting) {
            callback(&mut self.module, ctx);
        }
    }

    fn stop(&mut self, ctx: &mut Context<'_>) {
        self.module.stop(ctx);
    }
}

/// A callback for the messages of one topic.
pub(crate) trait AnySubscription<M>: Send {
    fn topic(&self) -> usize;
    fn receive(&mut self, module: &mut M, topics: &Topics, ctx: &mut Context<'_>);
    fn receive_shared(&mut self, module: &mut M, batch: Arc<dyn Any + Send + Sync>, ctx: &mut Context<'_>);
}

pub(crate) struct Subscription<T, F> {
    pub(crate) topic: usize,
    pub(crate) callback: F,
    pub(crate) message: std::marker::PhantomData<fn(T)>,
}

impl<M, T, F> AnySubscription<M> for Subscription<T, F>
where
    T: Send + Sync + 'static,
    F: FnMut(&mut M, Received<'_, T>, &mut Context<'_>) + Send,
{
    fn topic(&self) -> usize {
        self.topic
    }

    fn receive(&mut self, module: &mut M, topics: &Topics, ctx: &mut Context<'_>) {
        if let Some(topic) = topics.get::<T>(self.topic) {
            for_each_message(topic.batch(), |message| (self.callback)(module, message, ctx));
        }
    }

    fn receive_shared(&mut self, module: &mut M, batch: Arc<dyn Any + Send + Sync>, ctx: &mut Context<'_>) {
        if let Ok(batch) = batch.downcast::<Batch<T>>() {
            for_each_message(&batch, |message| (self.callback)(module, message, ctx));
        }
    }
}

#[inline]
fn for_each_message<T>(batch: &Arc<Batch<T>>, mut consume: impl FnMut(Received<'_, T>)) {
    for (segment, messages) in (0_u32..).zip(batch.segments()) {
        for (index, message) in (0_u32..).zip(messages) {
            consume(Received::new(message, batch, Position { segment, index }));
        }
    }
}
