//! Requests and answers on their way into and out of the executor.

use super::KnownService;
use bytes::Bytes;
use downbeat_executor::{
    CallError, Caller, Context, Core, Inbox, Inlet, Module, ModuleOptions, Received, Responder, Role, Setup,
    SetupError, Synchrony,
};
use downbeat_msgs::{Service, cdr};
use std::any::Any;
use std::collections::HashMap;
use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use thiserror::Error;

/// Calls a service of modules with serialized requests, from any thread. Clones call the same service.
#[derive(Clone)]
pub struct EncodedCaller {
    service: Arc<str>,
    call: Arc<CallEncoded>,
}

/// A call of serialized bytes has no answer.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum EncodedCallError {
    /// The bytes are no request of the service.
    #[error("service \"{service}\": the bytes are no {type_name}: {reason}")]
    Decode {
        /// The service.
        service: Arc<str>,
        /// The type of its requests.
        type_name: &'static str,
        /// What is wrong with the bytes.
        reason: String,
    },
    /// The core has no answer.
    #[error(transparent)]
    Call(#[from] CallError),
}

/// The answer of a module, not serialized yet: that may be done on another thread.
pub struct EncodedAnswer(Box<dyn FnOnce() -> Vec<u8> + Send>);

impl EncodedAnswer {
    /// Encapsulation header (little-endian) and body.
    #[must_use]
    pub fn into_cdr(self) -> Vec<u8> {
        (self.0)()
    }
}

type OnAnswer = Box<dyn FnOnce(Result<EncodedAnswer, EncodedCallError>) + Send>;
pub(super) type CallEncoded = dyn Fn(&[u8], Duration, OnAnswer) + Send + Sync;

impl EncodedCaller {
    pub(super) fn new(service: &str, call: Box<CallEncoded>) -> Self {
        Self { service: service.into(), call: call.into() }
    }

    /// The service.
    #[must_use]
    pub fn service(&self) -> &str {
        &self.service
    }

    /// Asks, with a request of either byte order. `on_answer` is called once: on the thread of the core, which it must not
    /// block, or on this one if the call could not be made. Never waits itself.
    pub fn call(
        &self,
        cdr: &[u8],
        timeout: Duration,
        on_answer: impl FnOnce(Result<EncodedAnswer, EncodedCallError>) + Send + 'static,
    ) {
        (self.call)(cdr, timeout, Box::new(on_answer));
    }
}

/// Answers calls of modules with serialized answers, in place of a server that is not in the core.
pub struct EncodedStandIn(pub(super) Box<AnswerEncoded>);

pub(super) type AnswerEncoded =
    dyn Fn(&str, u32, u64, Result<&[u8], CallError>) -> Result<(), cdr::Error> + Send + Sync;

impl EncodedStandIn {
    /// See [`StandIn::answer`](downbeat_executor::StandIn::answer).
    ///
    /// # Errors
    /// If the bytes are no answer of the service.
    pub fn answer(
        &self,
        client: &str,
        port: u32,
        number: u64,
        result: Result<&[u8], CallError>,
    ) -> Result<(), cdr::Error> {
        (self.0)(client, port, number, result)
    }
}

pub(super) fn open_stand_in<S: Service>(
    core: &mut Core,
    service: &str,
) -> Result<Box<AnswerEncoded>, SetupError> {
    let stand_in = core.stand_in::<S::Request, S::Response>(service)?;
    Ok(Box::new(move |client, port, number, result| {
        let result = match result {
            Ok(cdr) => Ok(cdr::from_slice::<S::Response>(cdr)?),
            Err(error) => Err(error),
        };
        stand_in.answer(client, port, number, result);
        Ok(())
    }))
}

pub(super) fn open_caller<S: Service>(
    core: &mut Core,
    service: &str,
) -> Result<Box<CallEncoded>, SetupError> {
    let caller: Caller<S::Request, S::Response> = core.caller(service)?;
    let service: Arc<str> = service.into();
    Ok(Box::new(move |bytes, timeout, on_answer| {
        let request = match cdr::from_slice(bytes) {
            Ok(request) => request,
            Err(error) => {
                let (service, reason) = (Arc::clone(&service), error.to_string());
                return on_answer(Err(EncodedCallError::Decode { service, type_name: S::TYPE_NAME, reason }));
            }
        };
        // Called once, by whichever of the two comes to it.
        let on_answer = Arc::new(Mutex::new(Some(on_answer)));
        let finish = |on_answer: &Mutex<Option<OnAnswer>>, result| {
            let on_answer = on_answer.lock().unwrap_or_else(PoisonError::into_inner).take();
            if let Some(on_answer) = on_answer {
                on_answer(result);
            }
        };
        let answered = Arc::clone(&on_answer);
        let called = caller.call(request, timeout, move |result| {
            let answer = |response: S::Response| EncodedAnswer(Box::new(move || cdr::to_vec(&response)));
            finish(&answered, result.map(answer).map_err(EncodedCallError::from));
        });
        if let Err(error) = called {
            finish(&on_answer, Err(error.into()));
        }
    }))
}

