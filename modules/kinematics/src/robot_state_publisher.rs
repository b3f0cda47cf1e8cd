//! Publishes where the links of a robot are, from its description and the positions of its joints, like ROS's
//! package of this name.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `joint_states` (in) | sensor_msgs/JointState | positions by name; unknown names, NaN and missing positions are ignored |
//! | `tf` | tf2_msgs/TFMessage | the joints that move, with the stamp of their positions |
//! | `tf_static` | tf2_msgs/TFMessage | the fixed joints, once; expose it latched |
//! | `robot_description` | std_msgs/String | the URDF, once; expose it latched |
//!
//! | setting | default | |
//! | --- | --- | --- |
//! | `robot_description` | required | the URDF file, or its text |
//! | `publish_frequency` | 20 | Hz; the maximum rate of each joint on `tf` |
//! | `frame_prefix` | empty | before the names of all frames, for several robots |
//! | `ignore_timestamp` | false | publish all positions, however close or old their stamps are |
//!
//! A joint with `<mimic>` follows its leader where a message does not contain it; a position of its own has
//! precedence. A joint is published when the stamps of its positions are at least a period apart, and after
//! stamps have gone back. Floating joints are not published, as their poses come from elsewhere; planar
//! joints count as fixed.
//!
//! # References
//! `robot_state_publisher` of `ros/robot_state_publisher`, branch jazzy.

use crate::description::{JointKind, Robot};
use crate::robot_description::{self, NoDescription};
use downbeat_executor::{
    Context, Module, Publication, Received, Setting, Setup, SetupError, TransitionError,
};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::geometry_msgs::msg::TransformStamped;
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::std_msgs::msg::{Header, String as Text};
use downbeat_transforms::{Isometry, TransformBroadcaster, transform_message};
use std::collections::BTreeMap;

/// Publishes where the links of a robot are; see the [module page](self).
#[derive(Default)]
pub struct RobotStatePublisher {
    publishing: Option<Publishing>,
}

/// The keys of [`RobotStatePublisher`].
pub struct Ports {
    transforms: TransformBroadcaster,
    description: Publication<Text>,
    publish_frequency: Setting<f64>,
    ignore_timestamp: Setting<bool>,
}

struct Publishing {
    robot: Robot,
    text: String,
    frame_prefix: String,
    /// The joints that have positions, by name, as indices of `Robot::joints`.
    joints: BTreeMap<String, usize>,
    /// When the position of each joint was last published, in ns.
    published_at: Vec<Option<i64>>,
    /// The position of each joint in the current message.
    given: Vec<Option<f64>>,
    last_stamp: i64,
}

impl RobotStatePublisher {
    fn on_joint_states(&mut self, state: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        let Some(publishing) = &mut self.publishing else { return };
        let period_ns = match *ctx.get(ctx.ports.ignore_timestamp) {
            true => None,
            false => Some((1e9 / *ctx.get(ctx.ports.publish_frequency)) as i64),
        };
        let moving = publishing.moving(&state, period_ns);
        if !moving.is_empty() {
            ctx.ports.transforms.send(ctx, moving);
        }
    }
}

impl Module for RobotStatePublisher {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let description = robot_description::declare(setup)?;
        let frame_prefix: Setting<String> =
            setup.read_only_setting("frame_prefix", String::new(), "before the names of all frames")?;
        let frame_prefix = setup.value(frame_prefix).cloned().unwrap_or_default();
        self.publishing =
            description.map(|description| Publishing::new(description.robot, description.text, frame_prefix));
        setup.subscribe("joint_states", Self::on_joint_states)?;
        let what = "Hz; the maximum rate of each joint on tf";
        Ok(Ports {
            transforms: TransformBroadcaster::declare(setup)?,
            description: setup.publish("robot_description")?,
            publish_frequency: setup.setting_in("publish_frequency", 20.0, 0.001..=1e6, what)?,
            ignore_timestamp: setup.setting(
                "ignore_timestamp",
                false,
                "publish all positions, whatever their stamps",
            )?,
        })
    }

    fn activate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        let Some(publishing) = &self.publishing else { return Err(NoDescription.into()) };
        let fixed = publishing.fixed(&Stamp::from_nanos(ctx.now().as_nanos()));
        ctx.ports.transforms.send_static(ctx, fixed);
        ctx.publish(ctx.ports.description, Text { data: publishing.text.clone() });
        Ok(())
    }
}

