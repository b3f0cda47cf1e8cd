//! The thread that runs the sinks of an inbox.

use std::collections::VecDeque;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Condvar, Mutex, MutexGuard};

use super::{Delivery, OutletShared};
use crate::Inbox;
use crate::threads::{drop_guarded, unpoisoned};

/// The batches that wait for the sinks of an inbox.
#[derive(Default)]
pub(super) struct Mailbox {
    contents: Mutex<Contents>,
    changed: Condvar,
}

#[derive(Default)]
struct Contents {
    deliveries: VecDeque<Addressed>,
    stop: bool,
}

pub(super) struct Addressed {
    pub(super) outlet: Arc<OutletShared>,
    pub(super) topic: usize,
    pub(super) delivery: Delivery,
}

impl Mailbox {
    /// Delivers all batches of a sync phase at once. Calls `dropped` with the topic and the number of
    /// messages of each batch that was dropped to make room.
    pub(super) fn deliver(
        &self,
        batches: &mut Vec<Addressed>,
        capacity: Inbox,
        mut dropped: impl FnMut(usize, u32),
    ) {
        let mut contents = self.lock();
        for mut addressed in batches.drain(..) {
            if let Inbox::KeepLast(limit) = capacity {
                let gone = contents.make_room(&addressed.outlet, limit.get());
                if let Some(gone) = gone {
                    dropped(gone.topic, gone.messages);
                    addressed.delivery.missed = gone.missed;
                }
            }
            contents.deliveries.push_back(addressed);
        }
        drop(contents);
        self.changed.notify_one();
    }

    pub(super) fn waiting(&self) -> u64 {
        self.lock().deliveries.iter().map(Addressed::messages).sum()
    }

    /// Ends the thread when no batch waits any more.
    pub(super) fn stop(&self) {
        self.lock().stop = true;
        self.changed.notify_one();
    }

    /// Runs the sinks until [`stop`](Self::stop) is called.
    pub(super) fn run(&self) {
        let mut deliveries = VecDeque::new();
        loop {
            let mut contents = self.lock();
            while contents.deliveries.is_empty() && !contents.stop {
                contents = unpoisoned(self.changed.wait(contents));
            }
            if contents.deliveries.is_empty() {
                return;
            }
            std::mem::swap(&mut deliveries, &mut contents.deliveries);
            drop(contents);
            deliveries.drain(..).for_each(Addressed::hand_over);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Contents> {
        unpoisoned(self.contents.lock())
    }
}

impl Addressed {
    pub(super) fn messages(&self) -> u64 {
        u64::from(self.delivery.messages)
    }

    pub(super) fn hand_over(self) {
        let Self { outlet, delivery, .. } = self;
        // Guarded, because destructors of messages in the batch may panic.
        drop_guarded("a message", || outlet.take(delivery));
    }
}

/// A batch that was dropped in favour of a newer one.
struct Gone {
    topic: usize,
    messages: u32,
    /// The number of missed messages to report with the newer batch; 0 if a waiting batch reports them.
    missed: u32,
}

impl Contents {
    /// Drops the oldest batch of the outlet if `limit` of them wait.
    fn make_room(&mut self, outlet: &Arc<OutletShared>, limit: usize) -> Option<Gone> {
        if self.deliveries.len() < limit {
            return None;
        }
        let is_its = |addressed: &Addressed| Arc::ptr_eq(&addressed.outlet, outlet);
        let mut waiting = (0..self.deliveries.len()).filter(|&index| is_its(&self.deliveries[index]));
        let (oldest, others) = (waiting.next()?, waiting.count());
        if others + 1 < limit {
            return None;
        }
        let Addressed { topic, delivery, .. } = self.deliveries.remove(oldest)?;
        let missed = delivery.missed.saturating_add(delivery.messages);
        let next = self.deliveries.iter_mut().find(|addressed| is_its(addressed));
        let messages = delivery.messages;
        outlet.dropped.fetch_add(u64::from(messages), Ordering::Relaxed);
        drop_guarded("a message", || drop(delivery));
        match next {
            Some(next) => {
                next.delivery.missed = next.delivery.missed.saturating_add(missed);
                Some(Gone { topic, messages, missed: 0 })
            }
            None => Some(Gone { topic, messages, missed }),
        }
    }
}
