//! Types of messages, and how messages leave a core as bytes and enter it from bytes.

use crate::CoreAccess;
use bytes::Bytes;
use downbeat_executor::queue::{Locked, Overflow};
use downbeat_executor::{
    AnyMessage, AnyReceived, Core, ErasedType, Inlet, InletError, MessageType, Outlet, OutletGate,
    OutletInbox, SetupError, Time,
};
use downbeat_msgs::definitions::{Kind, TypeName};
use downbeat_msgs::dynamic::{Definitions, DynamicMessage, DynamicType, TypeDefinition, TypeLookupError};
use downbeat_msgs::{Message, cdr};
use parking_lot::Mutex;
use std::any::{Any, TypeId, type_name};
use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;
use std::num::NonZeroUsize;
use std::sync::{Arc, OnceLock};
use thiserror::Error;

/// A message type of ROS 2: one with a Rust type ([`Interfaces`](crate::Interfaces), [`KnownType::of`]), or
/// one whose messages pass through as bytes ([`KnownType::raw`]).
#[derive(Clone, Copy)]
pub struct KnownType {
    entry: &'static Entry,
}

/// Takes the serialized messages of a topic. A closure takes all of them.
pub trait Sink: Send + 'static {
    /// Decides, on the thread of the core, whether messages are passed to the thread of the sink at all.
    /// `None` if all are.
    fn gate(&self) -> Option<OutletGate> {
        None
    }

    /// Whether to serialize the next message and pass it to [`take`](Self::take).
    fn is_wanted(&mut self, _message: Offered) -> bool {
        true
    }

    /// Takes a message: the time of the cycle that published it; encapsulation header (little-endian) and
    /// body.
    fn take(&mut self, time: Time, cdr: Bytes);
}

/// A message before it is serialized.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Offered {
    /// The time of the cycle that published it.
    pub time: Time,
    /// True if the topic carried no message after it in that cycle.
    pub is_last_of_cycle: bool,
    /// How many messages before it the inbox dropped, because the sink was too slow.
    pub missed: u32,
}

/// Publishes serialized messages on a topic of a core, from any thread. Clones publish on the same topic.
#[derive(Clone)]
pub struct EncodedInlet {
    topic: Arc<str>,
    message_type: KnownType,
    inlet: Inlet<AnyMessage>,
}

/// Which of the messages that arrive between two cycles enter the core.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Waiting {
    /// All, up to [`Inlet::CAPACITY`]; more are refused.
    #[default]
    All,
    /// The latest; those before it count as dropped by the topic.
    Latest,
}

/// A serialized message did not enter the core.
#[derive(Debug, Error)]
pub enum EncodedInletError {
    /// The bytes are no message of the type.
    #[error("topic \"{topic}\": the bytes are no {type_name}: {error}")]
    Decode {
        /// The topic.
        topic: Arc<str>,
        /// The type it carries.
        type_name: &'static str,
        /// What is wrong with the bytes.
        error: cdr::Error,
    },
    /// The core refused the message.
    #[error("topic \"{topic}\": {error}")]
    Inlet {
        /// The topic.
        topic: Arc<str>,
        /// Why.
        error: InletError,
    },
}

/// A message as bytes, with the name of its type: what a topic of a core carries whose type is not compiled
/// in. Modules read its fields by the definition of the type:
///
/// ```
/// use downbeat_edge::{KnownType, RawMessage};
/// use downbeat_msgs::dynamic::{Definitions, DynamicMessage, Schemas};
///
/// let mut schemas = Schemas::new("walk.mcap");
/// schemas.add("legs/msg/Leg", "ros2msg", "float64[] angles\n")?;
/// let definitions = Definitions::new().with(schemas);
/// let leg = KnownType::raw("legs/msg/Leg", &definitions)?;
///
/// let mut message = DynamicMessage::new(&definitions.find("legs/msg/Leg")?);
/// message.push("angles", 0.5)?;
/// let received = RawMessage::new(leg, message.to_cdr().into());
/// assert_eq!(received.decode()?.get("angles[0]")?.as_f64(), Some(0.5));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RawMessage {
    message_type: KnownType,
    cdr: Bytes,
}

/// A raw message cannot be decoded.
#[derive(Debug, Error)]
pub enum RawError {
    /// The definition of the type is unknown.
    #[error(
        "the definition of {0} is not known: source the workspace that has it (AMENT_PREFIX_PATH), or wait until its publisher \
         was asked"
    )]
    NoDefinition(&'static str),
    /// The bytes are no message of the type.
    #[error("the bytes are no {type_name}: {reason}")]
    Decode {
        /// The type.
        type_name: &'static str,
        /// What is wrong with the bytes.
        reason: String,
    },
}

