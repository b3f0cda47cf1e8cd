//! Lets an arm follow another one that a hand moves.
//!
//! | topic, service | type | |
//! | --- | --- | --- |
//! | `leader/joint_states` (in) | `sensor_msgs/JointState` | of the arm that is moved by hand |
//! | `joint_states` (in) | `sensor_msgs/JointState` | of the arm that follows |
//! | `joint_commands` | `sensor_msgs/JointState` | positions for the arm that follows, with each message of the leader |
//! | `leader/joint_torque` | `sensor_msgs/JointState` | takes the torque off the leader when its joints are first seen, and while it is followed |
//! | `follow` (service) | `std_srvs/SetBool` | begins and ends following; at the end the follower stays where it is |
//!
//! | setting | default | |
//! | --- | --- | --- |
//! | `joints` | | the joints that follow; without any all that both arms have |
//! | `scale` | | for each of `joints` by what the angle of the leader is multiplied: a gripper that is held differently |
//! | `following` | false | whether it follows from the start |
//! | `handover_speed` | 0.5 | rad/s; how fast a joint goes to where the leader is, when following begins |
//!
//! A joint first moves from where the follower is to where the leader is, at `handover_speed`; from then on
//! it follows each message. If the leader is silent for 0.25 s, the follower stays where it is, and begins
//! anew.

use std::collections::BTreeMap;
use std::time::Duration;

use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse};

use crate::stamps::header;

/// A leader that is silent for longer is not followed.
const SILENCE: Duration = Duration::from_millis(250);

/// How often the torque of the leader is taken off while the follower follows. Once would not be enough: a
/// message on a network may be lost.
const RELEASE: Duration = Duration::from_secs(1);

/// The longest time for which a joint moves at once on its way to the leader.
const LONGEST_STEP: f64 = 0.05;

/// More names than any arm has joints.
const MANY: usize = 256;

/// Lets an arm follow another one; see the [module page](self).
#[derive(Debug, Default)]
pub struct LeaderArm {
    joints: Vec<String>,
    scale: Vec<f64>,
    is_following: bool,
    /// The joints of the leader whose torque was taken off.
    limp: Vec<String>,
    /// Where the follower is, in rad.
    follower: BTreeMap<String, f64>,
    /// The joints that have arrived at the leader or are on their way, with their last goals.
    goals: BTreeMap<String, Goal>,
    last: Option<Time>,
    released: Option<Time>,
}

#[derive(Clone, Copy, Debug)]
struct Goal {
    angle: f64,
    has_arrived: bool,
    /// When it followed from a measurement.
    at: Time,
}

/// The keys of [`LeaderArm`].
pub struct Ports {
    commands: Publication<JointState>,
    torque: Publication<JointState>,
    handover_speed: Setting<f64>,
}

impl LeaderArm {
    fn on_follower(&mut self, states: Received<'_, JointState>, _: &mut Context<'_, Ports>) {
        for (name, angle) in states.name.iter().zip(&states.position).filter(|(_, angle)| angle.is_finite()) {
            if let Some(known) = self.follower.get_mut(name) {
                *known = *angle;
            } else if self.follower.len() < MANY {
                self.follower.insert(name.clone(), *angle);
            }
        }
    }

    fn on_leader(&mut self, states: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        let is_new = |name: &&String| !self.limp.contains(name);
        let unknown: Vec<_> = states.name.iter().filter(is_new).take(MANY).cloned().collect();
        if !unknown.is_empty() && self.limp.len() < MANY {
            self.limp.extend(unknown);
            self.release(ctx);
        }
        let now = ctx.now();
        let since = self.last.map(|last| now.saturating_since(last)).unwrap_or_default();
        self.last = Some(now);
        if !self.is_following {
            return;
        }
        if self.released.is_none_or(|released| now.saturating_since(released) > RELEASE) {
            self.release(ctx);
        }
        let reach = *ctx.get(ctx.ports.handover_speed) * since.as_secs_f64().min(LONGEST_STEP);
        let mut command = JointState { header: header(now, ""), ..JointState::default() };
        for (index, (name, angle)) in states.name.iter().zip(&states.position).enumerate() {
            // The last position of a servo that is silent has neither.
            let is_nan = |values: &[f64]| values.get(index).is_some_and(|value| value.is_nan());
            if is_nan(&states.velocity) && is_nan(&states.effort) {
                continue;
            }
            if let Some(angle) = self.goal(name, *angle, reach, now) {
                command.name.push(name.clone());
                command.position.push(angle);
            }
        }
        if !command.name.is_empty() {
            ctx.publish(ctx.ports.commands, command);
        }
    }

