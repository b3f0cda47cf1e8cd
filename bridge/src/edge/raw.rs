//! Messages that pass through as bytes: of types that are not compiled in, or that nobody here looks into.

use super::KnownType;
use super::known_type::{Entry, Rust};
use bytes::Bytes;
use downbeat_msgs::definitions::{Kind, TypeName};
use downbeat_msgs::dynamic::{Definitions, DynamicMessage, DynamicType, TypeDefinition};
use std::collections::BTreeMap;
use std::sync::{Mutex, OnceLock, PoisonError};
use thiserror::Error;

/// A message as bytes, with the name of its type: what a topic of a core carries whose type is not compiled in. A module that
/// knows what it wants of it reads it by the definition:
///
/// ```
/// use downbeat_bridge::edge::{KnownType, RawMessage};
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

/// A raw message cannot be read.
#[derive(Debug, Error)]
pub enum RawError {
    /// Nobody has told what the type looks like.
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

/// A type cannot pass through.
#[derive(Debug, Error)]
pub enum RawTypeError {
    /// It is no name.
    #[error("{name:?} is no message type: expected package/msg/Name")]
    Name {
        /// What was given.
        name: String,
    },
    /// There are too many.
    #[error("{name} is one type too many: this program has met {MOST_TYPES} that are not compiled in")]
    TooMany {
        /// The type.
        name: String,
    },
}

/// Types live as long as the program.
const MOST_TYPES: usize = 1024;

/// What becomes known of a raw type.
pub(super) struct Learned {
    pub(super) hash: String,
    pub(super) definition: String,
    dynamic: DynamicType,
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

    /// The message by the definition of its type.
    ///
    /// # Errors
    /// If that is not known, or the bytes are no such message.
    pub fn decode(&self) -> Result<DynamicMessage, RawError> {
        let type_name = self.message_type.name();
        let dynamic = self.message_type.dynamic().ok_or(RawError::NoDefinition(type_name))?;
        DynamicMessage::from_cdr(&dynamic, &self.cdr)
            .map_err(|error| RawError::Decode { type_name, reason: error.to_string() })
    }
}

impl KnownType {
    /// The type of that name as one that passes through: its messages are [`RawMessage`]s in a core. Its definition is looked
    /// up in `definitions`; where it is in none it can be told later, by [`KnownType::learn`].
    ///
    /// # Errors
    /// If that is no name of a message, or there are too many types.
    pub fn raw(name: &str, definitions: &Definitions) -> Result<Self, RawTypeError> {
        static TYPES: Mutex<BTreeMap<&'static str, &'static Entry>> = Mutex::new(BTreeMap::new());
        let is_message = |found: &TypeName| found.kind == Kind::Message;
        if !name.parse().as_ref().is_ok_and(is_message) {
            return Err(RawTypeError::Name { name: name.to_owned() });
        }
        let mut types = TYPES.lock().unwrap_or_else(PoisonError::into_inner);
        let entry = match types.get(name) {
            Some(entry) => *entry,
            None if types.len() >= MOST_TYPES => return Err(RawTypeError::TooMany { name: name.to_owned() }),
            None => {
                let name: &'static str = Box::leak(name.to_owned().into_boxed_str());
                let entry: &'static Entry = Box::leak(Box::new(Entry::raw(name)));
                types.insert(name, entry);
                entry
            }
        };
        drop(types);
        let raw = Self::of_entry(entry);
        if raw.hash().is_empty()
            && let Ok(definition) = definitions.describe(name)
        {
            raw.learn(definition);
        }
        Ok(raw)
    }

    /// True of a type whose messages are [`RawMessage`]s.
    #[must_use]
    pub fn is_raw(self) -> bool {
        matches!(self.entry().rust, Rust::Raw(_))
    }

    /// Tells what a raw type looks like. What was told first stays.
    pub fn learn(self, definition: TypeDefinition) {
        if let Rust::Raw(learned) = &self.entry().rust {
            let TypeDefinition { message_type: dynamic, text: definition, hash } = definition;
            // Another was faster.
            let _ = learned.set(Learned { hash, definition, dynamic });
        }
    }

    /// The type for reading its messages field by field; nothing where its definition is not known (yet).
    #[must_use]
    pub fn dynamic(self) -> Option<DynamicType> {
        match &self.entry().rust {
            Rust::Raw(learned) => Some(learned.get()?.dynamic.clone()),
            Rust::Compiled(_) => {
                DynamicType::from_definition_text(self.name(), "ros2msg", self.definition()).ok()
            }
        }
    }
}

impl Entry {
    fn raw(name: &'static str) -> Self {
        Self { name, rust: Rust::Raw(Box::leak(Box::new(OnceLock::new()))) }
    }
}
