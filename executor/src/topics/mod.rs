//! Storage of messages: the outboxes of publishers, and topics with the batches for subscribers.

mod batch;
mod message_type;
mod names;
mod outbox;
mod topic;

pub(crate) use batch::{Batch, for_each_message};
pub use batch::{Kept, Received};
pub(crate) use message_type::VisitBatch;
pub use message_type::{AnyReceived, MessageType};
pub(crate) use names::canonical_name;
pub use outbox::{AnyMessage, AnyPublication, Publication};
pub(crate) use outbox::{AnyOutbox, Outbox, Outboxes};
pub(crate) use topic::{Report, Subscriber, Topics};
pub use topic::{TopicCounter, TopicInfo};
