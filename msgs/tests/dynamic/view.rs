//! Reading a field through a view gives the same value as reading the whole message.

use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, DynamicView, MessageRef, ValueRef};
use downbeat_msgs::{Message, cdr, sensor_msgs};
use serde::de::DeserializeOwned;

use crate::random::Random;

/// The paths of all fields and elements, including messages and arrays.
fn paths(message: MessageRef<'_>, prefix: &str, all: &mut Vec<String>) {
    for (name, value) in message.fields() {
        let path = if prefix.is_empty() { name.to_owned() } else { format!("{prefix}.{name}") };
        all.push(path.clone());
        match value {
            ValueRef::Message(message) => paths(message, &path, all),
            ValueRef::Array(array) => {
                for (index, element) in array.iter().enumerate() {
                    let path = format!("{path}[{index}]");
                    all.push(path.clone());
                    if let ValueRef::Message(message) = element {
                        paths(message, &path, all);
                    }
                }
            }
            _ => {}
        }
    }
}

fn check<T: Message + DeserializeOwned>(random: &mut Random) {
    let of = DynamicType::of::<T>().unwrap();
    for _ in 0..3 {
        let bytes = cdr::to_vec(&random.value::<T>());
        let Ok(message) = DynamicMessage::from_cdr(&of, &bytes) else { continue };
        let view = DynamicView::new(&of, &bytes).unwrap();
        assert_eq!(view.to_message().unwrap().to_cdr(), bytes);
        let mut all = Vec::new();
        paths(message.as_message(), "", &mut all);
        for path in all.iter().take(300) {
            let ours = view.get(path).unwrap_or_else(|error| panic!("{path}: {error}")).to_value().unwrap();
            // Compares formatted values: NaN is not equal to itself.
            let whole = message.get(path).unwrap().to_value();
            assert_eq!(format!("{ours:?}"), format!("{whole:?}"), "{} {path}", T::TYPE_NAME);
        }
    }
}

#[test]
fn every_field_of_every_message_is_read_alone() {
    let mut random = Random::new(0x1a2);
    macro_rules! check_each {
        ($($message:ty),* $(,)?) => { $(check::<$message>(&mut random);)* };
    }
    downbeat_msgs::for_each_message!(check_each);
}

#[test]
fn a_field_is_read_even_if_the_following_bytes_are_missing() {
    let mut joints =
        sensor_msgs::msg::JointState { name: vec!["a".into(), "b".into()], ..Default::default() };
    joints.position = vec![0.5; 100];
    let bytes = cdr::to_vec(&joints);
    let of = DynamicType::of::<sensor_msgs::msg::JointState>().unwrap();
    let view = DynamicView::new(&of, &bytes[..60]).unwrap();
    assert_eq!(view.get("name[1]").unwrap().as_str(), Some("b"));
    let error = view.get("effort").unwrap_err().to_string();
    assert!(error.starts_with("cannot decode CDR at byte ") && error.contains("field `position`"), "{error}");
    for path in ["name[2]", "nam", "name.x", "header[0]", "header.frame_id.x", ""] {
        let whole = DynamicMessage::from_cdr(&of, &bytes).unwrap();
        let expected = whole.get(path).unwrap_err().to_string();
        assert_eq!(view.get(path).unwrap_err().to_string(), expected);
    }
}
