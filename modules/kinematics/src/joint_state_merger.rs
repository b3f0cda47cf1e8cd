//! Merges the joint states of several buses into one message, joint by joint.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | the topics in the setting `sources` (in) | sensor_msgs/JointState | the joints of each bus |
//! | `joint_states` | sensor_msgs/JointState | all of them, at `rate_hz`, with the newest of their stamps |
//!
//! | setting | default | |
//! | --- | --- | --- |
//! | `sources` | required | topics of joint states |
//! | `rate_hz` | 100 | the most that is published; 0: with each message of a source |
//! | `timeout_s` | 1 | how long a joint stays without a new value, s |
//! | `robot_description` | empty | the URDF file, or its text: joints with `<mimic>` that no source has follow their leaders |
//!
//! Joints keep the order of `sources` and of their messages. Nothing is published without a new value. Where
//! some joints have a velocity or an effort and others have none, these have NaN. If several sources have one
//! joint, the value with the newest stamp applies, and of one stamp the last that came; both topics are
//! logged once. A stamp of 0 is the time of arrival.
//!
//! A source that falls silent, or that has not sent anything `timeout_s` after the start, is reported with
//! its joints, which are left out until it speaks again.
//!
//! # References
//! `joint_state_publisher` of `ros/joint_state_publisher`, branch `ros2`, merges `source_list` in the same
//! way.

use crate::Robot;
use crate::robot_description;
use downbeat_executor::{
    Context, Module, Publication, Received, Setting, Setup, SetupError, Task, Time, TransitionError,
};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::sensor_msgs::msg::JointState;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Merges joint states; see the [module page](self).
#[derive(Debug, Default)]
pub struct JointStateMerger {
    sources: Vec<Source>,
    /// By name: the source whose value applies.
    owners: BTreeMap<String, usize>,
    /// Joints of several sources that were reported.
    reported: BTreeSet<String>,
    robot: Option<Robot>,
    has_news: bool,
    published_at: Option<Time>,
    is_scheduled: bool,
}

#[derive(Debug, Default)]
struct Source {
    topic: String,
    /// In the order in which they came first.
    joints: Vec<Joint>,
    heard_at: Time,
    is_silent: bool,
}

#[derive(Debug)]
struct Joint {
    name: String,
    values: Values,
    stamp: Time,
    seen_at: Time,
}

/// Position, velocity and effort.
type Values = [Option<f64>; 3];

/// The keys of [`JointStateMerger`].
pub struct Ports {
    joint_states: Publication<JointState>,
    rate_hz: Setting<f64>,
    timeout_s: Setting<f64>,
    /// Publishes what came within a period.
    later: Task,
}

/// More joints than any robot has.
const MANY: usize = 1024;

/// How often sources are looked for that have fallen silent.
const LOOK: Duration = Duration::from_millis(100);

impl JointStateMerger {
    fn on_states(&mut self, source: usize, state: &JointState, ctx: &mut Context<'_, Ports>) {
        let (now, stamp) = (ctx.now(), Time::from_nanos(state.header.stamp.as_nanos()));
        let stamp = if stamp == Time::ZERO { now } else { stamp };
        let of = &mut self.sources[source];
        of.heard_at = now;
        if std::mem::take(&mut of.is_silent) {
            tracing::info!("\"{}\" speaks again", of.topic);
        }
        for (index, name) in state.name.iter().enumerate() {
            let value = |values: &[f64]| values.get(index).copied();
            let values = [value(&state.position), value(&state.velocity), value(&state.effort)];
            self.take(source, name, values, stamp, now);
        }
        self.has_news = true;
        self.publish_if_due(ctx);
    }

