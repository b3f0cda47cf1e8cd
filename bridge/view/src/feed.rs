//! The messages of one topic on their way to the viewers that subscribed.

use crate::outbox::Outbox;
use bytes::Bytes;
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::sync::Arc;

/// The subscribers of one topic.
pub(crate) struct Feed {
    /// How many messages late subscribers receive.
    depth: usize,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    subscribers: Vec<Subscriber>,
    last: VecDeque<(u64, Bytes)>,
}

struct Subscriber {
    client: u64,
    subscription: u32,
    outbox: Arc<Outbox>,
}

impl Feed {
    pub(crate) fn new(depth: usize) -> Self {
        Self { depth, state: Mutex::default() }
    }

    pub(crate) fn depth(&self) -> usize {
        self.depth
    }

    /// Adds a subscriber, which receives the kept messages.
    pub(crate) fn add(&self, client: u64, subscription: u32, outbox: &Arc<Outbox>) {
        let mut state = self.state.lock();
        for (time_ns, message) in &state.last {
            outbox.push_message(subscription, *time_ns, message.clone());
        }
        state.subscribers.push(Subscriber { client, subscription, outbox: Arc::clone(outbox) });
    }

    /// Removes a subscriber; returns true if none is left.
    pub(crate) fn remove(&self, client: u64, subscription: u32) -> bool {
        let mut state = self.state.lock();
        state.subscribers.retain(|other| (other.client, other.subscription) != (client, subscription));
        state.subscribers.is_empty()
    }

    /// True if a message would be sent or kept.
    pub(crate) fn is_wanted(&self) -> bool {
        self.depth > 0 || !self.state.lock().subscribers.is_empty()
    }

    /// Counts messages that were lost before they came here.
    pub(crate) fn count_dropped(&self, messages: u32) {
        if messages > 0 {
            for Subscriber { subscription, outbox, .. } in &self.state.lock().subscribers {
                outbox.count_dropped(*subscription, messages.into());
            }
        }
    }

    /// Sends a message to one subscriber, if it is still there.
    pub(crate) fn send_to(&self, client: u64, subscription: u32, time_ns: u64, message: &Bytes) {
        let state = self.state.lock();
        let meant = |other: &&Subscriber| (other.client, other.subscription) == (client, subscription);
        if let Some(Subscriber { outbox, .. }) = state.subscribers.iter().find(meant) {
            outbox.push_message(subscription, time_ns, message.clone());
        }
    }

    /// Sends a message to all subscribers.
    pub(crate) fn send(&self, time_ns: u64, message: &Bytes) {
        let mut state = self.state.lock();
        for Subscriber { subscription, outbox, .. } in &state.subscribers {
            outbox.push_message(*subscription, time_ns, message.clone());
        }
        if self.depth > 0 {
            if state.last.len() >= self.depth {
                state.last.pop_front();
            }
            state.last.push_back((time_ns, message.clone()));
        }
    }
}
