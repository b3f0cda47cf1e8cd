//! Types of messages.

use super::raw::{Learned, RawMessage};
use super::{CoreAccess, EncodedInlet, Sink, Waiting, outlet};
use bytes::Bytes;
use downbeat_executor::{AnyMessage, Core, MessageType, Outlet, OutletInbox, SetupError};
use downbeat_msgs::dynamic::DynamicMessage;
use downbeat_msgs::{Message, cdr};
use std::any::{Any, TypeId};
use std::fmt;
use std::marker::PhantomData;
use std::sync::OnceLock;
use thiserror::Error;

/// A message type of ROS 2: one with a Rust type ([`Interfaces`](super::Interfaces), [`KnownType::of`]), or one whose messages pass
/// through as bytes ([`KnownType::raw`]).
#[derive(Clone, Copy)]
pub struct KnownType {
    entry: &'static Entry,
}

/// A type name that no message has.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("unknown message type {name:?}{}", nearest.map(|name| format!(", did you mean {name:?}?")).unwrap_or_default())]
pub struct UnknownType {
    /// The name that was looked for.
    pub name: String,
    /// The name most like it, if one is like it.
    pub nearest: Option<&'static str>,
}

impl KnownType {
    /// The message type of a Rust type, which need not be registered.
    #[must_use]
    pub fn of<T: Message>() -> Self {
        Self { entry: Of::<T>::ENTRY }
    }

    /// As in `sensor_msgs/msg/Imu`.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.entry.name
    }

    /// `RIHS01_` and 64 hexadecimal digits; empty of a raw type whose definition is not known.
    #[must_use]
    pub fn hash(self) -> &'static str {
        match &self.entry.rust {
            Rust::Compiled(compiled) => compiled.hash,
            Rust::Raw(learned) => learned.get().map_or("", |learned| &learned.hash),
        }
    }

    /// The `ros2msg` text with all dependencies, as rosbag2 stores it; empty of a raw type whose definition is not known.
    #[must_use]
    pub fn definition(self) -> &'static str {
        match &self.entry.rust {
            Rust::Compiled(compiled) => compiled.definition,
            Rust::Raw(learned) => learned.get().map_or("", |learned| &learned.definition),
        }
    }

    /// The Rust type; that of [`RawMessage`](super::RawMessage) is one for all raw types.
    #[must_use]
    pub fn rust_type(self) -> TypeId {
        match &self.entry.rust {
            Rust::Compiled(compiled) => (compiled.rust_type)(),
            Rust::Raw(_) => TypeId::of::<RawMessage>(),
        }
    }

    /// Gives each message of `topic` to `sink`, serialized, with the time of the cycle that published it, until the outlet is
    /// dropped.
    ///
    /// # Errors
    /// [`SetupError`] when the name is not valid, the topic carries another type, or the core does not answer.
    pub fn outlet(
        self,
        core: &mut CoreAccess<'_>,
        topic: &str,
        inbox: &OutletInbox,
        sink: impl Sink,
    ) -> Result<Outlet, SetupError> {
        outlet::open(self, core, topic, inbox, Box::new(sink))
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
    /// [`SetupError`] when the name is not valid, the topic carries another type, or the core does not answer.
    pub fn inlet_with(
        self,
        core: &mut CoreAccess<'_>,
        topic: &str,
        waiting: Waiting,
    ) -> Result<EncodedInlet, SetupError> {
        EncodedInlet::open(self, core, topic, waiting)
    }

    /// Serializes the default value of the type: a message that every reader accepts, for tests and probes. Of a raw type
    /// whose definition is not known it has no body.
    #[must_use]
    pub fn default_cdr(self) -> Vec<u8> {
        match &self.entry.rust {
            Rust::Compiled(compiled) => (compiled.default_cdr)(),
            Rust::Raw(_) => {
                let message = self.dynamic().map(|dynamic| DynamicMessage::new(&dynamic).to_cdr());
                message.unwrap_or_else(|| vec![0, 1, 0, 0])
            }
        }
    }

    /// The type of its messages in a core.
    pub(super) fn in_core(self) -> MessageType {
        match &self.entry.rust {
            Rust::Compiled(compiled) => compiled.in_core,
            Rust::Raw(_) => MessageType::of::<RawMessage>(),
        }
    }

    /// Makes a message of its serialized form.
    pub(super) fn decode(self, cdr: &[u8]) -> cdr::Result<AnyMessage> {
        match &self.entry.rust {
            Rust::Compiled(compiled) => (compiled.decode)(cdr),
            Rust::Raw(_) => Ok(Box::new(RawMessage::new(self, Bytes::copy_from_slice(cdr)))),
        }
    }

    /// Whether a message of [`in_core`](Self::in_core) is of this type: raw messages of all types have one Rust type.
    pub(super) fn is_of(self, message: &dyn Any) -> bool {
        message.downcast_ref::<RawMessage>().is_none_or(|raw| raw.message_type() == self)
    }

    /// Serializes a message; `None` if it has another Rust type.
    pub(super) fn encode(self, message: &dyn Any) -> Option<Bytes> {
        match &self.entry.rust {
            Rust::Compiled(compiled) => (compiled.encode)(message).map(Bytes::from),
            Rust::Raw(_) => message.downcast_ref().map(|raw: &RawMessage| raw.cdr().clone()),
        }
    }

    pub(super) fn of_entry(entry: &'static Entry) -> Self {
        Self { entry }
    }

    pub(super) fn entry(self) -> &'static Entry {
        self.entry
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

impl PartialEq for KnownType {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name() && self.is_raw() == other.is_raw()
    }
}

impl Eq for KnownType {}

pub(super) struct Entry {
    pub(super) name: &'static str,
    pub(super) rust: Rust,
}

/// What a type is in Rust.
pub(super) enum Rust {
    Compiled(Compiled),
    /// With what is known of it.
    Raw(&'static OnceLock<Learned>),
}

// Each function exists once per message type: what does not depend on the type is elsewhere.
pub(super) struct Compiled {
    hash: &'static str,
    definition: &'static str,
    rust_type: fn() -> TypeId,
    in_core: MessageType,
    decode: fn(&[u8]) -> cdr::Result<AnyMessage>,
    encode: fn(&dyn Any) -> Option<Vec<u8>>,
    default_cdr: fn() -> Vec<u8>,
}

/// Where the entry of a type is: a constant, so that a handle is a reference to it.
struct Of<T>(PhantomData<T>);

impl<T: Message> Of<T> {
    const ENTRY: &'static Entry = &Entry {
        name: T::TYPE_NAME,
        rust: Rust::Compiled(Compiled {
            hash: T::TYPE_HASH,
            definition: T::DEFINITION,
            rust_type: TypeId::of::<T>,
            in_core: MessageType::of::<T>(),
            decode: |bytes| Ok(Box::new(cdr::from_slice::<T>(bytes)?)),
            encode: |message| message.downcast_ref::<T>().map(cdr::to_vec),
            default_cdr: || cdr::to_vec(&T::default()),
        }),
    };
}