    fn take(&mut self, source: usize, name: &str, values: Values, stamp: Time, now: Time) {
        let joints = &mut self.sources[source].joints;
        if let Some(joint) = joints.iter_mut().find(|joint| joint.name == name) {
            (joint.values, joint.stamp, joint.seen_at) = (values, stamp, now);
        } else if joints.len() < MANY {
            joints.push(Joint { name: name.to_owned(), values, stamp, seen_at: now });
        } else {
            // Names are invented.
            return;
        }
        let owner = *self.owners.entry(name.to_owned()).or_insert(source);
        if owner == source {
            return;
        }
        if self.reported.insert(name.to_owned()) {
            tracing::warn!(
                "joint \"{name}\" is in \"{}\" and in \"{}\": the value with the newest stamp applies",
                self.sources[owner].topic,
                self.sources[source].topic
            );
        }
        let held = self.sources[owner].joints.iter().find(|joint| joint.name == name);
        if held.is_none_or(|held| held.stamp <= stamp) {
            self.owners.insert(name.to_owned(), source);
        }
    }

    /// Publishes what is new, now or when the period is over.
    fn publish_if_due(&mut self, ctx: &mut Context<'_, Ports>) {
        let rate_hz = *ctx.get(ctx.ports.rate_hz);
        let period = match rate_hz {
            0.0 => Duration::ZERO,
            rate => Duration::from_secs_f64((1.0 / rate).min(LONGEST_PERIOD_S)),
        };
        // Also after a time that has gone back.
        let waited = self.published_at.map(|at| ctx.now().saturating_since(at));
        match waited.filter(|waited| *waited < period && self.published_at <= Some(ctx.now())) {
            None => self.publish(ctx),
            Some(waited) if !self.is_scheduled => {
                self.is_scheduled = true;
                ctx.schedule_after(ctx.ports.later, period - waited);
            }
            Some(_) => {}
        }
    }

    fn publish(&mut self, ctx: &mut Context<'_, Ports>) {
        if !std::mem::take(&mut self.has_news) {
            return;
        }
        self.forget_old(ctx);
        self.published_at = Some(ctx.now());
        let mut merged: Vec<(&str, Values)> = Vec::new();
        let mut stamp = Time::ZERO;
        for (index, source) in self.sources.iter().enumerate() {
            for joint in source.joints.iter().filter(|joint| self.owners.get(&joint.name) == Some(&index)) {
                merged.push((&joint.name, joint.values));
                stamp = stamp.max(joint.stamp);
            }
        }
        let mimicking = self.robot.as_ref().map_or_else(Vec::new, |robot| mimicking(robot, &merged));
        merged.extend(mimicking.iter().map(|(name, values)| (&**name, *values)));
        if merged.is_empty() {
            return;
        }
        let mut state = JointState::default();
        state.header.stamp = Stamp::from_nanos(stamp.as_nanos());
        let [position, velocity, effort] = [0, 1, 2].map(|which| column(&merged, which));
        (state.position, state.velocity, state.effort) = (position, velocity, effort);
        state.name = merged.into_iter().map(|(name, _)| name.to_owned()).collect();
        ctx.publish(ctx.ports.joint_states, state);
    }

    /// Drops joints without a value for some time, and gives those to another source that has them.
    fn forget_old(&mut self, ctx: &Context<'_, Ports>) {
        let oldest = Duration::from_secs_f64(*ctx.get(ctx.ports.timeout_s));
        let now = ctx.now();
        for source in &mut self.sources {
            source.joints.retain(|joint| now.saturating_since(joint.seen_at) <= oldest);
        }
        let sources = &self.sources;
        let has = |source: usize, name: &str| sources[source].joints.iter().any(|joint| joint.name == name);
        self.owners.retain(|name, owner| {
            let other = || (0..sources.len()).find(|&source| has(source, name));
            match has(*owner, name).then_some(*owner).or_else(other) {
                Some(found) => *owner = found,
                None => return false,
            }
            true
        });
    }

