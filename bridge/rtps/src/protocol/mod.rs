//! The protocol as a state machine: no sockets, no clock, no threads.
//!
//! Datagrams, timeouts and the time go in; datagrams, events and the time of the next timeout come out.

mod assembly;
mod count;
mod history;
mod incoming;
mod intervals;
mod lane;
mod links;
mod now;
mod pacer;
mod reader;
mod received;
mod writer;

pub use incoming::MatchedWriter;
pub use lane::MatchedReader;
pub use links::{Destination, Emitted, LinkId, LinkOptions, Links};
pub use now::Now;
pub use reader::{Reader, ReaderConfig};
pub use received::{Received, Sample};
pub use writer::{WindowFull, WriteOptions, Writer, WriterConfig, WriterEvent};
