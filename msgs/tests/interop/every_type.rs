//! Every message type as a table of functions.

use downbeat_msgs::{Message, Service, cdr};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::random::Random;
use crate::{odd_msgs, test_msgs};

/// A message type.
pub struct Type {
    pub name: &'static str,
    pub hash: &'static str,
    pub definition: &'static str,
    /// The bytes of its default value.
    pub default: fn() -> Vec<u8>,
    /// The bytes of a random value within its bounds.
    pub random: fn(&mut Random) -> Vec<u8>,
    /// Reads bytes; gives them as we write them, and the value.
    pub read: Read,
}

type Read = fn(&[u8]) -> cdr::Result<(Vec<u8>, Value)>;

impl Type {
    fn of<T: Message + Serialize + DeserializeOwned>() -> Self {
        Self {
            name: T::TYPE_NAME,
            hash: T::TYPE_HASH,
            definition: T::DEFINITION,
            default: || cdr::to_vec(&T::default()),
            random: |random| {
                // Bounds of sequences are not known to serde, but to our reader.
                let bytes = std::iter::repeat_with(|| cdr::to_vec(&random.value::<T>()));
                let fitting = bytes.take(1000).find(|bytes| cdr::from_slice::<T>(bytes).is_ok());
                fitting.unwrap_or_else(|| panic!("{}: no random value can be read", T::TYPE_NAME))
            },
            read: |bytes| {
                let value: T = cdr::from_slice(bytes)?;
                Ok((cdr::to_vec(&value), serde_json::to_value(&value).unwrap()))
            },
        }
    }

    /// Whether it is defined nowhere but here.
    pub fn is_ours(&self) -> bool {
        self.name.starts_with("downbeat_interfaces/") || self.name.starts_with("odd_msgs/")
    }
}

/// The types this crate carries, those of test_msgs, and some that are odd.
pub fn every_type() -> Vec<Type> {
    macro_rules! table {
        ($($message:ty),* $(,)?) => { vec![$(Type::of::<$message>()),*] };
    }
    let mut types = downbeat_msgs::for_each_message!(table);
    types.extend(table![
        test_msgs::msg::Arrays,
        test_msgs::msg::BasicTypes,
        test_msgs::msg::BoundedPlainSequences,
        test_msgs::msg::BoundedSequences,
        test_msgs::msg::Builtins,
        test_msgs::msg::Constants,
        test_msgs::msg::Defaults,
        test_msgs::msg::Empty,
        test_msgs::msg::MultiNested,
        test_msgs::msg::Nested,
        test_msgs::msg::Strings,
        test_msgs::msg::UnboundedSequences,
        test_msgs::msg::WStrings,
        test_msgs::srv::ArraysRequest,
        test_msgs::srv::ArraysResponse,
        test_msgs::srv::ArraysEvent,
        test_msgs::srv::BasicTypesRequest,
        test_msgs::srv::BasicTypesResponse,
        test_msgs::srv::BasicTypesEvent,
        test_msgs::srv::EmptyRequest,
        test_msgs::srv::EmptyResponse,
        test_msgs::srv::EmptyEvent,
        odd_msgs::msg::Commented,
        odd_msgs::msg::Keywords,
        odd_msgs::msg::Long,
        odd_msgs::msg::Message,
        odd_msgs::msg::Quoted,
        odd_msgs::srv::OkEvent,
    ]);
    types
}

/// Name and hash of each service.
pub fn carried_services() -> Vec<(&'static str, &'static str)> {
    macro_rules! table {
        ($($service:ty),* $(,)?) => { vec![$((<$service>::TYPE_NAME, <$service>::TYPE_HASH)),*] };
    }
    let mut services = downbeat_msgs::for_each_service!(table);
    services.extend(table![test_msgs::srv::Arrays, test_msgs::srv::BasicTypes, test_msgs::srv::Empty]);
    services
}
