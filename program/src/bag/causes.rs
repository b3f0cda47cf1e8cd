//! What `bag why` and `bag latency` read from a bag.

use anyhow::{Context, anyhow};
use downbeat_bags::{BagMessage, Reader, Selection, TopicId};
use downbeat_files::nearest;
use downbeat_msgs::cdr;
use downbeat_msgs::downbeat_interfaces::msg::NetworkGraph;
use downbeat_msgs::dynamic::DynamicView;
use downbeat_msgs::printable;
use downbeat_robot::Catalog;
use downbeat_robot::causes::{Guess, Recorded, Stamped};
use downbeat_robot::playback::recorded_runs;
use downbeat_robot::table::Decoder;

use super::select::{absolute, each_message};

/// The topic of this name; the leading slash may be omitted.
pub(super) fn topic(bag: &Reader, name: &str) -> anyhow::Result<TopicId> {
    let name = absolute(name);
    bag.topic(&name).ok_or_else(|| {
        let topics = bag.topics().iter().map(|topic| topic.info.name.as_str());
        match nearest(&name, topics.clone()) {
            Some(topic) => anyhow!("the bag has no topic {name}, did you mean {}?", printable(topic)),
            None => {
                let known: Vec<_> = topics.map(printable).map(|name| name.to_string()).collect();
                anyhow!("the bag has no topic {name}; it has {}", known.join(", "))
            }
        }
    })
}

/// The recorded runs; `None` with a warning that says why the bag has none.
pub(super) fn runs(bag: &Reader, catalog: &Catalog) -> anyhow::Result<Option<Recorded>> {
    let recorded = recorded_runs(bag, &catalog.interfaces)?;
    if !recorded.is_empty() {
        return Ok(Some(recorded));
    }
    if bag.topic("/cycle_times").is_some() {
        tracing::warn!(
            "{} has no runs (topic module_runs): an earlier version recorded it, or [record] leaves the topic out. \
             Causes are guessed from stamps; a bag recorded with topics = \"all\" has them exactly",
            bag.path().display()
        );
    } else {
        tracing::warn!(
            "{} knows of no cycles: it was not recorded inside a robot. Causes are guessed from the stamps of messages",
            bag.path().display()
        );
    }
    Ok(None)
}

/// The messages of a bag by time and stamp, and its graph of nodes if it has one.
pub(super) fn guess(bag: &Reader, catalog: &Catalog) -> anyhow::Result<Guess> {
    let mut guess = Guess::default();
    let decoders: Vec<_> = (bag.topics().iter())
        .map(|topic| {
            let decoder = Decoder::of(topic, &catalog.interfaces).ok()?;
            let has_header =
                decoder.message_type().fields().next().is_some_and(|field| field.name == "header");
            has_header.then_some(decoder)
        })
        .collect();
    let all: Vec<_> = bag.topics().iter().filter_map(|topic| bag.topic(&topic.info.name)).collect();
    each_message(bag, all, "reading", |BagMessage { topic, log_time, data, .. }| {
        let recorded = &bag.topics()[topic.index()];
        let stamp_ns = decoders[topic.index()].as_ref().and_then(|decoder| {
            let cdr = decoder.to_cdr(data.clone()).ok()?;
            let view = DynamicView::new(decoder.message_type(), &cdr).ok()?;
            let get = |path: &str| view.get(path).ok()?.as_i64();
            get("header.stamp.sec")?.checked_mul(1_000_000_000)?.checked_add(get("header.stamp.nanosec")?)
        });
        if recorded.info.type_name == "downbeat_interfaces/msg/NetworkGraph"
            && recorded.info.is_cdr()
            && let Ok(graph) = cdr::from_slice::<NetworkGraph>(&data)
        {
            guess.push_graph(&graph);
        }
        guess.push(Stamped { topic: &recorded.info.name, time_ns: log_time, stamp_ns });
        Ok(())
    })?;
    Ok(guess)
}

/// The times of a topic's messages, in the order of the bag.
pub(super) fn times(bag: &Reader, topic: TopicId) -> anyhow::Result<Vec<i64>> {
    let messages = bag.messages(Selection::all().topics([topic]))?;
    // What cannot be read is reported by commands that read all of it; here it has no number.
    Ok(messages.filter_map(|message| Some(message.ok()?.log_time)).collect())
}

/// A time of a message as an offset into the bag.
pub(super) fn offset(bag: &Reader, time_ns: i64) -> String {
    let start = bag.start_time().unwrap_or_default();
    format!("{:.6} s", time_ns.saturating_sub(start) as f64 / 1e9)
}

/// The start of a bag.
pub(super) fn start(bag: &Reader) -> anyhow::Result<i64> {
    bag.start_time().with_context(|| format!("{} has no messages", bag.path().display()))
}
