//! Publishes where the links of a robot are, from its description and the positions of its joints, like ROS's package of
//! this name.
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
//! A joint with `<mimic>` follows its leader, and `joint_states` need not contain it. A joint is published when the
//! stamps of its positions are at least a period apart, and after stamps have gone back.
//!
//! # References
//! `robot_state_publisher` of `ros/robot_state_publisher`, branch jazzy.

use crate::robot_description::{self, NoDescription};
use crate::transforms::{Isometry, TransformBroadcaster, transform_message};
use downbeat_executor::{
    Context, Module, Publication, Received, Setting, Setup, SetupError, TransitionError,
};
use downbeat_kinematics::description::{JointKind, Robot};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::geometry_msgs::msg::TransformStamped;
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::std_msgs::msg::{Header, String as Text};
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
    coordinates: BTreeMap<String, usize>,
    /// The known positions of the robot.
    positions: Vec<f64>,
    /// When the positions of each coordinate were last published, in ns.
    published_at: Vec<Option<i64>>,
    /// Of the current message.
    is_due: Vec<bool>,
    last_stamp: i64,
}

impl RobotStatePublisher {
    fn on_joint_states(&mut self, state: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        let Some(publishing) = &mut self.publishing else { return };
        let period_ns = match *ctx.get(ctx.ports.ignore_timestamp) {
            true => None,
            false => Some((1e9 / *ctx.get(ctx.ports.publish_frequency)) as i64),
        };
        if publishing.take(&state, period_ns) {
            let moving = publishing.moving(&state.header.stamp);
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
        let names = robot.coordinates().iter().map(|&id| robot.joint(id).name.clone());
        let coordinates: BTreeMap<String, usize> = names.zip(0..).collect();
        let count = coordinates.len();
        Self {
            robot,
            text,
            frame_prefix,
            coordinates,
            positions: vec![0.0; count],
            published_at: vec![None; count],
            is_due: vec![false; count],
            last_stamp: i64::MIN,
        }
    }

    /// Takes the positions of a message. Returns whether any of them is to be published: with a period, only those of joints
    /// that were last published that long ago.
    fn take(&mut self, state: &JointState, period_ns: Option<i64>) -> bool {
        let stamp = state.header.stamp.as_nanos();
        if stamp < self.last_stamp {
            self.published_at.fill(None);
        }
        self.last_stamp = stamp;
        self.is_due.fill(false);
        for (name, position) in state.name.iter().zip(&state.position) {
            let Some(&index) = self.coordinates.get(name).filter(|_| position.is_finite()) else { continue };
            let last = self.published_at[index];
            let is_early =
                period_ns.zip(last).is_some_and(|(period, last)| stamp.saturating_sub(last) < period);
            if !is_early {
                self.positions[index] = *position;
                self.published_at[index] = Some(stamp);
                self.is_due[index] = true;
            }
        }
        self.is_due.contains(&true)
    }

    /// The transforms of the joints that are due.
    fn moving(&self, stamp: &Stamp) -> Vec<TransformStamped> {
        let is_due = |index: usize| {
            self.robot.joints()[index].drive.is_some_and(|drive| self.is_due[drive.coordinate])
        };
        let due = (0..self.robot.joints().len()).filter(|&index| is_due(index));
        due.map(|index| self.transform(index, stamp)).collect()
    }

    fn fixed(&self, stamp: &Stamp) -> Vec<TransformStamped> {
        let is_fixed = |index: &usize| self.robot.joints()[*index].kind == JointKind::Fixed;
        (0..self.robot.joints().len()).filter(is_fixed).map(|index| self.transform(index, stamp)).collect()
    }

    fn transform(&self, joint: usize, stamp: &Stamp) -> TransformStamped {
        let joint = &self.robot.joints()[joint];
        let frame = |link| format!("{}{}", self.frame_prefix, self.robot.link(link).name);
        let parent_from_child: Isometry = joint.parent_from_child(&self.positions);
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
