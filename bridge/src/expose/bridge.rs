//! The bridge: exposes topics of a core, and changes which while the core runs.

use super::conflict::Opposite;
use super::endpoint::ExposedEndpoint;
use super::endpoints::{BridgeStatus, EndpointReport, Endpoints, Exposed, FromRos, Held, ToRos, Traffic};
use super::exposure::{ExposeError, Exposure, Limiter, OfACycle};
use super::network_nodes::NetworkNodes;
use super::qos_events::{EndpointQos, QOS_EVENTS_TOPIC, QosEvents};
use crate::edge::{CoreAccess, Waiting};
use crate::middleware::{Direction, EndpointEvent, Gid, Sample};
use crate::ros::{MessageType, NameError, Node, NodeError, learn};
use downbeat_executor::{Clock, Core, CoreHandle, Inbox, OutletInbox};
use parking_lot::{Mutex, RwLock};
use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;
use std::sync::Arc;

/// How many batches of a topic wait while the bridge is busy: 8 s at 125 Hz. Older ones are dropped.
const CAPACITY: NonZeroUsize = NonZeroUsize::new(1000).unwrap();

/// Creates the endpoints of all exposures on `node`, each fed by an outlet of `core` or feeding an inlet.
///
/// The endpoints are removed when the core stops; the node when its last handle is dropped after that.
/// [`Bridge::start`] returns a handle to change what is exposed while the core runs.
///
/// # Errors
/// [`ExposeError`] when a topic cannot be exposed.
pub fn expose(core: &mut Core, node: &Node, exposures: &[Exposure]) -> Result<BridgeStatus, ExposeError> {
    Ok(Bridge::start(core, node, exposures)?.status())
}

/// Exposes topics of a core on a node, and changes while the core runs which. Clones share one bridge, which
/// keeps its node in the graph.
#[derive(Clone)]
pub struct Bridge {
    nodes: NetworkNodes,
    core: CoreHandle,
    clock: Arc<dyn Clock>,
    events: QosEvents,
    endpoints: Arc<Endpoints>,
    /// By network: a slow one delays no other, since each inbox has its own thread.
    inboxes: Arc<Mutex<BTreeMap<Option<String>, OutletInbox>>>,
    /// The publishers of the bridge. What they send comes from the core, so it does not enter the core again.
    own: Arc<RwLock<BTreeSet<Gid>>>,
    /// Held during a change, so that changes do not overlap.
    changes: Arc<Mutex<()>>,
}

impl Bridge {
    /// Creates the endpoints of all exposures on one node or on one in each network, each fed by an outlet of
    /// `core` or feeding an inlet.
    ///
    /// # Errors
    /// [`ExposeError`] when a topic cannot be exposed.
    pub fn start(
        core: &mut Core,
        nodes: impl Into<NetworkNodes>,
        exposures: &[Exposure],
    ) -> Result<Self, ExposeError> {
        if core.topics().any(|topic| *topic.name == *QOS_EVENTS_TOPIC && topic.is_published) {
            return Err(ExposeError::SecondBridge);
        }
        let clock = core.clock();
        let bridge = Self {
            nodes: nodes.into(),
            core: core.handle(),
            events: QosEvents::open(&mut CoreAccess::Idle(core), Arc::clone(&clock))?,
            clock,
            endpoints: Arc::default(),
            inboxes: Arc::default(),
            own: Arc::default(),
            changes: Arc::default(),
        };
        bridge.endpoints.extend(bridge.create_all(&mut CoreAccess::Idle(core), exposures)?)?;
        let endpoints = Arc::clone(&bridge.endpoints);
        core.on_stop(move || endpoints.close());
        Ok(bridge)
    }

    /// Reports the endpoints.
    #[must_use]
    pub fn status(&self) -> BridgeStatus {
        BridgeStatus::new(Arc::clone(&self.endpoints))
    }

    /// The node of the endpoints for which no other is named.
    #[must_use]
    pub fn node(&self) -> &Node {
        self.nodes.own()
    }

    /// Exposes more while the core runs: all of the exposures or, if one fails, none. Waits for the end of a
    /// cycle, so it must not be called on the core's own thread.
    ///
    /// # Errors
    /// [`ExposeError`] when a topic cannot be exposed, or the core does not run.
    pub fn add(&self, exposures: &[Exposure]) -> Result<Vec<EndpointReport>, ExposeError> {
        let _changes = self.changes.lock();
        let exposed = self.create_all(&mut CoreAccess::Running(&self.core), exposures)?;
        let reports = exposed.iter().map(Exposed::report).collect();
        self.endpoints.extend(exposed)?;
        Ok(reports)
    }

    /// Removes the endpoints for which `is_meant` returns true from the graph of ROS 2, and returns their
    /// last reports.
    pub fn remove(&self, is_meant: impl Fn(&ExposedEndpoint) -> bool) -> Vec<EndpointReport> {
        let _changes = self.changes.lock();
        self.endpoints.remove(is_meant)
    }

