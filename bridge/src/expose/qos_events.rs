//! Events of the quality of service of exposed endpoints: counted, logged, and published for modules.

use super::endpoint::ExposedEndpoint;
use crate::edge::CoreAccess;
use crate::middleware::{Aliveness, Direction, EndpointEvent, Gid, QosPolicyKind};
use downbeat_executor::queue::{Locked, Overflow};
use downbeat_executor::{Clock, Inlet, SetupError};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::downbeat_interfaces::msg::QosEvent;
use parking_lot::Mutex;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::num::NonZeroUsize;
use std::sync::Arc;

/// The topic of a core on which a bridge publishes events of the quality of service of its endpoints:
/// messages of `downbeat_interfaces/msg/QosEvent`. They enter through an inlet, so a replay repeats recorded
/// ones.
pub const QOS_EVENTS_TOPIC: &str = "bridge/qos_events";

/// The maximum number of events that wait for the core; older ones are dropped, and counted by the topic.
const WAITING: NonZeroUsize = NonZeroUsize::new(256).unwrap();

/// Events of the quality of service of one endpoint since its creation.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct QosCounts {
    /// Endpoints of others that were matched.
    pub matched: u64,
    /// Endpoints of others that were on the topic with a policy that did not match.
    pub incompatible: u64,
    /// The policy of the last of them.
    pub last_incompatible: Option<QosPolicyKind>,
    /// Endpoints of others that were on the topic with another type.
    pub incompatible_types: u64,
    /// Missed deadlines, offered or requested.
    pub deadlines_missed: u64,
    /// How often our publisher did not assert its liveliness in time.
    pub liveliness_lost: u64,
    /// How often a publisher was silent for longer than its lease.
    pub silences: u64,
    /// Messages of publishers that were lost.
    pub lost: u64,
}

impl QosCounts {
    /// The number of events that a user should look at.
    #[must_use]
    pub fn problems(&self) -> u64 {
        self.incompatible
            + self.incompatible_types
            + self.deadlines_missed
            + self.liveliness_lost
            + self.silences
            + self.lost
    }
}

/// Where events enter the core.
#[derive(Clone)]
pub(super) struct QosEvents {
    inlet: Inlet<QosEvent>,
    clock: Arc<dyn Clock>,
}

impl QosEvents {
    pub(super) fn open(core: &mut CoreAccess<'_>, clock: Arc<dyn Clock>) -> Result<Self, SetupError> {
        let queue = Locked::bounded(WAITING, Overflow::DropOldest);
        Ok(Self { inlet: core.inlet(QOS_EVENTS_TOPIC, queue)?, clock })
    }
}

/// The events of one endpoint.
pub(super) struct EndpointQos {
    topic: String,
    ros_topic: String,
    direction: Direction,
    events: QosEvents,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    counts: QosCounts,
    current: u64,
    alive: HashSet<Gid>,
    silent: HashSet<Gid>,
}

impl EndpointQos {
    pub(super) fn new(endpoint: &ExposedEndpoint, events: QosEvents) -> Self {
        let ExposedEndpoint { topic, ros_topic, direction, .. } = endpoint;
        let (topic, ros_topic) = (topic.clone(), ros_topic.clone());
        Self { topic, ros_topic, direction: *direction, events, state: Mutex::default() }
    }

    pub(super) fn counts(&self) -> QosCounts {
        self.state.lock().counts.clone()
    }

    pub(super) fn happened(&self, event: &EndpointEvent) {
        let Some((message, warning)) = self.note(event) else { return };
        if let Some(warning) = warning {
            tracing::warn!(topic = self.ros_topic, "{warning}; further events are only counted");
        }
        // Fails only when the core has stopped.
        let _ = self.events.inlet.publish(message);
    }