    /// Reports sources that have fallen silent.
    fn look(&mut self, ctx: &mut Context<'_, Ports>) {
        let timeout_s = *ctx.get(ctx.ports.timeout_s);
        for source in self.sources.iter_mut().filter(|source| !source.is_silent) {
            if ctx.now().saturating_since(source.heard_at).as_secs_f64() <= timeout_s {
                continue;
            }
            source.is_silent = true;
            let joints: Vec<&str> = source.joints.iter().map(|joint| &*joint.name).collect();
            match joints.is_empty() {
                true => tracing::warn!("nothing has come on \"{}\" for {timeout_s} s", source.topic),
                false => tracing::warn!(
                    "nothing has come on \"{}\" for {timeout_s} s: its joints are left out: {}",
                    source.topic,
                    joints.join(", ")
                ),
            }
        }
    }
}

/// Between two messages.
const LONGEST_PERIOD_S: f64 = 3600.0;

/// The values of one kind, NaN where there are none; empty if no joint has one.
fn column(merged: &[(&str, Values)], which: usize) -> Vec<f64> {
    match merged.iter().any(|(_, values)| values[which].is_some()) {
        true => merged.iter().map(|(_, values)| values[which].unwrap_or(f64::NAN)).collect(),
        false => Vec::new(),
    }
}

/// Joints that no source has and that mimic one, or one that mimics one, that some source has.
fn mimicking(robot: &Robot, known: &[(&str, Values)]) -> Vec<(String, Values)> {
    let value_of = |name: &str| known.iter().find(|(known, _)| *known == name).map(|(_, values)| *values);
    let mut found = Vec::new();
    for joint in robot.joints().iter().filter(|joint| value_of(&joint.name).is_none()) {
        let (mut multiplier, mut offset, mut leader) = (1.0, 0.0, joint);
        while let Some(mimic) = leader.mimic {
            offset += multiplier * mimic.offset;
            multiplier *= mimic.multiplier;
            leader = &robot.joints()[mimic.joint.index()];
            if let Some([position, velocity, _]) = value_of(&leader.name) {
                let position = position.map(|position| multiplier * position + offset);
                let velocity = velocity.map(|velocity| multiplier * velocity);
                found.push((joint.name.clone(), [position, velocity, None]));
                break;
            }
        }
    }
    found
}