/// A type cannot be used as a raw type.
#[derive(Debug, Error)]
pub enum RawTypeError {
    /// The name is no name of a message type.
    #[error("{name:?} is no message type: expected package/msg/Name")]
    Name {
        /// The name.
        name: String,
    },
    /// The definition cannot be used.
    #[error(transparent)]
    Definition(Box<TypeLookupError>),
    /// The program uses too many raw types.
    #[error("{name} is one type too many: this program has met {MOST_TYPES} that are not compiled in")]
    TooMany {
        /// The type.
        name: String,
    },
}

/// The raw types, by name.
static TYPES: Mutex<BTreeMap<&'static str, Vec<KnownType>>> = Mutex::new(BTreeMap::new());

/// Raw types live as long as the program, so there is a limit.
const MOST_TYPES: usize = 4096;

/// The encapsulation of plain CDR.
const PLAIN_LITTLE_ENDIAN: [u8; 2] = [0, 1];

impl KnownType {
    /// The message type of a Rust type, which need not be registered.
    #[must_use]
    pub const fn of<T: Message>() -> Self {
        Self { entry: Of::<T>::ENTRY }
    }

    /// The type of that name as one that passes through: its messages are [`RawMessage`]s in a core. If its
    /// definition is not in `definitions`, [`KnownType::learn`] can add it later.
    ///
    /// # Errors
    /// If that is no name of a message type, or there are too many raw types.
    pub fn raw(name: &str, definitions: &Definitions) -> Result<Self, RawTypeError> {
        let is_message = |found: &TypeName| found.kind == Kind::Message;
        if !name.parse().as_ref().is_ok_and(is_message) {
            return Err(RawTypeError::Name { name: name.to_owned() });
        }
        match definitions.describe(name) {
            Ok(definition) => Self::defined(definition),
            Err(_) => Self::interned(name, ""),
        }
    }

    /// The type of that definition, which may be that of a message of a service or an action, as one that
    /// passes through.
    pub(crate) fn defined(definition: TypeDefinition) -> Result<Self, RawTypeError> {
        let name = definition.message_type.name().to_string();
        let raw = Self::interned(&name, &definition.hash)?;
        raw.learn(definition);
        Ok(raw)
    }

    /// The raw type of that name that the program has met; if there are several, the one that `choose`
    /// returns.
    pub(crate) fn met(name: &str, choose: impl FnOnce() -> Option<Self>) -> Option<Self> {
        let of_name = TYPES.lock().get(name).cloned()?;
        match of_name.as_slice() {
            [one] => Some(*one),
            several => choose().or_else(|| several.first().copied()),
        }
    }

    /// The raw type of that name and hash. With an empty hash, the first one of that name; with another one,
    /// the one whose definition is unknown so far, if no other has it.
    fn interned(name: &str, hash: &str) -> Result<Self, RawTypeError> {
        let mut types = TYPES.lock();
        let of_name = types.get(name).map(Vec::as_slice).unwrap_or_default();
        let found = match hash {
            "" => of_name.first(),
            hash => {
                let with = |hash: &str| of_name.iter().find(|raw| raw.hash() == hash);
                with(hash).or_else(|| with(""))
            }
        };
        if let Some(found) = found {
            return Ok(*found);
        }
        if types.values().map(Vec::len).sum::<usize>() >= MOST_TYPES {
            return Err(RawTypeError::TooMany { name: name.to_owned() });
        }
        let name: &'static str = Box::leak(name.to_owned().into_boxed_str());
        let rust = Rust::Raw(Box::leak(Box::new(OnceLock::new())));
        let raw = Self { entry: Box::leak(Box::new(Entry { name, rust })) };
        types.entry(name).or_default().push(raw);
        Ok(raw)
    }

