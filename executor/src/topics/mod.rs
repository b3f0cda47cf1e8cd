//! Storage of messages: the outboxes of publishers, and topics with the batches for subscribers.

mod batch;
mod boxed;
mod message_type;
mod names;
mod outbox;
mod topic;

pub(crate) use batch::{AnyBatch, Batch, for_each_message};
pub use batch::{AnyReceived, Kept, Received};
pub use boxed::ErasedType;
pub use message_type::MessageType;
pub(crate) use names::canonical_name;
pub use outbox::{AnyMessage, AnyPublication, Publication};
pub(crate) use outbox::{AnyOutbox, Outbox, Outboxes};
pub(crate) use topic::{Report, Subscriber, Topics};
pub use topic::{TopicCounter, TopicInfo};
