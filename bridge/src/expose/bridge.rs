//! The bridge: what of a core is exposed, and changing it while the core runs.

use super::endpoints::{Endpoints, Exposed, Held};
use super::learning::learn;
use super::limit::Limiter;
use super::outgoing::{ToRos, inbox};
use super::qos_events::{EndpointQos, QOS_EVENTS_TOPIC, QosEvents};
use super::status::{BridgeStatus, EndpointReport, EndpointStatus, Traffic, WeakEndpoint};
use super::{ExposeError, Exposure, OfACycle};
use crate::edge::{CoreAccess, EncodedInlet, EncodedInletError, Waiting};
use crate::middleware::{Direction, Gid, Sample};
use crate::ros::{MessageType, Node, NodeError, Publisher, Subscription};
use downbeat_executor::{Clock, Core, CoreHandle, InletError, OutletInbox};
use downbeat_msgs::qos::QosProfile;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError, RwLock};

/// Creates the endpoints of all exposures on `node`, each fed by an outlet of `core` or feeding an inlet.
///
/// The endpoints go when the core stops; the node when its last handle is dropped after that. [`Bridge::start`] does the
/// same, for what is exposed to be changed while the core runs.
///
/// # Errors
/// [`ExposeError`] when a topic cannot be exposed.
pub fn expose(core: &mut Core, node: &Node, exposures: &[Exposure]) -> Result<BridgeStatus, ExposeError> {
    Ok(Bridge::start(core, node, exposures)?.status())
}

/// Exposes topics of a core on a node, and changes while the core runs which. Clones change the same.
///
/// It keeps its node in the graph until it is dropped.
#[derive(Clone)]
pub struct Bridge {
    node: Node,
    core: CoreHandle,
    clock: Arc<dyn Clock>,
    events: QosEvents,
    endpoints: Arc<Endpoints>,
    inbox: OutletInbox,
    own: OwnPublishers,
    /// Held while something is changed, so that one change follows the other.
    changes: Arc<Mutex<()>>,
}

/// The publishers of a bridge. What they send comes from the core, so it does not enter the core again.
#[derive(Clone, Default)]
struct OwnPublishers(Arc<RwLock<BTreeSet<Gid>>>);

impl OwnPublishers {
    fn add(&self, publisher: Gid) {
        self.0.write().unwrap_or_else(PoisonError::into_inner).insert(publisher);
    }

    fn contain(&self, writer: Gid) -> bool {
        self.0.read().unwrap_or_else(PoisonError::into_inner).contains(&writer)
    }
}

impl Bridge {
    /// Creates the endpoints of all exposures on `node`, each fed by an outlet of `core` or feeding an inlet.
    ///
    /// # Errors
    /// [`ExposeError`] when a topic cannot be exposed.
    pub fn start(core: &mut Core, node: &Node, exposures: &[Exposure]) -> Result<Self, ExposeError> {
        if core.topics().any(|topic| *topic.name == *QOS_EVENTS_TOPIC && topic.is_published) {
            return Err(ExposeError::SecondBridge);
        }
        let clock = core.clock();
        let bridge = Self {
            node: node.clone(),
            core: core.handle(),
            events: QosEvents::open(&mut CoreAccess::Idle(core), Arc::clone(&clock))?,
            clock,
            endpoints: Arc::default(),
            inbox: inbox(),
            own: OwnPublishers::default(),
            changes: Arc::default(),
        };
        bridge.endpoints.extend(bridge.create_all(&mut CoreAccess::Idle(core), exposures)?)?;
        let endpoints = Arc::clone(&bridge.endpoints);
        core.on_stop(move || endpoints.close());
        Ok(bridge)
    }

    /// What the bridge is doing.
    #[must_use]
    pub fn status(&self) -> BridgeStatus {
        BridgeStatus::new(Arc::clone(&self.endpoints))
    }

    /// The node that has the endpoints for which no other is named.
    #[must_use]
    pub fn node(&self) -> &Node {
        &self.node
    }

