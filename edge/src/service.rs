//! Types of services, and how requests and responses enter a core as bytes and leave it as bytes.

use crate::foreign::{CallEncodedIn, ForeignError, ForeignModule, ReplyEncoded};
use crate::service_codec::{Compiled, RawService, ServiceCodec};
use crate::{CoreAccess, KnownType, RawTypeError, Waiting};
use bytes::Bytes;
use downbeat_executor::{
    CallError, Context, Core, Inlet, Module, ModuleOptions, Received, Responder, Role, Setup, SetupError,
};
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, FieldError, InterfaceDefinition, TypeLookupError};
use downbeat_msgs::service_msgs::msg::ServiceEventInfo;
use downbeat_msgs::std_srvs::srv::Empty;
use downbeat_msgs::{Message, Service, cdr};
use parking_lot::Mutex;
use std::any::{Any, type_name};
use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::marker::PhantomData;
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// A service type of ROS 2, found through [`Interfaces`](crate::Interfaces) or by its Rust type
/// ([`KnownService::of`]). Requests and responses of a type of which only the definition is known pass
/// through as bytes, which are checked.
#[derive(Clone, Copy)]
pub struct KnownService {
    entry: &'static Entry,
}

/// Calls a service of modules with serialized requests, from any thread. Clones call the same service.
#[derive(Clone)]
pub struct EncodedCaller {
    service: Arc<str>,
    call: Arc<CallEncoded>,
}

/// A call with a serialized request failed.
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
    /// The core has no response.
    #[error(transparent)]
    Call(#[from] CallError),
}

/// The response of a module, which any thread may serialize.
pub struct EncodedAnswer(Box<dyn FnOnce() -> Vec<u8> + Send>);

/// Answers calls of modules with serialized responses, in place of a server that is not in the core.
pub struct EncodedStandIn(Box<AnswerEncoded>);

/// A server outside the core.
pub trait RemoteCall: Send + 'static {
    /// Takes a request, which any thread may serialize. The implementation calls `on_answer` once, from any
    /// thread, with the serialized response or with the reason why there is none. It runs on the thread of
    /// the core, which it must not block.
    fn call(
        &mut self,
        request: Box<dyn FnOnce() -> Bytes + Send>,
        on_answer: Box<dyn FnOnce(Result<Bytes, String>) + Send>,
    );
}

/// A service that modules call and that a [`RemoteCall`] serves, once it is part of [`RemoteServices`].
pub struct RemoteService {
    service: String,
    service_type: KnownService,
    answers_topic: String,
    answers: Answers,
    call: Box<dyn RemoteCall>,
}

/// The observer that serves services whose servers are outside the core.
pub struct RemoteServices {
    services: Vec<RemoteService>,
}

