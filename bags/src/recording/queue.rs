//! The queue between producers that must not wait for a disk and the thread that writes to it.
//!
//! Bounded in bytes, since one camera image weighs as much as ten thousand joint states. What a producer holds the
//! lock for is a push.

use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bytes::Bytes;

use super::RecordError;
use crate::topic::{TopicId, TopicInfo};

/// What a queued message costs besides its data.
const OVERHEAD: usize = size_of::<Item>();

/// How many items the writing thread takes at a time.
const BATCH: usize = 256;

pub(super) enum Item {
    /// Boxed, since every message takes as much room in the queue as the largest item.
    Topic(Box<TopicInfo>),
    Message {
        topic: TopicId,
        log_time: i64,
        publish_time: i64,
        data: Bytes,
    },
}

impl Item {
    fn cost(&self) -> usize {
        match self {
            Self::Topic(_) => OVERHEAD,
            Self::Message { data, .. } => OVERHEAD + data.len(),
        }
    }
}

pub(super) struct Queue {
    state: Mutex<State>,
    /// Something came in, or the queue was closed.
    filled: Condvar,
    /// Something was written, or the queue was closed.
    drained: Condvar,
    limit: usize,
}

#[derive(Default)]
pub(super) struct State {
    items: VecDeque<Item>,
    /// Cost of what is queued and of what the thread has taken and not yet written.
    pub(super) queued_bytes: usize,
    /// Names and types of the topics, in the order of their ids, and their lost messages.
    pub(super) topics: Vec<QueuedTopic>,
    is_closed: bool,
}

pub(super) struct QueuedTopic {
    pub(super) name: String,
    pub(super) type_name: String,
    pub(super) lost: u64,
}

/// What the writing thread is to do.
pub(super) enum Work {
    Write,
    /// Nothing came in for that long.
    TimedOut,
    /// The queue is closed and empty.
    End,
}

impl Queue {
    pub(super) fn new(limit: usize, topics: Vec<QueuedTopic>) -> Self {
        let state = State { topics, ..State::default() };
        Self { state: Mutex::new(state), filled: Condvar::new(), drained: Condvar::new(), limit }
    }

    /// A panic elsewhere leaves the counts usable.
    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn add_topic(&self, info: TopicInfo) -> Result<TopicId, RecordError> {
        let mut state = self.lock();
        if state.is_closed {
            return Err(RecordError::Stopped);
        }
        if let Some(index) = state.topics.iter().position(|topic| topic.name == info.name) {
            let first = &state.topics[index].type_name;
            if *first != info.type_name {
                return Err(RecordError::TypeConflict {
                    topic: info.name,
                    first: first.clone(),
                    second: info.type_name,
                });
            }
            return TopicId::from_index(index).ok_or(RecordError::TooManyTopics);
        }
        let id = TopicId::from_index(state.topics.len()).filter(|id| id.index() < usize::from(u16::MAX) - 1);
        let id = id.ok_or(RecordError::TooManyTopics)?;
        let (name, type_name) = (info.name.clone(), info.type_name.clone());
        state.topics.push(QueuedTopic { name, type_name, lost: 0 });
        self.push(&mut state, Item::Topic(Box::new(info)));
        Ok(id)
    }

    /// Queues the message if there is room; else counts it as lost.
    pub(super) fn try_add(&self, topic: TopicId, item: Item) -> Result<(), RecordError> {
        let mut state = self.lock();
        let is_closed = state.is_closed;
        let has_room = self.has_room(&state, &item);
        let entry = state.topics.get_mut(topic.index()).ok_or(RecordError::UnknownTopic)?;
        if is_closed || !has_room {
            entry.lost += 1;
            let (topic, lost) = (entry.name.clone(), entry.lost);
            return Err(if is_closed {
                RecordError::Stopped
            } else {
                RecordError::QueueFull { topic, lost }
            });
        }
        self.push(&mut state, item);
        Ok(())
    }

    /// Waits until there is room, and queues the message.
    pub(super) fn add(&self, topic: TopicId, item: Item) -> Result<(), RecordError> {
        let state = self.lock();
        let waiting = |state: &mut State| !state.is_closed && !self.has_room(state, &item);
        let mut state = self.drained.wait_while(state, waiting).unwrap_or_else(PoisonError::into_inner);
        let is_closed = state.is_closed;
        let entry = state.topics.get_mut(topic.index()).ok_or(RecordError::UnknownTopic)?;
        if is_closed {
            entry.lost += 1;
            return Err(RecordError::Stopped);
        }
        self.push(&mut state, item);
        Ok(())
    }

    /// Nothing comes in any more; what is queued can still be taken.
    pub(super) fn close(&self) {
        self.close_locked(&mut self.lock());
    }

    /// Closes the queue and counts what is in it, and the rest of a batch, as lost.
    pub(super) fn abandon(&self, rest: impl IntoIterator<Item = Item>) {
        let mut state = self.lock();
        let mut items: Vec<Item> = rest.into_iter().collect();
        items.extend(state.items.drain(..));
        for item in items {
            if let Item::Message { topic, .. } = item
                && let Some(topic) = state.topics.get_mut(topic.index())
            {
                topic.lost += 1;
            }
        }
        state.queued_bytes = 0;
        // Under the same lock, else a message could come in between and never be counted.
        self.close_locked(&mut state);
    }

    /// Waits for items, at most `timeout`, and moves some into `batch`. The room of the batch before becomes free.
    pub(super) fn take(&self, batch: &mut Vec<Item>, written: usize, timeout: Option<Duration>) -> Work {
        let mut state = self.lock();
        state.queued_bytes = state.queued_bytes.saturating_sub(written);
        if written > 0 {
            self.drained.notify_all();
        }
        let is_idle = |state: &mut State| state.items.is_empty() && !state.is_closed;
        let mut state = match timeout {
            None => self.filled.wait_while(state, is_idle).unwrap_or_else(PoisonError::into_inner),
            Some(timeout) => {
                let waited = self.filled.wait_timeout_while(state, timeout, is_idle);
                waited.unwrap_or_else(PoisonError::into_inner).0
            }
        };
        let count = state.items.len().min(BATCH);
        batch.extend(state.items.drain(..count));
        match (count, state.is_closed) {
            (0, true) => Work::End,
            (0, false) => Work::TimedOut,
            _ => Work::Write,
        }
    }

    pub(super) fn cost(batch: &[Item]) -> usize {
        batch.iter().map(Item::cost).sum()
    }

    /// A message larger than the limit may pass alone, else it could never.
    fn has_room(&self, state: &State, item: &Item) -> bool {
        state.queued_bytes == 0 || state.queued_bytes + item.cost() <= self.limit
    }

    fn close_locked(&self, state: &mut State) {
        state.is_closed = true;
        self.filled.notify_all();
        self.drained.notify_all();
    }

    fn push(&self, state: &mut State, item: Item) {
        state.queued_bytes += item.cost();
        state.items.push_back(item);
        self.filled.notify_one();
    }
}
