//! The measurements of hardware as the `joint_state_broadcaster` of ros2_control publishes them beside
//! `joint_states`: on `dynamic_joint_states`, by the names of interfaces.
//!
//! # References
//! ros2_controllers, branch jazzy: `joint_state_broadcaster/src/joint_state_broadcaster.cpp`,
//! `joint_state_broadcaster/doc/userdoc.rst`.

use super::measured_of;
use crate::ros::{MessageType, Node, NodeError, Publisher};
use downbeat_msgs::control_msgs::msg::{DynamicJointState, InterfaceValue};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::{Message, cdr};

/// Publishes `dynamic_joint_states`.
pub struct DynamicJointStates(Publisher);

impl DynamicJointStates {
    /// Beside this topic of `joint_states`.
    ///
    /// # Errors
    /// [`NodeError`] if the endpoint cannot be created.
    pub fn beside(node: &Node, joint_states: &str) -> Result<Self, NodeError> {
        let namespace = joint_states.rsplit_once('/').map_or("", |(namespace, _)| namespace);
        let topic = match namespace {
            "" => "dynamic_joint_states".to_owned(),
            namespace => format!("{namespace}/dynamic_joint_states"),
        };
        let kind = MessageType::new(DynamicJointState::TYPE_NAME)?;
        Ok(Self(node.publish(&topic, &kind, QosProfile::DEFAULT)?))
    }

    /// Publishes these measurements, if somebody receives them.
    pub fn publish(&self, state: &JointState) {
        if !self.0.is_subscribed() {
            return;
        }
        if let Err(error) = self.0.publish(cdr::to_vec(&by_interfaces(state)).into()) {
            tracing::debug!(%error, "the states of joints by interfaces were not published");
        }
    }
}

fn by_interfaces(state: &JointState) -> DynamicJointState {
    let of_joint = |index: usize| {
        let measured = measured_of(state).into_iter();
        let measured = measured.filter_map(|(name, values)| Some((name.to_owned(), *values.get(index)?)));
        let (interface_names, values) = measured.unzip();
        InterfaceValue { interface_names, values }
    };
    DynamicJointState {
        header: state.header.clone(),
        joint_names: state.name.clone(),
        interface_values: (0..state.name.len()).map(of_joint).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_joint_has_the_interfaces_that_its_hardware_measures() {
        let state = JointState {
            name: vec!["pan".to_owned(), "tilt".to_owned()],
            position: vec![0.25, -1.0],
            velocity: vec![2.0],
            ..JointState::default()
        };
        let dynamic = by_interfaces(&state);
        assert_eq!(dynamic.joint_names, state.name);
        let [pan, tilt] = &dynamic.interface_values[..] else { panic!("{dynamic:?}") };
        assert_eq!(
            (&pan.interface_names[..], &pan.values[..]),
            (&["position".to_owned(), "velocity".to_owned()][..], &[0.25, 2.0][..])
        );
        assert_eq!(
            (&tilt.interface_names[..], &tilt.values[..]),
            (&["position".to_owned()][..], &[-1.0][..])
        );
    }
}