    fn create_all(
        &self,
        core: &mut CoreAccess<'_>,
        exposures: &[Exposure],
    ) -> Result<Vec<Exposed>, ExposeError> {
        // Each node is created once, and kept until its endpoints keep it: peers do not see it come and go.
        let nodes = exposures.iter().map(|exposure| self.node_of(exposure)).collect::<Result<Vec<_>, _>>()?;
        // The names of the topics in ROS 2; `None` for an invalid name, which `create` reports.
        let names: Vec<_> = exposures
            .iter()
            .zip(&nodes)
            .map(|(exposure, node)| node.topic_name(exposure.ros_topic()).ok().map(|topic| topic.to_string()))
            .collect();
        let mut all = Vec::<Exposed>::with_capacity(exposures.len());
        for ((exposure, node), name) in exposures.iter().zip(&nodes).zip(&names) {
            let others = exposures.iter().zip(&names);
            let conflict = others.into_iter().find_map(|(other, other_name)| {
                exposure.conflict(name.as_deref(), &Opposite::of_exposure(other, other_name.as_deref()))
            });
            let conflict = conflict.or_else(|| {
                self.endpoints.find(|other| exposure.conflict(name.as_deref(), &Opposite::of_endpoint(other)))
            });
            if let Some(error) = conflict {
                return Err(error);
            }
            let exposed = self.create(core, node, exposure)?;
            let is_same = |other: &ExposedEndpoint| exposed.endpoint.is_same_as(other);
            if all.iter().any(|other| is_same(&other.endpoint)) || self.endpoints.any(is_same) {
                return Err(ExposeError::Twice(exposed.endpoint.ros_topic));
            }
            all.push(exposed);
        }
        Ok(all)
    }

    fn node_of(&self, exposure: &Exposure) -> Result<Node, ExposeError> {
        let failed = |error| ExposeError::Endpoint { topic: exposure.topic.clone(), error };
        let node = self.nodes.find(&exposure.topic, exposure.network.as_deref())?;
        match &exposure.node {
            None => Ok(node.clone()),
            Some(name) => node.sibling(name).map_err(failed),
        }
    }

    fn inbox_of(&self, exposure: &Exposure) -> OutletInbox {
        let new = || {
            let network = exposure.network.as_ref();
            let name = network.map_or_else(|| "bridge".to_owned(), |network| format!("bridge to {network}"));
            OutletInbox::new(&name, Inbox::KeepLast(CAPACITY))
        };
        self.inboxes.lock().entry(exposure.network.clone()).or_insert_with(new).clone()
    }

    fn create(
        &self,
        core: &mut CoreAccess<'_>,
        node: &Node,
        exposure: &Exposure,
    ) -> Result<Exposed, ExposeError> {
        let Exposure { direction, message_type, limits, send, .. } = *exposure;
        let (topic, ros_topic) = (&exposure.topic, exposure.ros_topic());
        let failed = |error: NodeError| ExposeError::Endpoint { topic: topic.clone(), error };
        let failed_name = |error: NameError| failed(error.into());
        let ros_type = MessageType::new(message_type.name()).map_err(failed_name)?;
        let qos = node.resolve_qos(ros_topic, direction, &exposure.qos).map_err(failed_name)?;
        let full_name = node.topic_name(ros_topic).map_err(failed_name)?;
        let endpoint = ExposedEndpoint::new(exposure, node.name(), &full_name, qos);
        let traffic = Arc::<Traffic>::default();
        let events = Arc::new(EndpointQos::new(&endpoint, self.events.clone()));
        let on_event = {
            let events = Arc::clone(&events);
            Box::new(move |event: &EndpointEvent| events.happened(event))
        };
        let limiter = Limiter::new(limits);
        let held = match direction {
            Direction::Out => {
                let publisher = Arc::new(node.publish_with(ros_topic, &ros_type, qos, send).map_err(failed)?);
                self.own.write().insert(publisher.gid());
                publisher.on_event(on_event);
                let weak = Arc::downgrade(&publisher);
                let traffic = Arc::clone(&traffic);
                let sink = ToRos { publisher, traffic, limiter, of_a_cycle: limits.of_a_cycle };
                Held::Out(weak, message_type.outlet(core, topic, &self.inbox_of(exposure), sink)?)
            }
            Direction::In => {
                let waiting = match limits.of_a_cycle {
                    OfACycle::All => Waiting::All,
                    OfACycle::Latest => Waiting::Latest,
                };
                let inlet = message_type.inlet_with(core, topic, waiting)?;
                let (traffic, clock) = (Arc::clone(&traffic), Arc::clone(&self.clock));
                let mut from_ros = FromRos { inlet, traffic, limiter, clock };
                let own = Arc::clone(&self.own);
                let take = move |sample: Sample| {
                    // Others of the participant are let in, such as a bag that is played.
                    if !own.read().contains(&sample.writer) {
                        from_ros.take(&sample);
                    }
                };
                let subscription =
                    node.subscribe(ros_topic, &ros_type, qos, Box::new(take)).map_err(failed)?;
                let subscription = Arc::new(subscription);
                learn(node, &subscription, message_type);
                subscription.on_event(on_event);
                Held::In(subscription)
            }
        };
        Ok(Exposed { endpoint, traffic, events, held: Some(held) })
    }
}
