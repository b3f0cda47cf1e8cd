//! What a run of a module reads.

use super::link::Delivery;
use super::port::Views;

/// The input of a run.
#[derive(Clone, Copy)]
pub(crate) enum Input<'a> {
    /// Inside a cycle: the views of the mechanisms.
    Views(&'a Views),
    /// On a separate thread: batches of earlier cycles.
    Batches(&'a [Delivery]),
}
