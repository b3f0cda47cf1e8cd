//! `~/get_type_description`, which every node offers: what a type looks like, for those that meet it for the
//! first time.
//!
//! As `rcl_node_type_description_service_handle_request` (`rcl/src/rcl/node.c`, branch jazzy) answers, but
//! for all types that are registered, not only those the node uses now.

use crate::edge::{Described, Interfaces};
use downbeat_msgs::definitions::{Kind, TypeName};
use downbeat_msgs::type_description_interfaces::msg::TypeSource;
use downbeat_msgs::type_description_interfaces::srv::{
    GetTypeDescriptionRequest, GetTypeDescriptionResponse,
};
use std::collections::HashMap;

/// The name of the service.
pub(super) const SERVICE: &str = "~/get_type_description";

/// The answer to a request.
pub(super) fn answer(
    interfaces: &Interfaces,
    request: &GetTypeDescriptionRequest,
) -> GetTypeDescriptionResponse {
    let refuse = |reason: &str| GetTypeDescriptionResponse {
        failure_reason: reason.to_owned(),
        ..GetTypeDescriptionResponse::default()
    };
    if !is_hash(&request.type_hash) {
        return refuse("Failed to parse type hash");
    }
    let Some(known) = interfaces.described(&request.type_hash) else {
        return refuse("Type not currently in use by this node");
    };
    let type_sources = if request.include_type_sources { sources(&known) } else { Vec::new() };
    GetTypeDescriptionResponse {
        successful: true,
        type_description: known.message,
        type_sources,
        ..GetTypeDescriptionResponse::default()
    }
}

fn is_hash(text: &str) -> bool {
    text.strip_prefix("RIHS01_")
        .is_some_and(|digits| digits.len() == 64 && digits.bytes().all(|digit| digit.is_ascii_hexdigit()))
}

/// The files that define the type and all that it refers to, as they are: the type itself first, the others
/// in the order of their names. A type without its own file, such as the request of a service, has no text:
/// rosidl calls that implicit.
fn sources(known: &Described) -> Vec<TypeSource> {
    let texts = texts(known);
    let names =
        known.message.referenced_type_descriptions.iter().map(|referenced| referenced.type_name.as_str());
    std::iter::once(known.type_name.as_str())
        .chain(names)
        .map(|name| {
            // The text of a service leaves out what its events refer to.
            let found = texts.get(name).copied().or_else(|| Some(("msg", carried_file(name)?)));
            let (encoding, text) = found.unwrap_or(("implicit", ""));
            TypeSource {
                type_name: name.to_owned(),
                encoding: encoding.to_owned(),
                raw_file_contents: text.to_owned(),
            }
        })
        .collect()
}

/// The file of a carried message.
fn carried_file(name: &str) -> Option<&'static str> {
    let name: TypeName = name.parse().ok().filter(|name: &TypeName| name.kind == Kind::Message)?;
    downbeat_msgs::carried().message(&name).ok().map(|message| message.text.as_str())
}

/// The parts of a definition text: encoding and text by name of the type.
fn texts(known: &Described) -> HashMap<String, (&'static str, &str)> {
    let rule = "=".repeat(80) + "\n";
    let mut texts = HashMap::new();
    let mut parts = known.definition.split(rule.as_str()).peekable();
    while let Some(part) = parts.next() {
        // The line break before a rule belongs to the rule.
        let part = part.strip_suffix('\n').filter(|_| parts.peek().is_some()).unwrap_or(part);
        let headed = part.split_once('\n').and_then(|(header, text)| {
            let (kind, name) = header.split_once(": ")?;
            let encoding = match kind {
                "MSG" => "msg",
                "SRV" => "srv",
                "ACTION" => "action",
                _ => return None,
            };
            // A message is named without its kind: `std_msgs/Header`.
            let (package, short) = name.split_once('/')?;
            let short = short.rsplit('/').next()?;
            Some((format!("{package}/{encoding}/{short}"), (encoding, text)))
        });
        match headed {
            Some((name, text)) => drop(texts.insert(name, text)),
            // The text of a message comes first, without a header.
            None if !part.is_empty() && known.type_name.contains("/msg/") => {
                texts.insert(known.type_name.to_owned(), ("msg", part));
            }
            None => {}
        }
    }
    texts
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use downbeat_msgs::Message;
    use downbeat_msgs::Service;
    use downbeat_msgs::sensor_msgs::msg::Imu;
    use downbeat_msgs::std_srvs::srv::{SetBool, SetBoolRequest};

    fn asked(type_hash: &str) -> GetTypeDescriptionResponse {
        let type_hash = type_hash.to_owned();
        let request = GetTypeDescriptionRequest { type_hash, ..GetTypeDescriptionRequest::default() };
        answer(&Interfaces::carried(), &request)
    }

    #[test]
    fn a_message_is_described_with_the_sources_of_all_it_refers_to() {
        let response = asked(Imu::TYPE_HASH);
        assert!(response.successful);
        assert_eq!(response.type_description, Imu::type_description());
        let sources: Vec<_> =
            response.type_sources.iter().map(|source| (&*source.type_name, &*source.encoding)).collect();
        assert_eq!(
            sources,
            [
                ("sensor_msgs/msg/Imu", "msg"),
                ("builtin_interfaces/msg/Time", "msg"),
                ("geometry_msgs/msg/Quaternion", "msg"),
                ("geometry_msgs/msg/Vector3", "msg"),
                ("std_msgs/msg/Header", "msg"),
            ]
        );
        for source in &response.type_sources {
            let file = carried_file(&source.type_name).unwrap();
            assert_eq!(source.raw_file_contents, file, "{}", source.type_name);
            assert!(file.contains("# "), "{}", source.type_name);
        }
        assert!(response.type_sources[0].raw_file_contents.contains("angular_velocity"));
    }

    #[test]
    fn a_service_has_a_source_and_its_request_is_implicit() {
        let service = asked(SetBool::TYPE_HASH);
        let encoding = |name: &str| {
            let source = service.type_sources.iter().find(|source| source.type_name == name);
            source.map(|source| source.encoding.clone())
        };
        assert_eq!(encoding("std_srvs/srv/SetBool").as_deref(), Some("srv"));
        assert_eq!(encoding("std_srvs/srv/SetBool_Request").as_deref(), Some("implicit"));
        assert_eq!(encoding("service_msgs/msg/ServiceEventInfo").as_deref(), Some("msg"));
        assert!(
            service.type_sources[0].raw_file_contents.starts_with("bool data # e.g. for hardware enabling")
        );
        assert_eq!(asked(SetBoolRequest::TYPE_HASH).type_sources[0].encoding, "implicit");
    }

    #[test]
    fn what_is_not_known_is_refused_as_rcl_refuses_it() {
        let unknown = asked(&format!("RIHS01_{}", "0".repeat(64)));
        assert_eq!(
            (unknown.successful, &*unknown.failure_reason),
            (false, "Type not currently in use by this node")
        );
        assert_eq!(asked("RIHS01_0").failure_reason, "Failed to parse type hash");
    }
}