    /// Where a joint is to go, if it follows and its place is known. It moves by at most `reach` until it has
    /// arrived, and begins anew after a silence of the leader.
    fn goal(&mut self, name: &str, leader: f64, reach: f64, now: Time) -> Option<f64> {
        let place = self.joints.iter().position(|known| known == name);
        if !leader.is_finite() || (place.is_none() && !self.joints.is_empty()) {
            return None;
        }
        let wanted = leader * place.and_then(|place| self.scale.get(place)).copied().unwrap_or(1.0);
        let start = Goal { angle: *self.follower.get(name)?, has_arrived: false, at: now };
        let goal = self.goals.entry(name.to_owned()).or_insert(start);
        let silence = now.saturating_since(goal.at);
        if silence > SILENCE {
            tracing::warn!(
                "{name} of the leader was silent for {:.2} s: the follower stopped",
                silence.as_secs_f64()
            );
            *goal = start;
        }
        goal.at = now;
        goal.has_arrived = goal.has_arrived || (wanted - goal.angle).abs() <= reach;
        goal.angle =
            if goal.has_arrived { wanted } else { wanted.clamp(goal.angle - reach, goal.angle + reach) };
        Some(goal.angle)
    }

    /// Takes the torque off the leader.
    fn release(&mut self, ctx: &mut Context<'_, Ports>) {
        self.released = Some(ctx.now());
        let name = self.limp.clone();
        let effort = vec![0.0; name.len()];
        let header = header(ctx.now(), "");
        ctx.publish(ctx.ports.torque, JointState { header, name, effort, ..JointState::default() });
    }

    fn follow(&mut self, request: &SetBoolRequest, ctx: &mut Context<'_, Ports>) -> SetBoolResponse {
        self.is_following = request.data;
        self.goals.clear();
        if self.is_following && !self.limp.is_empty() {
            self.release(ctx);
        }
        let message = match (request.data, self.last) {
            (true, Some(_)) => "the arm goes to the leader, and follows it",
            (true, None) => {
                "it follows as soon as the leader is there: nothing came on leader/joint_states yet"
            }
            (false, _) => "the arm stays where it is",
        };
        SetBoolResponse { success: true, message: message.to_owned() }
    }
}

impl Module for LeaderArm {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let joints: Setting<Vec<String>> = setup.read_only_setting(
            "joints",
            Vec::new(),
            "joints that follow; without any all that both arms have",
        )?;
        let scale: Setting<Vec<f64>> = setup.read_only_setting(
            "scale",
            Vec::new(),
            "for each of joints by what the angle of the leader is multiplied",
        )?;
        let following = setup.read_only_setting("following", false, "whether it follows from the start")?;
        self.joints = setup.value(joints).cloned().unwrap_or_default();
        self.scale = setup.value(scale).cloned().unwrap_or_default();
        self.is_following = setup.value(following).copied().unwrap_or_default();
        if !self.scale.is_empty() && self.scale.len() != self.joints.len() {
            let (scales, joints) = (self.scale.len(), self.joints.len());
            return Err(setup.refuse_value(scale, format!("it has {scales} numbers for {joints} joints")));
        }
        setup.subscribe("joint_states", Self::on_follower)?;
        setup.subscribe("leader/joint_states", Self::on_leader)?;
        setup
            .serve("follow", |arm: &mut Self, request: &SetBoolRequest, ctx| Ok(arm.follow(request, ctx)))?;
        Ok(Ports {
            commands: setup.publish("joint_commands")?,
            torque: setup.publish("leader/joint_torque")?,
            handover_speed: setup.setting_in(
                "handover_speed",
                0.5,
                0.05..=10.0,
                "rad/s; how fast a joint goes to where the leader is, when following begins",
            )?,
        })
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::testing::{Collector, core_at_zero};
    use downbeat_executor::{Core, ManualClock, ModuleOptions, SettingValue};
    use std::sync::mpsc::channel;

    fn at(angles: &[(&str, f64)]) -> JointState {
        let (name, position) = angles.iter().map(|(name, angle)| ((*name).to_owned(), *angle)).unzip();
        JointState { name, position, ..JointState::default() }
    }

    fn add(core: &mut Core, settings: Vec<(&str, SettingValue)>) -> Result<(), SetupError> {
        let settings = settings.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        core.add_with("leader_arm", LeaderArm::default(), options).map(drop)
    }

