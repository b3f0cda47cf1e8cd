//! The outlets of a core, as the sync phase accesses them.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam::channel::{Receiver, RecvTimeoutError, bounded};

use super::mailbox::{Addressed, Mailbox};
use super::{Delivery, Identity, OutletInbox, OutletShared};
use crate::topics::{Subscriber, Topics};
use crate::{OutletStatistics, SetupError, ThreadOptions};

/// The interval of log lines with the name of the inbox for which the shutdown of the core waits.
const PATIENCE: Duration = Duration::from_secs(1);

#[derive(Default)]
pub(crate) struct Outlets {
    /// By slot, under which topics refer to outlets.
    ports: Vec<Option<Port>>,
    /// In the order of their first use.
    inboxes: Vec<InboxPort>,
}

/// An outlet.
struct Port {
    topic: usize,
    identity: Arc<Identity>,
    shared: Arc<OutletShared>,
}

/// The inbox of one or more outlets.
struct InboxPort {
    identity: Arc<Identity>,
    name: Arc<str>,
    mailbox: Arc<Mailbox>,
    /// `None` if the sinks run inside the cycle.
    thread: Option<Thread>,
    /// The batches of this sync phase; without a thread, kept until the next process phase.
    outgoing: Vec<Addressed>,
    /// The counters of closed outlets.
    closed: Counts,
}

#[derive(Default)]
struct Counts {
    received: u64,
    dropped: u64,
}

struct Thread {
    handle: JoinHandle<()>,
    /// Disconnected shortly before the thread ends.
    ended: Receiver<()>,
}

impl Outlets {
    pub(super) fn open(
        &mut self,
        topics: &mut Topics,
        topic: usize,
        inbox: &OutletInbox,
        shared: &Arc<OutletShared>,
        has_thread: bool,
    ) -> Result<(), SetupError> {
        self.prune(topics);
        let identity = &inbox.identity;
        if !self.inboxes.iter().any(|known| Arc::ptr_eq(&known.identity, identity)) {
            let name = identity.name.as_ref().unwrap_or(&shared.topic);
            self.inboxes.push(InboxPort::new(identity, name, has_thread)?);
        }
        let slot = self.ports.iter().position(Option::is_none).unwrap_or_else(|| {
            self.ports.push(None);
            self.ports.len() - 1
        });
        let (identity, shared) = (Arc::clone(identity), Arc::clone(shared));
        self.ports[slot] = Some(Port { topic, identity, shared });
        topics.subscribe(topic, Subscriber::Outlet(slot));
        Ok(())
    }

    /// Removes closed outlets, and inboxes without outlets.
    pub(crate) fn prune(&mut self, topics: &mut Topics) {
        for (slot, place) in self.ports.iter_mut().enumerate() {
            let Some(port) = place.take_if(|port| port.shared.is_closed()) else { continue };
            topics.unsubscribe(port.topic, Subscriber::Outlet(slot));
            topics.release(port.topic);
            let inbox = self.inboxes.iter_mut().find(|inbox| Arc::ptr_eq(&inbox.identity, &port.identity));
            if let Some(InboxPort { closed, .. }) = inbox {
                closed.received += port.shared.received.load(Ordering::Relaxed);
                closed.dropped += port.shared.dropped.load(Ordering::Relaxed);
            }
        }
        let ports = &self.ports;
        self.inboxes.retain_mut(|inbox| {
            let is_used = ports.iter().flatten().any(|port| Arc::ptr_eq(&port.identity, &inbox.identity));
            if !is_used {
                inbox.retire();
            }
            is_used
        });
    }

    /// Queues the topic's batch for the next [`dispatch`](Self::dispatch), if the gate of the outlet is open.
    #[inline(never)]
    pub(crate) fn deliver(&mut self, topics: &Topics, slot: usize) {
        let Some(port) = self.ports.get(slot).and_then(Option::as_ref) else { return };
        if port.shared.is_closed() || !port.shared.is_wanted(|| topics.messages(port.topic)) {
            return;
        }
        let inbox = self.inboxes.iter_mut().find(|inbox| Arc::ptr_eq(&inbox.identity, &port.identity));
        if let Some(inbox) = inbox {
            let (batch, messages) = topics.share(port.topic);
            let delivery = Delivery { batch, messages, missed: 0 };
            let outlet = Arc::clone(&port.shared);
            inbox.outgoing.push(Addressed { outlet, topic: port.topic, delivery });
        }
    }

