//! Latched messages that are repeated at the start of a file of a bag, and how a reader tells them from
//! messages.
//!
//! A subscriber receives a latched (transient local) message whenever it joins, and a file that is opened
//! without the files before it must hold such messages too. A writer that splits a bag therefore writes the
//! last ones again, with their publish times, and the log time at which the file begins.
//!
//! The sequence number of such a copy in MCAP is [`SEQUENCE`]; recorders of ROS 2 write 0. A reader of the
//! whole bag leaves copies out, because the files before have the messages.

/// The sequence number of a repeated message.
pub(crate) const SEQUENCE: u32 = u32::MAX;
