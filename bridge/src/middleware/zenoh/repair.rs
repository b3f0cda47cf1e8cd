//! Asks writers for samples that are missing, until they answer.
//!
//! A subscription of zenoh-ext asks once. After an outage the way to a writer may be there for its samples
//! before it is there for questions; nobody answers then, and the samples would be lost.

use crate::middleware::Gid;
use crossbeam::channel::{Receiver, RecvTimeoutError, Sender, unbounded};
use downbeat_zenoh::zenoh::query::{ConsolidationMode, Reply, ReplyKeyExpr};
use downbeat_zenoh::zenoh::sample::Sample;
use downbeat_zenoh::zenoh::{Session, Wait};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock, Weak};
use std::time::{Duration, Instant};

/// How long to wait before each question. After the last one what is missing is lost.
const WAITS: [Duration; 6] = [
    Duration::from_millis(200),
    Duration::from_millis(500),
    Duration::from_secs(1),
    Duration::from_secs(2),
    Duration::from_secs(4),
    Duration::from_secs(8),
];

/// The thread that asks, from the first gap on.
#[derive(Default)]
pub(super) struct Repairs(OnceLock<Option<Sender<Gap>>>);

/// A subscription that waits for samples.
pub(super) trait Incomplete: Send + Sync {
    /// `None` when it has been left.
    fn session(&self) -> Option<Session>;
    fn has_gap(&self, writer: Gid) -> bool;
    fn take_answer(self: Arc<Self>, sample: &Sample);
    /// Goes on without the samples that a writer does not answer for.
    fn give_up(&self, writer: Gid);
}

/// Samples that are missing.
pub(super) struct Gap {
    of: Weak<dyn Incomplete>,
    writer: Gid,
    /// Where the writer answers for what it keeps, from the first one on that is missing, with the numbers of
    /// Zenoh. An answer has at least the one behind the gap.
    question: String,
    attempts: usize,
    is_answered: Arc<AtomicBool>,
}

/// Takes what is answered.
struct Answer {
    of: Weak<dyn Incomplete>,
    has_begun: AtomicBool,
    is_whole: Arc<AtomicBool>,
}

impl Answer {
    fn take(&self, reply: Reply) {
        if let (Some(of), Ok(sample)) = (self.of.upgrade(), reply.into_result()) {
            of.take_answer(&sample);
            self.has_begun.store(true, Ordering::Release);
        }
    }
}

/// When nothing follows.
impl Drop for Answer {
    fn drop(&mut self) {
        if *self.has_begun.get_mut() {
            self.is_whole.store(true, Ordering::Release);
        }
    }
}

impl Repairs {
    pub(super) fn ask(&self, gap: Gap) {
        let gaps = self.0.get_or_init(|| {
            // Unbounded: a writer of a subscription has one gap at a time.
            let (sender, gaps) = unbounded();
            let run = move || ask_until_answered(&gaps);
            let thread = std::thread::Builder::new().name("downbeat-zenoh-repair".into()).spawn(run);
            thread.is_ok().then_some(sender)
        });
        let refused = match gaps {
            Some(gaps) => gaps.send(gap).err().map(|error| error.0),
            None => Some(gap),
        };
        if let Some(gap) = refused {
            gap.give_up();
        }
    }
}

fn ask_until_answered(gaps: &Receiver<Gap>) {
    let mut waiting = Vec::<(Instant, Gap)>::new();
    loop {
        let next = waiting.iter().map(|(due, _)| *due).min();
        let received = match next {
            Some(due) => gaps.recv_deadline(due),
            None => gaps.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        match received {
            Ok(gap) => waiting.push((Instant::now() + WAITS[0], gap)),
            Err(RecvTimeoutError::Timeout) => (),
            Err(RecvTimeoutError::Disconnected) => return,
        }
        let now = Instant::now();
        for (due, gap) in std::mem::take(&mut waiting) {
            if due > now {
                waiting.push((due, gap));
            } else if let Some(gap) = gap.ask_again() {
                waiting.push((now + WAITS[gap.attempts], gap));
            }
        }
    }
}

impl Gap {
    pub(super) fn new(of: Weak<dyn Incomplete>, writer: Gid, question: String) -> Self {
        Self { of, writer, question, attempts: 0, is_answered: Arc::default() }
    }

    /// Asks, or gives up. Returns itself if there is more to do.
    fn ask_again(mut self) -> Option<Self> {
        let of = self.of.upgrade()?;
        if !of.has_gap(self.writer) {
            return None;
        }
        self.attempts += 1;
        if self.is_answered.load(Ordering::Acquire) || self.attempts >= WAITS.len() {
            // What the writer does not keep any more does not come.
            self.give_up();
            return None;
        }
        self.ask(&of.session()?);
        Some(self)
    }

    fn ask(&self, session: &Session) {
        let (of, is_whole) = (Weak::clone(&self.of), Arc::clone(&self.is_answered));
        let answer = Answer { of, has_begun: AtomicBool::new(false), is_whole };
        let asked = session
            .get(&self.question)
            .callback(move |reply| answer.take(reply))
            .consolidation(ConsolidationMode::None)
            .accept_replies(ReplyKeyExpr::Any)
            .timeout(Duration::from_secs(10))
            .wait();
        if let Err(error) = asked {
            tracing::debug!(%error, question = self.question, "missing samples cannot be asked for");
        }
    }

    fn give_up(&self) {
        if let Some(of) = self.of.upgrade() {
            of.give_up(self.writer);
        }
    }
}
