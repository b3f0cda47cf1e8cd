//! What a robot would have in its networks, found without joining any.

use std::sync::Arc;
use std::time::{Duration, Instant};

use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::middleware::{Middleware, ParticipantOptions, RemoteEndpoint};
use downbeat_bridge::ros::{Found, Participant, Service};

use super::expose_service::placeholder;
use super::node::{NodeLog, RobotNode};
use super::{PreparedRobot, StartError};

/// How long the nodes of a robot may take to announce themselves in memory.
const PATIENCE: Duration = Duration::from_secs(10);

/// The networks of a robot that was exposed in memory.
pub struct Rehearsal {
    networks: Vec<(Option<String>, ParticipantOptions, Hub)>,
    _expose_service: Option<Service>,
}

/// A network, and what the robot has in it.
pub struct RehearsedNetwork {
    /// Its name in the robot file; `None` for that of `[expose]`.
    pub name: Option<String>,
    /// How the robot would join it.
    pub options: ParticipantOptions,
    /// Its nodes with their topics and services.
    pub found: Found,
    /// All endpoints, with their names on the wire of DDS.
    pub endpoints: Vec<RemoteEndpoint>,
}

impl PreparedRobot {
    /// Creates the node with all that the robot file exposes, as [`expose`](Self::expose) does, but in
    /// memory: no network hears of it.
    ///
    /// # Errors
    /// If something cannot be exposed as the file says.
    pub fn rehearse(
        &mut self,
        options: &ParticipantOptions,
        log: Option<&NodeLog>,
    ) -> Result<Rehearsal, StartError> {
        let mut hubs = Vec::new();
        let mut join = |options: &ParticipantOptions| {
            let hub = Hub::new();
            let participant: Arc<dyn Middleware> = Arc::new(hub.join());
            hubs.push((options.clone(), hub));
            Ok(participant)
        };
        let diagnostics = self.diagnostics.as_ref();
        let node = RobotNode::on(&mut self.robot, &self.clock, diagnostics, options, log, &mut join)?;
        let offers_expose = self.file().expose.features.expose_service;
        let expose_service = offers_expose.then(|| placeholder(node.node())).transpose()?;
        self.node = Some(node);
        let further = self.file().networks.iter().map(|network| Some(network.name.clone()));
        let names = std::iter::once(None).chain(further);
        let networks = names.zip(hubs).map(|(name, (options, hub))| (name, options, hub)).collect();
        Ok(Rehearsal { networks, _expose_service: expose_service })
    }
}

impl Rehearsal {
    /// The robot's networks, that of `[expose]` first, and what it has there by now.
    ///
    /// # Errors
    /// If a thread cannot be started.
    pub fn networks(&self) -> Result<Vec<RehearsedNetwork>, StartError> {
        let look = |(name, options, hub): &(Option<String>, ParticipantOptions, Hub)| {
            let observer = hub.join();
            let endpoints = observer.remote_endpoints();
            let participant = Participant::on(Arc::new(observer))?;
            let deadline = Instant::now() + PATIENCE;
            while !participant.has_heard_all() && Instant::now() < deadline {
                std::thread::sleep(Duration::from_millis(1));
            }
            let (name, options) = (name.clone(), options.clone());
            Ok(RehearsedNetwork { name, options, found: participant.found(), endpoints })
        };
        self.networks.iter().map(look).collect()
    }
}
