//! What viewers look at.

use crate::bag::BagSource;
use crate::channels::{Changes, Channels};
use crate::client::Client;
use crate::options::{ViewOptions, ViewTime};
use crate::services::{ShownService, shown};
use crate::subscribed::{Subscribed, no_channel};
use downbeat_edge::{CoreAccess, Interfaces};
use downbeat_executor::{Clock, Core, CoreHandle, SetupError, TopicInfo};
use serde_json::Value;
use std::sync::Arc;
use std::time::Duration;

/// What viewers look at.
pub(crate) enum Source {
    /// A core, running or about to.
    Core(CoreSource),
    /// Nothing but what the host of the page answers.
    Nothing,
    /// Recorded bags.
    Bag(BagSource),
}

/// What a server needs of a core that only a core that does not run yet can give.
#[derive(Clone)]
pub struct CoreLink {
    pub(crate) core: CoreHandle,
    pub(crate) clock: Arc<dyn Clock>,
    pub(crate) interfaces: Interfaces,
    pub(crate) services: Arc<[ShownService]>,
}

impl CoreLink {
    /// Links to a core. Viewers can call the services that modules serve now.
    ///
    /// # Errors
    /// If the core has no caller for a service.
    pub fn of(core: &mut Core, interfaces: &Interfaces) -> Result<Self, SetupError> {
        let services = shown(core, interfaces)?.into();
        Ok(Self { core: core.handle(), clock: core.clock(), interfaces: interfaces.clone(), services })
    }
}

/// A core, and what of it viewers see.
pub(crate) struct CoreSource {
    pub(crate) handle: CoreHandle,
    pub(crate) channels: Channels,
    pub(crate) services: Arc<[ShownService]>,
    clock: Arc<dyn Clock>,
}

impl Source {
    /// What viewers can do with it, besides what the token allows.
    pub(crate) fn capabilities(&self, options: &ViewOptions) -> Vec<&'static str> {
        match self {
            Self::Core(_) => {
                let mut capabilities = vec!["parameters", "parametersSubscribe", "connectionGraph", "assets"];
                if options.time == ViewTime::Core {
                    capabilities.push("time");
                }
                capabilities
            }
            Self::Nothing => Vec::new(),
            Self::Bag(_) => vec!["time", "playbackControl", "assets"],
        }
    }

    /// The channels as the protocol announces them.
    pub(crate) fn channels(&self) -> Vec<Value> {
        match self {
            Self::Core(core) => core.channels.all().iter().map(|channel| channel.announcement()).collect(),
            Self::Nothing => Vec::new(),
            Self::Bag(bag) => bag.channels(),
        }
    }

    /// The services that viewers may call.
    pub(crate) fn services(&self) -> &[ShownService] {
        match self {
            Self::Core(core) => &core.services,
            Self::Nothing => &[],
            Self::Bag(_) => &[],
        }
    }

    /// The core, for what only a core has.
    ///
    /// # Errors
    /// In words for the viewer.
    pub(crate) fn core(&self) -> Result<&CoreSource, String> {
        match self {
            Self::Core(core) => Ok(core),
            Self::Nothing => Err("no robot runs here".to_owned()),
            Self::Bag(_) => Err("this is a recorded bag: it has no modules".to_owned()),
        }
    }

    pub(crate) fn bag(&self) -> Option<&BagSource> {
        match self {
            Self::Bag(bag) => Some(bag),
            Self::Core(_) | Self::Nothing => None,
        }
    }

    /// Subscribes a viewer to a channel.
    ///
    /// # Errors
    /// In words for the viewer.
    pub(crate) fn subscribe(
        &self,
        client: &Client,
        subscription: u32,
        channel: u32,
    ) -> Result<Subscribed, String> {
        match self {
            Self::Core(core) => core.subscribe(client, subscription, channel),
            Self::Nothing => Err(no_channel(channel)),
            Self::Bag(bag) => bag.subscribe(client, subscription, channel),
        }
    }

    /// Ends its threads.
    pub(crate) fn stop(&self) {
        if let Some(bag) = self.bag() {
            bag.stop();
        }
    }

    /// Ends what would keep it alive.
    pub(crate) fn close(&self) {
        match self {
            Self::Core(core) => core.channels.close(),
            Self::Nothing => {}
            Self::Bag(_) => {}
        }
    }
}

impl CoreSource {
    pub(crate) fn new(
        link: CoreLink,
        access: &mut CoreAccess<'_>,
        topics: &[TopicInfo],
        options: &ViewOptions,
    ) -> Self {
        let CoreLink { core, clock, interfaces, services } = link;
        let channels = Channels::new(&interfaces);
        channels.refresh(access, topics, options);
        Self { handle: core, channels, services, clock }
    }

    /// Looks for topics that have come or gone; `None` if the core does not answer within `patience`.
    pub(crate) fn refresh(&self, options: &ViewOptions, patience: Duration) -> Option<Changes> {
        let topics = self.handle.topics().wait(patience)?;
        Some(self.channels.refresh(&mut CoreAccess::Running(&self.handle), &topics, options))
    }

    /// The time of the core, in nanoseconds.
    pub(crate) fn time_ns(&self) -> u64 {
        u64::try_from(self.clock.now().as_nanos()).unwrap_or(0)
    }

    fn subscribe(
        &self,
        &Client { id: client, ref outbox, .. }: &Client,
        subscription: u32,
        channel: u32,
    ) -> Result<Subscribed, String> {
        let channel = self.channels.find(channel).ok_or_else(|| no_channel(channel))?;
        let mut core = CoreAccess::Running(&self.handle);
        let subscribed = self.channels.subscribe(&channel, &mut core, client, subscription, outbox);
        subscribed.map_err(|error| error.to_string())?;
        let topic = Arc::clone(&channel.topic);
        Ok(Subscribed::new(topic, move || channel.unsubscribe(client, subscription)))
    }
}