impl Publishing {
    fn new(robot: Robot, text: String, frame_prefix: String) -> Self {
        let positioned = robot.joints().iter().zip(0..).filter(|(joint, _)| joint.kind.has_position());
        let joints = positioned.map(|(joint, index)| (joint.name.clone(), index)).collect();
        let count = robot.joints().len();
        let (published_at, given) = (vec![None; count], vec![None; count]);
        Self { robot, text, frame_prefix, joints, published_at, given, last_stamp: i64::MIN }
    }

    /// The transforms that follow from a message: with a period, only those of joints that were last
    /// published that long ago.
    fn moving(&mut self, state: &JointState, period_ns: Option<i64>) -> Vec<TransformStamped> {
        let stamp = state.header.stamp.as_nanos();
        if stamp < self.last_stamp {
            self.published_at.fill(None);
        }
        self.last_stamp = stamp;
        self.given.fill(None);
        for (name, position) in state.name.iter().zip(&state.position) {
            if let Some(&index) = self.joints.get(name).filter(|_| position.is_finite()) {
                self.given[index] = Some(*position);
            }
        }
        let mut transforms = Vec::new();
        for index in 0..self.robot.joints().len() {
            let last = self.published_at[index];
            let is_early =
                period_ns.zip(last).is_some_and(|(period, last)| stamp.saturating_sub(last) < period);
            if let (Some(position), false) = (self.position(index), is_early) {
                self.published_at[index] = Some(stamp);
                let parent_from_child = self.robot.joints()[index].parent_from_child_at(position);
                transforms.push(self.transform(index, parent_from_child, &state.header.stamp));
            }
        }
        transforms
    }

    /// The position of a joint by the current message: its own, or what follows from the joint that it
    /// mimics.
    fn position(&self, index: usize) -> Option<f64> {
        let (mut index, mut multiplier, mut offset) = (index, 1.0, 0.0);
        loop {
            if let Some(given) = self.given[index] {
                return Some(multiplier * given + offset);
            }
            let mimic = self.robot.joints()[index].mimic?;
            offset += multiplier * mimic.offset;
            multiplier *= mimic.multiplier;
            index = mimic.joint.index();
        }
    }

    fn fixed(&self, stamp: &Stamp) -> Vec<TransformStamped> {
        let joints = self.robot.joints().iter().zip(0..);
        let fixed = joints.filter(|(joint, _)| matches!(joint.kind, JointKind::Fixed | JointKind::Planar));
        fixed.map(|(joint, index)| self.transform(index, joint.parent_from_joint, stamp)).collect()
    }

