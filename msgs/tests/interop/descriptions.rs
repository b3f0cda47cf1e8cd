//! Compares type descriptions, including default values, with those in the wheels.

use std::collections::BTreeMap;

use downbeat_msgs::type_description_interfaces::msg::TypeDescription;
use downbeat_msgs::{Action, Message, Service};
use serde_json::Value;

use crate::peer::Peer;

#[test]
fn every_type_description_is_that_of_the_wheels() {
    let Some(peer) = Peer::find() else { return };
    let mut count = 0;
    for (name, describe) in every_description() {
        if !peer.has_package_of(name) {
            continue;
        }
        let ours = serde_json::to_value(describe()).unwrap();
        let published = individual_descriptions(&peer.published(name)["type_description_msg"]);
        // The wheels have one file per message, service or action; referenced types and parts are nested in
        // it.
        for (part, description) in individual_descriptions(&ours) {
            assert_eq!(Some(&description), published.get(&part), "{part} in {name}");
        }
        if !name.rsplit('/').next().unwrap().contains('_') {
            assert_eq!(ours, peer.published(name)["type_description_msg"], "{name}");
        }
        count += 1;
    }
    assert!(count > 250, "only {count} types were compared");
}

type Describe = fn() -> TypeDescription;

fn every_description() -> Vec<(&'static str, Describe)> {
    macro_rules! messages {
        ($($of:ty),* $(,)?) => { vec![$((<$of as Message>::TYPE_NAME, <$of as Message>::type_description as Describe)),*] };
    }
    macro_rules! services {
        ($($of:ty),* $(,)?) => { vec![$((<$of as Service>::TYPE_NAME, <$of as Service>::type_description as Describe)),*] };
    }
    macro_rules! actions {
        ($($of:ty),* $(,)?) => { vec![$((<$of as Action>::TYPE_NAME, <$of as Action>::type_description as Describe)),*] };
    }
    let mut all = downbeat_msgs::for_each_message!(messages);
    all.extend(downbeat_msgs::for_each_service!(services));
    all.extend(downbeat_msgs::for_each_action!(actions));
    all
}

/// The descriptions of a type and of the types it refers to, by name.
fn individual_descriptions(description: &Value) -> BTreeMap<String, Value> {
    let referenced = description["referenced_type_descriptions"].as_array().unwrap().iter();
    let all = referenced.chain([&description["type_description"]]);
    all.map(|of| (of["type_name"].as_str().unwrap().to_owned(), of.clone())).collect()
}
