//! The protocol as a state machine: no sockets, no clock, no threads.
//!
//! Datagrams, timeouts and the time go in; datagrams, events and the time of the next timeout come out.

mod now;

pub use now::Now;
