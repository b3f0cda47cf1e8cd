//! The topics that viewers see, and the messages on their way to those who subscribed.

use crate::feed::Feed;
use crate::options::ViewOptions;
use crate::outbox::Outbox;
use bytes::Bytes;
use downbeat_edge::{CoreAccess, Interfaces, KnownType, Offered, Sink};
use downbeat_executor::{Inbox, Outlet, OutletInbox, SetupError, Time, TopicInfo};
use parking_lot::Mutex;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::sync::Arc;

/// How many batches of a topic wait while the thread that serializes is busy; older ones are dropped.
const CAPACITY: NonZeroUsize = NonZeroUsize::new(1000).unwrap();

/// The topics of a core that viewers see.
pub(crate) struct Channels {
    interfaces: Interfaces,
    inbox: OutletInbox,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    by_topic: BTreeMap<Arc<str>, Arc<Channel>>,
    last_id: u32,
    is_full: bool,
}

/// A topic with its messages for all viewers.
pub(crate) struct Channel {
    pub(crate) id: u32,
    /// In the core, without a leading slash.
    pub(crate) topic: Arc<str>,
    message_type: KnownType,
    feed: Arc<Feed>,
    /// Open while somebody subscribes. Its lock is taken before that of the feed, and the sink never takes
    /// it: the thread that opens an outlet waits for the core, which may run the sink.
    outlet: Mutex<Option<Outlet>>,
}

/// What a look at the topics of the core has changed.
pub(crate) struct Changes {
    pub(crate) added: Vec<Arc<Channel>>,
    pub(crate) removed: Vec<u32>,
}

impl Channels {
    pub(crate) fn new(interfaces: &Interfaces) -> Self {
        let inbox = OutletInbox::new("view", Inbox::KeepLast(CAPACITY));
        Self { interfaces: interfaces.clone(), inbox, state: Mutex::default() }
    }

    pub(crate) fn interfaces(&self) -> &Interfaces {
        &self.interfaces
    }

    /// The type of a topic's messages, if it is a ROS 2 type whose definition is known.
    pub(crate) fn message_type(&self, topic: &TopicInfo, options: &ViewOptions) -> Option<KnownType> {
        let raw = || options.raw.iter().find(|(name, _)| name.trim_start_matches('/') == &*topic.name);
        let found = self.interfaces.message_in(topic).or_else(|| Some(raw()?.1))?;
        (!found.hash().is_empty()).then_some(found)
    }

    /// Compares with the topics of the core.
    pub(crate) fn refresh(
        &self,
        core: &mut CoreAccess<'_>,
        topics: &[TopicInfo],
        options: &ViewOptions,
    ) -> Changes {
        let mut state = self.state.lock();
        let shown = topics.iter().filter(|topic| (options.topics)(&topic.name));
        let shown = shown.filter_map(|topic| Some((&topic.name, self.message_type(topic, options)?)));
        let shown: BTreeMap<_, _> = shown.collect();
        let mut removed = Vec::new();
        state.by_topic.retain(|topic, channel| {
            let is_there = shown.get(topic) == Some(&channel.message_type);
            if !is_there {
                removed.push(channel.id);
            }
            is_there
        });
        let mut added = Vec::new();
        for (&topic, &message_type) in &shown {
            if state.by_topic.contains_key(topic) {
                continue;
            }
            if state.by_topic.len() >= options.limits.channels {
                if !std::mem::replace(&mut state.is_full, true) {
                    tracing::warn!("viewers see only {} topics, the core has more", options.limits.channels);
                }
                break;
            }
            state.last_id += 1;
            let latched = options.latched.iter().find(|(name, _)| name.trim_start_matches('/') == &**topic);
            let depth = latched.map_or(0, |(_, depth)| *depth);
            let channel = Arc::new(Channel {
                id: state.last_id,
                topic: Arc::clone(topic),
                message_type,
                feed: Arc::new(Feed::new(depth)),
                outlet: Mutex::default(),
            });
            if depth > 0
                && let Err(error) = channel.open(core, &self.inbox, &mut channel.outlet.lock())
            {
                tracing::warn!("viewers that come later do not see the last messages of {topic}: {error}");
            }
            state.by_topic.insert(Arc::clone(topic), Arc::clone(&channel));
            added.push(channel);
        }
        Changes { added, removed }
    }

    pub(crate) fn all(&self) -> Vec<Arc<Channel>> {
        self.state.lock().by_topic.values().cloned().collect()
    }

    pub(crate) fn find(&self, id: u32) -> Option<Arc<Channel>> {
        self.state.lock().by_topic.values().find(|channel| channel.id == id).cloned()
    }

    /// Closes all outlets.
    pub(crate) fn close(&self) {
        let channels = std::mem::take(&mut self.state.lock().by_topic);
        channels.into_values().for_each(|channel| drop(channel.outlet.lock().take()));
    }

    /// Opens the outlet of a channel if it is the first subscription.
    ///
    /// # Errors
    /// If the core refuses, or does not answer.
    pub(crate) fn subscribe(
        &self,
        channel: &Channel,
        core: &mut CoreAccess<'_>,
        client: u64,
        subscription: u32,
        outbox: &Arc<Outbox>,
    ) -> Result<(), SetupError> {
        let mut outlet = channel.outlet.lock();
        if outlet.is_none() {
            channel.open(core, &self.inbox, &mut outlet)?;
        }
        channel.feed.add(client, subscription, outbox);
        Ok(())
    }
}

impl Channel {
    /// As the protocol announces it.
    pub(crate) fn announcement(&self) -> Value {
        json!({
            "id": self.id,
            "topic": format!("/{}", self.topic),
            "encoding": "cdr",
            "schemaName": self.message_type.name(),
            "schema": self.message_type.definition(),
            "schemaEncoding": "ros2msg",
        })
    }

    /// Ends a subscription, and closes the outlet after the last.
    pub(crate) fn unsubscribe(&self, client: u64, subscription: u32) {
        let mut outlet = self.outlet.lock();
        if self.feed.remove(client, subscription) && self.feed.depth() == 0 {
            drop(outlet.take());
        }
    }

    fn open(
        &self,
        core: &mut CoreAccess<'_>,
        inbox: &OutletInbox,
        outlet: &mut Option<Outlet>,
    ) -> Result<(), SetupError> {
        let sink = ToViewers(Arc::clone(&self.feed));
        *outlet = Some(self.message_type.outlet(core, &self.topic, inbox, sink)?);
        Ok(())
    }
}

struct ToViewers(Arc<Feed>);

impl Sink for ToViewers {
    fn is_wanted(&mut self, message: Offered) -> bool {
        self.0.count_dropped(message.missed);
        self.0.is_wanted()
    }

    fn take(&mut self, time: Time, cdr: Bytes) {
        self.0.send(u64::try_from(time.as_nanos()).unwrap_or(0), &cdr);
    }
}
