//! The controller in a core whose time the test moves.
#![allow(clippy::unwrap_used)]
use super::*;
use crate::testing::{Collector, core_at_zero};
use downbeat_executor::{Clock, Core, ManualClock, ModuleOptions, SettingValue};
use downbeat_msgs::action_msgs::srv::{CancelGoalRequest, CancelGoalResponse};
use downbeat_msgs::control_msgs::action::{
    FollowJointTrajectoryGetResultRequest, FollowJointTrajectoryGetResultResponse,
    FollowJointTrajectorySendGoalRequest, FollowJointTrajectorySendGoalResponse,
};
use downbeat_msgs::unique_identifier_msgs::msg::UUID;
use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, channel};

const SUCCEEDED: i8 = 4;
const CANCELED: i8 = 5;
const ABORTED: i8 = 6;

/// An arm of two joints that follows its commands one period later, unless it is stuck.
struct Arm {
    core: Core,
    clock: ManualClock,
    commands: Collector<JointState>,
    state: downbeat_executor::Inlet<JointState>,
    position: Vec<f64>,
    is_stuck: bool,
    /// No joint answers: `joint_states` stops, and no command arrives.
    is_cut: bool,
    /// The elbow does not answer.
    is_elbow_dead: bool,
}

impl Arm {
    fn new(settings: &[(&str, f64)]) -> Self {
        let (mut core, clock) = core_at_zero();
        let names = vec!["shoulder".to_owned(), "elbow".to_owned()];
        let mut settings: BTreeMap<String, SettingValue> =
            settings.iter().map(|(name, value)| ((*name).to_owned(), (*value).into())).collect();
        settings.insert("joints".into(), names.into());
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        core.add_with("arm", JointTrajectoryController::default(), options).unwrap();
        let commands = Collector::add(&mut core, "joint_commands");
        let state = core.inlet("joint_states").unwrap();
        let mut arm = Self {
            core,
            clock,
            commands,
            state,
            position: vec![0.0, 0.0],
            is_stuck: false,
            is_cut: false,
            is_elbow_dead: false,
        };
        arm.run(0.1);
        arm
    }

    fn run(&mut self, seconds: f64) {
        for _ in 0..(seconds * 125.0_f64).round() as u32 {
            if !self.is_cut {
                self.publish_state();
            }
            self.clock.advance(Duration::from_millis(8));
            (0..3).for_each(|_| self.core.cycle().unwrap());
            if let Some(command) = self.commands.take().pop().filter(|_| !self.is_stuck && !self.is_cut) {
                let elbow = self.position[1];
                self.position = command.position;
                if self.is_elbow_dead {
                    self.position[1] = elbow;
                }
            }
        }
    }

    /// As `servo_bus` does: a joint that does not answer keeps its last position.
    fn publish_state(&mut self) {
        let name = vec!["shoulder".into(), "elbow".into()];
        let velocity = vec![0.0, if self.is_elbow_dead { f64::NAN } else { 0.0 }];
        let (position, effort) = (self.position.clone(), velocity.clone());
        let header = header(self.clock.now(), "");
        self.state.publish(JointState { header, name, position, velocity, effort }).unwrap();
    }

    fn call<Q: Send + 'static, R: Send + 'static>(&mut self, part: &str, request: Q) -> Receiver<R> {
        let name = format!("arm/follow_joint_trajectory/_action/{part}");
        let caller = self.core.caller::<Q, R>(&name).unwrap();
        let (sender, answer) = channel();
        caller.call(request, Duration::MAX, move |result| drop(sender.send(result.unwrap()))).unwrap();
        (0..4).for_each(|_| self.core.cycle().unwrap());
        answer
    }

    /// Sends a goal; returns where its result arrives, or `None` if it is rejected.
    fn send(&mut self, number: u8, goal: FollowJointTrajectoryGoal) -> Option<Receiver<Response>> {
        let goal_id = UUID { uuid: [number; 16] };
        let request = FollowJointTrajectorySendGoalRequest { goal_id, goal };
        let accepted: Receiver<FollowJointTrajectorySendGoalResponse> = self.call("send_goal", request);
        let request = FollowJointTrajectoryGetResultRequest { goal_id };
        accepted.try_recv().unwrap().accepted.then(|| self.call("get_result", request))
    }
}

type Response = FollowJointTrajectoryGetResultResponse;

