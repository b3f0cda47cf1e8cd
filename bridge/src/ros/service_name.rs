//! Names of services and their types, and as they stand on the wire.
//!
//! The wire form is that of `rmw_fastrtps_shared_cpp/namespace_prefix.hpp` and `names.hpp` (branch jazzy).

use super::{MessageType, NameError, NodeName, TopicName};
use crate::edge::Interfaces;
use crate::middleware::rpc::ServiceEndpoint;
use downbeat_msgs::qos::QosProfile;
use std::fmt;

/// The absolute name of a service, such as `/stand_up`.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ServiceName(pub(super) TopicName);

impl ServiceName {
    /// The service that a node means by `name`, by the rules of [`TopicName::expand`].
    ///
    /// # Errors
    /// [`NameError`] when ROS 2 does not accept the name.
    pub fn expand(name: &str, node: &NodeName) -> Result<Self, NameError> {
        TopicName::expand(name, node).map(Self)
    }

    /// The absolute name.
    #[must_use]
    pub fn as_str(&self) -> &str {
        self.0.as_str()
    }

    /// The service whose requests are sent on that topic of the wire, if they are those of a service of ROS
    /// 2.
    pub(super) fn of_requests(topic: &str) -> Option<Self> {
        TopicName::absolute(topic.strip_prefix("rq")?.strip_suffix("Request")?).map(Self)
    }

    /// The topic of its requests and the one of its replies, as they stand on the wire.
    pub(super) fn topics(&self) -> [String; 2] {
        [format!("rq{}Request", self.as_str()), format!("rr{}Reply", self.as_str())]
    }

    /// The endpoints announce the hashes of the messages that they carry, as those of `rmw_cyclonedds_cpp`
    /// do. Those of `rmw_fastrtps_cpp` announce that of the request on both topics.
    pub(super) fn endpoint(
        &self,
        node: &NodeName,
        interfaces: &Interfaces,
        service_type: &ServiceType,
        qos: QosProfile,
    ) -> ServiceEndpoint {
        let [request_topic, reply_topic] = self.topics();
        let type_hashes =
            ["Request", "Response"].map(|part| interfaces.message_hash(&format!("{service_type}_{part}")));
        let known = interfaces.service(service_type.as_str()).ok();
        let type_hash = known.map(|known| known.hash().to_owned()).filter(|hash| !hash.is_empty());
        ServiceEndpoint {
            name: self.as_str().to_owned(),
            type_name: service_type.0.to_wire(),
            type_hash,
            node: Some(node.identity()),
            request_topic,
            request_type: format!("{}Request_", service_type.0.to_wire()),
            reply_topic,
            reply_type: format!("{}Response_", service_type.0.to_wire()),
            qos,
            type_hashes,
        }
    }
}

impl fmt::Display for ServiceName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// The name of a service type, such as `std_srvs/srv/SetBool`.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ServiceType(MessageType);

impl ServiceType {
    /// A type as ROS 2 writes it: package, kind (`srv`, or `action` for the services of an action) and name.
    ///
    /// # Errors
    /// [`NameError`] when the three parts are not there.
    pub fn new(name: &str) -> Result<Self, NameError> {
        MessageType::new(name).map(Self)
    }

    /// The name as ROS 2 writes it.
    #[must_use]
    pub fn as_str(&self) -> &str {
        self.0.as_str()
    }
}

impl fmt::Display for ServiceType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_service_stands_on_the_wire_as_in_rmw() {
        let node = NodeName::new("/robot", "downbeat").unwrap();
        let service = ServiceName::expand("~/stand_up", &node).unwrap();
        let endpoint = service.endpoint(
            &node,
            &Interfaces::carried(),
            &ServiceType::new("std_srvs/srv/SetBool").unwrap(),
            QosProfile::SERVICES,
        );
        assert_eq!(endpoint.request_topic, "rq/robot/downbeat/stand_upRequest");
        assert_eq!(endpoint.reply_topic, "rr/robot/downbeat/stand_upReply");
        assert_eq!(endpoint.request_type, "std_srvs::srv::dds_::SetBool_Request_");
        assert_eq!(endpoint.reply_type, "std_srvs::srv::dds_::SetBool_Response_");
    }
}
