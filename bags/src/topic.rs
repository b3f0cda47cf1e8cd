//! What a bag knows of a topic.

use downbeat_msgs::qos::QosProfile;

/// A topic as a bag describes it. The strings come from whoever made the type; this crate knows no message types.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TopicInfo {
    /// Absolute topic name, `/joint_states`.
    pub name: String,
    /// ROS type name, `sensor_msgs/msg/JointState`.
    pub type_name: String,
    /// The `ros2msg` text of the type, its dependencies included, as rosbag2 writes it.
    ///
    /// Empty when it is not known. A reader also leaves it empty when the bag holds something other than `ros2msg`.
    pub definition: String,
    /// Type hash as in REP-2016, `RIHS01_…`; empty when it is not known.
    pub type_hash: String,
    /// What each publisher of the topic offered.
    pub offered_qos: Vec<QosProfile>,
}

/// A topic of one [`Writer`](crate::Writer), one [`Recording`](crate::Recording) or one [`Reader`](crate::Reader):
/// its position in the list of topics there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TopicId(u16);

impl TopicId {
    pub(crate) fn from_index(index: usize) -> Option<Self> {
        u16::try_from(index).ok().map(Self)
    }

    /// The position in the list of topics.
    #[must_use]
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// Whether a topic carries the events of a service (service introspection), which `ros2 bag info` lists apart.
///
/// The rule is that of `rosbag2_cpp/service_utils.cpp`.
pub(crate) fn is_service_event(name: &str, type_name: &str) -> bool {
    name.strip_suffix(SERVICE_EVENT_TOPIC).is_some_and(|service| !service.is_empty())
        && type_name.contains("/srv/")
        && type_name.ends_with(SERVICE_EVENT_TYPE)
}

pub(crate) const SERVICE_EVENT_TOPIC: &str = "/_service_event";
pub(crate) const SERVICE_EVENT_TYPE: &str = "_Event";