fn to(seconds: i64, shoulder: f64, elbow: f64) -> FollowJointTrajectoryGoal {
    let point = JointTrajectoryPoint {
        positions: vec![shoulder, elbow],
        velocities: vec![0.0, 0.0],
        time_from_start: DurationMessage::from_nanos(seconds * 1_000_000_000),
        ..JointTrajectoryPoint::default()
    };
    let joint_names = vec!["shoulder".into(), "elbow".into()];
    let trajectory = JointTrajectory { joint_names, points: vec![point], ..JointTrajectory::default() };
    FollowJointTrajectoryGoal { trajectory, ..FollowJointTrajectoryGoal::default() }
}

#[test]
fn a_goal_is_followed_and_succeeds() {
    let mut arm = Arm::new(&[("constraints.shoulder.goal", 0.01), ("constraints.elbow.trajectory", 0.2)]);
    let feedback =
        Collector::<downbeat_msgs::control_msgs::action::FollowJointTrajectoryFeedbackMessage>::add(
            &mut arm.core,
            "arm/follow_joint_trajectory/_action/feedback",
        );
    let result = arm.send(1, to(1, 0.5, -1.0)).unwrap();
    arm.run(0.5);
    assert!(
        (arm.position[0] - 0.25).abs() < 0.02 && (arm.position[1] + 0.5).abs() < 0.04,
        "{:?}",
        arm.position
    );
    assert!(result.try_recv().is_err());
    arm.run(0.6);
    let response = result.try_recv().unwrap();
    assert_eq!((response.status, response.result.error_code), (SUCCEEDED, 0));
    assert_eq!(arm.position, [0.5, -1.0]);
    let feedback = feedback.take();
    assert!(feedback.len() > 20, "{}", feedback.len());
    assert_eq!(feedback[0].feedback.joint_names, ["shoulder", "elbow"]);
}

#[test]
fn a_clock_that_is_set_ahead_moves_nothing_at_once() {
    let mut arm = Arm::new(&[]);
    let result = arm.send(1, to(2, 0.5, -1.0)).unwrap();
    arm.run(0.8);
    for _ in 0..3 {
        let before = arm.position[0];
        arm.clock.advance(Duration::from_secs(3600));
        arm.run(0.2);
        let moved = arm.position[0] - before;
        assert!((0.02..0.1).contains(&moved), "{moved}");
    }
    assert!(result.try_recv().is_err());
    arm.run(1.0);
    assert_eq!(result.try_recv().unwrap().status, SUCCEEDED);
    assert_eq!(arm.position, [0.5, -1.0]);
}

#[test]
fn a_joint_that_does_not_follow_violates_its_path_tolerance() {
    let mut arm = Arm::new(&[("constraints.elbow.trajectory", 0.2)]);
    arm.is_stuck = true;
    let result = arm.send(1, to(2, 0.0, -1.0)).unwrap();
    arm.run(2.0);
    let response = result.try_recv().unwrap();
    assert_eq!((response.status, response.result.error_code), (ABORTED, -4));
    assert!(
        response.result.error_string.contains("\"elbow\" is off by -0.2"),
        "{}",
        response.result.error_string
    );
    arm.is_stuck = false;
    arm.run(1.0);
    assert!(arm.position[1] > -0.25, "it holds where it was given up: {:?}", arm.position);
}

#[test]
fn a_goal_on_a_joint_that_does_not_answer_is_aborted_and_the_arm_holds() {
    let mut arm = Arm::new(&[("state_timeout", 0.5)]);
    let result = arm.send(1, to(2, 0.5, -1.0)).unwrap();
    arm.run(0.8);
    arm.is_elbow_dead = true;
    arm.run(0.4);
    assert!(result.try_recv().is_err(), "0.5 s are allowed");
    arm.run(0.2);
    let response = result.try_recv().unwrap();
    assert_eq!((response.status, response.result.error_code), (ABORTED, -4));
    let text = response.result.error_string;
    let parts = ["\"elbow\" is 0.50", "state_timeout of 0.5 s", "does not answer", "check cable, power"];
    assert!(parts.iter().all(|part| text.contains(part)), "{text}");
    let held = arm.position.clone();
    assert!(arm.send(2, to(1, 0.0, 0.0)).is_none(), "no goal is accepted for it");
    arm.run(1.0);
    assert!((arm.position[0] - held[0]).abs() < 0.01, "{held:?} {:?}", arm.position);
    arm.position[1] = -0.1;
    (arm.is_elbow_dead, arm.is_stuck) = (false, true);
    // A servo approaches old commands slowly until its position is known here.
    arm.run(0.008);
    arm.is_stuck = false;
    for _ in 0..50 {
        arm.run(0.008);
        assert!((arm.position[1] + 0.1).abs() < 0.01, "it stays where it is: {:?}", arm.position);
    }
    let again = arm.send(3, to(1, 0.2, 0.2)).unwrap();
    arm.run(1.1);
    assert_eq!(again.try_recv().unwrap().status, SUCCEEDED);
    assert_eq!(arm.position, [0.2, 0.2]);
}

