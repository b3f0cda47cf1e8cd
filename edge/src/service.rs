//! Types of services, and how requests and responses enter a core as bytes and leave it as bytes.

use crate::{CoreAccess, KnownType, RawTypeError, Waiting};
use bytes::Bytes;
use downbeat_executor::{
    AnyValue, CallError, Context, Core, Inlet, Module, ModuleOptions, Received, Responder, Role, ServiceType,
    Setup, SetupError, StandIn,
};
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, FieldError, InterfaceDefinition, TypeLookupError};
use downbeat_msgs::service_msgs::msg::ServiceEventInfo;
use downbeat_msgs::{Service, cdr};
use parking_lot::Mutex;
use std::any::Any;
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
pub struct EncodedStandIn {
    service: KnownService,
    stand_in: StandIn<AnyValue>,
}

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
    answers: Inlet<Answer>,
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

/// The types of an event and of what it holds, for writing events field by field.
struct EventTypes {
    event: DynamicType,
    request: DynamicType,
    response: DynamicType,
}

impl EventTypes {
    /// Those of a service, which are read from its definitions once.
    fn of(entry: &'static Entry) -> Option<Arc<Self>> {
        static READ: Mutex<BTreeMap<&'static str, Arc<EventTypes>>> = Mutex::new(BTreeMap::new());
        if let Some(types) = READ.lock().get(entry.hash) {
            return Some(Arc::clone(types));
        }
        let types = Self {
            event: entry.event.dynamic()?,
            request: entry.request.dynamic()?,
            response: entry.response.dynamic()?,
        };
        Some(Arc::clone(READ.lock().entry(entry.hash).or_insert_with(|| Arc::new(types))))
    }
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
        let entry = Entry { name, hash, definition, request, response, event };
        let mut services = SERVICES.lock();
        Ok(Self { entry: services.entry(hash).or_insert_with(|| Box::leak(Box::new(entry))) })
    }

    /// As in `std_srvs/srv/SetBool`.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.entry.name
    }

    /// `RIHS01_` and 64 hexadecimal digits.
    #[must_use]
    pub fn hash(self) -> &'static str {
        self.entry.hash
    }

    /// The definition text with all dependencies, as rosbag2 stores it for service events.
    #[must_use]
    pub fn definition(self) -> &'static str {
        self.entry.definition
    }

    /// True if its requests and responses pass through as bytes.
    #[must_use]
    pub fn is_raw(self) -> bool {
        self.entry.request.is_raw()
    }

    /// The hashes of the messages of its requests, responses and events.
    #[must_use]
    pub fn message_hashes(self) -> [&'static str; 3] {
        let Entry { request, response, event, .. } = self.entry;
        [*request, *response, *event].map(KnownType::hash)
    }

    /// The type of its requests, for reading and writing them field by field; `None` while its definition is
    /// unknown.
    #[must_use]
    pub fn request_type(self) -> Option<DynamicType> {
        self.entry.request.dynamic()
    }

    /// The type of its responses, for reading and writing them field by field; `None` while its definition is
    /// unknown.
    #[must_use]
    pub fn response_type(self) -> Option<DynamicType> {
        self.entry.response.dynamic()
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
        // Known for every service: a raw one is made of its definitions.
        let Some(types) = EventTypes::of(self.entry) else { return Ok(self.entry.event.default_cdr()) };
        let mut event = DynamicMessage::new(&types.event);
        let of_info = event.get("info")?.as_message().map(|info| info.message_type());
        if let Some(of_info) = of_info {
            event.set("info", DynamicMessage::from_cdr(&of_info, &cdr::to_vec(&info))?)?;
        }
        // Decoded and encoded again: the alignment in the middle of a message differs.
        match content {
            EventContent::Nothing => {}
            EventContent::Request(cdr) => {
                event.push("request", DynamicMessage::from_cdr(&types.request, cdr)?)?;
            }
            EventContent::Response(cdr) => {
                event.push("response", DynamicMessage::from_cdr(&types.response, cdr)?)?;
            }
        }
        Ok(event.to_cdr())
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
        let caller = core.caller_of(self.in_core(), service)?;
        let service: Arc<str> = service.into();
        let name = Arc::clone(&service);
        let call: Arc<CallEncoded> = Arc::new(move |bytes, timeout, on_answer: OnAnswer| {
            let request = match self.read_request(bytes) {
                Ok(request) => request,
                Err(error) => {
                    let (service, reason) = (Arc::clone(&name), error.to_string());
                    let type_name = self.name();
                    return on_answer(Err(EncodedCallError::Decode { service, type_name, reason }));
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
                    |response: AnyValue| EncodedAnswer(Box::new(move || self.write_response(&*response.0)));
                finish(&answered, result.map(answer).map_err(EncodedCallError::from));
            });
            if let Err(error) = called {
                finish(&on_answer, Err(error.into()));
            }
        });
        Ok(EncodedCaller { service, call })
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
        let answers = core.inlet::<Answer>(&answers_topic, Waiting::All.queue())?;
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
        let Entry { request, response, .. } = *self.entry;
        let write = |of: KnownType| move |value: &dyn Any| of.encode(value).map(Vec::from);
        core.encode_service_of(self.in_core(), service, write(request), write(response))
    }

    /// Opens a stand-in, which answers calls of modules with serialized responses in place of a server.
    ///
    /// # Errors
    /// [`SetupError`] when the name is not valid or the service has other types.
    pub fn stand_in(self, core: &mut Core, service: &str) -> Result<EncodedStandIn, SetupError> {
        let stand_in = core.stand_in_of(self.in_core(), service)?;
        Ok(EncodedStandIn { service: self, stand_in })
    }

    /// The names of the types of request and response in a core.
    pub(crate) fn types_in_core(self) -> (&'static str, &'static str) {
        (self.entry.request.in_core_as().1, self.entry.response.in_core_as().1)
    }

    /// The types as the executor knows them. In a core, requests and responses are in boxes here, and values
    /// of their Rust types where modules use them.
    pub(crate) fn in_core(self) -> ServiceType<AnyValue, AnyValue> {
        ServiceType::erased(self.entry.request.in_core_as(), self.entry.response.in_core_as())
    }

    /// Reads a request of either byte order.
    pub(crate) fn read_request(self, cdr: &[u8]) -> cdr::Result<AnyValue> {
        self.entry.request.decode_checked(cdr).map(|request| AnyValue(request))
    }

    /// Reads a response of either byte order.
    pub(crate) fn read_response(self, cdr: &[u8]) -> cdr::Result<AnyValue> {
        self.entry.response.decode_checked(cdr).map(|response| AnyValue(response))
    }

    /// Writes a request, little-endian.
    pub(crate) fn write_request(self, request: &dyn Any) -> Vec<u8> {
        written(self.entry.request, request)
    }

    /// Writes a response, little-endian.
    pub(crate) fn write_response(self, response: &dyn Any) -> Vec<u8> {
        written(self.entry.response, response)
    }
}

