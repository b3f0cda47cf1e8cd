//! Messages, a service and an action of a user.
#![allow(rustdoc::broken_intra_doc_links)] // units in brackets, as ROS writes them in comments of messages

use downbeat_msgs::Message;
use downbeat_msgs::std_msgs::msg::Header;

downbeat_msgs::include_interfaces!();

/// The reach of an arm, as a hand-written struct.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "my_msgs/msg/Reach")]
pub struct Reach {
    /// Time and frame.
    pub header: Header,
    /// From the shoulder [m].
    pub distance: f64,
}

/// The message of `std_msgs`, as another crate would generate it.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "std_msgs/msg/Bool")]
pub struct OtherBool {
    /// The value.
    pub data: bool,
}

downbeat_msgs::interfaces! {
    /// The interfaces that are derived here.
    pub DERIVED: Reach, OtherBool
}
