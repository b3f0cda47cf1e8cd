//! Every message type as a table of functions.

use std::path::Path;

use downbeat_msgs::{Action, Message, Service, cdr};
use downbeat_msgs_definitions::{Catalog, TypeName};
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::exact::from_exact;
use crate::odd_msgs;

/// A message type.
pub struct Type {
    pub name: &'static str,
    pub hash: &'static str,
    pub definition: &'static str,
    /// The bytes of its default value.
    pub default: fn() -> Vec<u8>,
    /// The bytes of a value whose floating-point numbers are strings of their bits.
    pub write: fn(&Value) -> Vec<u8>,
    /// Reads bytes and writes them again.
    pub read: fn(&[u8]) -> cdr::Result<Vec<u8>>,
    /// Reads bytes and returns the debug output of the message or its view.
    pub show: fn(&[u8], As) -> cdr::Result<String>,
}

/// How bytes are read.
#[derive(Clone, Copy)]
pub enum As {
    Message,
    View,
}

impl Type {
    fn of<T: Message + cdr::Viewed + DeserializeOwned>() -> Self {
        Self {
            name: T::TYPE_NAME,
            hash: T::TYPE_HASH,
            definition: T::DEFINITION,
            default: || cdr::to_vec(&T::default()),
            write: |value| {
                let value = from_exact::<T>(value);
                let bytes = cdr::to_vec(&value);
                assert_eq!(cdr::encoded_size(&value), bytes.len(), "{}", T::TYPE_NAME);
                assert_eq!(cdr::try_to_vec(&value).as_ref(), Ok(&bytes), "{}", T::TYPE_NAME);
                bytes
            },
            read: |bytes| Ok(cdr::to_vec(&cdr::from_slice::<T>(bytes)?)),
            show: |bytes, read_as| {
                Ok(match read_as {
                    As::Message => format!("{:?}", cdr::from_slice::<T>(bytes)?),
                    As::View => format!("{:?}", cdr::from_slice::<T::View<'_>>(bytes)?),
                })
            },
        }
    }

    pub fn type_name(&self) -> TypeName {
        self.name.parse().unwrap()
    }
}

/// The built-in types, and some unusual ones.
pub fn every_type() -> Vec<Type> {
    macro_rules! table {
        ($($message:ty),* $(,)?) => { vec![$(Type::of::<$message>()),*] };
    }
    let mut types = downbeat_msgs::for_each_message!(table);
    types.extend(table![
        odd_msgs::msg::Commented,
        odd_msgs::msg::Into,
        odd_msgs::msg::Keywords,
        odd_msgs::msg::Long,
        odd_msgs::msg::Message,
        odd_msgs::msg::Option,
        odd_msgs::msg::Quoted,
        odd_msgs::msg::Self_,
        odd_msgs::srv::OkEvent,
    ]);
    types
}

/// Name and hash of each service and each action.
pub fn services_and_actions() -> Vec<(&'static str, &'static str)> {
    macro_rules! services {
        ($($service:ty),* $(,)?) => { vec![$((<$service as Service>::TYPE_NAME, <$service as Service>::TYPE_HASH)),*] };
    }
    macro_rules! actions {
        ($($action:ty),* $(,)?) => { vec![$((<$action as Action>::TYPE_NAME, <$action as Action>::TYPE_HASH)),*] };
    }
    let mut all = downbeat_msgs::for_each_service!(services);
    all.extend(downbeat_msgs::for_each_action!(actions));
    all
}

/// The definitions of the types, read again.
pub fn catalog() -> Catalog {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut catalog = Catalog::new();
    catalog.add_packages(&root.join("interfaces")).unwrap();
    catalog.add_packages(&root.join("tests/data")).unwrap();
    catalog.check().unwrap();
    catalog
}