    /// Exposes more while the core runs, all of it or, where one cannot be, nothing. Waits for the end of a cycle, so not
    /// from the core's own thread.
    ///
    /// # Errors
    /// [`ExposeError`] when a topic cannot be exposed, or the core does not run.
    pub fn add(&self, exposures: &[Exposure]) -> Result<Vec<EndpointReport>, ExposeError> {
        let _changes = self.changes.lock().unwrap_or_else(PoisonError::into_inner);
        let exposed = self.create_all(&mut CoreAccess::Running(&self.core), exposures)?;
        let reports = exposed.iter().map(Exposed::report).collect();
        self.endpoints.extend(exposed)?;
        Ok(reports)
    }

    /// Takes back what is exposed where `is_meant` says so: its endpoints are gone from the graph of ROS 2 when this
    /// returns. Returns what it was.
    pub fn remove(&self, is_meant: impl Fn(&EndpointReport) -> bool) -> Vec<EndpointReport> {
        let _changes = self.changes.lock().unwrap_or_else(PoisonError::into_inner);
        self.endpoints.remove(is_meant)
    }

    fn create_all(
        &self,
        core: &mut CoreAccess<'_>,
        exposures: &[Exposure],
    ) -> Result<Vec<Exposed>, ExposeError> {
        // Each node is created once and kept until its endpoints keep it: peers need not see it come and go.
        let nodes = exposures.iter().map(|exposure| self.node_of(exposure)).collect::<Result<Vec<_>, _>>()?;
        // The names that the topics have in ROS 2; nothing where one is not valid, which the creation tells.
        let names: Vec<_> = exposures
            .iter()
            .zip(&nodes)
            .map(|(exposure, node)| node.topic_name(exposure.ros_topic()).ok().map(|topic| topic.to_string()))
            .collect();
        let mut all = Vec::with_capacity(exposures.len());
        for ((exposure, node), name) in exposures.iter().zip(&nodes).zip(&names) {
            let is_reverse = |report: &EndpointReport| {
                exposure.is_reverse_of(&report.topic, report.direction)
                    && !(exposure.message_type.is_raw() && name.as_ref() != Some(&report.ros_topic))
            };
            let others = exposures.iter().zip(&names).any(|(other, name_of_other)| {
                exposure.is_reverse_of(&other.topic, other.direction)
                    && !(exposure.message_type.is_raw() && name != name_of_other)
            });
            if others || self.endpoints.any(is_reverse) {
                return Err(ExposeError::BothDirections(exposure.topic.clone()));
            }
            let exposed = self.create(core, node, exposure)?;
            let new = exposed.report();
            let is_same = |report: &EndpointReport| {
                report.direction == new.direction
                    && report.ros_topic == new.ros_topic
                    && report.node == new.node
            };
            if all.iter().map(Exposed::report).any(|report| is_same(&report)) || self.endpoints.any(is_same) {
                return Err(ExposeError::Twice(new.ros_topic));
            }
            all.push(exposed);
        }
        Ok(all)
    }

    fn node_of(&self, exposure: &Exposure) -> Result<Node, ExposeError> {
        let failed = |error| ExposeError::Endpoint { topic: exposure.topic.clone(), error };
        match &exposure.node {
            None => Ok(self.node.clone()),
            Some(name) => self.node.sibling(name).map_err(failed),
        }
    }

