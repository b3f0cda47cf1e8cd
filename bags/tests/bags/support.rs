//! Helpers shared by several tests.

use std::path::PathBuf;

use downbeat_bags::{BagMessage, Reader, Selection, TopicDescription, Writer};
use downbeat_msgs::qos::QosProfile;

use crate::matrix::{self, Check, Way, With};

/// Notes which direction of exchanging bags the test proves.
pub fn noted(feature: &str, with: With, way: Way) -> Check {
    matrix::check("Bag files", feature, with, way)
}

/// A bag of the real recorder, see `tests/data/README.md`.
pub fn fixture(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

pub fn topic(name: &str) -> TopicDescription {
    TopicDescription {
        name: name.to_owned(),
        type_name: "std_msgs/msg/Int64".to_owned(),
        definition: "int64 data\n".to_owned(),
        type_hash: String::new(),
        offered_qos: vec![QosProfile::DEFAULT.into()],
        format: None,
    }
}

/// A std_msgs/Int64 as CDR.
pub fn number(value: i64) -> Vec<u8> {
    let mut cdr = vec![0, 1, 0, 0];
    cdr.extend_from_slice(&value.to_le_bytes());
    cdr
}

pub fn value(message: &BagMessage) -> i64 {
    i64::from_le_bytes(message.data[4..].try_into().unwrap())
}

/// Adds the topic `/numbers` and writes `0..count` into it, one per millisecond.
pub fn write_numbers(writer: &mut Writer, count: i64) {
    let id = writer.add_topic(topic("/numbers")).unwrap();
    for n in 0..count {
        writer.write(id, 1_000_000 * n, 1_000_000 * n, &number(n)).unwrap();
    }
}

/// The messages that can be read; errors are skipped.
pub fn messages(reader: &Reader) -> Vec<BagMessage> {
    reader.messages(Selection::all()).unwrap().filter_map(Result::ok).collect()
}