#[test]
fn a_goal_does_not_wait_for_joint_states_that_have_stopped() {
    for (seconds, code) in [(2, -4), (1, -5)] {
        // A joint that is not at its goal when `joint_states` stop after the end of the trajectory.
        let mut arm = Arm::new(&[("constraints.shoulder.goal", 0.01), ("state_timeout", 0.5)]);
        let result = arm.send(1, to(seconds, 0.5, 0.0)).unwrap();
        arm.run(0.9);
        arm.is_stuck = true;
        arm.run(0.2);
        arm.is_cut = true;
        arm.run(0.6);
        let response = result.try_recv().unwrap();
        assert_eq!((response.status, response.result.error_code), (ABORTED, code), "{seconds}");
        assert!(response.result.error_string.contains("`joint_states` stopped"));
    }
    let mut patient = Arm::new(&[("state_timeout", 0.0)]);
    let result = patient.send(1, to(1, 0.5, 0.0)).unwrap();
    patient.is_cut = true;
    patient.run(3.0);
    assert_eq!(result.try_recv().unwrap().status, SUCCEEDED, "any age is allowed");
}

#[test]
fn joints_whose_velocities_are_never_known_are_followed() {
    // As the joint_state_broadcaster of ros2_control publishes hardware without velocities.
    let mut arm = Arm::new(&[]);
    let result = arm.send(1, to(1, 0.0, 0.0)).unwrap();
    for _ in 0..150 {
        let name = vec!["shoulder".into(), "elbow".into()];
        let (position, velocity) = (vec![0.0; 2], vec![f64::NAN; 2]);
        let state =
            JointState { name, position, effort: velocity.clone(), velocity, ..JointState::default() };
        arm.state.publish(state).unwrap();
        arm.is_cut = true;
        arm.run(0.008);
    }
    assert_eq!(result.try_recv().unwrap().status, SUCCEEDED);
}

#[test]
fn a_goal_that_is_not_reached_in_time_is_aborted() {
    let mut arm = Arm::new(&[]);
    arm.is_stuck = true;
    let mut goal = to(1, 0.5, 0.0);
    goal.goal_tolerance =
        vec![JointTolerance { name: "shoulder".into(), position: 0.1, ..Default::default() }];
    goal.goal_time_tolerance = DurationMessage::from_nanos(500_000_000);
    let result = arm.send(1, goal).unwrap();
    arm.run(1.4);
    assert!(result.try_recv().is_err(), "it has half a second more");
    arm.run(0.2);
    let response = result.try_recv().unwrap();
    assert_eq!((response.status, response.result.error_code), (ABORTED, -5));
}

#[test]
fn a_new_goal_replaces_the_one_before_without_a_jump() {
    let mut arm = Arm::new(&[]);
    let first = arm.send(1, to(1, 1.0, 0.0)).unwrap();
    arm.run(0.5);
    let before = arm.position[0];
    let second = arm.send(2, to(1, 0.0, 0.0)).unwrap();
    let response = first.try_recv().unwrap();
    assert_eq!(response.status, ABORTED);
    assert!(response.result.error_string.contains("replaced"));
    arm.run(0.016);
    assert!((arm.position[0] - before).abs() < 0.05, "{before} {}", arm.position[0]);
    arm.run(1.2);
    assert_eq!(second.try_recv().unwrap().status, SUCCEEDED);
}