    fn create(
        &self,
        core: &mut CoreAccess<'_>,
        node: &Node,
        exposure: &Exposure,
    ) -> Result<Exposed, ExposeError> {
        let failed = |error| ExposeError::Endpoint { topic: exposure.topic.clone(), error };
        let traffic = Arc::<Traffic>::default();
        let events = |ros_topic: &str| {
            let events = self.events.clone();
            Arc::new(EndpointQos::new(&exposure.topic, ros_topic, exposure.direction, events))
        };
        let (held, endpoint, ros_topic, qos, events) = match exposure.direction {
            Direction::Out => {
                let publisher = Arc::new(publisher(node, exposure).map_err(failed)?);
                self.own.add(publisher.gid());
                let (topic, qos) = (publisher.topic().to_string(), publisher.qos());
                let events = events(&topic);
                let told = Arc::clone(&events);
                publisher.on_event(Box::new(move |event| told.happened(event)));
                let endpoint = WeakEndpoint::Publisher(Arc::downgrade(&publisher));
                let sink = ToRos {
                    publisher,
                    traffic: Arc::clone(&traffic),
                    limiter: Limiter::new(exposure.limits),
                    of_a_cycle: exposure.limits.of_a_cycle,
                };
                let outlet = exposure.message_type.outlet(core, &exposure.topic, &self.inbox, sink)?;
                (Held::Outlet(outlet), endpoint, topic, qos, events)
            }
            Direction::In => {
                let waiting = match exposure.limits.of_a_cycle {
                    OfACycle::All => Waiting::All,
                    OfACycle::Latest => Waiting::Latest,
                };
                let inlet = exposure.message_type.inlet_with(core, &exposure.topic, waiting)?;
                let limiter = Limiter::new(exposure.limits);
                let take =
                    from_ros(inlet, self.own.clone(), Arc::clone(&traffic), limiter, Arc::clone(&self.clock));
                let subscription = Arc::new(subscription(node, exposure, take).map_err(failed)?);
                if let Err(error) = learn(node, &subscription, exposure.message_type) {
                    tracing::warn!(topic = exposure.topic, %error, "nobody is asked what the type looks like: no thread");
                }
                let (topic, qos) = (subscription.topic().to_string(), subscription.qos());
                let events = events(&topic);
                let told = Arc::clone(&events);
                subscription.on_event(Box::new(move |event| told.happened(event)));
                let endpoint = WeakEndpoint::Subscription(Arc::downgrade(&subscription));
                (Held::Subscription(subscription), endpoint, topic, qos, events)
            }
        };
        let status = EndpointStatus {
            topic: exposure.topic.clone(),
            ros_topic,
            node: node.name().to_string(),
            message_type: exposure.message_type,
            direction: exposure.direction,
            qos,
            limits: exposure.limits,
            endpoint,
            traffic,
            events,
        };
        Ok(Exposed::new(status, held))
    }
}

fn publisher(node: &Node, exposure: &Exposure) -> Result<Publisher, NodeError> {
    let message_type = MessageType::new(exposure.message_type.name())?;
    node.publish(exposure.ros_topic(), &message_type, qos(node, exposure)?)
}

fn subscription(
    node: &Node,
    exposure: &Exposure,
    take: impl FnMut(Sample) + Send + 'static,
) -> Result<Subscription, NodeError> {
    let message_type = MessageType::new(exposure.message_type.name())?;
    node.subscribe(exposure.ros_topic(), &message_type, qos(node, exposure)?, Box::new(take))
}

fn qos(node: &Node, exposure: &Exposure) -> Result<QosProfile, NodeError> {
    Ok(node.resolve_qos(exposure.ros_topic(), exposure.direction, &exposure.qos)?)
}

/// Takes the samples of one topic in, but for those that left the core by the same bridge.
fn from_ros(
    inlet: EncodedInlet,
    own: OwnPublishers,
    traffic: Arc<Traffic>,
    mut limiter: Limiter,
    clock: Arc<dyn Clock>,
) -> impl FnMut(Sample) + Send {
    move |sample| {
        if own.contain(sample.writer) {
            return;
        }
        if !limiter.lets_pass(clock.now()) {
            traffic.count_limited();
            return;
        }
        let result = inlet.publish(&sample.cdr);
        if matches!(result, Err(EncodedInletError::Inlet { error: InletError::Stopped, .. })) {
            return;
        }
        if traffic.count(&result)
            && let Err(error) = result
        {
            tracing::warn!(writer = %sample.writer, %error, "a message was not taken in; from now on this is only counted");
        }
    }
}
