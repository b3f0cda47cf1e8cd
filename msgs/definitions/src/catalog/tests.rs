#![allow(clippy::unwrap_used)]

use super::Catalog;

fn catalog(messages: &[(&str, &str)]) -> Catalog {
    let mut catalog = Catalog::new();
    for (name, text) in messages {
        catalog.add_message(name.parse().unwrap(), text, name).unwrap();
    }
    catalog
}

fn fault(messages: &[(&str, &str)]) -> String {
    catalog(messages).check().unwrap_err().to_string()
}

#[test]
fn an_unknown_type_is_reported_with_its_place_and_the_likely_name() {
    assert_eq!(
        fault(&[("a/msg/A", "int8 x\nHeader header"), ("std_msgs/msg/Header", "string frame_id")]),
        "a/msg/A:2:1: field `header` of a/msg/A has the unknown type `a/msg/Header`, did you mean `std_msgs/Header`?"
    );
    assert_eq!(
        fault(&[("a/msg/A", "std_msgs/Heder header"), ("std_msgs/msg/Header", "string frame_id")]),
        "a/msg/A:1:1: field `header` of a/msg/A has the unknown type `std_msgs/msg/Heder`, did you mean `std_msgs/Header`?"
    );
    assert_eq!(
        fault(&[("a/msg/A", "other_msgs/Thing thing")]),
        "a/msg/A:1:1: field `thing` of a/msg/A has the unknown type `other_msgs/msg/Thing`: no interface of the package \
         other_msgs is known, add its folder"
    );
}

#[test]
fn a_missing_type_is_reported_with_the_nearest_name() {
    let mut catalog = catalog(&[("std_msgs/msg/Header", ""), ("sensor_msgs/msg/JointState", "")]);
    catalog.add_service("std_srvs/srv/SetBool".parse().unwrap(), "---\n", "").unwrap();
    let message = |name: &str| catalog.message(&name.parse().unwrap()).unwrap_err().to_string();
    assert_eq!(
        message("sensor_msgs/msg/JointStates"),
        "sensor_msgs/msg/JointStates is not in the catalog, did you mean sensor_msgs/msg/JointState?"
    );
    assert_eq!(
        message("std_srvs/srv/SetBool"),
        "std_srvs/srv/SetBool is not in the catalog: it is a service, not a message"
    );
    assert_eq!(
        message("my_msgs/msg/Leg"),
        "my_msgs/msg/Leg is not in the catalog: no interface of the package my_msgs is known, add its folder"
    );
    assert_eq!(
        catalog.service(&"std_srvs/srv/SetBoll".parse().unwrap()).unwrap_err().to_string(),
        "std_srvs/srv/SetBoll is not in the catalog, did you mean std_srvs/srv/SetBool?"
    );
}

#[test]
fn a_message_that_contains_itself_is_refused() {
    let cyclic = [("a/msg/A", "B b"), ("a/msg/B", "int8 x\nC[] c"), ("a/msg/C", "B b")];
    assert_eq!(fault(&cyclic), "a/msg/C:1:1: a/msg/B contains itself: a/msg/B -> a/msg/C -> a/msg/B");
    assert_eq!(fault(&[("a/msg/A", "A a")]), "a/msg/A:1:1: a/msg/A contains itself: a/msg/A -> a/msg/A");
    // Following references terminates even before the check.
    let catalog = catalog(&cyclic);
    let name = "a/msg/A".parse().unwrap();
    assert!(catalog.least_wire_size(&name).is_err());
    assert_eq!(catalog.type_description(&name).unwrap().referenced_type_descriptions.len(), 2);
    assert!(catalog.definition_text(&name).is_ok());
}

#[test]
fn messages_cannot_be_nested_without_end() {
    let mut chain = Catalog::new();
    for depth in 0..10_000 {
        let name = format!("a/msg/N{depth:06}").parse().unwrap();
        chain.add_message(name, &format!("N{:06} next\n", depth + 1), "chain").unwrap();
    }
    chain.add_message("a/msg/N010000".parse().unwrap(), "", "chain").unwrap();
    let error = chain.check().unwrap_err().to_string();
    assert_eq!(error, "chain:1:1: a/msg/N000064 is nested deeper than 64 messages");
    // The same chain, built from its far end.
    let mut chain = Catalog::new();
    for depth in (0..1000).rev() {
        let name = format!("a/msg/N{:06}", 1000 - depth).parse().unwrap();
        chain.add_message(name, &format!("N{:06} next\n", 999 - depth), "chain").unwrap();
    }
    chain.add_message("a/msg/N000000".parse().unwrap(), "", "chain").unwrap();
    assert!(chain.check().is_err());
    assert!(chain.definition_text(&"a/msg/N001000".parse().unwrap()).is_ok());
}

#[test]
fn a_message_too_large_to_be_sent_is_refused_and_sizes_are_computed_quickly() {
    assert_eq!(
        fault(&[("a/msg/A", "int8 x\nB[70000] b"), ("a/msg/B", "float64[70000] x")]),
        "a/msg/A:2:1: a/msg/A takes at least 39200000001 bytes, and no more than 4294967295 can be sent"
    );
    // Every level contains the one below twice: 2^40 paths from top to bottom.
    let texts: Vec<(String, String)> = (0..40)
        .map(|depth| (format!("a/msg/N{depth}"), format!("N{}[] one\nN{} two\n", depth + 1, depth + 1)))
        .chain([("a/msg/N40".to_owned(), String::new())])
        .collect();
    let texts: Vec<(&str, &str)> = texts.iter().map(|(name, text)| (name.as_str(), text.as_str())).collect();
    let catalog = catalog(&texts);
    catalog.check().unwrap();
    assert_eq!(catalog.least_wire_size(&"a/msg/N0".parse().unwrap()).unwrap(), 40 * 4 + 1);
}

#[test]
fn one_type_can_be_checked_beside_others_that_are_broken() {
    let catalog = catalog(&[("a/msg/A", "B b"), ("a/msg/B", ""), ("a/msg/Broken", "Missing m")]);
    assert!(catalog.check().is_err());
    catalog.check_type(&"a/msg/A".parse().unwrap()).unwrap();
    assert!(catalog.check_type(&"a/msg/Broken".parse().unwrap()).is_err());
    assert!(catalog.check_type(&"a/msg/Missing".parse().unwrap()).is_err());
}

#[test]
fn the_same_definition_twice_is_fine_and_another_one_is_not() {
    let mut catalog = catalog(&[("a/msg/A", "int8 x\nfloat64 NO=nan")]);
    catalog
        .add_message("a/msg/A".parse().unwrap(), "# why\nfloat64  NO = nan\nint8 x # how much", "copy")
        .unwrap();
    for other in ["int16 x\nfloat64 NO=nan", "int8 x\nfloat64 NO=1", "int8 x 1\nfloat64 NO=nan", "int8 x"] {
        let error = catalog.add_message("a/msg/A".parse().unwrap(), other, "other").unwrap_err();
        assert_eq!(error.to_string(), "other: a/msg/A is already defined, differently, in a/msg/A");
    }
    catalog.add_action("a/action/A".parse().unwrap(), "int8 x\n---\n---\n", "first").unwrap();
    catalog.add_action("a/action/A".parse().unwrap(), "int8 x # why\n---\n---\n", "copy").unwrap();
    let error = catalog.add_action("a/action/A".parse().unwrap(), "---\n---\nint8 x\n", "other").unwrap_err();
    assert_eq!(error.to_string(), "other: a/action/A_Goal is already defined, differently, in first");
}
