//! Asks again what nobody has answered: writers for samples that are missing, servers for replies.
//!
//! Zenoh asks once. After an outage, or while a session still links with others, the way to a writer may be
//! there for its samples, or a server may be announced, before there is a way for questions. Nobody answers
//! then, and samples or replies would be lost.

use crate::middleware::Gid;
use crossbeam::channel::{Receiver, RecvTimeoutError, Sender, unbounded};
use downbeat_zenoh::zenoh::query::{ConsolidationMode, Reply, ReplyKeyExpr};
use downbeat_zenoh::zenoh::sample::Sample;
use downbeat_zenoh::zenoh::{Session, Wait};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock, Weak};
use std::time::{Duration, Instant};

/// How long to wait before each question, while nothing comes. After the last one nothing is expected.
pub(super) const WAITS: [Duration; 6] = [
    Duration::from_millis(200),
    Duration::from_millis(500),
    Duration::from_secs(1),
    Duration::from_secs(2),
    Duration::from_secs(4),
    Duration::from_secs(8),
];

/// An answer that takes longer is asked for again, from where it ended.
const PATIENCE: Duration = Duration::from_secs(10);

/// The thread that asks, from the first open question on.
#[derive(Default)]
pub(super) struct Repairs(OnceLock<Option<Sender<Box<dyn Question>>>>);

/// Something that is asked until it is answered.
pub(super) trait Question: Send {
    /// How long to wait before the first `go_on`.
    fn first_wait(&self) -> Duration {
        WAITS[0]
    }

    /// Asks, or gives up. Returns itself, and when to go on, if something is still missing.
    fn go_on(self: Box<Self>) -> Option<(Duration, Box<dyn Question>)>;
    /// There is no thread that asks.
    fn is_refused(self: Box<Self>);
}

/// A subscription that waits for samples.
pub(super) trait Incomplete: Send + Sync {
    /// `None` when it has been left.
    fn session(&self) -> Option<Session>;
    /// The last sample of a writer before those that are missing; `None` when none is.
    fn last_before_gap(&self, writer: Gid) -> Option<i64>;
    fn take_answer(self: Arc<Self>, sample: &Sample);
    /// Goes on without what is missing: calls the handler of the subscription.
    fn give_up(&self, writer: Gid);
}

/// Samples of a writer that are missing. There is one of these for a writer of a subscription at a time.
pub(super) struct Gap {
    of: Weak<dyn Incomplete>,
    writer: Gid,
    /// Where the writer answers for what it keeps.
    source: String,
    /// What its numbers in Zenoh are ahead of those in its samples; Zenoh's are of 32 bits.
    ahead: u32,
    attempts: usize,
    asked: Option<Asked>,
}

/// A question.
struct Asked {
    /// The last sample that was there.
    after: i64,
    answer: Arc<Answer>,
}

/// What has become of a question.
#[derive(Default)]
struct Answer {
    is_over: AtomicBool,
    /// At least what is behind the gap was answered, and nothing is left.
    is_whole: AtomicBool,
}

/// Takes what is answered. Dropped when nothing follows.
struct Answering {
    of: Weak<dyn Incomplete>,
    has_begun: AtomicBool,
    has_failed: AtomicBool,
    answer: Arc<Answer>,
}

impl Answering {
    fn take(&self, reply: Reply) {
        match (self.of.upgrade(), reply.into_result()) {
            (Some(of), Ok(sample)) => {
                of.take_answer(&sample);
                self.has_begun.store(true, Ordering::Release);
            }
            (_, Err(_)) => self.has_failed.store(true, Ordering::Release),
            (None, Ok(_)) => (),
        }
    }
}

impl Drop for Answering {
    fn drop(&mut self) {
        let is_whole = *self.has_begun.get_mut() && !*self.has_failed.get_mut();
        self.answer.is_whole.store(is_whole, Ordering::Release);
        self.answer.is_over.store(true, Ordering::Release);
    }
}

