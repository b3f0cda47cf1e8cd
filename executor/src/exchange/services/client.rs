//! The client's side of services.

use std::any::Any;
use std::sync::Arc;
use std::time::Duration;

use super::any_value::into_any;
use super::call::{CallError, CallId, Reply, ReplyTo};
use super::server::{AnyReply, AnyRequests, Incoming, take_reply};
use crate::{ModuleId, Time};

/// The calls of one module to one service: new ones, and those that wait for an answer.
pub(crate) struct ClientPort<Q, R> {
    service: usize,
    name: Arc<str>,
    timeout: Duration,
    next: u64,
    outgoing: Vec<(u64, Q)>,
    /// In the order of deadlines, since all have the same time-out.
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

    /// Takes the replies that have arrived and those that timed out, and leaves `empty` as the new buffer.
    pub(crate) fn take_replies(&mut self, now: Time, empty: Vec<Reply<R>>) -> Vec<Reply<R>> {
        let mut replies = std::mem::replace(&mut self.replies, empty);
        // A reply that comes after its time-out has already been replaced by an error.
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

/// A [`ClientPort`] with its types erased.
pub(crate) trait AnyClient: Any + Send {
    fn service(&self) -> usize;
    /// The name of the service: the same `Arc` as in the registry, which is compared by pointer.
    fn name(&self) -> &Arc<str>;
    /// The earliest time-out of the calls.
    fn due(&self) -> Time;
    fn has_calls(&self) -> bool;
    /// The numbers of the calls that have not been sent yet.
    fn calls(&self) -> Vec<u64>;
    /// Appends the calls to `staged`.
    fn stage(&mut self, from: ModuleId, port: u32, staged: &mut dyn AnyRequests);
    /// Answers the calls with an error.
    fn fail_calls(&mut self, error: &CallError);
    /// Moves the calls to a new port, which takes them to the thread of the core.
    fn split_off(&mut self) -> Box<dyn AnyClient>;
    /// Takes the answers of failed calls, for the port from which the calls were split off.
    fn drain_replies(&mut self, deliver: &mut dyn FnMut(&mut dyn AnyReply));
    fn accept_any(&mut self, reply: &mut dyn AnyReply);
    /// Discards calls and answers.
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

    fn stage(&mut self, from: ModuleId, port: u32, staged: &mut dyn AnyRequests) {
        let Some(staged) = (&mut *staged as &mut dyn Any).downcast_mut::<Vec<Incoming<Q>>>() else {
            // A client of boxes.
            for (call, request) in self.outgoing.drain(..) {
                let is_of_type =
                    staged.add_any(ReplyTo::Module { module: from, port, call }, into_any(request));
                debug_assert!(is_of_type, "a call reached a service of another type");
            }
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
        self.replies.extend(take_reply(reply));
    }

    fn reset(&mut self) {
        self.outgoing.clear();
        self.waiting.clear();
        self.replies.clear();
    }
}