    /// Counts an event, and returns a warning for the first of its kind; `None` if rmw has no such event.
    /// (The node warns of endpoints that do not match.)
    fn note(&self, event: &EndpointEvent) -> Option<(QosEvent, Option<String>)> {
        let mut state = self.state.lock();
        let State { counts, current, alive, silent } = &mut *state;
        let mut message = QosEvent {
            stamp: Time::from_nanos(self.events.clock.now().as_nanos()),
            topic: self.topic.clone(),
            ros_topic: self.ros_topic.clone(),
            is_publisher: self.direction == Direction::Out,
            count: 1,
            ..QosEvent::default()
        };
        let mut warning = None;
        let peer = match *event {
            EndpointEvent::Matched { peer } => {
                counts.matched += 1;
                *current += 1;
                (message.kind, message.total) = (QosEvent::MATCHED, counts.matched);
                peer
            }
            EndpointEvent::Unmatched { peer } => {
                *current = current.saturating_sub(1);
                (message.kind, message.count, message.total) = (QosEvent::MATCHED, -1, counts.matched);
                peer
            }
            EndpointEvent::IncompatibleQos { peer, policy } => {
                counts.incompatible += 1;
                counts.last_incompatible = Some(policy);
                (message.kind, message.total) = (QosEvent::INCOMPATIBLE_QOS, counts.incompatible);
                message.policy = policy.name().to_owned();
                peer
            }
            EndpointEvent::IncompatibleType { peer, .. }
            | EndpointEvent::IncompatibleDefinition { peer, .. } => {
                counts.incompatible_types += 1;
                (message.kind, message.total) = (QosEvent::INCOMPATIBLE_TYPE, counts.incompatible_types);
                peer
            }
            EndpointEvent::DeadlineMissed { count } => {
                if counts.deadlines_missed == 0 {
                    warning = Some(self.deadline_warning());
                }
                counts.deadlines_missed += u64::from(count);
                message.count = count.into();
                (message.kind, message.total) = (QosEvent::DEADLINE_MISSED, counts.deadlines_missed);
                Gid::default()
            }
            EndpointEvent::LivelinessLost => {
                if counts.liveliness_lost == 0 {
                    let text = "no message was sent within the offered liveliness lease, so subscriptions consider the publisher \
                                dead. To do: publish more often, or offer a longer liveliness_lease_duration";
                    warning = Some(text.to_owned());
                }
                counts.liveliness_lost += 1;
                (message.kind, message.total) = (QosEvent::LIVELINESS_LOST, counts.liveliness_lost);
                Gid::default()
            }
            EndpointEvent::LivelinessChanged { peer, now } => {
                alive.remove(&peer);
                silent.remove(&peer);
                match now {
                    Aliveness::Gone => false,
                    Aliveness::Alive => alive.insert(peer),
                    Aliveness::NotAlive => {
                        if counts.silences == 0 {
                            warning = Some(format!(
                                "publisher {peer} was silent for longer than the requested lease and counts as not alive. \
                                 To do: check whether it hangs, or request a longer liveliness_lease_duration"
                            ));
                        }
                        counts.silences += 1;
                        silent.insert(peer)
                    }
                };
                (message.kind, message.total) = (QosEvent::LIVELINESS_CHANGED, counts.silences);
                peer
            }
            EndpointEvent::BegunAnew { .. } => return None,
            EndpointEvent::MessagesLost { peer, count } => {
                if counts.lost == 0 {
                    warning = Some(format!(
                        "{count} messages of publisher {peer} were lost. To do: request reliability reliable, a deeper history or \
                         fewer messages; for large messages raise net.core.rmem_max"
                    ));
                }
                counts.lost = counts.lost.saturating_add(count);
                message.count = i64::try_from(count).unwrap_or(i64::MAX);
                (message.kind, message.total) = (QosEvent::MESSAGE_LOST, counts.lost);
                peer
            }
        };
        message.peer = peer.0;
        (message.current, message.not_alive) = match message.kind {
            QosEvent::MATCHED => (*current, 0),
            QosEvent::LIVELINESS_CHANGED => (alive.len() as u64, silent.len() as u64),
            _ => (0, 0),
        };
        Some((message, warning))
    }

    fn deadline_warning(&self) -> String {
        match self.direction {
            Direction::Out => "no message was sent within the offered deadline. To do: publish more often, or offer a longer \
                               deadline",
            Direction::In => "no message arrived within the requested deadline. To do: check whether the publisher hangs, or \
                              request a longer deadline",
        }
        .to_owned()
    }
}
