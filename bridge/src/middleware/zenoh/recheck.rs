//! Compares the known graph with that of the router after many tokens have arrived.
//!
//! Zenoh (1.10) sends the beginning and the end of tokens after it has released the lock of its tables. A
//! session that joins while another leaves may therefore receive the end of a token before its beginning, and
//! would list that token for as long as it lives. A new session receives all tokens again.

use super::domain::Domain;
use super::graph::MOST_TOKENS;
use crate::middleware::MiddlewareError;
use crossbeam::channel::{Receiver, Sender, bounded};
use downbeat_zenoh::Settings;
use downbeat_zenoh::wire::tokens_of;
use downbeat_zenoh::zenoh::Wait;
use downbeat_zenoh::zenoh::query::Reply;
use parking_lot::Mutex;
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

/// So long after the last change.
const QUIET: Duration = Duration::from_secs(5);

/// Changes that go on do not put it off for longer.
const LONGEST: Duration = Duration::from_secs(20);

/// After the first comparison, the next one waits for so many new tokens: few of them hardly overlap with
/// others that end.
const MANY: usize = 32;

/// An answer that takes longer is not waited for.
const PATIENCE: Duration = Duration::from_secs(5);

/// After so many it is left to the next time.
const MOST_QUESTIONS: usize = 6;

/// Tells the thread that compares of tokens that come. It ends when this is dropped.
pub(super) struct Arrivals {
    count: Arc<AtomicUsize>,
    happened: Sender<()>,
}

impl Arrivals {
    pub(super) fn add(&self) {
        self.count.fetch_add(1, Ordering::Relaxed);
        // One that waits stands for all.
        let _ = self.happened.try_send(());
    }
}

/// Starts the thread that compares.
pub(super) fn start(domain: &Arc<Domain>, settings: &Settings) -> Result<Arrivals, MiddlewareError> {
    let (happened, happening) = bounded(1);
    let arrivals = Arrivals { count: Arc::default(), happened };
    let count = Arc::clone(&arrivals.count);
    let recheck = Recheck { domain: Arc::downgrade(domain), settings: settings.clone(), happening };
    let run = move || {
        let mut next = 1;
        while recheck.happening.recv().is_ok() && recheck.wait_for_quiet().is_some() {
            let count = count.load(Ordering::Relaxed);
            if count >= next {
                next = count + MANY;
                if recheck.settle().is_none() {
                    return;
                }
            }
        }
    };
    std::thread::Builder::new().name("downbeat-zenoh-recheck".into()).spawn(run)?;
    Ok(arrivals)
}

struct Recheck {
    domain: Weak<Domain>,
    settings: Settings,
    happening: Receiver<()>,
}

impl Recheck {
    /// `None` when the domain is left.
    fn wait_for_quiet(&self) -> Option<()> {
        let latest = Instant::now() + LONGEST;
        loop {
            let left = latest.saturating_duration_since(Instant::now());
            match self.happening.recv_timeout(QUIET.min(left)) {
                Ok(()) if left.is_zero() => return Some(()),
                Ok(()) => (),
                Err(error) => return error.is_timeout().then_some(()),
            }
        }
    }

    /// Asks until nothing differs. `None` when the domain is left.
    fn settle(&self) -> Option<()> {
        if self.knows_other_ways()? {
            return Some(());
        }
        let mut before = BTreeSet::new();
        for _ in 0..MOST_QUESTIONS {
            if let Some(told) = self.ask()? {
                let domain = self.domain.upgrade()?;
                let mut now = domain.graph.difference(&told);
                let linked = domain.linked_sessions();
                now.retain(|difference| !difference.is_of(&linked));
                // A token may come or go while it is asked for.
                for lasting in now.intersection(&before) {
                    tracing::debug!(?lasting, "what is known of the Zenoh graph is put right");
                    domain.graph.put_right(lasting);
                }
                before = &now - &before;
                if before.is_empty() {
                    break;
                }
            }
            self.wait_for_quiet()?;
        }
        Some(())
    }

    /// Whether there are routers that may not know of each other, of which only one would be asked. `None`
    /// when the domain is left.
    fn knows_other_ways(&self) -> Option<bool> {
        Some(self.domain.upgrade()?.session.info().routers_zid().wait().count() > 1)
    }

    /// Asks the router for all tokens of the domain. The inner `None` means that the answer took too long or
    /// was empty, the outer one that the domain has been left.
    fn ask(&self) -> Option<Option<BTreeSet<String>>> {
        let tokens = tokens_of(self.domain.upgrade()?.domain_id);
        let Some(session) = downbeat_zenoh::open_onlooker(&self.settings) else { return Some(None) };
        let (all, told) = bounded(1);
        let telling = Telling { tokens: Mutex::default(), all };
        let tell = move |reply: Reply| telling.take(&reply);
        if let Err(error) = session.liveliness().get(tokens).callback(tell).wait() {
            tracing::debug!(%error, "the Zenoh graph cannot be asked for");
            return Some(None);
        }
        let told = told.recv_timeout(PATIENCE).ok();
        Some(told.filter(|tokens| !tokens.is_empty() && tokens.len() < MOST_TOKENS))
    }
}

/// Collects the tokens of an answer, and sends them when the answer is complete.
struct Telling {
    tokens: Mutex<BTreeSet<String>>,
    all: Sender<BTreeSet<String>>,
}

impl Telling {
    fn take(&self, reply: &Reply) {
        let mut tokens = self.tokens.lock();
        if let Ok(token) = reply.result()
            && tokens.len() < MOST_TOKENS
        {
            tokens.insert(token.key_expr().as_str().to_owned());
        }
    }
}

impl Drop for Telling {
    fn drop(&mut self) {
        // Fails when it took too long.
        let _ = self.all.send(std::mem::take(self.tokens.get_mut()));
    }
}