    /// Two arms: `step` moves the leader, and the follower to where it was commanded.
    struct Arms {
        core: Core,
        clock: ManualClock,
        commands: Collector<JointState>,
        pan: f64,
    }

    impl Arms {
        fn new(settings: Vec<(&str, SettingValue)>) -> Self {
            let (mut core, clock) = core_at_zero();
            add(&mut core, settings).unwrap();
            let commands = Collector::add(&mut core, "joint_commands");
            Self { core, clock, commands, pan: 0.0 }
        }

        fn follow(&mut self, data: bool) -> String {
            let caller = self.core.caller::<SetBoolRequest, SetBoolResponse>("follow").unwrap();
            let (sender, answer) = channel();
            let answered = move |result: Result<SetBoolResponse, _>| drop(sender.send(result.unwrap()));
            caller.call(SetBoolRequest { data }, Duration::MAX, answered).unwrap();
            (0..4).for_each(|_| self.core.cycle().unwrap());
            answer.try_recv().unwrap().message
        }

        /// The goal of the joint, if there is one.
        fn step(&mut self, leader: f64, millis: u64) -> Option<f64> {
            self.clock.advance(Duration::from_millis(millis));
            for (topic, angles) in [
                ("joint_states", at(&[("pan", self.pan)])),
                ("leader/joint_states", at(&[("pan", leader), ("only_of_leader", 0.0)])),
            ] {
                self.core.inlet(topic).unwrap().publish(angles).unwrap();
            }
            (0..3).for_each(|_| self.core.cycle().unwrap());
            let command = self.commands.take().pop()?;
            assert_eq!(command.name, ["pan"]);
            self.pan = command.position[0];
            Some(self.pan)
        }
    }

    #[test]
    fn an_arm_goes_slowly_to_its_leader_follows_each_message_and_stops_with_it() {
        let mut arms = Arms::new(Vec::new());
        let torque = Collector::<JointState>::add(&mut arms.core, "leader/joint_torque");
        assert_eq!(arms.step(1.0, 10), None, "nothing moves before it is asked to");
        let released = torque.take();
        assert_eq!((released.len(), &released[0].effort), (1, &vec![0.0, 0.0]));
        assert!(arms.follow(true).contains("goes to the leader"));
        for number in 1..200 {
            let goal = arms.step(1.0, 10).unwrap();
            assert!((goal - f64::from(number) * 0.005).abs() < 1e-9, "{goal}: it moves at 0.5 rad/s");
        }
        assert_eq!(arms.step(1.0, 10), Some(1.0));
        assert_eq!(arms.step(-0.4, 10), Some(-0.4), "from now on each message");
        // After a pause it moves slowly again.
        assert_eq!(arms.step(0.4, 400), Some(-0.4 + 0.5 * LONGEST_STEP));
        // And while the servo of the joint alone is silent: the last position stays, without velocity and
        // effort.
        for _ in 0..200 {
            arms.step(0.4, 10);
        }
        assert_eq!(arms.pan, 0.4);
        let stale = JointState { velocity: vec![f64::NAN], effort: vec![f64::NAN], ..at(&[("pan", 0.4)]) };
        for _ in 0..40 {
            arms.clock.advance(Duration::from_millis(10));
            arms.core.inlet("leader/joint_states").unwrap().publish(stale.clone()).unwrap();
            (0..3).for_each(|_| arms.core.cycle().unwrap());
        }
        assert!(arms.commands.take().is_empty());
        assert_eq!(arms.step(-0.4, 10), Some(0.4 - 0.5 * 0.01));
        assert!(arms.follow(false).contains("stays"));
        assert_eq!(arms.step(0.4, 10), None);
    }

    #[test]
    fn joints_can_be_chosen_and_scaled() {
        let pan = vec!["pan".to_owned()];
        let mut arms = Arms::new(vec![
            ("joints", pan.clone().into()),
            ("scale", vec![-2.0].into()),
            ("following", true.into()),
            ("handover_speed", 10.0.into()),
        ]);
        for _ in 0..20 {
            arms.step(0.3, 10);
        }
        assert_eq!(arms.step(0.3, 10), Some(-0.6));
        let (mut core, _) = core_at_zero();
        let error =
            add(&mut core, vec![("joints", pan.into()), ("scale", vec![1.0, 2.0].into())]).unwrap_err();
        assert!(error.to_string().contains("2 numbers for 1 joints"), "{error}");
    }
}
