//! Every message type as a table of functions, and their definitions.

use std::path::Path;
use std::sync::LazyLock;

use downbeat_msgs::definitions::{Catalog, TypeName};
use downbeat_msgs::{Message, cdr};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::odd_msgs;
use crate::random::Random;

/// A message type. Values are their CDR.
pub struct Type {
    pub name: &'static str,
    /// A random value within its bounds; its numbers include NaN and infinities.
    pub random: fn(&mut Random) -> Vec<u8>,
    pub to_json: fn(&[u8]) -> String,
    pub to_json_value: fn(&[u8]) -> Value,
    pub from_json: fn(&str) -> serde_json::Result<Vec<u8>>,
    pub to_cbor: fn(&[u8]) -> Vec<u8>,
    pub from_cbor: fn(&[u8]) -> Vec<u8>,
}

impl Type {
    fn of<T: Message + Serialize + DeserializeOwned>() -> Self {
        fn read<T: Message>(bytes: &[u8]) -> T {
            cdr::from_slice(bytes).unwrap_or_else(|error| panic!("{}: {error}", T::TYPE_NAME))
        }
        Self {
            name: T::TYPE_NAME,
            random: |random| {
                // Serde does not check the bounds of sequences, but our reader does.
                let bytes = std::iter::repeat_with(|| cdr::to_vec(&random.value::<T>()));
                let fitting = bytes.take(1000).find(|bytes| cdr::from_slice::<T>(bytes).is_ok());
                fitting.unwrap_or_else(|| panic!("{}: no random value can be read", T::TYPE_NAME))
            },
            to_json: |bytes| serde_json::to_string(&read::<T>(bytes)).unwrap(),
            to_json_value: |bytes| serde_json::to_value(read::<T>(bytes)).unwrap(),
            from_json: |text| Ok(cdr::to_vec(&serde_json::from_str::<T>(text)?)),
            to_cbor: |bytes| {
                let mut cbor = Vec::new();
                ciborium::into_writer(&read::<T>(bytes), &mut cbor).unwrap();
                cbor
            },
            from_cbor: |bytes| cdr::to_vec(&ciborium::from_reader::<T, _>(bytes).unwrap()),
        }
    }
}

/// The built-in types, and some unusual ones.
pub fn every_type() -> Vec<Type> {
    macro_rules! table {
        ($($message:ty),* $(,)?) => { vec![$(Type::of::<$message>()),*] };
    }
    let mut types = downbeat_msgs::for_each_message!(table);
    types.extend(table![
        odd_msgs::msg::Keywords,
        odd_msgs::msg::Long,
        odd_msgs::msg::Message,
        odd_msgs::msg::Quoted,
        odd_msgs::srv::OkEvent,
    ]);
    types
}

/// Their definitions.
pub fn catalog() -> &'static Catalog {
    static CATALOG: LazyLock<Catalog> = LazyLock::new(|| {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut catalog = Catalog::new();
        catalog.add_packages(&folder.join("interfaces")).unwrap();
        catalog.add_package(&folder.join("tests/data/odd_msgs")).unwrap();
        catalog.check().unwrap();
        catalog
    });
    &CATALOG
}

pub fn name(name: &str) -> TypeName {
    name.parse().unwrap()
}
