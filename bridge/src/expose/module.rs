//! The bridge as a module of the executor.

use super::status::{BridgeStatus, EndpointStatus, Traffic, WeakEndpoint};
use crate::edge::{EncodedInlet, EncodedInletError, KnownType, Sink};
use crate::middleware::{Direction, Sample};
use crate::ros::{MessageType, NameError, Node, NodeError, Publisher, Subscription};
use bytes::Bytes;
use downbeat_executor::{
    Context, Core, Inbox, InletError, Module, ModuleOptions, Role, Setup, SetupError, Synchrony, Time,
};
use downbeat_msgs::qos::{Durability, QosProfile};
use std::num::NonZeroUsize;
use std::sync::Arc;
use thiserror::Error;

/// The name under which the bridge joins a core.
pub const MODULE_NAME: &str = "bridge";

/// Batches that wait while the bridge is busy: 8 s at 125 Hz. Older ones are dropped.
const INBOX: NonZeroUsize = NonZeroUsize::new(1000).unwrap();

/// A topic to show to ROS 2, or to take from it.
#[derive(Clone, Debug)]
pub struct Exposure {
    /// The topic in the executor.
    pub topic: String,
    /// The topic in ROS 2 where it differs: absolute, relative to the node's namespace, or private (`~/…`).
    pub ros_topic: Option<String>,
    /// The type of the messages.
    pub message_type: KnownType,
    /// Out of the executor or into it.
    pub direction: Direction,
    /// What to offer or request.
    pub qos: QosProfile,
}

/// A topic could not be exposed.
#[derive(Debug, Error)]
pub enum ExposeError {
    /// Its ROS 2 endpoint could not be created.
    #[error("exposing topic \"{topic}\": {error}")]
    Endpoint {
        /// The topic in the executor.
        topic: String,
        /// Why not.
        error: NodeError,
    },
    /// The ROS 2 endpoints of a service could not be created.
    #[error("exposing service \"{service}\": {error}")]
    Service {
        /// The service in the executor.
        service: String,
        /// Why not.
        error: NodeError,
    },
    /// A message that came in would go out again, and reach those who heard it already.
    #[error(
        "topic \"{0}\" is exposed in both directions: what comes in would go out again; expose one of them under \
         another topic of the executor"
    )]
    BothDirections(String),
    /// The executor refused.
    #[error(transparent)]
    Setup(#[from] SetupError),
}

/// Creates the endpoints of all exposures on `node`, and adds the bridge to `core` as the detached observer
/// [`MODULE_NAME`].
///
/// The endpoints go when the core stops; the node when its last handle is dropped after that.
///
/// # Errors
/// [`ExposeError`] when a topic cannot be exposed.
pub fn expose(core: &mut Core, node: &Node, exposures: &[Exposure]) -> Result<BridgeStatus, ExposeError> {
    let mut bridge = Bridge::default();
    let mut statuses = Vec::with_capacity(exposures.len());
    for exposure in exposures {
        if exposures.iter().any(|other| is_reverse(exposure, other)) {
            return Err(ExposeError::BothDirections(exposure.topic.clone()));
        }
        statuses.push(match exposure.direction {
            Direction::Out => bridge.add_out(node, exposure)?,
            Direction::In => bridge.add_in(core, node, exposure)?,
        });
    }
    let options = ModuleOptions {
        synchrony: Synchrony::Detached(Inbox::KeepLast(INBOX)),
        role: Role::Observer,
        ..ModuleOptions::default()
    };
    core.add_with(MODULE_NAME, bridge, options)?;
    Ok(BridgeStatus::new(statuses))
}

#[derive(Default)]
struct Bridge {
    out: Vec<Out>,
    subscriptions: Vec<Arc<Subscription>>,
}

struct Out {
    topic: String,
    message_type: KnownType,
    publisher: Arc<Publisher>,
    traffic: Arc<Traffic>,
}

