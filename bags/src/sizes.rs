//! The sizes of topics and the counts of service calls, which require reading every message.

use std::collections::{BTreeMap, BTreeSet};

use downbeat_msgs::cdr;
use downbeat_msgs::service_msgs::msg::ServiceEventInfo;

use crate::reader::{Reader, ReaderError, Selection};
use crate::topic::{SERVICE_EVENT_TOPIC, is_service_event};

/// The bytes of messages by topic, and the requests and responses of services.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TopicSizes {
    bytes: BTreeMap<String, u64>,
    calls: BTreeMap<String, ServiceCalls>,
}

/// The calls of a service.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ServiceCalls {
    /// The number of distinct requests, recorded by client or server.
    pub requests: u64,
    /// The number of distinct responses.
    pub responses: u64,
}

/// The size of an event's first field in CDR: header, type, stamp, id of the client, sequence number.
const EVENT_INFO: usize = 4 + 32 + 8;

impl TopicSizes {
    /// Reads all messages of a bag, skipping unreadable parts. `progress` is called with the number of
    /// messages read.
    ///
    /// # Errors
    /// Returns an error if a file can no longer be opened.
    pub fn read(reader: &Reader, mut progress: impl FnMut(u64)) -> Result<Self, ReaderError> {
        // Counted by client and sequence number, as in rosbag2 (`rosbag2_cpp/info.cpp`).
        type Seen = BTreeSet<([u8; 16], i64)>;
        let mut seen: BTreeMap<String, (Seen, Seen)> = BTreeMap::new();
        let mut bytes = vec![0_u64; reader.topics().len()];
        for (number, message) in (1..).zip(reader.messages(Selection::all())?) {
            let Ok(message) = message else { continue };
            bytes[message.topic.index()] += message.data.len() as u64;
            let info = &reader.topics()[message.topic.index()].info;
            if is_service_event(&info.name, &info.type_name) {
                let service = info.name.strip_suffix(SERVICE_EVENT_TOPIC).unwrap_or(&info.name);
                let (requests, responses) = seen.entry(service.to_owned()).or_default();
                let start = message.data.get(..EVENT_INFO).unwrap_or(&message.data);
                if let Ok(event) = cdr::from_slice::<ServiceEventInfo>(start) {
                    let call = (event.client_gid, event.sequence_number);
                    match event.event_type {
                        ServiceEventInfo::REQUEST_SENT | ServiceEventInfo::REQUEST_RECEIVED => {
                            requests.insert(call);
                        }
                        ServiceEventInfo::RESPONSE_SENT | ServiceEventInfo::RESPONSE_RECEIVED => {
                            responses.insert(call);
                        }
                        _ => {}
                    }
                }
            }
            if number % 256 == 0 {
                progress(number);
            }
        }
        let names = reader.topics().iter().map(|topic| topic.info.name.clone());
        let calls = seen.into_iter().map(|(service, (requests, responses))| {
            (service, ServiceCalls { requests: requests.len() as u64, responses: responses.len() as u64 })
        });
        Ok(Self { bytes: names.zip(bytes).collect(), calls: calls.collect() })
    }

    /// The total size of a topic's messages in bytes.
    #[must_use]
    pub fn bytes_of(&self, topic: &str) -> u64 {
        self.bytes.get(topic).copied().unwrap_or(0)
    }

    /// The calls of a service.
    #[must_use]
    pub fn calls_of(&self, service: &str) -> ServiceCalls {
        self.calls.get(service).copied().unwrap_or_default()
    }
}
