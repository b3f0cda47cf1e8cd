//! A module's side of the services it calls.

use std::any::Any;
use std::sync::Arc;
use std::time::Duration;

use super::call::{CallError, CallId, Reply, ReplyTo};
use super::server::{AnyReply, Incoming};
use crate::{ModuleId, Time};

/// The calls of one module to one service: those it has just made, and those that wait for an answer.
pub(crate) struct ClientPort<Q, R> {
    service: usize,
    name: Arc<str>,
    timeout: Duration,
    next: u64,
    outgoing: Vec<(u64, Q)>,
    /// In the order of the deadlines, since all have the same time-out.
    waiting: Vec<(u64, Time)>,
    replies: Vec<Reply<R>>,
}

impl<Q, R> ClientPort<Q, R> {
    pub(crate) fn new(service: usize, name: Arc<str>, timeout: Duration) -> Self {
        Self {
            service,
            name,
            timeout,
            next: 0,
            outgoing: Vec::new(),
            waiting: Vec::new(),
            replies: Vec::new(),
        }
    }

    pub(crate) fn call(&mut self, request: Q, now: Time) -> CallId {
        let call = self.next;
        self.next += 1;
        self.outgoing.push((call, request));
        self.waiting.push((call, now + self.timeout));
        CallId(call)
    }

    pub(crate) fn has_replies(&self, now: Time) -> bool {
        !self.replies.is_empty() || self.waiting.first().is_some_and(|&(_, deadline)| deadline <= now)
    }

    /// The replies that came and those that did not come in time, in place of `empty`.
    pub(crate) fn take_replies(&mut self, now: Time, empty: Vec<Reply<R>>) -> Vec<Reply<R>> {
        let mut replies = std::mem::replace(&mut self.replies, empty);
        // What comes after its time was up has been answered already.
        replies.retain(|reply| match self.waiting.iter().position(|(call, _)| *call == reply.call.0) {
            Some(position) => {
                self.waiting.remove(position);
                true
            }
            None => false,
        });
        let late = self.waiting.iter().take_while(|(_, deadline)| *deadline <= now).count();
        for (call, _) in self.waiting.drain(..late) {
            let error = CallError::TimedOut { service: Arc::clone(&self.name), timeout: self.timeout };
            replies.push(Reply { call: CallId(call), result: Err(error) });
        }
        replies
    }
}

/// A [`ClientPort`] whose types only the service knows.
pub(crate) trait AnyClient: Any + Send {
    fn service(&self) -> usize;
    /// The name of the service: the very one that the registry gave.
    fn name(&self) -> &Arc<str>;
    /// When the first of the calls is given up.
    fn due(&self) -> Time;
    fn has_calls(&self) -> bool;
    /// The numbers of the calls that were not made yet.
    fn calls(&self) -> Vec<u64>;
    /// Appends the calls to `staged`, a `Vec<Incoming<Q>>`.
    fn stage(&mut self, from: ModuleId, port: u32, staged: &mut dyn Any);
    /// Answers the calls with an error.
    fn fail_calls(&mut self, error: &CallError);
    /// The calls in a port of their own, which takes them to the thread of the core.
    fn split_off(&mut self) -> Box<dyn AnyClient>;
    /// The answers of calls that failed, for the port the calls were split off.
    fn drain_replies(&mut self, deliver: &mut dyn FnMut(&mut dyn AnyReply));
    fn accept_any(&mut self, reply: &mut dyn AnyReply);
    /// Forgets calls and answers.
    fn reset(&mut self);
}

impl<Q: Send + 'static, R: Send + 'static> AnyClient for ClientPort<Q, R> {
    fn service(&self) -> usize {
        self.service
    }

    fn name(&self) -> &Arc<str> {
        &self.name
    }

    fn due(&self) -> Time {
        self.waiting.first().map_or(Time::MAX, |&(_, deadline)| deadline)
    }

    fn has_calls(&self) -> bool {
        !self.outgoing.is_empty()
    }

    fn calls(&self) -> Vec<u64> {
        self.outgoing.iter().map(|(call, _)| *call).collect()
    }

    fn stage(&mut self, from: ModuleId, port: u32, staged: &mut dyn Any) {
        let Some(staged) = staged.downcast_mut::<Vec<Incoming<Q>>>() else {
            debug_assert!(false, "a call reached a service of another type");
            return;
        };
        staged.extend(
            self.outgoing.drain(..).map(|(call, request)| Incoming {
                to: ReplyTo::Module { module: from, port, call },
                request,
            }),
        );
    }

    fn fail_calls(&mut self, error: &CallError) {
        for (call, _) in self.outgoing.drain(..) {
            self.replies.push(Reply { call: CallId(call), result: Err(error.clone()) });
        }
    }

    fn split_off(&mut self) -> Box<dyn AnyClient> {
        let mut calls = Self::new(self.service, Arc::clone(&self.name), self.timeout);
        std::mem::swap(&mut calls.outgoing, &mut self.outgoing);
        Box::new(calls)
    }

    fn drain_replies(&mut self, deliver: &mut dyn FnMut(&mut dyn AnyReply)) {
        self.replies.drain(..).for_each(|reply| deliver(&mut Some(reply)));
    }

    fn accept_any(&mut self, reply: &mut dyn AnyReply) {
        if let Some(reply) = (reply as &mut dyn Any).downcast_mut::<Option<Reply<R>>>() {
            self.replies.extend(reply.take());
        }
    }

    fn reset(&mut self) {
        self.outgoing.clear();
        self.waiting.clear();
        self.replies.clear();
    }
}
