//! The other nodes of the ROS 2 domain, for modules: the graph as a message of the core.
//!
//! ```
//! # use downbeat_bridge::middleware::in_process::Hub;
//! use downbeat_bridge::network::{self, NetworkWatch};
//! use downbeat_bridge::ros::{NodeName, Participant};
//! use downbeat_executor::{Core, Module, Setup, SetupError};
//! use downbeat_msgs::downbeat_interfaces::msg::NetworkGraph;
//!
//! struct Companion;
//!
//! impl Module for Companion {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         setup.subscribe::<NetworkGraph, _>(network::TOPIC, |_, graph, _| {
//!             let is_there = graph.nodes.iter().any(|node| node.name == "/operator");
//!             tracing::info!("the operator is {}", if is_there { "there" } else { "away" });
//!         })
//!     }
//! }
//!
//! let participant = Participant::on(std::sync::Arc::new(Hub::new().join()))?;
//! let mut core = Core::new();
//! core.add("companion", Companion)?;
//! let _watch = NetworkWatch::start(&mut core, &participant)?; // Until it is dropped.
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::ros::Participant;
use crate::worker::WorkerLink;
use downbeat_executor::{Core, Inlet, InletError, SetupError};
use downbeat_msgs::downbeat_interfaces::msg::NetworkGraph;
use std::sync::Arc;
use std::time::Duration;

/// The topic in the core, with a `downbeat_interfaces/msg/NetworkGraph` whenever the graph has changed.
pub const TOPIC: &str = "network";

/// The period in which the graph is compared.
const LOOK: Duration = Duration::from_millis(500);

/// Publishes the graph of the network in a core until it is dropped.
///
/// The graph enters the core as a message from outside does: all modules receive it in the same cycle, and a
/// bag that holds the topic repeats it.
pub struct NetworkWatch {
    /// `None` once it is dropped.
    watched: Option<Arc<Watched>>,
    worker: WorkerLink,
}

struct Watched {
    participant: Participant,
    inlet: Inlet<NetworkGraph>,
}

impl NetworkWatch {
    /// Publishes the graph on [`TOPIC`], at first and whenever it has changed.
    ///
    /// # Errors
    /// [`SetupError`] when the topic carries another type.
    pub fn start(core: &mut Core, participant: &Participant) -> Result<Self, SetupError> {
        let (inlet, participant) = (core.inlet::<NetworkGraph>(TOPIC)?, participant.clone());
        let worker = participant.worker();
        let watched = Arc::new(Watched { participant, inlet });
        let weak = Arc::downgrade(&watched);
        let sleeper = worker.clone();
        worker.spawn(async move {
            let mut last = None;
            while let Some(watched) = weak.upgrade() {
                let network = watched.participant.network();
                if last.as_ref() != Some(&network) {
                    match watched.inlet.publish(network.clone()) {
                        Ok(()) => {}
                        Err(InletError::Stopped) => return,
                        Err(error) => tracing::warn!(%error, "a change of the network is not published"),
                    }
                    last = Some(network);
                }
                drop(watched);
                sleeper.sleep(LOOK).await;
            }
        });
        Ok(Self { watched: Some(watched), worker })
    }
}

impl Drop for NetworkWatch {
    fn drop(&mut self) {
        self.watched = None;
        // The worker has none either after this, so that the participant may leave.
        self.worker.flush();
    }
}
