//! The graph of modules as the protocol's connection graph.

use downbeat_executor::{Graph, GraphEdge};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};

type Ends = BTreeMap<String, BTreeSet<String>>;

/// Who publishes and subscribes to which topics, and serves which services; the ids are the names of modules.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Connections {
    published: Ends,
    subscribed: Ends,
    served: Ends,
}

impl Connections {
    pub(crate) fn of(graph: &Graph) -> Self {
        let mut connections = Self::default();
        let module = |index: usize| graph.modules.get(index).map(|module| module.name.clone());
        let topic = |index: usize| graph.topics.get(index).map(|topic| topic.name.as_str());
        for edge in &graph.edges {
            let (ends, name, module) = match *edge {
                GraphEdge::Publishes { module: m, topic: t } => {
                    (&mut connections.published, topic(t), module(m))
                }
                GraphEdge::Subscribes { module: m, topic: t } => {
                    (&mut connections.subscribed, topic(t), module(m))
                }
                GraphEdge::Serves { module: m, service: s } => {
                    let service = graph.services.get(s).map(|service| service.name.as_str());
                    (&mut connections.served, service, module(m))
                }
                GraphEdge::Calls { .. } | GraphEdge::Leaves { .. } => continue,
            };
            if let (Some(name), Some(module)) = (name, module) {
                ends.entry(format!("/{name}")).or_default().insert(module);
            }
        }
        connections
    }

    /// The message that changes what a viewer knows into this; `None` if it is this already.
    pub(crate) fn update(&self, known: &Self) -> Option<String> {
        if self == known {
            return None;
        }
        let changed = |new: &Ends, old: &Ends, ids: &str| -> Vec<Value> {
            let changed = new.iter().filter(|&(name, modules)| old.get(name) != Some(modules));
            changed.map(|(name, modules)| json!({ "name": name, ids: modules })).collect()
        };
        let mut published = changed(&self.published, &known.published, "publisherIds");
        let mut subscribed = changed(&self.subscribed, &known.subscribed, "subscriberIds");
        // A topic is removed when it has neither; before that, one of its lists may have become empty.
        let gone = |old: &Ends, new: &Ends| -> Vec<String> {
            old.keys().filter(|name| !new.contains_key(*name)).cloned().collect()
        };
        let mut removed = BTreeSet::new();
        for name in gone(&known.published, &self.published) {
            if self.subscribed.contains_key(&name) {
                published.push(json!({ "name": name, "publisherIds": [] }));
            } else {
                removed.insert(name);
            }
        }
        for name in gone(&known.subscribed, &self.subscribed) {
            if self.published.contains_key(&name) {
                subscribed.push(json!({ "name": name, "subscriberIds": [] }));
            } else {
                removed.insert(name);
            }
        }
        let update = json!({
            "op": "connectionGraphUpdate",
            "publishedTopics": published,
            "subscribedTopics": subscribed,
            "advertisedServices": changed(&self.served, &known.served, "providerIds"),
            "removedTopics": removed,
            "removedServices": gone(&known.served, &self.served),
        });
        Some(update.to_string())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn connections(published: &[(&str, &str)], subscribed: &[(&str, &str)]) -> Connections {
        let ends = |pairs: &[(&str, &str)]| {
            let mut ends = Ends::new();
            for (topic, module) in pairs {
                ends.entry((*topic).to_owned()).or_default().insert((*module).to_owned());
            }
            ends
        };
        Connections { published: ends(published), subscribed: ends(subscribed), served: Ends::new() }
    }

    fn update(new: &Connections, old: &Connections) -> Value {
        serde_json::from_str(&new.update(old).unwrap()).unwrap()
    }

    #[test]
    fn the_first_update_holds_everything_and_the_next_what_changed() {
        let first = connections(&[("/a", "x"), ("/b", "x")], &[("/a", "y")]);
        let all = update(&first, &Connections::default());
        assert_eq!(
            all["publishedTopics"],
            json!([{ "name": "/a", "publisherIds": ["x"] }, { "name": "/b", "publisherIds": ["x"] }])
        );
        assert_eq!(all["subscribedTopics"], json!([{ "name": "/a", "subscriberIds": ["y"] }]));
        assert_eq!(first.update(&first), None);
        let second = connections(&[("/a", "x")], &[]);
        let changes = update(&second, &first);
        assert_eq!(changes["removedTopics"], json!(["/b"]));
        assert_eq!(changes["publishedTopics"], json!([]));
        assert_eq!(changes["subscribedTopics"], json!([{ "name": "/a", "subscriberIds": [] }]));
    }
}
