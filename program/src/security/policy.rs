//! `downbeat security generate-policy`

use std::collections::BTreeMap;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;

use anyhow::{Context, ensure};
use downbeat_bridge::middleware::ParticipantOptions;
use downbeat_bridge::ros::{EndpointKind, Found};
use downbeat_robot::RobotFile;
use downbeat_security::keystore::Keystore;
use downbeat_security::policy::{NodeEndpoints, Policy};

use super::robot::networks;
use crate::logging::Log;

pub(super) fn generate(
    file: RobotFile,
    is_recorded: bool,
    enclave: Option<&str>,
    output: Option<&Path>,
    log: &Log,
) -> anyhow::Result<()> {
    let enclave =
        enclave.map_or_else(|| file.node_name().map(|name| name.to_string()), |name| Ok(name.into()))?;
    Keystore::check_name(&enclave)?;
    let mut policy = output.map(read_if_there).transpose()?.unwrap_or_default();
    let robot = file.path().display().to_string();
    let networks = networks(file, is_recorded, &ParticipantOptions::from_env()?, log)?;
    let nodes = networks.over_dds.iter().flat_map(|network| nodes(&network.found, &enclave));
    let mut is_empty = true;
    nodes.for_each(|node| {
        is_empty = false;
        policy.permit(&node);
    });
    ensure!(
        !is_empty,
        "{robot} exposes nothing over DDS, which is all that a policy permits: is its engine, or \
         RMW_IMPLEMENTATION, that of Zenoh?"
    );
    let Some(path) = output else {
        print!("{}", policy.to_xml());
        return Ok(());
    };
    fs::write(path, policy.to_xml()).with_context(|| format!("cannot write {}", path.display()))?;
    println!("{} permits enclave {enclave} what the robot exposes", path.display());
    Ok(())
}

/// An empty policy if there is no file.
fn read_if_there(path: &Path) -> anyhow::Result<Policy> {
    match fs::read_to_string(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(Policy::default()),
        _ => read(path),
    }
}

pub(super) fn read(path: &Path) -> anyhow::Result<Policy> {
    let text = fs::read_to_string(path).with_context(|| format!("cannot read policy {}", path.display()))?;
    Policy::parse(&text).with_context(|| path.display().to_string())
}

/// What each node has. The parts of an action are one name.
fn nodes(found: &Found, enclave: &str) -> Vec<NodeEndpoints> {
    let mut nodes: BTreeMap<&str, NodeEndpoints> = BTreeMap::new();
    for endpoint in &found.endpoints {
        let Some(full_name) = &endpoint.node else { continue };
        let (namespace, name) = full_name.rsplit_once('/').unwrap_or_default();
        let node = nodes.entry(full_name).or_insert_with(|| NodeEndpoints {
            enclave: enclave.to_owned(),
            namespace: if namespace.is_empty() { "/" } else { namespace }.to_owned(),
            node: name.to_owned(),
            ..NodeEndpoints::default()
        });
        let (name, is_part_of_action) = match endpoint.name.split_once("/_action/") {
            Some((action, _)) => (action, true),
            None => (&*endpoint.name, false),
        };
        let names = match (endpoint.kind, is_part_of_action) {
            (EndpointKind::Publisher, false) => &mut node.publishes,
            (EndpointKind::Subscription, false) => &mut node.subscribes,
            (EndpointKind::Server, false) => &mut node.replies,
            (EndpointKind::Client, false) => &mut node.requests,
            (EndpointKind::Publisher | EndpointKind::Server, true) => &mut node.executes,
            (EndpointKind::Subscription | EndpointKind::Client, true) => &mut node.calls,
        };
        names.push(name.to_owned());
    }
    nodes.into_values().collect()
}
