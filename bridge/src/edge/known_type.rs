//! Types of messages.

use super::raw::{self, Learned};
use super::{CoreAccess, EncodedInlet, EncodedInletError, Sink, Waiting, inlet, outlet};
use downbeat_executor::{Core, Outlet, OutletInbox, SetupError};
use downbeat_msgs::Message;
use downbeat_msgs::dynamic::DynamicMessage;
use std::any::TypeId;
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
#[error("unknown message type {name:?}, did you mean {nearest:?}?")]
pub struct UnknownType {
    /// The name that was looked for.
    pub name: String,
    /// The name most like it.
    pub nearest: &'static str,
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
            Rust::Raw(_) => raw::rust_type(),
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
        match &self.entry.rust {
            Rust::Compiled(compiled) => (compiled.open_outlet)(core, topic, inbox, Box::new(sink)),
            Rust::Raw(_) => raw::open_outlet(self, core, topic, inbox, Box::new(sink)),
        }
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
        let publish = match &self.entry.rust {
            Rust::Compiled(compiled) => (compiled.open_inlet)(core, topic, waiting)?,
            Rust::Raw(_) => raw::open(self, core, topic, waiting)?,
        };
        Ok(EncodedInlet::new(topic, self, publish))
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

/// Decodes one message and publishes it.
pub(super) type PublishEncoded = dyn Fn(&[u8]) -> Result<(), EncodedInletError> + Send + Sync;

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

/// Gives the messages of a topic, serialized, to a sink.
type OpenOutlet = fn(&mut CoreAccess<'_>, &str, &OutletInbox, Box<dyn Sink>) -> Result<Outlet, SetupError>;

pub(super) struct Compiled {
    hash: &'static str,
    definition: &'static str,
    rust_type: fn() -> TypeId,
    open_inlet: fn(&mut CoreAccess<'_>, &str, Waiting) -> Result<Box<PublishEncoded>, SetupError>,
    open_outlet: OpenOutlet,
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
            open_inlet: inlet::open::<T>,
            open_outlet: outlet::open::<T>,
            default_cdr: || downbeat_msgs::cdr::to_vec(&T::default()),
        }),
    };
}
