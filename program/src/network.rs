//! Which network a command joins, and its node there.

use anyhow::Context;
use clap::Args;
use downbeat_bridge::middleware::{Engine, MAX_DOMAIN_ID, ParticipantOptions};
use downbeat_bridge::ros::{Node, NodeName, Participant};
use downbeat_robot::{Catalog, RosArgs};

/// Arguments of every command that joins a network without a robot.
#[derive(Args, Clone)]
pub(crate) struct NetworkArguments {
    /// The ROS domain, instead of ROS_DOMAIN_ID.
    #[arg(long, value_name = "N")]
    pub(crate) domain: Option<u16>,
    /// Use this engine instead of that of RMW_IMPLEMENTATION: rtps (DDS), or zenoh or rustdds if built with
    /// that feature.
    #[arg(long, value_name = "ENGINE")]
    pub(crate) engine: Option<Engine>,
    /// Join over Zenoh, as a client of the router at this endpoint, such as tls/robot.local:7447.
    #[arg(long, value_name = "ENDPOINT")]
    pub(crate) connect: Option<String>,
}

impl NetworkArguments {
    /// Creates the node of a command.
    pub(crate) fn node(
        &self,
        name: &str,
        catalog: &Catalog,
        ros: &RosArgs,
    ) -> anyhow::Result<(Participant, Node)> {
        ros.warn_about_what_is_ignored();
        let name = NodeName::new(ros.namespace.as_deref().unwrap_or("/"), name)?;
        let options = ros.with_enclave(self.options()?);
        let participant = Participant::join_with(&options, ros.remap_rules(), catalog.interfaces.clone())?;
        let node = participant.create_node(name)?;
        Ok((participant, node))
    }

    fn options(&self) -> anyhow::Result<ParticipantOptions> {
        let mut options = participant_options(self.domain)?;
        options.engine = self.engine.unwrap_or(options.engine);
        if let Some(endpoint) = &self.connect {
            connect(&mut options, endpoint, self.engine)?;
        }
        Ok(options)
    }
}

/// Joins over Zenoh, by the router at this endpoint.
#[cfg(feature = "zenoh")]
fn connect(options: &mut ParticipantOptions, endpoint: &str, engine: Option<Engine>) -> anyhow::Result<()> {
    if let Some(engine) = engine.filter(|engine| *engine != Engine::Zenoh) {
        anyhow::bail!("--connect {endpoint} is for Zenoh, not for --engine {engine}");
    }
    options.engine = Engine::Zenoh;
    options.zenoh.connect = Some(endpoint.to_owned());
    Ok(())
}

#[cfg(not(feature = "zenoh"))]
fn connect(_: &mut ParticipantOptions, endpoint: &str, _: Option<Engine>) -> anyhow::Result<()> {
    anyhow::bail!(
        "--connect {endpoint} is for Zenoh, and this program is {}",
        downbeat_robot::features::built_without("zenoh")
    )
}

/// The options from the environment, with the domain of the command line if given.
pub(crate) fn participant_options(domain: Option<u16>) -> anyhow::Result<ParticipantOptions> {
    let mut options = ParticipantOptions::from_env()?;
    if let Some(domain) = domain {
        let is_valid = domain <= MAX_DOMAIN_ID;
        is_valid
            .then_some(())
            .with_context(|| format!("--domain {domain}: domains are 0 to {MAX_DOMAIN_ID}"))?;
        options.domain_id = domain;
    }
    Ok(options)
}
