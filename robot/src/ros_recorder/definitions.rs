//! Definitions of types that are not compiled in.

use std::sync::Arc;
use std::time::{Duration, Instant};

use downbeat_bridge::ros::{Client, Node, Participant};
use downbeat_edge::Interfaces;
use downbeat_msgs::definitions::{Catalog, TypeDescription, TypeName};
use downbeat_msgs::dynamic::{AmentPrefixPath, Definitions};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::type_description_interfaces::srv::{
    GetTypeDescription, GetTypeDescriptionRequest, GetTypeDescriptionResponse,
};
use parking_lot::Mutex;

/// How long it may take to find the node of a publisher and receive the description.
const PATIENCE: Duration = Duration::from_secs(10);
const CALL_TIMEOUT: Duration = Duration::from_secs(5);

/// A type as a bag describes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Definition {
    /// With all that it refers to; see [`downbeat_bags::TopicDescription::definition`].
    pub(crate) text: String,
    /// RIHS01.
    pub(crate) hash: String,
}

/// The definition that is at hand: of a type with the announced hash where there is one, from
/// `AMENT_PREFIX_PATH`, or from what is registered in this program.
///
/// # Errors
/// In words: where it was looked up, and what was found there.
pub(crate) fn at_hand(
    interfaces: &Interfaces,
    type_name: &str,
    announced: Option<&str>,
) -> Result<Definition, String> {
    let places = [
        Definitions::new()
            .with(AmentPrefixPath::from_environment())
            .with(interfaces.registered_definitions())
            .with_carried(),
        Definitions::new().with(interfaces.registered_definitions()).with_carried(),
    ];
    let mut problems = Vec::new();
    for place in places {
        match place.find_text(type_name) {
            Ok((text, hash)) if announced.is_none_or(|announced| announced == hash) => {
                return Ok(Definition { text, hash });
            }
            Ok((_, hash)) => problems.push(format!("{place:?} has another one, with hash {hash}")),
            Err(error) => problems.push(error.to_string()),
        }
    }
    problems.dedup();
    Err(problems.join("; "))
}

/// Asks the node of a publisher for the definition of its type.
pub(super) struct Inquiry {
    type_name: String,
    hash: String,
    deadline: Instant,
    client: Option<Client<GetTypeDescription>>,
    is_asked: bool,
    answer: Arc<Mutex<Option<Result<GetTypeDescriptionResponse, String>>>>,
}

impl Inquiry {
    /// About the type with that hash; without a hash nodes do not answer.
    pub(super) fn new(type_name: &str, hash: &str, now: Instant) -> Self {
        Self {
            type_name: type_name.to_owned(),
            hash: hash.to_owned(),
            deadline: now + PATIENCE,
            client: None,
            is_asked: false,
            answer: Arc::default(),
        }
    }

    /// Goes a step on, without waiting. Returns what came of it when there is something: a definition, or why
    /// there is none.
    pub(super) fn poll(
        &mut self,
        participant: &Participant,
        node: &Node,
        topic: &str,
        now: Instant,
    ) -> Option<Result<Definition, String>> {
        let answer = self.answer.lock().take();
        if let Some(answer) = answer {
            return Some(answer.and_then(|answer| self.read(&answer)));
        }
        if now >= self.deadline {
            let of_whom = match &self.client {
                Some(client) => format!("{} does not answer", client.name()),
                None => "no node is known that publishes it".to_owned(),
            };
            return Some(Err(of_whom));
        }
        if self.client.is_none() {
            self.client = self.find(participant, node, topic);
        }
        if let Some(client) = self.client.as_ref().filter(|client| !self.is_asked && client.is_available()) {
            let request = GetTypeDescriptionRequest {
                type_name: self.type_name.clone(),
                type_hash: self.hash.clone(),
                include_type_sources: true,
            };
            let answer = Arc::clone(&self.answer);
            client.call(&request, CALL_TIMEOUT, move |result| {
                let result = result.map_err(|error| error.to_string());
                *answer.lock() = Some(result);
            });
            self.is_asked = true;
        }
        None
    }

    fn find(
        &self,
        participant: &Participant,
        node: &Node,
        topic: &str,
    ) -> Option<Client<GetTypeDescription>> {
        let publishes = |endpoint: &downbeat_bridge::ros::RemoteTopic| {
            endpoint.is_published
                && endpoint.topic.as_str() == topic
                && endpoint.message_type.as_str() == self.type_name
        };
        let nodes = participant.remote_nodes();
        let publisher = nodes.iter().find(|remote| remote.endpoints.iter().any(publishes))?;
        let service = format!("{}/get_type_description", publisher.name);
        node.client::<GetTypeDescription>(&service, QosProfile::SERVICES).ok()
    }