    /// As in `sensor_msgs/msg/Imu`.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.entry.name
    }

    /// `RIHS01_` and 64 hexadecimal digits; empty for a raw type whose definition is unknown.
    #[must_use]
    pub fn hash(self) -> &'static str {
        match &self.entry.rust {
            Rust::Compiled(compiled) => compiled.hash,
            Rust::Raw(learned) => learned.get().map_or("", |learned| &learned.hash),
        }
    }

    /// The `ros2msg` text with all dependencies, as rosbag2 stores it; empty for a raw type whose definition
    /// is unknown.
    #[must_use]
    pub fn definition(self) -> &'static str {
        match &self.entry.rust {
            Rust::Compiled(compiled) => compiled.definition,
            Rust::Raw(learned) => learned.get().map_or("", |learned| &learned.definition),
        }
    }

    /// The Rust type; [`RawMessage`] for all raw types.
    #[must_use]
    pub fn rust_type(self) -> TypeId {
        self.entry.message_type()
    }

    /// The Rust type, and the name under which a core knows the type.
    pub(crate) fn in_core_as(self) -> (TypeId, &'static str) {
        (self.entry.message_type(), self.entry.type_name())
    }

    /// True if messages of the type are [`RawMessage`]s.
    #[must_use]
    pub fn is_raw(self) -> bool {
        matches!(self.entry.rust, Rust::Raw(_))
    }

    /// Sets the definition of a raw type. The first definition stays.
    pub fn learn(self, definition: TypeDefinition) {
        if let Rust::Raw(learned) = &self.entry.rust {
            let TypeDefinition { message_type: dynamic, text: definition, hash } = definition;
            // Fails if another thread has set it.
            let _ = learned.set(Learned { hash, definition, dynamic });
        }
    }

    /// The type for reading its messages field by field; `None` while its definition is unknown.
    #[must_use]
    pub fn dynamic(self) -> Option<DynamicType> {
        match &self.entry.rust {
            Rust::Raw(learned) => Some(learned.get()?.dynamic.clone()),
            Rust::Compiled(_) => {
                DynamicType::from_definition_text(self.name(), "ros2msg", self.definition()).ok()
            }
        }
    }

    /// Serializes the messages of `topic` and passes them to `sink`, with the time of the cycle that
    /// published them, until the outlet is dropped. A raw type passes on only messages of this type.
    ///
    /// # Errors
    /// [`SetupError`] when the name is not valid, the topic carries another type, or the core does not
    /// answer.
    pub fn outlet(
        self,
        core: &mut CoreAccess<'_>,
        topic: &str,
        inbox: &OutletInbox,
        sink: impl Sink,
    ) -> Result<Outlet, SetupError> {
        self.outlet_to(core, topic, inbox, Box::new(sink))
    }

    fn outlet_to(
        self,
        core: &mut CoreAccess<'_>,
        topic: &str,
        inbox: &OutletInbox,
        mut sink: Box<dyn Sink>,
    ) -> Result<Outlet, SetupError> {
        let gate = sink.gate();
        let take = move |AnyReceived { message, time, is_last, missed }: AnyReceived<'_>| {
            let offered = Offered { time, is_last_of_cycle: is_last, missed };
            if self.is_type_of(message)
                && sink.is_wanted(offered)
                && let Some(cdr) = self.encode(message)
            {
                sink.take(time, cdr);
            }
        };
        core.outlet_of(self.in_core(), topic, inbox, gate, take)
    }

    /// Opens an inlet for serialized messages, which any thread may use.
    ///
    /// # Errors
    /// [`SetupError`] when the name is not valid or the topic carries another type.
    pub fn inlet(self, core: &mut Core, topic: &str) -> Result<EncodedInlet, SetupError> {
        self.inlet_with(&mut CoreAccess::Idle(core), topic, Waiting::All)
    }

    /// Opens an inlet for serialized messages into a core that may be running.
    ///
    /// # Errors
    /// [`SetupError`] when the name is not valid, the topic carries another type, or the core does not
    /// answer.
    pub fn inlet_with(
        self,
        core: &mut CoreAccess<'_>,
        topic: &str,
        waiting: Waiting,
    ) -> Result<EncodedInlet, SetupError> {
        let inlet = core.inlet_of(self.in_core(), topic, waiting.queue::<AnyMessage>())?;
        Ok(EncodedInlet { topic: topic.into(), message_type: self, inlet })
    }

    /// Serializes the default value of the type: a message that every reader accepts, for tests and probes.
    /// For a raw type whose definition is unknown it has no body.
    #[must_use]
    pub fn default_cdr(self) -> Vec<u8> {
        let message = self.dynamic().map(|dynamic| DynamicMessage::new(&dynamic).to_cdr());
        message.unwrap_or_else(|| vec![0, 1, 0, 0])
    }

    /// The type as the executor knows it, for [`Setup::publish_of`](downbeat_executor::Setup::publish_of) and
    /// [`Setup::subscribe_of`](downbeat_executor::Setup::subscribe_of).
    #[must_use]
    pub fn in_core(self) -> MessageType {
        match &self.entry.rust {
            Rust::Compiled(_) => MessageType::erased(self.entry),
            Rust::Raw(_) => MessageType::of::<RawMessage>().named(self.name()),
        }
    }

    /// Decodes a message, encapsulation header (of either byte order) and body. The bytes of a raw type are
    /// not checked.
    ///
    /// # Errors
    /// If the bytes are no such message.
    pub fn decode(self, cdr: &[u8]) -> cdr::Result<AnyMessage> {
        match &self.entry.rust {
            Rust::Compiled(compiled) => (compiled.decode)(cdr),
            Rust::Raw(_) => Ok(Box::new(RawMessage::new(self, Bytes::copy_from_slice(cdr)))),
        }
    }

    /// As [`decode`](Self::decode), and checks the bytes of a raw type too.
    pub(crate) fn decode_checked(self, cdr: &[u8]) -> cdr::Result<AnyMessage> {
        match &self.entry.rust {
            Rust::Compiled(compiled) => (compiled.decode)(cdr),
            Rust::Raw(_) => Ok(Box::new(RawMessage::new(self, self.checked(Bytes::copy_from_slice(cdr))?))),
        }
    }

    /// As [`decode`](Self::decode), for bytes that can be shared: a raw message keeps them instead of a copy.
    ///
    /// # Errors
    /// If the bytes are no such message.
    pub fn decode_shared(self, cdr: &Bytes) -> cdr::Result<AnyMessage> {
        match &self.entry.rust {
            Rust::Compiled(compiled) => (compiled.decode)(cdr),
            Rust::Raw(_) => Ok(Box::new(RawMessage::new(self, cdr.clone()))),
        }
    }

    /// Checks a serialized message of a raw type whose definition is known, and returns it as plain
    /// little-endian CDR. Other messages are checked when they are decoded.
    ///
    /// # Errors
    /// If the bytes are no such message.
    pub(crate) fn checked(self, cdr: Bytes) -> cdr::Result<Bytes> {
        let Rust::Raw(learned) = &self.entry.rust else { return Ok(cdr) };
        let Some(Learned { dynamic, .. }) = learned.get() else { return Ok(cdr) };
        if !cdr.starts_with(&PLAIN_LITTLE_ENDIAN) {
            return Ok(DynamicMessage::from_cdr(dynamic, &cdr)?.to_cdr().into());
        }
        dynamic.validate_cdr(&cdr)?;
        Ok(cdr)
    }

    /// Whether a message that a module received is of this type: raw messages of all types have one Rust
    /// type.
    #[must_use]
    pub fn is_type_of(self, message: &dyn Any) -> bool {
        message.downcast_ref::<RawMessage>().is_none_or(|raw| raw.message_type() == self)
    }

    /// Serializes a message, with its encapsulation header. Returns `None` if it has another Rust type.
    #[must_use]
    pub fn encode(self, message: &dyn Any) -> Option<Bytes> {
        match &self.entry.rust {
            Rust::Compiled(compiled) => (compiled.encode)(message).map(Bytes::from),
            Rust::Raw(_) => message.downcast_ref().map(|raw: &RawMessage| raw.cdr().clone()),
        }
    }
}

