//! What a subscriber receives: all messages of a topic from one cycle, stored once and shared.

use std::ops::Deref;
use std::sync::Arc;

use crate::Time;

/// The messages that were published on one topic in one cycle, one segment per publisher.
///
/// Segments are taken over from outboxes whole, so no message is moved; they keep their capacity when the
/// batch is used again.
pub(crate) struct Batch<T> {
    time: Time,
    segments: Vec<Vec<T>>,
    used: usize,
}

impl<T> Default for Batch<T> {
    fn default() -> Self {
        Self { time: Time::ZERO, segments: Vec::new(), used: 0 }
    }
}

impl<T> Batch<T> {
    pub(crate) fn clear(&mut self) {
        for segment in &mut self.segments[..self.used] {
            segment.clear();
        }
        self.used = 0;
    }

    /// Takes over the messages and leaves an empty vector, with capacity where there is some to reuse.
    pub(crate) fn take_over(&mut self, messages: &mut Vec<T>) {
        if self.used == self.segments.len() {
            self.segments.push(Vec::new());
        }
        std::mem::swap(&mut self.segments[self.used], messages);
        self.used += 1;
    }

    pub(crate) fn stamp(&mut self, time: Time) {
        self.time = time;
    }

    pub(crate) fn segments(&self) -> &[Vec<T>] {
        &self.segments[..self.used]
    }

    pub(crate) fn len(&self) -> usize {
        self.segments().iter().map(Vec::len).sum()
    }

    fn get(&self, position: Position) -> &T {
        &self.segments[position.segment as usize][position.index as usize]
    }
}

#[derive(Clone, Copy)]
pub(crate) struct Position {
    pub(crate) segment: u32,
    pub(crate) index: u32,
}

/// A message as a callback receives it. It dereferences to the message, so `clone` copies that; see
/// [`keep`](Self::keep) for keeping it without.
pub struct Received<'a, T> {
    message: &'a T,
    batch: &'a Arc<Batch<T>>,
    position: Position,
}

impl<'a, T> Received<'a, T> {
    pub(crate) fn new(message: &'a T, batch: &'a Arc<Batch<T>>, position: Position) -> Self {
        Self { message, batch, position }
    }

    /// The time of the cycle in which the message was published.
    #[must_use]
    pub fn time(&self) -> Time {
        self.batch.time
    }

    /// The message, for as long as the callback runs.
    #[must_use]
    pub fn get(&self) -> &'a T {
        self.message
    }

    /// Keeps the message beyond the callback without copying it. The messages that the topic carried in
    /// the same cycle stay in memory with it.
    #[must_use]
    pub fn keep(&self) -> Kept<T> {
        Kept { batch: Arc::clone(self.batch), position: self.position }
    }
}

impl<T> Deref for Received<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.message
    }
}

/// A message kept beyond its cycle, see [`Received::keep`].
pub struct Kept<T> {
    batch: Arc<Batch<T>>,
    position: Position,
}

impl<T> Clone for Kept<T> {
    fn clone(&self) -> Self {
        Self { batch: Arc::clone(&self.batch), position: self.position }
    }
}

impl<T> Kept<T> {
    /// The time of the cycle in which the message was published.
    #[must_use]
    pub fn time(&self) -> Time {
        self.batch.time
    }
}

impl<T> Deref for Kept<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.batch.get(self.position)
    }
}