    /// Runs the sinks that have no thread.
    #[cold]
    pub(crate) fn run_waiting(&mut self) {
        for inbox in self.inboxes.iter_mut().filter(|inbox| inbox.thread.is_none()) {
            inbox.outgoing.drain(..).for_each(Addressed::hand_over);
        }
    }

    /// Delivers all batches of a sync phase at once, so that each thread wakes once. Returns true if batches
    /// wait for sinks without a thread.
    #[inline(never)]
    pub(crate) fn dispatch(&mut self, topics: &mut Topics) -> bool {
        let mut is_waiting = false;
        for inbox in self.inboxes.iter_mut().filter(|inbox| !inbox.outgoing.is_empty()) {
            if inbox.thread.is_none() {
                is_waiting = true;
                continue;
            }
            let dropped = |topic, messages| topics.meter_mut(topic).dropped(u64::from(messages));
            inbox.mailbox.deliver(&mut inbox.outgoing, inbox.identity.capacity, dropped);
        }
        is_waiting
    }

    /// Waits until the sinks have processed all waiting batches, however long that takes, and drops the
    /// sinks.
    pub(crate) fn stop(&mut self) {
        self.run_waiting();
        for inbox in &mut self.inboxes {
            inbox.stop();
        }
        self.ports.iter().flatten().for_each(|port| port.shared.close());
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.inboxes.is_empty()
    }

    /// The inboxes, each with the topics of its outlets.
    pub(crate) fn connections(&self) -> impl Iterator<Item = (&Arc<str>, impl Iterator<Item = usize>)> {
        self.inboxes.iter().map(|inbox| (&inbox.name, self.ports_of(inbox).map(|port| port.topic)))
    }

    pub(crate) fn statistics(&self) -> Vec<OutletStatistics> {
        let statistics = |inbox: &InboxPort| {
            let sum = |count: fn(&OutletShared) -> u64| {
                self.ports_of(inbox).map(|port| count(&port.shared)).sum::<u64>()
            };
            OutletStatistics {
                name: inbox.name.to_string(),
                topics: sum(|_| 1),
                received: inbox.closed.received + sum(|shared| shared.received.load(Ordering::Relaxed)),
                inbox: inbox.mailbox.waiting() + inbox.outgoing.iter().map(Addressed::messages).sum::<u64>(),
                dropped: inbox.closed.dropped + sum(|shared| shared.dropped.load(Ordering::Relaxed)),
                failed: sum(|shared| u64::from(shared.has_failed.load(Ordering::Relaxed))),
            }
        };
        self.inboxes.iter().map(statistics).collect()
    }

    fn ports_of(&self, inbox: &InboxPort) -> impl Iterator<Item = &Port> {
        let is_its = |port: &&Port| Arc::ptr_eq(&port.identity, &inbox.identity) && !port.shared.is_closed();
        self.ports.iter().flatten().filter(is_its)
    }
}

impl InboxPort {
    fn new(identity: &Arc<Identity>, name: &Arc<str>, has_thread: bool) -> Result<Self, SetupError> {
        let mailbox = Arc::<Mailbox>::default();
        let start = || {
            let (alive, ended) = bounded::<()>(0);
            let mailbox = Arc::clone(&mailbox);
            let run = move || {
                mailbox.run();
                drop(alive);
            };
            let handle = ThreadOptions::default().spawn(&**name, run)?;
            Ok(Thread { handle, ended })
        };
        let thread = has_thread.then(start).transpose().map_err(|error: crate::ThreadError| {
            SetupError::Thread { module: format!("outlet {name}"), reason: error.to_string() }
        })?;
        Ok(Self {
            identity: Arc::clone(identity),
            name: Arc::clone(name),
            mailbox,
            thread,
            outgoing: Vec::new(),
            closed: Counts::default(),
        })
    }

    /// Ends the thread without waiting for it; all its sinks are closed.
    fn retire(&mut self) {
        self.mailbox.stop();
        self.thread = None;
    }

    fn stop(&mut self) {
        self.mailbox.stop();
        let Some(Thread { handle, ended }) = self.thread.take() else { return };
        let begin = Instant::now();
        while ended.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
            let seconds = begin.elapsed().as_secs();
            tracing::warn!(
                outlet = &*self.name,
                "a sink has not returned for {seconds} s, shutdown is waiting for it"
            );
        }
        if handle.join().is_err() {
            tracing::error!(outlet = &*self.name, "the thread of an outlet ended by a panic");
        }
    }
}

impl Drop for Outlets {
    fn drop(&mut self) {
        self.stop();
    }
}