impl fmt::Debug for KnownType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("KnownType").field(&self.name()).finish()
    }
}

impl fmt::Display for KnownType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Raw types of one name with two definitions are two types.
impl PartialEq for KnownType {
    fn eq(&self, other: &Self) -> bool {
        match (&self.entry.rust, &other.entry.rust) {
            (Rust::Raw(own), Rust::Raw(other)) => std::ptr::eq(*own, *other),
            _ => self.name() == other.name() && self.is_raw() == other.is_raw(),
        }
    }
}

impl Eq for KnownType {}

impl<F: FnMut(Time, Bytes) + Send + 'static> Sink for F {
    fn take(&mut self, time: Time, cdr: Bytes) {
        self(time, cdr);
    }
}

impl EncodedInlet {
    /// The topic.
    #[must_use]
    pub fn topic(&self) -> &str {
        &self.topic
    }

    /// The type of its messages.
    #[must_use]
    pub fn message_type(&self) -> KnownType {
        self.message_type
    }

    /// Decodes a message, encapsulation header (of either byte order) and body, and passes it to the core.
    /// Never blocks.
    ///
    /// # Errors
    /// [`EncodedInletError`] when the bytes are no such message, or the core refuses it.
    pub fn publish(&self, cdr: &[u8]) -> Result<(), EncodedInletError> {
        self.publish_decoded(self.message_type.decode(cdr))
    }

