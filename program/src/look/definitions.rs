//! Lookup of the types of topics, services and actions.

use std::path::PathBuf;
use std::time::Duration;

use crate::interface::{Interfaces, SourceArguments};
use anyhow::Context;
use downbeat_bridge::ros::{EndpointKind, Found, MessageType, ServiceType};
use downbeat_msgs::carried;
use downbeat_msgs::definitions::{Catalog, TypeName};
use downbeat_msgs::dynamic::DynamicType;

use super::Look;

/// How long a node may take to describe a type.
const PATIENCE: Duration = Duration::from_secs(5);

/// Definitions from `--from`, AMENT_PREFIX_PATH, this program, and nodes on the network, in this order.
pub(super) struct Types {
    interfaces: Interfaces,
}

impl Types {
    pub(super) fn load(look: &Look, from: &[PathBuf]) -> anyhow::Result<Self> {
        let source = SourceArguments { from: from.to_vec() };
        Ok(Self { interfaces: Interfaces::load(&source, &look.interfaces)? })
    }

    /// The type of the messages on a topic. Uses a local definition with the hash that the topic announces,
    /// if any; otherwise requests a description from a node with the topic.
    pub(super) fn message(&self, look: &Look, topic: &str, type_name: &str) -> anyhow::Result<DynamicType> {
        let name: TypeName = type_name.parse()?;
        let topic = look.node.topic_name(topic)?;
        let announced = announced_hash(&look.participant.found(), topic.as_str(), type_name);
        if let Some(known) = self.at_hand(&name, announced.as_deref()) {
            return Ok(known);
        }
        let is_known = |found: &Found| {
            let mut endpoints = found.endpoints.iter();
            endpoints.any(|endpoint| {
                endpoint.name == topic.as_str()
                    && endpoint.node.is_some()
                    && endpoint.remote.type_hash.is_some()
            })
        };
        look.found_with(is_known);
        let described = look.node.describe(&topic, &MessageType::new(type_name)?, PATIENCE);
        Ok(described.with_context(|| self.not_at_hand(&name))?.message_type)
    }

    /// Request and response of a service. Uses local definitions unless a known server announces another
    /// hash; then its node is asked for a description.
    pub(super) fn service(
        &self,
        look: &Look,
        service: &str,
        type_name: &ServiceType,
    ) -> anyhow::Result<[DynamicType; 2]> {
        let part = |suffix: &str| format!("{type_name}{suffix}").parse::<TypeName>();
        let names = [part("_Request")?, part("_Response")?];
        let service = look.node.service_name(service)?;
        let announced = announced_hash(&look.participant.found(), service.as_str(), type_name.as_str());
        let known = [self.at_hand(&names[0], announced.as_deref()), self.at_hand(&names[1], None)];
        if let [Some(request), Some(response)] = known {
            return Ok([request, response]);
        }
        let is_known = |found: &Found| {
            let mut endpoints = found.endpoints.iter();
            endpoints.any(|endpoint| endpoint.name == service.as_str() && endpoint.node.is_some())
        };
        look.found_with(is_known);
        let described = look.node.describe_service(&service, type_name, PATIENCE);
        let described = described.with_context(|| self.not_at_hand(&names[0]))?;
        Ok(described.map(|described| described.message_type))
    }

    /// A local type, with the given hash if any.
    fn at_hand(&self, name: &TypeName, hash: Option<&str>) -> Option<DynamicType> {
        let has_hash = |catalog: &Catalog| {
            hash.is_none_or(|hash| catalog.type_hash(name).is_ok_and(|known| known == hash))
        };
        let mut catalogs = [&self.interfaces.catalog, carried()].into_iter();
        let catalog = catalogs.find(|catalog| catalog.message(name).is_ok() && has_hash(catalog))?;
        DynamicType::new(catalog, name).ok()
    }

    fn not_at_hand(&self, name: &TypeName) -> String {
        match self.interfaces.find(name) {
            Ok(_) => format!("{name} is known here with a different hash than the announced one"),
            Err(error) => error.to_string(),
        }
    }
}

/// The hash that an endpoint of the topic announces for that type, or a server of the service for its
/// requests.
fn announced_hash(found: &Found, name: &str, type_name: &str) -> Option<String> {
    let mut endpoints = found.endpoints.iter();
    endpoints
        .find(|endpoint| {
            endpoint.name == name
                && endpoint.type_name == type_name
                && endpoint.kind != EndpointKind::Client
                && endpoint.remote.type_hash.is_some()
        })
        .and_then(|endpoint| endpoint.remote.type_hash.clone())
}

/// Adds the middle part of a type name, which may be omitted: `std_msgs/String` is `std_msgs/msg/String`.
pub(super) fn full_name(text: &str, kind: &str) -> String {
    match text.split_once('/') {
        Some((package, name)) if !name.contains('/') => format!("{package}/{kind}/{name}"),
        _ => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_of_a_name_can_be_omitted() {
        assert_eq!(full_name("std_msgs/String", "msg"), "std_msgs/msg/String");
        assert_eq!(full_name("std_msgs/msg/String", "msg"), "std_msgs/msg/String");
        assert_eq!(full_name("String", "msg"), "String");
    }
}