    fn transform(&self, joint: usize, parent_from_child: Isometry, stamp: &Stamp) -> TransformStamped {
        let joint = &self.robot.joints()[joint];
        let frame = |link| format!("{}{}", self.frame_prefix, self.robot.link(link).name);
        TransformStamped {
            header: Header { stamp: *stamp, frame_id: frame(joint.parent) },
            child_frame_id: frame(joint.child),
            transform: transform_message(&parent_from_child),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::testing::{Collector, core_at_zero};
    use downbeat_executor::{Core, ModuleOptions, SettingValue};
    use downbeat_msgs::tf2_msgs::msg::TFMessage;

    const GRIPPER: &str = r#"<robot name="gripper">
      <link name="palm"/>
      <joint name="left" type="prismatic"><parent link="palm"/><child link="left"/><axis xyz="0 1 0"/>
        <limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
      <link name="left"/>
      <joint name="right" type="prismatic"><parent link="palm"/><child link="right"/><axis xyz="0 1 0"/>
        <limit lower="-0.1" upper="0" effort="1" velocity="1"/><mimic joint="left" multiplier="-1"/></joint>
      <link name="right"/>
      <joint name="wrist" type="continuous"><parent link="palm"/><child link="arm"/></joint>
      <link name="arm"/>
      <joint name="mount" type="fixed"><parent link="arm"/><child link="camera"/><origin xyz="0.1 0 0"/></joint>
      <link name="camera"/>
    </robot>"#;

    fn core(settings: &[(&str, SettingValue)]) -> (Core, Collector<TFMessage>, Collector<TFMessage>) {
        let (mut core, _) = core_at_zero();
        let described = ("robot_description".to_owned(), GRIPPER.to_owned().into());
        let settings = settings.iter().map(|(name, value)| ((*name).to_owned(), value.clone()));
        let settings = settings.chain([described]).collect();
        let [moving, fixed] = ["tf", "tf_static"].map(|topic| Collector::add(&mut core, topic));
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        core.add_with("publisher", RobotStatePublisher::default(), options).unwrap();
        (core, moving, fixed)
    }

    fn publish(core: &mut Core, milliseconds: i64, joints: &[(&str, f64)]) {
        let mut state = JointState::default();
        state.header.stamp = Stamp::from_nanos(milliseconds * 1_000_000);
        state.name = joints.iter().map(|(name, _)| (*name).to_owned()).collect();
        state.position = joints.iter().map(|(_, position)| *position).collect();
        core.inlet("joint_states").unwrap().publish(state).unwrap();
        (0..3).try_for_each(|_| core.cycle()).unwrap();
    }

    /// The children with their y coordinates.
    fn children(messages: &[TFMessage]) -> Vec<(&str, f64)> {
        let transforms = messages.iter().flat_map(|message| &message.transforms);
        transforms.map(|transform| (&*transform.child_frame_id, transform.transform.translation.y)).collect()
    }

    #[test]
    fn fixed_joints_and_the_description_are_published_once() {
        let (mut core, moving, fixed) = core(&[("frame_prefix", "red/".to_owned().into())]);
        let descriptions = Collector::<Text>::add(&mut core, "robot_description");
        (0..3).try_for_each(|_| core.cycle()).unwrap();
        publish(&mut core, 0, &[("wrist", 0.0)]);
        assert_eq!(descriptions.take(), [Text { data: GRIPPER.into() }]);
        let fixed = fixed.take();
        assert_eq!((fixed.len(), fixed[0].transforms.len()), (1, 1));
        let mount = &fixed[0].transforms[0];
        assert_eq!((&*mount.header.frame_id, &*mount.child_frame_id), ("red/arm", "red/camera"));
        assert_eq!((mount.transform.translation.x, mount.header.stamp.sec), (0.1, 1000));
        assert_eq!(children(&moving.take()), [("red/arm", 0.0)]);
    }

    #[test]
    fn joints_with_mimic_follow_and_what_is_not_known_is_not_published() {
        let (mut core, moving, _) = core(&[]);
        publish(&mut core, 0, &[("left", 0.03), ("wrist", f64::NAN), ("nose", 1.0)]);
        let messages = moving.take();
        assert_eq!(children(&messages), [("left", 0.03), ("right", -0.03)]);
        assert_eq!(messages[0].transforms[0].header.frame_id, "palm");
    }

    #[test]
    fn a_published_position_of_a_joint_with_mimic_has_precedence() {
        let (mut core, moving, _) = core(&[]);
        publish(&mut core, 0, &[("left", 0.03), ("right", -0.07)]);
        assert_eq!(children(&moving.take()), [("left", 0.03), ("right", -0.07)]);
        publish(&mut core, 100, &[("right", -0.02)]);
        assert_eq!(children(&moving.take()), [("right", -0.02)]);
        publish(&mut core, 200, &[("left", 0.05), ("right", f64::NAN)]);
        assert_eq!(children(&moving.take()), [("left", 0.05), ("right", -0.05)]);
    }

    #[test]
    fn each_joint_is_published_at_most_with_the_frequency() {
        let (mut core, moving, _) = core(&[("publish_frequency", 20.0.into())]);
        publish(&mut core, 0, &[("left", 0.0)]);
        publish(&mut core, 20, &[("left", 0.01), ("wrist", 0.0)]);
        publish(&mut core, 49, &[("left", 0.02)]);
        publish(&mut core, 50, &[("left", 0.03), ("wrist", 0.0)]);
        let expected = [("left", 0.0), ("right", 0.0), ("arm", 0.0), ("left", 0.03), ("right", -0.03)];
        let published = moving.take();
        assert_eq!(children(&published), expected);
        // A simulation that starts again.
        publish(&mut core, 10, &[("wrist", 0.0)]);
        assert_eq!(children(&moving.take()), [("arm", 0.0)]);
    }

    #[test]
    fn time_stamps_can_be_ignored() {
        let (mut core, moving, _) = core(&[("ignore_timestamp", true.into())]);
        publish(&mut core, 0, &[("wrist", 0.0)]);
        publish(&mut core, 0, &[("wrist", 0.0)]);
        assert_eq!(moving.take().len(), 2);
    }
}