    /// As [`publish`](Self::publish), for bytes that can be shared: a raw message keeps them instead of a
    /// copy.
    ///
    /// # Errors
    /// As for [`publish`](Self::publish).
    pub fn publish_shared(&self, cdr: &Bytes) -> Result<(), EncodedInletError> {
        self.publish_decoded(self.message_type.decode_shared(cdr))
    }

    fn publish_decoded(&self, message: cdr::Result<AnyMessage>) -> Result<(), EncodedInletError> {
        let topic = || Arc::clone(&self.topic);
        let type_name = self.message_type.name();
        let message =
            message.map_err(|error| EncodedInletError::Decode { topic: topic(), type_name, error })?;
        self.inlet.publish(message).map_err(|error| EncodedInletError::Inlet { topic: topic(), error })
    }
}

impl fmt::Debug for EncodedInlet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("EncodedInlet").field("topic", &self.topic).field("type", &self.message_type).finish()
    }
}

impl Waiting {
    pub(crate) fn queue<T: Send + 'static>(self) -> Locked<T> {
        let all = NonZeroUsize::MIN.saturating_add(Inlet::<T>::CAPACITY - 1);
        match self {
            Self::All => Locked::bounded(all, Overflow::Refuse),
            Self::Latest => Locked::bounded(NonZeroUsize::MIN, Overflow::DropOldest),
        }
    }
}

impl RawMessage {
    /// Encapsulation header (of either byte order) and body of a message.
    #[must_use]
    pub fn new(message_type: KnownType, cdr: Bytes) -> Self {
        Self { message_type, cdr }
    }

    /// Its type.
    #[must_use]
    pub fn message_type(&self) -> KnownType {
        self.message_type
    }

    /// Encapsulation header and body.
    #[must_use]
    pub fn cdr(&self) -> &Bytes {
        &self.cdr
    }

    /// Decodes the message by the definition of its type.
    ///
    /// # Errors
    /// If the definition is unknown, or the bytes are no such message.
    pub fn decode(&self) -> Result<DynamicMessage, RawError> {
        let type_name = self.message_type.name();
        let dynamic = self.message_type.dynamic().ok_or(RawError::NoDefinition(type_name))?;
        DynamicMessage::from_cdr(&dynamic, &self.cdr)
            .map_err(|error| RawError::Decode { type_name, reason: error.to_string() })
    }
}

struct Entry {
    name: &'static str,
    rust: Rust,
}

/// The Rust side of a type.
enum Rust {
    Compiled(Compiled),
    Raw(&'static OnceLock<Learned>),
}

// Each function exists once per message type: what does not depend on the type is elsewhere.
struct Compiled {
    hash: &'static str,
    definition: &'static str,
    rust_type: fn() -> (TypeId, &'static str),
    decode: fn(&[u8]) -> cdr::Result<AnyMessage>,
    encode: fn(&dyn Any) -> Option<Vec<u8>>,
}

// A core keeps messages of compiled types in the boxes that `decode` returns, unless a module uses their
// topic.
impl ErasedType for Entry {
    fn message_type(&self) -> TypeId {
        match &self.rust {
            Rust::Compiled(compiled) => (compiled.rust_type)().0,
            Rust::Raw(_) => TypeId::of::<RawMessage>(),
        }
    }

    fn type_name(&self) -> &'static str {
        match &self.rust {
            Rust::Compiled(compiled) => (compiled.rust_type)().1,
            Rust::Raw(_) => self.name,
        }
    }

    fn copy(&self, message: &dyn Any) -> Option<AnyMessage> {
        match &self.rust {
            Rust::Compiled(compiled) => (compiled.decode)(&(compiled.encode)(message)?).ok(),
            Rust::Raw(_) => {
                message.downcast_ref().map(|raw: &RawMessage| Box::new(raw.clone()) as AnyMessage)
            }
        }
    }
}

/// The definition of a raw type.
struct Learned {
    hash: String,
    definition: String,
    dynamic: DynamicType,
}

/// Holds the entry of a type as a constant, so that a handle is a reference to it.
struct Of<T>(PhantomData<T>);

impl<T: Message> Of<T> {
    const ENTRY: &'static Entry = &Entry {
        name: T::TYPE_NAME,
        rust: Rust::Compiled(Compiled {
            hash: T::TYPE_HASH,
            definition: T::DEFINITION,
            rust_type: || (TypeId::of::<T>(), type_name::<T>()),
            decode: |bytes| Ok(Box::new(cdr::from_slice::<T>(bytes)?)),
            encode: |message| message.downcast_ref::<T>().map(cdr::to_vec),
        }),
    };
}
