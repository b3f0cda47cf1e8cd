//! A connected viewer, as the other threads of the server see it.

use crate::graph::Connections;
use crate::outbox::Outbox;
use parking_lot::Mutex;
use serde_json::Value;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::Instant;

/// A connected viewer, as the thread that announces changes sees it.
pub(crate) struct Client {
    pub(crate) id: u64,
    pub(crate) outbox: Arc<Outbox>,
    /// True if its version of the protocol has the state of playback.
    pub(crate) knows_playback: bool,
    pub(crate) watched: Mutex<Watched>,
}

/// What is announced to a viewer when it changes.
#[derive(Default)]
pub(crate) struct Watched {
    /// The parameters, with the values that it knows.
    pub(crate) parameters: BTreeMap<String, Option<Value>>,
    /// The connections that it knows, if it asked for them.
    pub(crate) connections: Option<Connections>,
    /// The topics of its subscriptions.
    pub(crate) topics: HashMap<u32, Arc<str>>,
    /// When it was last told that messages of a topic were dropped.
    pub(crate) told: HashMap<Arc<str>, Instant>,
}