/// What a service event holds besides its [`ServiceEventInfo`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EventContent<'a> {
    /// Nothing.
    Nothing,
    /// The serialized request.
    Request(&'a [u8]),
    /// The serialized response.
    Response(&'a [u8]),
}

/// A service event was not serialized.
#[derive(Debug, Error)]
pub enum EventError {
    /// The bytes are no request or response of the type.
    #[error(transparent)]
    Content(#[from] cdr::Error),
    /// The definition of the event differs from the one that ROS 2 derives from a service.
    #[error("the event of the service has other fields: {0}")]
    Fields(#[from] FieldError),
}

fn encode_event<S: Service>(
    info: ServiceEventInfo,
    content: EventContent<'_>,
) -> Result<Vec<u8>, EventError> {
    let event = match content {
        EventContent::Nothing => S::event(info, None, None),
        // Decoded and encoded again: the alignment in the middle of a message differs.
        EventContent::Request(request) => S::event(info, Some(cdr::from_slice(request)?), None),
        EventContent::Response(response) => S::event(info, None, Some(cdr::from_slice(response)?)),
    };
    Ok(cdr::to_vec(&event))
}

fn encode_raw_event(
    raw: &RawService,
    info: ServiceEventInfo,
    content: EventContent<'_>,
) -> Result<Vec<u8>, EventError> {
    // Those of a raw service are known.
    let (Some(event), Some(request), Some(response)) =
        (raw.event.dynamic(), raw.request.dynamic(), raw.response.dynamic())
    else {
        return encode_event::<Empty>(info, EventContent::Nothing);
    };
    let mut event = DynamicMessage::new(&event);
    let bytes = cdr::to_vec(&info);
    let info = event.get("info")?.as_message().map(|info| info.message_type());
    if let Some(info) = info {
        event.set("info", DynamicMessage::from_cdr(&info, &bytes)?)?;
    }
    match content {
        EventContent::Nothing => {}
        EventContent::Request(cdr) => event.push("request", DynamicMessage::from_cdr(&request, cdr)?)?,
        EventContent::Response(cdr) => event.push("response", DynamicMessage::from_cdr(&response, cdr)?)?,
    }
    Ok(event.to_cdr())
}

impl KnownService {
    /// The service type of a Rust type, which need not be registered.
    #[must_use]
    pub const fn of<S: Service>() -> Self {
        Self { entry: Of::<S>::ENTRY }
    }

    /// A service of the definition, which may be that of an action: one whose requests and responses pass
    /// through.
    pub(crate) fn defined(definition: &InterfaceDefinition, name: &str) -> Result<Self, RawTypeError> {
        // A hash is of the name too. Types live as long as the program; the messages limit how many there
        // are.
        static SERVICES: Mutex<BTreeMap<&'static str, &'static Entry>> = Mutex::new(BTreeMap::new());
        let unusable = |error: TypeLookupError| RawTypeError::Definition(Box::new(error));
        let (hash, definition_text) = definition.described(name).map_err(unusable)?;
        if let Some(entry) = SERVICES.lock().get(hash.as_str()) {
            return Ok(Self { entry });
        }
        let message =
            |part: &str| KnownType::defined(definition.message(&format!("{name}_{part}")).map_err(unusable)?);
        let (request, response, event) = (message("Request")?, message("Response")?, message("Event")?);
        let (name, hash, definition) = (leak(name), leak(&hash), leak(&definition_text));
        let raw = RawService { name, hash, definition, request, response, event };
        let mut services = SERVICES.lock();
        Ok(Self { entry: services.entry(hash).or_insert_with(|| Box::leak(Box::new(Entry::Raw(raw)))) })
    }

    /// As in `std_srvs/srv/SetBool`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self.entry {
            Entry::Compiled(of) => of.name,
            Entry::Raw(raw) => raw.name,
        }
    }

    /// `RIHS01_` and 64 hexadecimal digits.
    #[must_use]
    pub fn hash(self) -> &'static str {
        match self.entry {
            Entry::Compiled(of) => of.hash,
            Entry::Raw(raw) => raw.hash,
        }
    }

    /// The definition text with all dependencies, as rosbag2 stores it for service events.
    #[must_use]
    pub fn definition(self) -> &'static str {
        match self.entry {
            Entry::Compiled(of) => of.definition,
            Entry::Raw(raw) => raw.definition,
        }
    }

    /// True if its requests and responses pass through as bytes.
    #[must_use]
    pub fn is_raw(self) -> bool {
        matches!(self.entry, Entry::Raw(_))
    }

    /// The hashes of the messages of its requests, responses and events.
    #[must_use]
    pub fn message_hashes(self) -> [&'static str; 3] {
        match self.entry {
            Entry::Compiled(of) => of.message_hashes,
            Entry::Raw(raw) => [raw.request, raw.response, raw.event].map(KnownType::hash),
        }
    }

    /// The type of its responses, for reading and writing them field by field; `None` while its definition is
    /// unknown.
    #[must_use]
    pub fn response_type(self) -> Option<DynamicType> {
        match self.entry {
            Entry::Compiled(of) => (of.response_type)(),
            Entry::Raw(raw) => raw.response.dynamic(),
        }
    }

    /// Serializes an event of the service: encapsulation header (little-endian) and body. An event without
    /// content is the same whatever the type.
    ///
    /// # Errors
    /// When the content is no request or response of the type.
    pub fn encode_event(
        self,
        info: ServiceEventInfo,
        content: EventContent<'_>,
    ) -> Result<Vec<u8>, EventError> {
        match self.entry {
            Entry::Compiled(of) => (of.encode_event)(info, content),
            Entry::Raw(raw) => encode_raw_event(raw, info, content),
        }
    }

    /// Opens a caller of a service of modules, which any thread may use.
    ///
    /// # Errors
    /// [`SetupError`] when the name is not valid or the service has other types.
    pub fn caller(self, core: &mut Core, service: &str) -> Result<EncodedCaller, SetupError> {
        self.caller_in(&mut CoreAccess::Idle(core), service)
    }

    /// The same for a core that may be running.
    ///
    /// # Errors
    /// Those of [`caller`](Self::caller), and one if the core does not answer.
    pub fn caller_in(self, core: &mut CoreAccess<'_>, service: &str) -> Result<EncodedCaller, SetupError> {
        let call = match self.entry {
            Entry::Compiled(of) => (of.caller)(core, service)?,
            Entry::Raw(raw) => caller(raw, core, service)?,
        };
        Ok(EncodedCaller { service: service.into(), call: call.into() })
    }

    /// Prepares a service that modules call and whose requests `call` takes. [`RemoteServices::add_to`]
    /// completes it.
    ///
    /// # Errors
    /// [`SetupError`] when the name is not valid.
    pub fn remote(
        self,
        core: &mut Core,
        service: &str,
        call: impl RemoteCall,
    ) -> Result<RemoteService, SetupError> {
        self.remote_in(&mut CoreAccess::Idle(core), service, call)
    }

    /// The same for a core that may be running.
    ///
    /// # Errors
    /// Those of [`remote`](Self::remote), and one if the core does not answer.
    pub fn remote_in(
        self,
        core: &mut CoreAccess<'_>,
        service: &str,
        call: impl RemoteCall,
    ) -> Result<RemoteService, SetupError> {
        let answers_topic = format!("bridge/answers/{}", service.trim_start_matches('/'));
        let answers = match self.entry {
            Entry::Compiled(of) => (of.answers)(core, &answers_topic)?,
            Entry::Raw(raw) => answers(raw, core, &answers_topic)?,
        };
        Ok(RemoteService {
            service: service.to_owned(),
            service_type: self,
            answers_topic,
            answers,
            call: Box::new(call),
        })
    }

    /// Makes each [`ModuleEvent`](downbeat_executor::ModuleEvent) of a service of modules carry its request
    /// or response as CDR.
    ///
    /// # Errors
    /// [`SetupError`] when the name is not valid or the service has other types.
    pub fn encode(self, core: &mut Core, service: &str) -> Result<(), SetupError> {
        self.encode_in(&mut CoreAccess::Idle(core), service)
    }

    /// The same for a core that may be running.
    ///
    /// # Errors
    /// Those of [`encode`](Self::encode), and one if the core does not answer.
    pub fn encode_in(self, core: &mut CoreAccess<'_>, service: &str) -> Result<(), SetupError> {
        match self.entry {
            Entry::Compiled(of) => (of.encode)(core, service),
            Entry::Raw(raw) => encode(raw, core, service),
        }
    }

    /// Opens a stand-in, which answers calls of modules with serialized responses in place of a server.
    ///
    /// # Errors
    /// [`SetupError`] when the name is not valid or the service has other types.
    pub fn stand_in(self, core: &mut Core, service: &str) -> Result<EncodedStandIn, SetupError> {
        Ok(EncodedStandIn(match self.entry {
            Entry::Compiled(of) => (of.stand_in)(core, service)?,
            Entry::Raw(raw) => stand_in(raw, core, service)?,
        }))
    }

    /// Declares that a module in another language serves the service.
    pub(crate) fn serve_foreign(
        self,
        setup: &mut Setup<'_, ForeignModule>,
        service: &str,
        server: u32,
    ) -> Result<(), SetupError> {
        match self.entry {
            Entry::Compiled(of) => (of.serve_foreign)(setup, service, server),
            Entry::Raw(raw) => serve_foreign(raw, setup, service, server),
        }
    }

    /// Declares that a module in another language calls the service.
    pub(crate) fn foreign_client(
        self,
        setup: &mut Setup<'_, ForeignModule>,
        service: &str,
        timeout: Duration,
        client: u32,
    ) -> Result<CallEncodedIn, SetupError> {
        match self.entry {
            Entry::Compiled(of) => (of.foreign_client)(setup, service, timeout, client),
            Entry::Raw(raw) => foreign_client(raw, setup, service, timeout, client),
        }
    }

    /// The names of the types of request and response in a core.
    pub(crate) fn types_in_core(self) -> (&'static str, &'static str) {
        match self.entry {
            Entry::Compiled(of) => (of.rust_types)(),
            Entry::Raw(raw) => (raw.request.name(), raw.response.name()),
        }
    }
}