/// The executor passes only values of the types that a service was opened with.
fn written(of: KnownType, value: &dyn Any) -> Vec<u8> {
    let written = of.encode(value);
    debug_assert!(written.is_some(), "a value of another type than {of}");
    written.map(Vec::from).unwrap_or_default()
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
        let result = match result {
            Ok(cdr) => Ok(self.service.read_response(cdr)?),
            Err(error) => Err(error),
        };
        self.stand_in.answer(client, port, number, result);
        Ok(())
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
        self.services.drain(..).try_for_each(|service| serve(setup, service))
    }
}

type OnAnswer = Box<dyn FnOnce(Result<EncodedAnswer, EncodedCallError>) + Send>;
type CallEncoded = dyn Fn(&[u8], Duration, OnAnswer) + Send + Sync;

/// The outcome of one request.
struct Answer {
    number: u64,
    /// The subscription of [`RemoteServices`], the only one of its topic, takes it out.
    result: Mutex<Option<Result<AnyValue, String>>>,
}

struct Entry {
    name: &'static str,
    hash: &'static str,
    definition: &'static str,
    request: KnownType,
    response: KnownType,
    event: KnownType,
}

/// Holds the entry of a type as a constant, so that a handle is a reference to it.
struct Of<S>(PhantomData<S>);

impl<S: Service> Of<S> {
    const ENTRY: &'static Entry = &Entry {
        name: S::TYPE_NAME,
        hash: S::TYPE_HASH,
        definition: S::DEFINITION,
        request: KnownType::of::<S::Request>(),
        response: KnownType::of::<S::Response>(),
        event: KnownType::of::<S::Event>(),
    };
}

fn leak(text: &str) -> &'static str {
    Box::leak(text.to_owned().into_boxed_str())
}

fn serve(setup: &mut Setup<'_, RemoteServices>, remote: RemoteService) -> Result<(), SetupError> {
    let RemoteService { service, service_type, answers_topic, answers, mut call } = remote;
    let open = Arc::<Mutex<HashMap<u64, Responder<AnyValue, AnyValue>>>>::default();
    let mut next = 0;
    let asked = Arc::clone(&open);
    setup.serve_later_of(
        service_type.in_core(),
        &service,
        move |_: &mut RemoteServices, request, responder, _: &mut Context<'_>| {
            let number = next;
            next += 1;
            asked.lock().insert(number, responder);
            let answers = answers.clone();
            let on_answer = move |result: Result<Bytes, String>| {
                let result = result.and_then(|cdr| {
                    let response = service_type.read_response(&cdr);
                    response.map_err(|error| format!("the answer is no {service_type}: {error}"))
                });
                // Fails only if the core has stopped or is flooded; the call then times out.
                if let Err(error) = answers.publish(Answer { number, result: Mutex::new(Some(result)) }) {
                    tracing::debug!(%error, "an answer did not enter the core");
                }
            };
            let request = move || service_type.write_request(&*request.0).into();
            call.call(Box::new(request), Box::new(on_answer));
        },
    )?;
    setup.subscribe(
        &answers_topic,
        move |_: &mut RemoteServices, answer: Received<'_, Answer>, ctx: &mut Context<'_>| {
            let responder = open.lock().remove(&answer.number);
            if let (Some(responder), Some(result)) = (responder, answer.result.lock().take()) {
                ctx.reply(responder, result);
            }
        },
    )
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_msgs::std_srvs::srv::{Empty, SetBool, SetBoolEvent, SetBoolRequest};

    fn encode_event<S: Service>(
        info: ServiceEventInfo,
        content: EventContent<'_>,
    ) -> Result<Vec<u8>, EventError> {
        KnownService::of::<S>().encode_event(info, content)
    }

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
