//! The topics that a replay does not compare, with the reasons.

use downbeat_bags::Reader;
use downbeat_edge::Interfaces;

use super::ReplayOptions;
use super::plan::Plan;
use super::report::{NotCompared, NotComparedReason, TopicReport};
use super::wiring::Wiring;
use crate::encoding::RecordedType;
use crate::journal;
use crate::recorder::{Unrecorded, UnrecordedTopic};

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
