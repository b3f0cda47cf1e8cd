//! The protocol as a state machine: no sockets, no clock, no threads.
//!
//! Its inputs are datagrams, timeouts and the time; its outputs are datagrams, events and the time of the
//! next timeout. [`Participant`] is the complete state machine; [`Writer`] and [`Reader`] are parts of it,
//! which tests use separately.

mod account;
mod addresses;
mod assembly;
mod belief;
mod config;
mod count;
mod counters;
mod discovery;
mod dispatch;
#[cfg(test)]
mod endpoints_test;
mod event;
mod guard;
mod history;
mod incoming;
mod intervals;
mod lane;
mod links;
mod locals;
mod matching;
mod now;
mod outgoing;
mod pacer;
mod part;
mod participant;
mod peers;
mod reader;
mod received;
mod routes;
mod security;
mod timers;
mod transmit;
mod validation;
mod writer;

pub use addresses::{Addresses, Interface};
pub use config::{Config, EndpointConfig, Limits};
pub use counters::{Counters, Fault};
pub use discovery::{BUILTIN_OF_SECURITY, Builtin};
pub use event::{Departure, Event, LivelinessChange};
pub use guard::{Admission, Channel, Demand, Denial, Guard, Report, Room, Severity, TopicProtection};
pub use incoming::{MatchedWriter, Numbers};
pub use links::{Destination, Emitted, LinkId, LinkOptions, Links};
pub use now::Now;
pub use outgoing::MatchedReader;
pub use participant::{CreateError, Participant, WriteError};
pub use reader::{Reader, ReaderConfig};
pub use received::{Received, Sample};
pub use writer::{WindowFull, WriteOptions, Writer, WriterConfig, WriterEvent};
