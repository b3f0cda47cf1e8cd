//! Messages of real bags, read by the definitions in those bags.

use std::collections::BTreeMap;
use std::fs;

use downbeat_bags::{Reader, Selection};
use downbeat_msgs::dynamic::{Definitions, DynamicMessage, DynamicView, Schemas};

use crate::support::fixture;

#[test]
fn every_message_of_a_real_bag_is_read_by_the_bags_own_schema_and_written_again_the_same() {
    for name in ["jazzy_mcap", "jazzy_mcap_zstd"] {
        let reader = Reader::open(fixture(name)).unwrap();
        let mut schemas = Schemas::new(name);
        let file = fs::read(reader.files().next().unwrap()).unwrap();
        for schema in mcap::Summary::read(&file).unwrap().unwrap().schemas.values() {
            let text = str::from_utf8(&schema.data).unwrap();
            schemas.add(&schema.name, &schema.encoding, text).unwrap();
        }
        // Uses only definitions in the bag.
        let definitions = Definitions::new().with(schemas);
        let types: Vec<_> =
            reader.topics().iter().map(|topic| definitions.find(&topic.info.type_name).unwrap()).collect();
        let mut read: BTreeMap<String, usize> = BTreeMap::new();
        for message in reader.messages(Selection::all()).unwrap() {
            let message = message.unwrap();
            let of = &types[message.topic.index()];
            let dynamic = DynamicMessage::from_cdr(of, &message.data).unwrap();
            let again = dynamic.to_cdr();
            // In the real recorder's bags, padding may follow the value.
            assert_eq!(again, message.data[..again.len()], "{name} {}", of.name());
            let view = DynamicView::new(of, &message.data).unwrap();
            for (field, value) in dynamic.fields() {
                assert_eq!(view.get(field).unwrap().to_value().unwrap(), value.to_value());
            }
            *read.entry(of.name().to_string()).or_default() += 1;
        }
        assert_eq!(read.values().sum::<usize>() as u64, reader.message_count(), "{name}");
        assert!(read.len() >= 8, "{name}: {read:?}");
    }
}
