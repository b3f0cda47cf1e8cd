//! Times that are filled in when a message is sent.

use downbeat_msgs_definitions::TypeName;

use crate::builtin_interfaces::msg::Time;
use crate::dynamic::{DynamicMessage, FieldError};

/// The times of a message that its text asks the sender to set: `header: auto` and `stamp: now`, as in `ros2
/// topic pub`.
///
/// ```
/// use downbeat_msgs::builtin_interfaces::msg::Time;
/// use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
/// use downbeat_msgs::sensor_msgs::msg::JointState;
///
/// let mut joints = DynamicMessage::new(&DynamicType::of::<JointState>()?);
/// let stamps = joints.fill_yaml("{header: auto, name: [pan], position: [0.25]}")?;
/// stamps.set(&mut joints, Time { sec: 5, nanosec: 0 })?; // before each time it is sent
/// assert_eq!(joints.get("header.stamp.sec")?.as_i64(), Some(5));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stamps {
    pub(super) paths: Vec<String>,
}

impl Stamps {
    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.paths.is_empty()
    }

    /// The paths of the times.
    pub fn paths(&self) -> impl Iterator<Item = &str> {
        self.paths.iter().map(String::as_str)
    }

    /// Sets all of them to this value.
    ///
    /// # Errors
    /// If the message has a different type than the filled one.
    pub fn set(&self, message: &mut DynamicMessage, time: Time) -> Result<(), FieldError> {
        for path in &self.paths {
            message.set(&format!("{path}.sec"), time.sec)?;
            message.set(&format!("{path}.nanosec"), time.nanosec)?;
        }
        Ok(())
    }
}

pub(super) fn is_header(name: &TypeName) -> bool {
    name.package == "std_msgs" && name.kind.as_str() == "msg" && name.name == "Header"
}

pub(super) fn is_time(name: &TypeName) -> bool {
    name.package == "builtin_interfaces" && name.kind.as_str() == "msg" && name.name == "Time"
}
