//! Passes positions, velocities or efforts on to joints, as the `forward_command_controller` of ros2_control
//! and its kin `position_controllers`, `velocity_controllers` and `effort_controllers` do.
//!
//! `NAME` is the name of the module:
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `NAME/commands` (in) | std_msgs/Float64MultiArray | one value per joint, in the order of `joints` |
//! | `NAME/reference` (in) | sensor_msgs/JointState | the commands of another controller, by name; other joints and values are ignored |
//! | `joint_commands` | sensor_msgs/JointState | the same with names |
//!
//! | setting | default | |
//! | --- | --- | --- |
//! | `joints` | | names of the joints |
//! | `interface_name` | `position` | what the values are: `position` (rad or m), `velocity` (rad/s or m/s), `effort` (N·m or N) |
//!
//! A message with a wrong number of values is dropped; a value that is not finite leaves its joint alone.
//! Both are logged the 1st, 10th, 100th time. Deactivation commands velocities and efforts of 0; positions
//! stay.
//!
//! # References
//! `forward_command_controller` of `ros-controls/ros2_controllers`, branch jazzy: `doc/userdoc.rst`.

use super::claims::OwnClaims;
use super::{joint_names, own};
use crate::stamps::header;
use downbeat_executor::{
    Context, Module, Publication, Received, Setting, Setup, SetupError, TransitionError,
};
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::std_msgs::msg::Float64MultiArray;

/// Passes commands on to joints; see the [module page](self).
#[derive(Debug, Default)]
pub struct ForwardCommandController {
    joints: Vec<String>,
    interface: Interface,
    faults: u64,
    claims: OwnClaims,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Interface {
    #[default]
    Position,
    Velocity,
    Effort,
}

/// The keys of [`ForwardCommandController`].
pub struct Ports {
    commands: Publication<JointState>,
}

impl ForwardCommandController {
    fn on_commands(&mut self, values: Received<'_, Float64MultiArray>, ctx: &mut Context<'_, Ports>) {
        let values = &values.data;
        if values.len() != self.joints.len() {
            let (found, needed) = (values.len(), self.joints.len());
            return self.fault(&format!("a command has {found} values for {needed} joints; it is dropped"));
        }
        if values.iter().any(|value| !value.is_finite()) {
            self.fault("a command has a value that is not finite; its joint is left alone");
        }
        let commanded = self.joints.iter().zip(values).filter(|(_, value)| value.is_finite());
        let commanded = commanded.map(|(joint, value)| (joint.clone(), *value)).collect();
        self.command(commanded, ctx);
    }

    fn on_reference(&mut self, reference: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        let values = match self.interface {
            Interface::Position => &reference.position,
            Interface::Velocity => &reference.velocity,
            Interface::Effort => &reference.effort,
        };
        let of_joints = reference.name.iter().zip(values);
        let of_joints = of_joints.filter(|(name, value)| self.joints.contains(name) && value.is_finite());
        let commanded: Vec<_> = of_joints.map(|(name, value)| (name.clone(), *value)).collect();
        if !commanded.is_empty() {
            self.command(commanded, ctx);
        }
    }

    fn command(&mut self, commanded: Vec<(String, f64)>, ctx: &mut Context<'_, Ports>) {
        if self.claims.are_granted(ctx) {
            self.publish(commanded, ctx);
        }
    }

    fn publish(&self, commanded: Vec<(String, f64)>, ctx: &mut Context<'_, Ports>) {
        let (name, values) = commanded.into_iter().unzip();
        let mut command = JointState { header: header(ctx.now(), ""), name, ..JointState::default() };
        match self.interface {
            Interface::Position => command.position = values,
            Interface::Velocity => command.velocity = values,
            Interface::Effort => command.effort = values,
        }
        ctx.publish(ctx.ports.commands, command);
    }

    fn fault(&mut self, what: &str) {
        self.faults += 1;
        if 10_u64.pow(self.faults.ilog10()) == self.faults {
            tracing::warn!(times = self.faults, "{what}");
        }
    }
}

impl Module for ForwardCommandController {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        self.joints = joint_names(setup, "joints", "names of the joints, in the order of the commands")?;
        let key: Setting<String> = setup.read_only_choice(
            "interface_name",
            "position",
            &["position", "velocity", "effort"],
            "what the commands are: position, velocity or effort",
        )?;
        self.interface = match setup.value(key).map(String::as_str) {
            Some("position") => Interface::Position,
            Some("velocity") => Interface::Velocity,
            Some("effort") => Interface::Effort,
            other => {
                let other = other.unwrap_or_default();
                let reason = format!("\"{other}\" is none of position, velocity and effort");
                return Err(setup.refuse_value(key, reason));
            }
        };
        let commands = own(setup, "commands");
        setup.subscribe(&commands, Self::on_commands)?;
        let reference = own(setup, "reference");
        setup.subscribe(&reference, Self::on_reference)?;
        let ports = Ports { commands: setup.publish("joint_commands")? };
        self.claims = OwnClaims::declare(setup, "joint_commands", &self.joints);
        Ok(ports)
    }

    fn activate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        self.claims.take(ctx)
    }

    fn deactivate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        if self.interface != Interface::Position && self.claims.are_granted(ctx) {
            self.publish(self.joints.iter().map(|joint| (joint.clone(), 0.0)).collect(), ctx);
        }
        self.claims.give_back(ctx);
        Ok(())
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_executor::{ModuleOptions, Probe, ProbeError};

    fn add(probe: &mut Probe, interface: &str) -> Result<(), ProbeError> {
        let settings = [
            ("joints".to_owned(), vec!["left".to_owned(), "right".to_owned()].into()),
            ("interface_name".to_owned(), interface.to_owned().into()),
        ];
        let options = ModuleOptions { settings: settings.into(), ..ModuleOptions::default() };
        probe.add_with("wheels", ForwardCommandController::default(), options)
    }

    #[test]
    fn commands_get_the_names_of_the_joints() {
        let mut probe = Probe::new();
        add(&mut probe, "velocity").unwrap();
        let forwarded = probe.listen::<JointState>("joint_commands").unwrap();
        for data in [vec![1.0, -2.0], vec![1.0], vec![f64::NAN, 3.0]] {
            probe
                .publish("wheels/commands", Float64MultiArray { data, ..Float64MultiArray::default() })
                .unwrap();
        }
        let forwarded = forwarded.take();
        let seen: Vec<_> =
            forwarded.iter().map(|command| (&command.name[..], &command.velocity[..])).collect();
        let names = ["left".to_owned(), "right".to_owned()];
        assert_eq!(seen, [(&names[..], &[1.0, -2.0][..]), (&names[1..], &[3.0][..])]);
        assert!(forwarded.iter().all(|command| command.position.is_empty() && command.effort.is_empty()));
    }

    #[test]
    fn an_unknown_interface_is_refused() {
        let refused = add(&mut Probe::new(), "torque").unwrap_err().to_string();
        assert!(refused.contains("\"torque\" is none of position, velocity, effort"), "{refused}");
    }
}