impl fmt::Debug for KnownService {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("KnownService").field(&self.name()).finish()
    }
}

impl fmt::Display for KnownService {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Two definitions of one name are two types.
impl PartialEq for KnownService {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name() && self.hash() == other.hash()
    }
}

impl Eq for KnownService {}

impl EncodedCaller {
    /// The service.
    #[must_use]
    pub fn service(&self) -> &str {
        &self.service
    }

    /// Calls the service with a request of either byte order. `on_answer` is called once: on the thread of
    /// the core, which it must not block, or on this thread if the call fails at once. Never blocks.
    pub fn call(
        &self,
        cdr: &[u8],
        timeout: Duration,
        on_answer: impl FnOnce(Result<EncodedAnswer, EncodedCallError>) + Send + 'static,
    ) {
        (self.call)(cdr, timeout, Box::new(on_answer));
    }
}

impl EncodedAnswer {
    /// Encapsulation header (little-endian) and body.
    #[must_use]
    pub fn into_cdr(self) -> Vec<u8> {
        (self.0)()
    }
}

impl EncodedStandIn {
    /// See [`StandIn::answer`](downbeat_executor::StandIn::answer).
    ///
    /// # Errors
    /// If the bytes are no response of the service.
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

impl RemoteServices {
    /// Adds the module to a core, unless there are no services.
    ///
    /// # Errors
    /// [`SetupError`] when a service has other types or a server, or another module has the name.
    pub fn add_to(core: &mut Core, name: &str, services: Vec<RemoteService>) -> Result<(), SetupError> {
        Self::add_in(&mut CoreAccess::Idle(core), name, services)
    }

