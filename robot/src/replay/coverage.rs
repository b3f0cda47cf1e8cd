//! The topics that a replay does not compare, with the reasons.

use std::fmt;

use downbeat_bags::Reader;
use downbeat_edge::Interfaces;

use super::plan::{Plan, Wiring};
use super::{ReplayOptions, TopicReport};
use crate::encoding::RecordedType;
use crate::journal;
use crate::recorder::{Unrecorded, UnrecordedTopic};

/// A topic of the bag, or of the replayed modules, that was not compared.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NotCompared {
    /// With the leading slash.
    pub topic: String,
    /// The reason.
    pub reason: NotComparedReason,
}

/// Why a topic was not compared.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NotComparedReason {
    /// No module of the robot publishes the topic: its messages came from outside.
    Input,
    /// The topic describes the recorded run itself.
    Journal,
    /// The process publishes the topic, not a module of the robot file.
    Process,
    /// All modules that publish the topic were not chosen.
    NotChosen {
        /// The modules that publish it.
        modules: Vec<String>,
    },
    /// All modules that publish the topic cannot be replayed.
    LeftOut {
        /// The modules that publish it.
        modules: Vec<String>,
    },
    /// Excluded by [`ReplayOptions::except`].
    Excluded,
    /// The messages have a plain Rust type, which cannot be recorded.
    PlainType {
        /// The type.
        rust_type: String,
    },
    /// A service that is called between modules, one of them detached, has plain Rust types, which cannot be
    /// recorded.
    PlainService {
        /// The types of request and response.
        rust_types: String,
    },
    /// The messages of the bag cannot be read.
    Unreadable {
        /// The reason.
        problem: String,
    },
    /// Replayed modules publish the topic, but the bag lacks it.
    NotInBag {
        /// The modules that publish it.
        modules: Vec<String>,
    },
    /// Replayed modules publish the topic, but there was no message, neither recorded nor replayed.
    NoMessages,
}

impl NotCompared {
    /// Returns whether the topic should have been compared, because replayed or chosen modules publish it. A
    /// [strict](super::ReplayReport::assert_same) comparison then fails.
    #[must_use]
    pub fn is_gap(&self) -> bool {
        use NotComparedReason as Why;
        matches!(self.reason, Why::LeftOut { .. } | Why::Unreadable { .. } | Why::NotInBag { .. })
    }
}

/// Returns the topics that cannot be compared, by name, and removes them from the outputs of the plan.
pub(super) fn not_compared(
    plan: &mut Plan,
    graph: &Wiring,
    reader: &Reader,
    options: &ReplayOptions,
    interfaces: &Interfaces,
) -> Vec<NotCompared> {
    let mut list = Vec::new();
    let recorded = reader.topics().iter().map(|topic| topic.info.name.trim_start_matches('/').to_owned());
    let published = graph.publishers.keys().filter(|topic| plan.publishes(graph, topic)).cloned();
    let names: std::collections::BTreeSet<String> = recorded.chain(published).collect();
    for name in names {
        if let Some(reason) = reason(&name, plan, graph, reader, options, interfaces) {
            plan.outputs.remove(&name);
            list.push(NotCompared { topic: format!("/{name}"), reason });
        }
    }
    let services = graph.unrecorded_services.iter();
    for service in services.filter(|service| service.modules.iter().any(|module| plan.replays(module))) {
        let reason = NotComparedReason::PlainService { rust_types: service.types.clone() };
        list.push(NotCompared { topic: format!("/{}", service.service), reason });
    }
    let noted = reader.metadata().map(Unrecorded::in_bag).unwrap_or_default();
    for UnrecordedTopic { topic, rust_type, .. } in noted {
        if list.iter().all(|known| known.topic != topic) {
            list.push(NotCompared { topic, reason: NotComparedReason::PlainType { rust_type } });
        }
    }
    list
}

fn reason(
    name: &str,
    plan: &Plan,
    graph: &Wiring,
    reader: &Reader,
    options: &ReplayOptions,
    interfaces: &Interfaces,
) -> Option<NotComparedReason> {
    use NotComparedReason as Why;
    if journal::TOPICS.contains(&name) {
        return Some(Why::Journal);
    }
    let publishers = graph.publishers.get(name).into_iter().flatten();
    let of_file: Vec<String> = publishers.filter(|name| graph.modules.contains(*name)).cloned().collect();
    if !plan.publishes(graph, name) {
        let is_left_out = |module: &String| plan.left_out.iter().any(|left| left.module == *module);
        return Some(match () {
            () if options.excludes(name) => Why::Excluded,
            () if of_file.iter().any(is_left_out) => {
                Why::LeftOut { modules: of_file.into_iter().filter(is_left_out).collect() }
            }
            () if !of_file.is_empty() => Why::NotChosen { modules: of_file },
            () if graph.types.contains_key(name) && graph.is_published_by_process(name) => Why::Process,
            () => Why::Input,
        });
    }
    if options.excludes(name) {
        return Some(Why::Excluded);
    }
    let plain = graph.types.get(name).filter(|known| interfaces.message_in(known).is_none());
    let Some(id) = reader.topic(&format!("/{name}")) else {
        return Some(match plain {
            Some(known) => Why::PlainType { rust_type: known.message_type.to_owned() },
            None => Why::NotInBag { modules: plan.publishers_of(graph, name) },
        });
    };
    let problem = match (plain, RecordedType::of(&reader.topics()[id.index()], interfaces)) {
        (_, Err(error)) => error.to_string(),
        (Some(known), Ok(_)) => format!(
            "the modules publish {} on it, which is not a registered message type",
            known.message_type
        ),
        (None, Ok(_)) => return None,
    };
    Some(Why::Unreadable { problem })
}

/// Moves topics without messages to the topics that were not compared.
pub(super) fn move_empty(topics: &mut Vec<TopicReport>, not_compared: &mut Vec<NotCompared>) {
    for empty in topics.extract_if(.., |topic| topic.compared == 0) {
        not_compared.push(NotCompared { topic: empty.topic, reason: NotComparedReason::NoMessages });
    }
    not_compared.sort_by(|one, other| one.topic.cmp(&other.topic));
}

impl fmt::Display for NotComparedReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Input => write!(f, "input, no module of the robot publishes it"),
            Self::Journal => write!(f, "the recording's own account of the run"),
            Self::Process => write!(f, "published by the process, not by a module"),
            Self::NotChosen { modules } => {
                write!(f, "published by {}, which {} not chosen", modules.join(", "), are(modules))
            }
            Self::LeftOut { modules } => {
                write!(f, "published by {}, which {} not replayed", modules.join(", "), are(modules))
            }
            Self::Excluded => write!(f, "excluded"),
            Self::PlainType { rust_type } => {
                write!(f, "messages of the plain Rust type {rust_type} are in no bag")
            }
            Self::PlainService { rust_types } => {
                write!(f, "calls of the plain Rust types {rust_types} are in no bag")
            }
            Self::Unreadable { problem } => write!(f, "{problem}"),
            Self::NotInBag { modules } => {
                write!(f, "published by {}, but the bag lacks the topic", modules.join(", "))
            }
            Self::NoMessages => write!(f, "no messages, neither recorded nor replayed"),
        }
    }
}

impl fmt::Display for NotCompared {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.topic, self.reason)
    }
}

fn are(modules: &[String]) -> &'static str {
    if modules.len() == 1 { "was" } else { "were" }
}
