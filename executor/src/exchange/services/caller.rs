//! Calls from threads outside the executor.

use std::any::Any;
use std::sync::Arc;
use std::time::Duration;

use super::Services;
use super::any_value::into_any;
use super::call::{CallError, ReplyTo};
use super::server::{AnyReply, AnyRequests, Incoming, take_reply};
use crate::Time;
use crate::module::{Link, SERVICES};
use crate::threads::end_of;

/// Calls a service from a thread outside the executor; from [`Core::caller`](crate::Core::caller).
///
/// A call takes effect in the next sync phase, in the order of arrival.
///
/// ```
/// use std::sync::mpsc::channel;
/// use std::time::Duration;
/// use downbeat_executor::{CallError, Core, ManualClock, Module, Setup, SetupError, Time};
///
/// struct Gripper;
///
/// impl Module for Gripper {
///     type Ports = ();
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         setup.serve::<f64, (), _>("close", |_, &force, _| match force {
///             0.0..=20.0 => Ok(()),
///             _ => Err(format!("{force} N is more than the 20 N it has")),
///         })
///     }
/// }
///
/// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
/// core.add("gripper", Gripper)?;
/// let close = core.caller::<f64, ()>("close")?;
/// let (sender, answer) = channel();
/// close.call(35.0, Duration::from_secs(1), move |result| drop(sender.send(result)))?;
/// core.cycle()?; // The call joins.
/// core.cycle()?; // The gripper answers.
/// let CallError::Refused { reason, .. } = answer.try_recv()?.unwrap_err() else { panic!() };
/// assert_eq!(reason, "35 N is more than the 20 N it has");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Caller<Q, R> {
    service: usize,
    name: Arc<str>,
    link: Arc<Link>,
    types: std::marker::PhantomData<fn(Q) -> R>,
}

impl<Q, R> Clone for Caller<Q, R> {
    fn clone(&self) -> Self {
        let (link, name) = (Arc::clone(&self.link), Arc::clone(&self.name));
        Self { service: self.service, name, link, types: self.types }
    }
}

impl<Q: Send + 'static, R: Send + 'static> Caller<Q, R> {
    pub(crate) fn new(service: usize, name: Arc<str>, link: Arc<Link>) -> Self {
        Self { service, name, link, types: std::marker::PhantomData }
    }

    /// Calls the service. `on_reply` is called once, on the thread of the core, and must not block; it is
    /// called on this thread if the core stops at this moment. This function never waits.
    ///
    /// # Errors
    /// If the core has stopped; `on_reply` is then not called.
    pub fn call(
        &self,
        request: Q,
        timeout: Duration,
        on_reply: impl FnOnce(Result<R, CallError>) + Send + 'static,
    ) -> Result<(), CallError> {
        if self.link.is_closed() {
            return Err(CallError::Stopped { service: Arc::clone(&self.name) });
        }
        let (service, name) = (self.service, Arc::clone(&self.name));
        let on_reply: OnReply<R> = Box::new(on_reply);
        let call = ExternalCall { service, name, timeout, request: Some(request), on_reply: Some(on_reply) };
        self.link.post(SERVICES, |services: &mut Services| services.calls.push(Box::new(call)));
        Ok(())
    }
}

type OnReply<R> = Box<dyn FnOnce(Result<R, CallError>) + Send>;

struct ExternalCall<Q, R> {
    service: usize,
    name: Arc<str>,
    timeout: Duration,
    request: Option<Q>,
    on_reply: Option<OnReply<R>>,
}

impl<Q, R> Drop for ExternalCall<Q, R> {
    /// A call that the core never takes ends with an error.
    fn drop(&mut self) {
        if let Some(on_reply) = self.on_reply.take() {
            let service = Arc::clone(&self.name);
            guarded(|| on_reply(Err(CallError::Stopped { service })));
        }
    }
}

/// A call of a [`Caller`] with its types erased.
pub(crate) trait AnyCall: Send {
    fn service(&self) -> usize;
    fn timeout(&self) -> Duration;
    /// Appends the request to `staged`.
    fn stage(&mut self, call: u64, staged: &mut dyn AnyRequests);
    fn finish(&mut self, reply: &mut dyn AnyReply);
    fn fail(&mut self, error: CallError);
    fn name(&self) -> Arc<str>;
}

impl<Q: Send + 'static, R: Send + 'static> AnyCall for ExternalCall<Q, R> {
    fn service(&self) -> usize {
        self.service
    }

    fn timeout(&self) -> Duration {
        self.timeout
    }

    fn stage(&mut self, call: u64, staged: &mut dyn AnyRequests) {
        let Some(request) = self.request.take() else { return };
        let to = ReplyTo::External { call };
        match (&mut *staged as &mut dyn Any).downcast_mut::<Vec<Incoming<Q>>>() {
            Some(staged) => staged.push(Incoming { to, request }),
            // A caller of boxes.
            None => {
                let is_of_type = staged.add_any(to, into_any(request));
                debug_assert!(is_of_type, "a call reached a service of another type");
            }
        }
    }

    fn finish(&mut self, reply: &mut dyn AnyReply) {
        if let Some(reply) = take_reply::<R>(reply)
            && let Some(on_reply) = self.on_reply.take()
        {
            on_reply(reply.result);
        }
    }

    fn fail(&mut self, error: CallError) {
        if let Some(on_reply) = self.on_reply.take() {
            on_reply(Err(error));
        }
    }

    fn name(&self) -> Arc<str> {
        Arc::clone(&self.name)
    }
}

/// Calls of [`Caller`](crate::Caller)s that wait for an answer.
#[derive(Default)]
pub(crate) struct ExternalCalls {
    next: u64,
    waiting: Vec<(u64, Time, Box<dyn AnyCall>)>,
}

impl ExternalCalls {
    /// Stages the call under a new number, and keeps it until it is answered.
    pub(crate) fn add(&mut self, mut call: Box<dyn AnyCall>, staged: &mut dyn AnyRequests, now: Time) {
        let number = self.next;
        self.next += 1;
        call.stage(number, staged);
        self.waiting.push((number, now + call.timeout(), call));
    }

    pub(crate) fn due(&self) -> Time {
        self.waiting.iter().map(|&(_, deadline, _)| deadline).min().unwrap_or(Time::MAX)
    }

    pub(crate) fn finish(&mut self, number: u64, reply: &mut dyn AnyReply) {
        if let Some(position) = self.waiting.iter().position(|(known, ..)| *known == number) {
            let (_, _, mut call) = self.waiting.remove(position);
            guarded(|| call.finish(reply));
        }
    }

    pub(crate) fn give_up(&mut self, now: Time) {
        if self.waiting.is_empty() {
            return;
        }
        let late = self.waiting.extract_if(.., |(_, deadline, _)| *deadline <= now);
        for (_, _, mut call) in late.collect::<Vec<_>>() {
            let error = CallError::TimedOut { service: call.name(), timeout: call.timeout() };
            guarded(|| call.fail(error));
        }
    }

    pub(crate) fn stop(&mut self) {
        for (_, _, mut call) in std::mem::take(&mut self.waiting) {
            let error = CallError::Stopped { service: call.name() };
            guarded(|| call.fail(error));
        }
    }
}

/// Runs a caller's closure, and catches its panic.
pub(crate) fn guarded(run: impl FnOnce()) {
    let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(run));
    if let Err(panic) = outcome {
        tracing::error!("the closure for an answer panicked: {}", end_of(panic));
    }
}