    /// The same for a core that may be running.
    ///
    /// # Errors
    /// Those of [`add_to`](Self::add_to), and one if the core does not answer.
    pub fn add_in(
        core: &mut CoreAccess<'_>,
        name: &str,
        services: Vec<RemoteService>,
    ) -> Result<(), SetupError> {
        if services.is_empty() {
            return Ok(());
        }
        let options = ModuleOptions { role: Role::Observer, ..ModuleOptions::default() };
        core.add(name, Self { services }, options)
    }
}

impl Module for RemoteServices {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        self.services.drain(..).try_for_each(|service| match service.service_type.entry {
            Entry::Compiled(of) => (of.serve)(setup, service),
            Entry::Raw(raw) => serve(raw, setup, service),
        })
    }
}

type OnAnswer = Box<dyn FnOnce(Result<EncodedAnswer, EncodedCallError>) + Send>;
type CallEncoded = dyn Fn(&[u8], Duration, OnAnswer) + Send + Sync;
type AnswerEncoded = dyn Fn(&str, u32, u64, Result<&[u8], CallError>) -> Result<(), cdr::Error> + Send + Sync;

/// An `Inlet<Answer<R>>` whose type only the service knows.
type Answers = Box<dyn Any + Send>;

/// The outcome of one request.
struct Answer<R> {
    number: u64,
    result: Result<R, String>,
}

/// Requests without an answer so far.
type Open<Q, R> = Arc<Mutex<HashMap<u64, Responder<Q, R>>>>;

enum Entry {
    Compiled(CompiledEntry),
    Raw(RawService),
}

