//! Topics and messages of the bags that several measurements write.

use downbeat_bags::TopicDescription;
use downbeat_msgs::Message;
use downbeat_msgs::sensor_msgs::msg::{Imu, JointState};

pub(crate) fn topic<T: Message>(name: &str) -> TopicDescription {
    TopicDescription {
        name: name.to_owned(),
        type_name: T::TYPE_NAME.to_owned(),
        definition: T::DEFINITION.to_owned(),
        type_hash: T::TYPE_HASH.to_owned(),
        ..TopicDescription::default()
    }
}

/// The `n`th state of 20 joints.
pub(crate) fn joint_state(n: u32) -> JointState {
    JointState {
        name: (0..20).map(|index| format!("joint_{index}")).collect(),
        position: (0..20).map(|index| f64::from(index + n) / 7.0).collect(),
        ..JointState::default()
    }
}

/// An inertial reading.
pub(crate) fn inertial(x: f64) -> Imu {
    let mut reading = Imu::default();
    reading.angular_velocity.x = x;
    reading
}

/// The output of a Python script, if there is a Python to compare with.
pub(crate) fn by_python(arguments: &[&std::ffi::OsStr]) -> anyhow::Result<Option<Vec<u8>>> {
    let Some(python) = std::env::var_os("DOWNBEAT_PYTHON") else { return Ok(None) };
    let output = std::process::Command::new(python).args(arguments).output()?;
    anyhow::ensure!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Ok(Some(output.stdout))
}