#[test]
fn a_goal_that_stops_a_joint_in_motion_does_not_let_it_swing() {
    let mut arm = Arm::new(&[]);
    drop(arm.send(1, to(2, 2.0, 0.0)));
    arm.run(1.0);
    let (before, period) = (arm.position[0], 0.008);
    let second = arm.send(2, to(10, before, 0.0)).unwrap();
    let (mut last, mut most) = (before, before);
    for _ in 0..1400 {
        arm.run(period);
        assert!((arm.position[0] - last).abs() < 1.6 * period, "{last} {}", arm.position[0]);
        last = arm.position[0];
        most = most.max(last);
    }
    // At 1.5 rad/s and 10 rad/s² it takes 0.11 rad to stop; the spline alone would swing out by 2.2 rad.
    assert!(most - before < 0.14, "{}", most - before);
    assert_eq!((second.try_recv().unwrap().status, arm.position[0]), (SUCCEEDED, before));
}

#[test]
fn a_late_trajectory_and_one_whose_first_point_is_now_do_not_jump() {
    for late_ms in [0, 20, 300, 480] {
        let mut arm = Arm::new(&[("constraints.shoulder.trajectory", 0.1)]);
        let mut goal = to(2, 1.0, 0.0);
        let first = JointTrajectoryPoint {
            positions: vec![0.4, 0.0],
            time_from_start: DurationMessage::from_nanos(0),
            ..goal.trajectory.points[0].clone()
        };
        goal.trajectory.points.insert(0, first);
        if late_ms > 0 {
            let stamp = arm.clock.now().as_nanos() - late_ms * 1_000_000;
            goal.trajectory.header = header(Time::from_nanos(stamp), "");
        }
        let result = arm.send(1, goal).unwrap();
        let mut last = 0.0;
        for _ in 0..300 {
            arm.run(0.008);
            let step = (arm.position[0] - last).abs();
            assert!(step < 0.016, "late by {late_ms} ms: a step of {step} rad in 8 ms");
            last = arm.position[0];
        }
        let response = result.try_recv().unwrap();
        assert_eq!((response.status, last), (SUCCEEDED, 1.0), "{}", response.result.error_string);
    }
}

#[test]
fn a_canceled_goal_holds_its_position() {
    let mut arm = Arm::new(&[]);
    let result = arm.send(1, to(1, 1.0, 0.0)).unwrap();
    arm.run(0.4);
    let mut request = CancelGoalRequest::default();
    request.goal_info.goal_id = UUID { uuid: [1; 16] };
    let canceled: Receiver<CancelGoalResponse> = arm.call("cancel_goal", request);
    assert_eq!(canceled.try_recv().unwrap().return_code, CancelGoalResponse::ERROR_NONE);
    assert_eq!(result.try_recv().unwrap().status, CANCELED);
    let held = arm.position[0];
    arm.run(1.0);
    assert!((arm.position[0] - held).abs() < 0.02 && held > 0.2 && held < 0.6, "{held}");
}

#[test]
fn goals_that_cannot_be_followed_are_rejected_and_nothing_moves() {
    let mut arm = Arm::new(&[]);
    let mut past = to(1, 1.0, 0.0);
    past.trajectory.header.stamp.sec = 10;
    assert!(arm.send(1, past).is_none());
    assert!(arm.send(2, to(1, f64::NAN, 0.0)).is_none());
    for (id, seconds_ago) in [(3, 2), (4, -100)] {
        // Still going on, but its beginning was skipped; and one of another clock.
        let mut stale = to(5, 1.0, 0.0);
        stale.trajectory.header = header(arm.clock.now(), "");
        stale.trajectory.header.stamp.sec -= seconds_ago;
        assert!(arm.send(id, stale).is_none(), "{seconds_ago}");
    }
    arm.run(0.1);
    assert_eq!(arm.position, [0.0, 0.0]);
}

#[test]
fn a_trajectory_from_the_topic_is_followed() {
    let mut arm = Arm::new(&[]);
    let trajectory = arm.core.inlet("arm/joint_trajectory").unwrap();
    trajectory.publish(to(1, 0.3, 0.1).trajectory).unwrap();
    arm.run(1.1);
    assert_eq!(arm.position, [0.3, 0.1]);
}

#[test]
fn joints_must_be_named() {
    let (mut core, _clock) = core_at_zero();
    let refused = core.add("arm", JointTrajectoryController::default()).unwrap_err().to_string();
    assert!(refused.contains("joints") && refused.contains("names no joint"), "{refused}");
}