// Each function exists once per service type: what does not depend on the type is elsewhere.
struct CompiledEntry {
    name: &'static str,
    hash: &'static str,
    definition: &'static str,
    message_hashes: [&'static str; 3],
    rust_types: fn() -> (&'static str, &'static str),
    caller: fn(&mut CoreAccess<'_>, &str) -> Result<Box<CallEncoded>, SetupError>,
    answers: fn(&mut CoreAccess<'_>, &str) -> Result<Answers, SetupError>,
    serve: fn(&mut Setup<'_, RemoteServices>, RemoteService) -> Result<(), SetupError>,
    serve_foreign: fn(&mut Setup<'_, ForeignModule>, &str, u32) -> Result<(), SetupError>,
    foreign_client:
        fn(&mut Setup<'_, ForeignModule>, &str, Duration, u32) -> Result<CallEncodedIn, SetupError>,
    encode: fn(&mut CoreAccess<'_>, &str) -> Result<(), SetupError>,
    stand_in: fn(&mut Core, &str) -> Result<Box<AnswerEncoded>, SetupError>,
    response_type: fn() -> Option<DynamicType>,
    encode_event: fn(ServiceEventInfo, EventContent<'_>) -> Result<Vec<u8>, EventError>,
}

/// Holds the entry of a type as a constant, so that a handle is a reference to it.
struct Of<S>(PhantomData<S>);

impl<S: Service> Of<S> {
    const ENTRY: &'static Entry = &Entry::Compiled(CompiledEntry {
        name: S::TYPE_NAME,
        hash: S::TYPE_HASH,
        definition: S::DEFINITION,
        message_hashes: [
            <S::Request as Message>::TYPE_HASH,
            <S::Response as Message>::TYPE_HASH,
            <S::Event as Message>::TYPE_HASH,
        ],
        rust_types: || (type_name::<S::Request>(), type_name::<S::Response>()),
        caller: |core, service| caller(Compiled::<S>::NEW, core, service),
        answers: |core, topic| answers(Compiled::<S>::NEW, core, topic),
        serve: |setup, remote| serve(Compiled::<S>::NEW, setup, remote),
        serve_foreign: |setup, service, server| serve_foreign(Compiled::<S>::NEW, setup, service, server),
        foreign_client: |setup, service, timeout, client| {
            foreign_client(Compiled::<S>::NEW, setup, service, timeout, client)
        },
        encode: |core, service| encode(Compiled::<S>::NEW, core, service),
        stand_in: |core, service| stand_in(Compiled::<S>::NEW, core, service),
        response_type: || {
            let (name, text) = (<S::Response as Message>::TYPE_NAME, <S::Response as Message>::DEFINITION);
            DynamicType::from_definition_text(name, "ros2msg", text).ok()
        },
        encode_event: encode_event::<S>,
    });
}

fn leak(text: &str) -> &'static str {
    Box::leak(text.to_owned().into_boxed_str())
}

fn answers<C: ServiceCodec>(_: C, core: &mut CoreAccess<'_>, topic: &str) -> Result<Answers, SetupError> {
    Ok(Box::new(core.inlet::<Answer<C::Response>>(topic, Waiting::All.queue())?))
}

fn encode<C: ServiceCodec>(codec: C, core: &mut CoreAccess<'_>, service: &str) -> Result<(), SetupError> {
    core.encode_service_of(codec.in_core(), service, C::write_request, C::write_response)
}

fn caller<C: ServiceCodec>(
    codec: C,
    core: &mut CoreAccess<'_>,
    service: &str,
) -> Result<Box<CallEncoded>, SetupError> {
    let caller = core.caller_of(codec.in_core(), service)?;
    let service: Arc<str> = service.into();
    Ok(Box::new(move |bytes, timeout, on_answer| {
        let request = match codec.read_request(bytes) {
            Ok(request) => request,
            Err(error) => {
                let (service, reason) = (Arc::clone(&service), error.to_string());
                return on_answer(Err(EncodedCallError::Decode { service, type_name: codec.name(), reason }));
            }
        };
        // Whichever of the two outcomes comes first takes it.
        let on_answer = Arc::new(Mutex::new(Some(on_answer)));
        let finish = |on_answer: &Mutex<Option<OnAnswer>>, result| {
            let on_answer = on_answer.lock().take();
            if let Some(on_answer) = on_answer {
                on_answer(result);
            }
        };
        let answered = Arc::clone(&on_answer);
        let called = caller.call(request, timeout, move |result| {
            let answer =
                |response: C::Response| EncodedAnswer(Box::new(move || C::write_response(&response)));
            finish(&answered, result.map(answer).map_err(EncodedCallError::from));
        });
        if let Err(error) = called {
            finish(&on_answer, Err(error.into()));
        }
    }))
}

fn stand_in<C: ServiceCodec>(
    codec: C,
    core: &mut Core,
    service: &str,
) -> Result<Box<AnswerEncoded>, SetupError> {
    let stand_in = core.stand_in_of(codec.in_core(), service)?;
    Ok(Box::new(move |client, port, number, result| {
        let result = match result {
            Ok(cdr) => Ok(codec.read_response(cdr)?),
            Err(error) => Err(error),
        };
        stand_in.answer(client, port, number, result);
        Ok(())
    }))
}

fn serve<C: ServiceCodec>(
    codec: C,
    setup: &mut Setup<'_, RemoteServices>,
    remote: RemoteService,
) -> Result<(), SetupError> {
    let RemoteService { service, answers_topic, answers, mut call, .. } = remote;
    let answers = match answers.downcast::<Inlet<Answer<C::Response>>>() {
        Ok(answers) => *answers,
        Err(_) => return Err(setup.refuse(format!("service {service:?} was prepared for another type"))),
    };
    let open = Open::<C::Request, C::Response>::default();
    let mut next = 0;
    let asked = Arc::clone(&open);
    setup.serve_later_of(
        codec.in_core(),
        &service,
        move |_: &mut RemoteServices, request, responder, _: &mut Context<'_>| {
            let number = next;
            next += 1;
            asked.lock().insert(number, responder);
            let answers = answers.clone();
            let on_answer = move |result: Result<Bytes, String>| {
                let result = result.and_then(|cdr| {
                    codec
                        .read_response(&cdr)
                        .map_err(|error| format!("the answer is no {}: {error}", codec.name()))
                });
                // Fails only if the core has stopped or is flooded; the call then times out.
                if let Err(error) = answers.publish(Answer { number, result }) {
                    tracing::debug!(%error, "an answer did not enter the core");
                }
            };
            call.call(Box::new(move || C::write_request(&request).into()), Box::new(on_answer));
        },
    )?;
    setup.subscribe(
        &answers_topic,
        move |_: &mut RemoteServices, answer: Received<'_, Answer<C::Response>>, ctx: &mut Context<'_>| {
            let responder = open.lock().remove(&answer.number);
            if let Some(responder) = responder {
                ctx.reply(responder, answer.result.clone());
            }
        },
    )
}

fn serve_foreign<C: ServiceCodec>(
    codec: C,
    setup: &mut Setup<'_, ForeignModule>,
    service: &str,
    server: u32,
) -> Result<(), SetupError> {
    let name: Arc<str> = service.into();
    setup.serve_later_of(
        codec.in_core(),
        service,
        move |module: &mut ForeignModule, request, responder: Responder<_, C::Response>, ctx| {
            let name = Arc::clone(&name);
            let reply: ReplyEncoded = Box::new(move |ctx, result| {
                let (answer, outcome) = match result.map(|cdr| codec.read_response(cdr)) {
                    Ok(Ok(response)) => (Ok(response), Ok(())),
                    Ok(Err(error)) => {
                        let type_name = format!("response of {}", codec.name());
                        let error = ForeignError::Decode { name: name.to_string(), type_name, error };
                        (Err(error.to_string()), Err(error))
                    }
                    Err(reason) => (Err(reason), Ok(())),
                };
                ctx.reply(responder, answer);
                outcome
            });
            module.take_request(server, C::write_request(&request).into(), reply, ctx);
        },
    )
}

fn foreign_client<C: ServiceCodec>(
    codec: C,
    setup: &mut Setup<'_, ForeignModule>,
    service: &str,
    timeout: Duration,
    client: u32,
) -> Result<CallEncodedIn, SetupError> {
    let key = setup.client_of(
        codec.in_core(),
        service,
        timeout,
        move |module: &mut ForeignModule, reply, ctx| {
            let result = reply.result.map(|response| C::write_response(&response).into());
            let result = result.map_err(|error| error.to_string());
            module.take_reply(client, reply.call.number(), result, ctx);
        },
    )?;
    let name = service.to_owned();
    Ok(Box::new(move |ctx, cdr| {
        let request = codec.read_request(cdr).map_err(|error| {
            let type_name = format!("request of {}", codec.name());
            ForeignError::Decode { name: name.clone(), type_name, error }
        })?;
        Ok(ctx.call(key, request).number())
    }))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_msgs::std_srvs::srv::{Empty, SetBool, SetBoolEvent, SetBoolRequest};

    fn info() -> ServiceEventInfo {
        ServiceEventInfo {
            event_type: 1,
            client_gid: [7; 16],
            sequence_number: 9,
            ..ServiceEventInfo::default()
        }
    }

    #[test]
    fn an_event_has_the_request_or_the_response_or_neither() {
        let request = SetBoolRequest { data: true };
        let bytes = encode_event::<SetBool>(info(), EventContent::Request(&cdr::to_vec(&request))).unwrap();
        let event: SetBoolEvent = cdr::from_slice(&bytes).unwrap();
        assert_eq!((event.info, event.request, event.response), (info(), vec![request], vec![]));
        assert!(encode_event::<SetBool>(info(), EventContent::Response(&[0, 1])).is_err());
    }

    #[test]
    fn an_event_without_content_is_the_same_whatever_the_type() {
        let of_empty = encode_event::<Empty>(info(), EventContent::Nothing).unwrap();
        assert_eq!(encode_event::<SetBool>(info(), EventContent::Nothing).unwrap(), of_empty);
    }
}