impl Module for JointStateMerger {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        self.robot = robot_description::declare(setup)?.map(|description| description.robot);
        let key: Setting<Vec<String>> =
            setup.read_only_setting("sources", Vec::new(), "topics of joint states")?;
        let topics = setup.value(key).cloned().unwrap_or_default();
        if topics.is_empty() {
            let reason = "it names no topic: give those of the buses, such as [\"left/joint_states\", \"right/joint_states\"]";
            return Err(setup.refuse_value(key, reason));
        }
        for (source, topic) in topics.iter().enumerate() {
            if topics[..source].contains(topic) {
                return Err(setup.refuse_value(key, format!("it names \"{topic}\" twice")));
            }
            setup.subscribe(topic, move |merger: &mut Self, state: Received<'_, JointState>, ctx| {
                merger.on_states(source, &state, ctx);
            })?;
        }
        if topics.iter().any(|topic| topic == "joint_states") {
            return Err(setup.refuse_value(
                key,
                "it names \"joint_states\", which is what is published: remap the topic of that bus, and name it here",
            ));
        }
        self.sources = topics.into_iter().map(|topic| Source { topic, ..Source::default() }).collect();
        setup.every(LOOK, Self::look)?;
        let later = setup.task(|merger: &mut Self, ctx| {
            merger.is_scheduled = false;
            merger.publish(ctx);
        });
        Ok(Ports {
            joint_states: setup.publish("joint_states")?,
            rate_hz: setup.setting_in(
                "rate_hz",
                100.0,
                0.0..=10_000.0,
                "Hz; 0: with each message of a source",
            )?,
            timeout_s: setup.setting_in(
                "timeout_s",
                1.0,
                0.001..=3600.0,
                "s; how long a joint stays without a new value",
            )?,
            later,
        })
    }

    fn activate(&mut self, ctx: &mut Context<'_, Ports>) -> Result<(), TransitionError> {
        self.is_scheduled = false;
        for source in &mut self.sources {
            source.heard_at = ctx.now();
        }
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
    use crate::testing::{Collector, core_at_zero};
    use downbeat_executor::{Clock, Core, Inlet, ManualClock, ModuleOptions, SettingValue};

    struct Buses {
        core: Core,
        clock: ManualClock,
        merged: Collector<JointState>,
        left: Inlet<JointState>,
        right: Inlet<JointState>,
    }

    fn add(core: &mut Core, settings: &[(&str, SettingValue)]) -> Result<(), SetupError> {
        let settings = settings.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect();
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        core.add_with("merger", JointStateMerger::default(), options).map(drop)
    }

    fn sources(topics: &[&str]) -> SettingValue {
        topics.iter().map(ToString::to_string).collect::<Vec<_>>().into()
    }

    impl Buses {
        fn new(more: &[(&str, SettingValue)]) -> Self {
            let (mut core, clock) = core_at_zero();
            let mut settings = vec![("sources", sources(&["left", "right"]))];
            settings.extend(more.iter().cloned());
            add(&mut core, &settings).unwrap();
            let merged = Collector::add(&mut core, "joint_states");
            let [left, right] = ["left", "right"].map(|topic| core.inlet(topic).unwrap());
            core.cycle().unwrap();
            Self { core, clock, merged, left, right }
        }

        fn after(&mut self, ms: u64) -> Vec<JointState> {
            self.clock.advance(Duration::from_millis(ms));
            (0..3).for_each(|_| self.core.cycle().unwrap());
            self.merged.take()
        }

        /// A state whose stamp is now, and `ms` later.
        fn state(&self, ms: i64, joints: &[(&str, f64)]) -> JointState {
            let stamp = self.clock.now().as_nanos() + ms * 1_000_000;
            let mut state = JointState::default();
            state.header.stamp = Stamp::from_nanos(stamp);
            state.name = joints.iter().map(|(name, _)| (*name).to_owned()).collect();
            state.position = joints.iter().map(|(_, position)| *position).collect();
            state
        }
    }

    #[test]
    fn joints_of_all_sources_are_one_message_with_the_newest_stamp() {
        let mut buses = Buses::new(&[("rate_hz", 0.0.into())]);
        let mut left = buses.state(5, &[("knee", 1.0)]);
        left.velocity = vec![0.5];
        buses.left.publish(left.clone()).unwrap();
        assert_eq!(buses.after(1).pop().unwrap(), left);
        let right = buses.state(-1, &[("elbow", 2.0), ("wrist", 3.0)]);
        buses.right.publish(right).unwrap();
        let merged = buses.after(1).pop().unwrap();
        assert_eq!(
            (merged.name, merged.position),
            (vec!["knee".into(), "elbow".into(), "wrist".into()], vec![1.0, 2.0, 3.0])
        );
        assert!(merged.velocity[0] == 0.5 && merged.velocity[1..].iter().all(|value| value.is_nan()));
        assert_eq!((merged.header.stamp, merged.effort.len()), (left.header.stamp, 0));
    }

    #[test]
    fn it_publishes_at_the_rate_and_only_what_is_new() {
        let mut buses = Buses::new(&[("rate_hz", 50.0.into())]);
        let mut count = 0;
        for number in 0..100 {
            buses.left.publish(buses.state(0, &[("knee", f64::from(number))])).unwrap();
            buses.right.publish(buses.state(0, &[("elbow", f64::from(number))])).unwrap();
            count += buses.after(4).len();
        }
        assert!((19..=22).contains(&count), "{count} in 0.4 s");
        assert_eq!(buses.after(100).len() + buses.after(100).len(), 1, "the last value");
    }

    #[test]
    fn of_a_joint_of_two_sources_the_newest_stamp_applies() {
        let mut buses = Buses::new(&[("rate_hz", 0.0.into())]);
        for (is_left, ms, position, expected) in [
            (true, 0, 1.0, 1.0),
            (false, -5, 2.0, 1.0),
            (false, 5, 3.0, 3.0),
            (true, 1, 4.0, 3.0),
            (true, 20, 5.0, 5.0),
        ] {
            let state = buses.state(ms, &[("neck", position)]);
            if is_left { &buses.left } else { &buses.right }.publish(state).unwrap();
            let merged = buses.after(1).pop().unwrap();
            assert_eq!((merged.name.len(), merged.position), (1, vec![expected]), "{position}");
        }
    }

    #[test]
    fn a_silent_source_is_left_out_until_it_speaks_again() {
        let mut buses = Buses::new(&[("rate_hz", 0.0.into()), ("timeout_s", 0.2.into())]);
        buses.right.publish(buses.state(0, &[("elbow", 1.0), ("neck", 2.0)])).unwrap();
        buses.after(1);
        for number in 0..30 {
            buses.left.publish(buses.state(0, &[("knee", f64::from(number))])).unwrap();
            let merged = buses.after(10).pop().unwrap();
            assert_eq!(merged.name.len(), if number < 20 { 3 } else { 1 }, "{number}");
        }
        buses.right.publish(buses.state(0, &[("elbow", 3.0)])).unwrap();
        assert_eq!(buses.after(10).pop().unwrap().name, ["knee", "elbow"]);
    }

    #[test]
    fn joints_that_mimic_others_follow_them_unless_a_source_has_them() {
        let urdf = r#"<robot name="gripper"><link name="a"/><link name="b"/><link name="c"/><link name="d"/>
            <joint name="finger" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
            <joint name="other" type="revolute"><parent link="a"/><child link="c"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/><mimic joint="finger" multiplier="-2" offset="0.25"/></joint>
            <joint name="tip" type="revolute"><parent link="c"/><child link="d"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/><mimic joint="other" multiplier="0.5"/></joint>
            </robot>"#;
        let mut buses = Buses::new(&[("rate_hz", 0.0.into()), ("robot_description", urdf.to_owned().into())]);
        let mut state = buses.state(0, &[("finger", 0.5)]);
        state.velocity = vec![1.0];
        buses.left.publish(state).unwrap();
        let merged = buses.after(1).pop().unwrap();
        assert_eq!(merged.name, ["finger", "other", "tip"]);
        assert_eq!((merged.position, merged.velocity), (vec![0.5, -0.75, -0.375], vec![1.0, -2.0, -1.0]));
        buses.right.publish(buses.state(0, &[("other", 0.1)])).unwrap();
        assert_eq!(buses.after(1).pop().unwrap().position, [0.5, 0.1, 0.05]);
    }

    #[test]
    fn sources_that_make_no_sense_are_refused() {
        for (topics, words) in [
            (&[][..], "names no topic"),
            (&["left", "left"], "twice"),
            (&["left", "joint_states"], "which is what is published"),
        ] {
            let refused = add(&mut Core::new(), &[("sources", sources(topics))]).unwrap_err().to_string();
            assert!(refused.contains(words), "{refused}");
        }
    }

    #[test]
    fn invented_names_do_not_fill_the_memory() {
        let mut buses = Buses::new(&[("rate_hz", 0.0.into())]);
        for number in 0..200 {
            let names: Vec<String> = (0..20).map(|joint| format!("joint{number}.{joint}")).collect();
            let joints: Vec<_> = names.iter().map(|name| (name.as_str(), 0.0)).collect();
            buses.left.publish(buses.state(0, &joints)).unwrap();
            assert!(buses.after(1).pop().unwrap().name.len() <= MANY);
        }
    }
}
