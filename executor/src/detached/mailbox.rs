//! What waits for a detached module.

use std::any::Any;
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crossbeam::sync::Unparker;

use crate::cell::Delivery;
use crate::management::SettingRefused;
use crate::receipt::ReceiptSender;
use crate::service::AnyReply;
use crate::{Inbox, LifecycleState, SettingValue, Transition, TransitionRefused};

/// What the core has sent to the thread of a detached module.
pub(super) struct Mailbox {
    pub(super) contents: Mutex<Contents>,
    pub(super) owner: Unparker,
    pub(super) capacity: Inbox,
}

#[derive(Default)]
pub(super) struct Contents {
    pub(super) deliveries: VecDeque<Delivery>,
    /// By topic, how many messages were dropped.
    pub(super) skipped: Vec<(usize, u32)>,
    pub(super) parcels: Vec<Parcel>,
    pub(super) is_held: bool,
    pub(super) stop: bool,
}

/// What the core has for a detached module beside messages.
pub(crate) enum Parcel {
    Reply {
        port: u32,
        reply: Box<dyn AnyReply>,
    },
    /// A `Vec<Incoming<Q>>`.
    Requests {
        port: u32,
        count: u32,
        requests: Box<dyn Any + Send>,
    },
    /// An `Option<Result<T, JobError>>`.
    Job {
        port: u32,
        result: Box<dyn Any + Send>,
    },
    Set {
        setting: String,
        value: SettingValue,
        receipt: Option<ReceiptSender<Result<(), SettingRefused>>>,
    },
    Transition {
        transition: Transition,
        receipt: Option<ReceiptSender<Result<LifecycleState, TransitionRefused>>>,
    },
    Pause,
    Resume,
    StepOnce,
}

impl Mailbox {
    pub(super) fn lock(&self) -> MutexGuard<'_, Contents> {
        self.contents.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Contents {
    /// Drops the oldest batch of the topic if `limit` of them wait. Returns how many messages the next one misses.
    pub(super) fn make_room(&mut self, topic: usize, limit: usize) -> u32 {
        let mut waiting = (0..self.deliveries.len()).filter(|&index| self.deliveries[index].topic == topic);
        let (oldest, others) = (waiting.next(), waiting.count());
        if let Some(oldest) = oldest
            && others + 1 >= limit
            && let Some(dropped) = self.deliveries.remove(oldest)
        {
            self.skip(topic, dropped.messages);
            let missed = dropped.missed.saturating_add(dropped.messages);
            match self.deliveries.iter_mut().find(|delivery| delivery.topic == topic) {
                Some(next) => next.missed = next.missed.saturating_add(missed),
                None => return missed,
            }
        }
        0
    }

    fn skip(&mut self, topic: usize, messages: u32) {
        match self.skipped.iter_mut().find(|(known, _)| *known == topic) {
            Some((_, count)) => *count = count.saturating_add(messages),
            None => self.skipped.push((topic, messages)),
        }
    }
}