/// Something outside the core that answers requests.
pub trait RemoteCall: Send + 'static {
    /// Takes a serialized request; `on_answer` is to be called once, with the serialized answer or with why there is none,
    /// from any thread. Must not wait.
    fn call(&mut self, request: Bytes, on_answer: Box<dyn FnOnce(Result<Bytes, String>) + Send>);
}

/// Answers that wait while the module is busy; more than may be in flight.
const INBOX: NonZeroUsize = NonZeroUsize::new(4096).unwrap();

/// The detached observer that serves services whose servers are outside the core.
pub struct Callees {
    outlets: Vec<Outlet>,
}

impl Callees {
    /// Adds the module to a core; none where there is nothing to serve.
    ///
    /// # Errors
    /// [`SetupError`] when a service has other types, or a server already, or there is a module of that name.
    pub fn add_to(core: &mut Core, name: &str, outlets: Vec<Outlet>) -> Result<(), SetupError> {
        if outlets.is_empty() {
            return Ok(());
        }
        let options = ModuleOptions {
            synchrony: Synchrony::Detached(Inbox::KeepLast(INBOX)),
            role: Role::Observer,
            ..ModuleOptions::default()
        };
        core.add_with(name, Self { outlets }, options)
    }
}

impl Module for Callees {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        self.outlets.drain(..).try_for_each(|outlet| outlet.service_type.serve(setup, outlet))
    }
}

/// A service that modules call and that something outside serves, until it is part of [`Callees`].
pub struct Outlet {
    pub(super) service: String,
    pub(super) service_type: KnownService,
    pub(super) answers_topic: String,
    pub(super) answers: Answers,
    pub(super) call: Box<dyn RemoteCall>,
}

/// An `Inlet<Answer<R>>` whose type only the service knows.
pub(super) type Answers = Box<dyn Any + Send>;

/// What came back for one request.
struct Answer<R> {
    number: u64,
    result: Result<R, String>,
}

/// Requests whose answers have not come.
type Open<Q, R> = Arc<Mutex<HashMap<u64, Responder<Q, R>>>>;

pub(super) fn open_answers<S: Service>(core: &mut Core, topic: &str) -> Result<Answers, SetupError> {
    Ok(Box::new(core.inlet::<Answer<S::Response>>(topic)?))
}

pub(super) fn serve<S: Service>(setup: &mut Setup<'_, Callees>, outlet: Outlet) -> Result<(), SetupError> {
    let Outlet { service, answers_topic, answers, mut call, .. } = outlet;
    let answers = match answers.downcast::<Inlet<Answer<S::Response>>>() {
        Ok(answers) => *answers,
        Err(_) => return Err(setup.refuse(format!("service {service:?} was prepared for another type"))),
    };
    let open = Open::<S::Request, S::Response>::default();
    let mut next = 0;
    let asked = Arc::clone(&open);
    setup.serve_later(
        &service,
        move |_: &mut Callees, request: S::Request, responder, _: &mut Context<'_>| {
            let number = next;
            next += 1;
            lock(&asked).insert(number, responder);
            let answers = answers.clone();
            let on_answer = move |result: Result<Bytes, String>| {
                let result = result.and_then(|cdr| {
                    cdr::from_slice(&cdr)
                        .map_err(|error| format!("the answer is no {}: {error}", S::TYPE_NAME))
                });
                // Fails only when the core has stopped or is flooded; the time of the caller runs out then.
                if let Err(error) = answers.publish(Answer { number, result }) {
                    tracing::debug!(%error, "an answer did not enter the core");
                }
            };
            call.call(cdr::to_vec(&request).into(), Box::new(on_answer));
        },
    )?;
    setup.subscribe(
        &answers_topic,
        move |_: &mut Callees, answer: Received<'_, Answer<S::Response>>, ctx: &mut Context<'_>| {
            let responder = lock(&open).remove(&answer.number);
            if let Some(responder) = responder {
                ctx.reply(responder, answer.result.clone());
            }
        },
    )
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