impl Repairs {
    pub(super) fn ask(&self, question: impl Question + 'static) {
        let questions = self.0.get_or_init(|| {
            // Unbounded: a writer of a subscription has one gap at a time, and writers are bounded; so are
            // the open calls of a client.
            let (sender, questions) = unbounded();
            let run = move || ask_until_answered(&questions);
            let thread = std::thread::Builder::new().name("downbeat-zenoh-repair".into()).spawn(run);
            thread.is_ok().then_some(sender)
        });
        let question: Box<dyn Question> = Box::new(question);
        let refused = match questions {
            Some(questions) => questions.send(question).err().map(|error| error.0),
            None => Some(question),
        };
        if let Some(question) = refused {
            question.is_refused();
        }
    }
}

fn ask_until_answered(questions: &Receiver<Box<dyn Question>>) {
    let mut waiting = Vec::<(Instant, Box<dyn Question>)>::new();
    loop {
        let next = waiting.iter().map(|(due, _)| *due).min();
        let received = match next {
            Some(due) => questions.recv_deadline(due),
            None => questions.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        match received {
            Ok(question) => waiting.push((Instant::now() + question.first_wait(), question)),
            Err(RecvTimeoutError::Timeout) => {
                let now = Instant::now();
                for (due, question) in std::mem::take(&mut waiting) {
                    if due > now {
                        waiting.push((due, question));
                    } else if let Some((wait, question)) = question.go_on() {
                        waiting.push((now + wait, question));
                    }
                }
            }
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

impl Gap {
    /// Of a writer with a sample whose numbers are `number` and, in Zenoh, `number_in_zenoh`.
    pub(super) fn new(
        of: Weak<dyn Incomplete>,
        writer: Gid,
        source: String,
        number: i64,
        number_in_zenoh: u32,
    ) -> Self {
        let ahead = number_in_zenoh.wrapping_sub(low_bits(number));
        Self { of, writer, source, ahead, attempts: 0, asked: None }
    }

    fn ask(&mut self, session: &Session, after: i64) {
        let answer = Arc::<Answer>::default();
        let answering = Answering {
            of: Weak::clone(&self.of),
            has_begun: AtomicBool::new(false),
            has_failed: AtomicBool::new(false),
            answer: Arc::clone(&answer),
        };
        let first = low_bits(after).wrapping_add(1).wrapping_add(self.ahead);
        let question = format!("{}?_sn={first}..", self.source);
        let asked = session
            .get(&question)
            .callback(move |reply| answering.take(reply))
            .consolidation(ConsolidationMode::None)
            .accept_replies(ReplyKeyExpr::Any)
            .timeout(PATIENCE)
            .wait();
        if let Err(error) = asked {
            tracing::debug!(%error, question, "missing samples cannot be asked for");
        }
        self.asked = Some(Asked { after, answer });
    }
}

impl Question for Gap {
    fn go_on(mut self: Box<Self>) -> Option<(Duration, Box<dyn Question>)> {
        let of = self.of.upgrade()?;
        let after = of.last_before_gap(self.writer)?;
        let asked = self.asked.as_ref();
        let is_over = asked.is_none_or(|asked| asked.answer.is_over.load(Ordering::Acquire));
        let is_whole = asked.is_some_and(|asked| asked.answer.is_whole.load(Ordering::Acquire));
        let has_moved = asked.is_some_and(|asked| asked.after != after);
        self.attempts = if has_moved { 0 } else { self.attempts + 1 };
        // What the writer does not keep any more does not come.
        if (is_whole && !has_moved) || self.attempts >= WAITS.len() {
            of.give_up(self.writer);
            of.last_before_gap(self.writer)?;
            self.attempts = 0;
        }
        if is_over {
            self.ask(&of.session()?, after);
        } else if let Some(asked) = self.asked.as_mut() {
            asked.after = after;
        }
        Some((WAITS[self.attempts], self))
    }

    fn is_refused(self: Box<Self>) {
        if let Some(of) = self.of.upgrade() {
            of.give_up(self.writer);
        }
    }
}

/// The numbers of samples are of 64 bits.
fn low_bits(number: i64) -> u32 {
    let [a, b, c, d, ..] = number.to_le_bytes();
    u32::from_le_bytes([a, b, c, d])
}
