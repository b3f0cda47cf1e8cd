//! Messages on their way into the executor.

use super::{CoreAccess, KnownType};
use downbeat_executor::queue::{Locked, Overflow};
use downbeat_executor::{AnyMessage, Inlet, InletError, SetupError};
use downbeat_msgs::cdr;
use std::fmt;
use std::num::NonZeroUsize;
use std::sync::Arc;
use thiserror::Error;

/// Publishes serialized messages on a topic of a core, from any thread. Clones publish on the same topic.
#[derive(Clone)]
pub struct EncodedInlet {
    topic: Arc<str>,
    message_type: KnownType,
    inlet: Inlet<AnyMessage>,
}

/// Which of the messages that come between two cycles enter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Waiting {
    /// All, up to [`Inlet::CAPACITY`]; more are refused.
    #[default]
    All,
    /// The latest; those before it count as dropped by the topic.
    Latest,
}

/// A serialized message did not enter.
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
    /// The core did not take the message.
    #[error("topic \"{topic}\": {error}")]
    Inlet {
        /// The topic.
        topic: Arc<str>,
        /// Why not.
        error: InletError,
    },
}

impl EncodedInlet {
    pub(super) fn open(
        message_type: KnownType,
        core: &mut CoreAccess<'_>,
        topic: &str,
        waiting: Waiting,
    ) -> Result<Self, SetupError> {
        let inlet = core.inlet_of(message_type.in_core(), topic, waiting.queue())?;
        Ok(Self { topic: topic.into(), message_type, inlet })
    }

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

    /// Decodes a message, encapsulation header (of either byte order) and body, and hands it to the core. Never waits.
    ///
    /// # Errors
    /// [`EncodedInletError`] when the bytes are no such message, or the core does not take it.
    pub fn publish(&self, cdr: &[u8]) -> Result<(), EncodedInletError> {
        let topic = || Arc::clone(&self.topic);
        let type_name = self.message_type.name();
        let message = self.message_type.decode(cdr);
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
    fn queue(self) -> Locked<AnyMessage> {
        let all = NonZeroUsize::MIN.saturating_add(Inlet::<AnyMessage>::CAPACITY - 1);
        match self {
            Self::All => Locked::bounded(all, Overflow::Refuse),
            Self::Latest => Locked::bounded(NonZeroUsize::MIN, Overflow::DropOldest),
        }
    }
}
