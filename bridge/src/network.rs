//! What else is in the ROS 2 domain, for modules: the graph as a message of the core.
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
use crossbeam::channel::{RecvTimeoutError, Sender, bounded};
use downbeat_executor::{Core, Inlet, InletError, SetupError};
use downbeat_msgs::downbeat_interfaces::msg::NetworkGraph;
use std::thread::JoinHandle;
use std::time::Duration;
use thiserror::Error;

/// The topic in the core, with a `downbeat_interfaces/msg/NetworkGraph` whenever the graph has changed.
pub const TOPIC: &str = "network";

/// How often the graph is looked at.
const LOOK: Duration = Duration::from_millis(500);

/// The graph cannot be watched.
#[derive(Debug, Error)]
pub enum NetworkError {
    /// The core refuses the topic.
    #[error("watching the network: {0}")]
    Setup(#[from] SetupError),
    /// The thread could not be started.
    #[error("starting the thread that watches the network: {0}")]
    Thread(#[from] std::io::Error),
}

/// Has modules told of the network until it is dropped.
///
/// The graph enters the core as a message from outside does: all modules receive it in the same cycle, and a bag that holds
/// the topic tells it again.
pub struct NetworkWatch {
    stop: Sender<()>,
    thread: Option<JoinHandle<()>>,
}

impl NetworkWatch {
    /// Publishes the graph on [`TOPIC`], at first and whenever it has changed.
    ///
    /// # Errors
    /// [`NetworkError`] when the topic carries another type, or no thread can be had.
    pub fn start(core: &mut Core, participant: &Participant) -> Result<Self, NetworkError> {
        let (inlet, participant) = (core.inlet::<NetworkGraph>(TOPIC)?, participant.clone());
        let (stop, stopped) = bounded(1);
        let thread = std::thread::Builder::new().name("downbeat-network".into()).spawn(move || {
            let mut told = None;
            loop {
                let network = participant.network();
                if told.as_ref() != Some(&network) {
                    if tell(&inlet, &network).is_break() {
                        return;
                    }
                    told = Some(network);
                }
                if stopped.recv_timeout(LOOK) != Err(RecvTimeoutError::Timeout) {
                    return;
                }
            }
        })?;
        Ok(Self { stop, thread: Some(thread) })
    }
}

fn tell(inlet: &Inlet<NetworkGraph>, network: &NetworkGraph) -> std::ops::ControlFlow<()> {
    match inlet.publish(network.clone()) {
        Ok(()) => std::ops::ControlFlow::Continue(()),
        Err(InletError::Stopped) => std::ops::ControlFlow::Break(()),
        Err(error) => {
            tracing::warn!(%error, "modules are not told of a change of the network");
            std::ops::ControlFlow::Continue(())
        }
    }
}

impl Drop for NetworkWatch {
    fn drop(&mut self) {
        // Fails only when the thread has ended.
        let _ = self.stop.try_send(());
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread that watches the network panicked");
        }
    }
}
