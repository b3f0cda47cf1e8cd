//! Controllers as users of ros2_control know them, for any robot whose joints have names.
//!
//! - [`joint_trajectory`]: follows trajectories of joints, as the action `FollowJointTrajectory` or from a
//!   topic;
//! - [`forward_command`]: passes positions, velocities or efforts on to joints;
//! - [`diff_drive`]: two-wheeled bases: `cmd_vel` to wheel speeds, and odometry.
//!
//! They read `joint_states` and publish `joint_commands`, both `sensor_msgs/JointState`; remap these to the
//! topics of the hardware module or of a multiplexer. Their other names begin with the name of the module, as
//! those of a controller in ros2_control begin with the name of the controller, so that a module called
//! `arm_controller` serves `arm_controller/follow_joint_trajectory`, which is what MoveIt looks for.
//!
//! # Switched and chained
//! Transitions of the lifecycle switch controllers: an active one has its joints for itself ([`claims`]), and
//! the next one starts from where they are. The commands of one are the reference of another where a remap
//! says so: those of any controller go into `NAME/reference` of a [`forward_command`].

pub mod claims;
pub mod diff_drive;
pub mod forward_command;
pub mod joint_trajectory;
pub mod motion;
pub mod spline;

use downbeat_executor::{Module, Setting, Setup, SetupError};
use downbeat_msgs::sensor_msgs::msg::JointState;

/// Whether the position of this joint of `joint_states` is a measurement of now.
///
/// `servo_bus` gives a servo that does not answer its last position, and NaN as velocity and effort. Hardware
/// that measures neither, of which ros2_control publishes NaN too, has none for any of its joints.
fn is_fresh(state: &JointState, joint: usize) -> bool {
    let has = |joint: usize| {
        [&state.velocity, &state.effort].iter().any(|values| values.get(joint).is_some_and(|v| v.is_finite()))
    };
    let is_position = state.position.get(joint).is_some_and(|position| position.is_finite());
    is_position && (has(joint) || !(0..state.name.len()).any(has))
}

/// A name of the module's own, as ros2_control forms it.
fn own<M: Module>(setup: &Setup<'_, M>, name: &str) -> String {
    format!("{}/{name}", setup.module_name())
}

/// Declares a setting that holds names of joints: at least one, none twice.
fn joint_names<M: Module>(
    setup: &mut Setup<'_, M>,
    setting: &str,
    description: &str,
) -> Result<Vec<String>, SetupError> {
    let key: Setting<Vec<String>> = setup.read_only_setting(setting, Vec::new(), description)?;
    let names = setup.value(key).cloned().unwrap_or_default();
    if names.is_empty() {
        return Err(setup.refuse_value(key, "it names no joint: give the names as `joint_states` has them"));
    }
    if let Some((_, twice)) = names.iter().enumerate().find(|(index, name)| names[..*index].contains(name)) {
        return Err(setup.refuse_value(key, format!("it names the joint \"{twice}\" twice")));
    }
    Ok(names)
}
