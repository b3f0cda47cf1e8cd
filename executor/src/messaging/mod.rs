//! Messages: topics, the outboxes of publishers, the batches of subscribers.

mod batch;
mod message_type;
mod outbox;
mod sync;
mod topic;

pub(crate) use batch::{Batch, Position};
pub use batch::{Kept, Received};
pub(crate) use message_type::VisitBatch;
pub use message_type::{AnyMessage, AnyReceived, MessageType};
pub use outbox::Publication;
pub(crate) use outbox::{AnyOutbox, Outbox, Outboxes};
pub(crate) use sync::Messaging;
pub(crate) use topic::{Subscriber, Topics, canonical_name};
pub use topic::{TopicCounter, TopicInfo};