impl Module for Bridge {
    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        for Out { topic, message_type, publisher, traffic } in self.out.drain(..) {
            let is_latched = publisher.qos().durability == Durability::TransientLocal;
            message_type.subscribe(setup, &topic, ToRos { publisher, traffic, is_latched })?;
        }
        Ok(())
    }

    fn shutdown(&mut self, _ctx: &mut Context<'_>) {
        self.subscriptions.clear();
    }
}

impl Bridge {
    fn add_out(&mut self, node: &Node, exposure: &Exposure) -> Result<EndpointStatus, ExposeError> {
        let message_type = ros_type(exposure)?;
        let publisher = node
            .publish(ros_topic(exposure), &message_type, exposure.qos)
            .map_err(|error| failed(exposure, error))?;
        let (publisher, traffic) = (Arc::new(publisher), Arc::<Traffic>::default());
        let status = status(
            exposure,
            publisher.topic().to_string(),
            WeakEndpoint::Publisher(Arc::downgrade(&publisher)),
            &traffic,
        );
        let (topic, message_type) = (exposure.topic.clone(), exposure.message_type);
        self.out.push(Out { topic, message_type, publisher, traffic });
        Ok(status)
    }

    fn add_in(
        &mut self,
        core: &mut Core,
        node: &Node,
        exposure: &Exposure,
    ) -> Result<EndpointStatus, ExposeError> {
        let message_type = ros_type(exposure)?;
        let inlet = exposure.message_type.inlet(core, &exposure.topic)?;
        let traffic = Arc::<Traffic>::default();
        let from_ros = from_ros(inlet, Arc::clone(&traffic));
        let subscription = node
            .subscribe(ros_topic(exposure), &message_type, exposure.qos, Box::new(from_ros))
            .map_err(|error| failed(exposure, error))?;
        let subscription = Arc::new(subscription);
        let endpoint = WeakEndpoint::Subscription(Arc::downgrade(&subscription));
        let status = status(exposure, subscription.topic().to_string(), endpoint, &traffic);
        self.subscriptions.push(subscription);
        Ok(status)
    }
}

/// Publishes the messages of one topic.
struct ToRos {
    publisher: Arc<Publisher>,
    traffic: Arc<Traffic>,
    is_latched: bool,
}

impl Sink for ToRos {
    fn is_wanted(&mut self) -> bool {
        let is_wanted = self.is_latched || self.publisher.matched_subscriptions() > 0;
        if !is_wanted {
            self.traffic.count_skipped();
        }
        is_wanted
    }

    fn take(&mut self, _time: Time, cdr: Bytes) {
        let result = self.publisher.publish(cdr);
        if self.traffic.count(&result)
            && let Err(error) = result
        {
            let topic = self.publisher.topic().as_str();
            tracing::warn!(topic, %error, "a message was not sent; from now on this is only counted");
        }
    }
}

/// Takes the samples of one topic in.
fn from_ros(inlet: EncodedInlet, traffic: Arc<Traffic>) -> impl FnMut(Sample) + Send {
    move |sample| {
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

fn is_reverse(one: &Exposure, other: &Exposure) -> bool {
    let same_topic = one.topic.trim_start_matches('/') == other.topic.trim_start_matches('/');
    same_topic && one.direction != other.direction
}

fn ros_topic(exposure: &Exposure) -> &str {
    exposure.ros_topic.as_deref().unwrap_or(&exposure.topic)
}

fn ros_type(exposure: &Exposure) -> Result<MessageType, ExposeError> {
    MessageType::new(exposure.message_type.name()).map_err(|error: NameError| failed(exposure, error.into()))
}

fn failed(exposure: &Exposure, error: NodeError) -> ExposeError {
    ExposeError::Endpoint { topic: exposure.topic.clone(), error }
}

fn status(
    exposure: &Exposure,
    ros_topic: String,
    endpoint: WeakEndpoint,
    traffic: &Arc<Traffic>,
) -> EndpointStatus {
    EndpointStatus {
        topic: exposure.topic.clone(),
        ros_topic,
        type_name: exposure.message_type.name(),
        direction: exposure.direction,
        qos: exposure.qos,
        endpoint,
        traffic: Arc::clone(traffic),
    }
}