    /// Nothing is believed that has not the announced hash.
    fn read(&self, answer: &GetTypeDescriptionResponse) -> Result<Definition, String> {
        if !answer.successful {
            return Err(format!("its node says: {}", answer.failure_reason));
        }
        let name = self.type_name.parse::<TypeName>().map_err(|error| format!("{error}"))?;
        if let Some(text) = self.text_in_sources(&name, answer) {
            return Ok(Definition { text, hash: self.hash.clone() });
        }
        let described = TypeDescription::from(&answer.type_description);
        let mut catalog = Catalog::new();
        catalog.add_type_description(&described, "its node").map_err(|error| error.to_string())?;
        let hash = catalog.type_description(&name).map_err(|error| error.to_string())?.hash();
        if hash != self.hash {
            return Err(format!(
                "its node describes a type with hash {hash}, its publisher announces {}",
                self.hash
            ));
        }
        let text = catalog.definition_text(&name).map_err(|error| error.to_string())?;
        Ok(Definition { text, hash })
    }

    /// The texts that the authors wrote, comments and all, if they define that type.
    fn text_in_sources(&self, name: &TypeName, answer: &GetTypeDescriptionResponse) -> Option<String> {
        let mut catalog = Catalog::new();
        for source in answer.type_sources.iter().filter(|source| source.encoding != "implicit") {
            let of = source.type_name.parse::<TypeName>().ok()?;
            let text = &source.raw_file_contents;
            match source.encoding.as_str() {
                "msg" => catalog.add_message(of, text, "its node").ok()?,
                "srv" => catalog.add_service(of, text, "its node").ok()?,
                "action" => catalog.add_action(of, text, "its node").ok()?,
                _ => return None,
            }
        }
        let has_same_hash =
            catalog.type_description(name).is_ok_and(|described| described.hash() == self.hash);
        has_same_hash.then(|| catalog.definition_text(name).ok()).flatten()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_bridge::middleware::in_process::Hub;
    use downbeat_bridge::ros::{MessageType, NodeName};
    use downbeat_msgs::Message;
    use downbeat_msgs::sensor_msgs::msg::Imu;

    /// Asks a node that publishes `/imu` of the type Imu about that type.
    fn ask(type_name: &str, hash: &str, patience: Duration) -> Result<Definition, String> {
        let hub = Hub::new();
        let join = || Participant::on(Arc::new(hub.join())).unwrap();
        let (robot, recorder) = (join(), join());
        let publishing = robot.create_node(NodeName::new("/lab", "robot").unwrap()).unwrap();
        let imu = MessageType::new(Imu::TYPE_NAME).unwrap();
        let publisher = publishing.publish("/imu", &imu, QosProfile::DEFAULT).unwrap();
        let node = recorder.create_node(NodeName::new("/", "recorder").unwrap()).unwrap();
        let mut inquiry = Inquiry::new(type_name, hash, Instant::now());
        inquiry.deadline = Instant::now() + patience;
        let found = loop {
            if let Some(found) = inquiry.poll(&recorder, &node, "/imu", Instant::now()) {
                break found;
            }
            std::thread::yield_now();
        };
        drop(publisher);
        found
    }

    #[test]
    fn the_node_of_a_publisher_describes_its_type() {
        let found = ask(Imu::TYPE_NAME, Imu::TYPE_HASH, PATIENCE).unwrap();
        assert_eq!(found.hash, Imu::TYPE_HASH);
        // The files that a node of ours sends may have an additional empty line.
        let lines = |text: &str| -> Vec<String> {
            text.lines().filter(|line| !line.is_empty()).map(str::to_owned).collect()
        };
        assert_eq!(lines(&found.text), lines(Imu::DEFINITION));
    }

    #[test]
    fn why_there_is_no_definition_is_told() {
        let unknown = format!("RIHS01_{}", "0".repeat(64));
        let error = ask(Imu::TYPE_NAME, &unknown, PATIENCE).unwrap_err();
        assert!(error.contains("Type not currently in use by this node"), "{error}");
        let error = ask("sensor_msgs/msg/Joy", &unknown, Duration::ZERO).unwrap_err();
        assert!(error.contains("no node is known that publishes it"), "{error}");
    }

    #[test]
    fn a_definition_at_hand_counts_only_if_it_has_the_announced_hash() {
        assert_eq!(
            at_hand(&Interfaces::carried(), Imu::TYPE_NAME, Some(Imu::TYPE_HASH)).unwrap().text,
            Imu::DEFINITION
        );
        assert!(at_hand(&Interfaces::carried(), Imu::TYPE_NAME, None).is_ok());
        let error = at_hand(&Interfaces::carried(), Imu::TYPE_NAME, Some("RIHS01_other")).unwrap_err();
        assert!(error.contains(Imu::TYPE_HASH), "{error}");
        assert!(at_hand(&Interfaces::carried(), "lawn_msgs/msg/Blade", None).is_err());
        let event = at_hand(&Interfaces::carried(), "std_srvs/srv/SetBool_Event", None).unwrap();
        assert!(event.text.contains("MSG: std_srvs/srv/SetBool_Request"), "{}", event.text);
    }
}
