//! Every message type as a table of functions.

use downbeat_msgs::{Message, Service, cdr};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::odd_msgs;
use crate::random::Random;

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
}

/// Whether a type's package is in no wheel: those defined nowhere but here, and some of ROS 2.
pub fn has_no_wheel(name: &str) -> bool {
    const PACKAGES: [&str; 6] = [
        "composition_interfaces/",
        "downbeat_interfaces/",
        "odd_msgs/",
        "rosbag2_interfaces/",
        "statistics_msgs/",
        "tf2_msgs/",
    ];
    PACKAGES.iter().any(|package| name.starts_with(package))
}

/// The types this crate carries, and some that are odd.
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

/// Name and hash of each service that is carried.
pub fn carried_services() -> Vec<(&'static str, &'static str)> {
    macro_rules! table {
        ($($service:ty),* $(,)?) => { vec![$((<$service>::TYPE_NAME, <$service>::TYPE_HASH)),*] };
    }
    downbeat_msgs::for_each_service!(table)
}
