//! The module under a controller that follows trajectories, with cables that are cut and servos that die.

use super::*;
use crate::controllers::joint_trajectory::JointTrajectoryController;
use downbeat_msgs::builtin_interfaces::msg::Duration as DurationMessage;
use downbeat_msgs::control_msgs::action::{
    FollowJointTrajectoryGetResultRequest, FollowJointTrajectoryGetResultResponse as Response,
    FollowJointTrajectorySendGoalRequest, FollowJointTrajectorySendGoalResponse,
};
use downbeat_msgs::trajectory_msgs::msg::{JointTrajectory, JointTrajectoryPoint};
use downbeat_msgs::unique_identifier_msgs::msg::UUID;
use std::sync::mpsc::Receiver;

const SUCCEEDED: i8 = 4;
const ABORTED: i8 = 6;
const JOINTS: [&str; 4] = ["pan", "lift", "elbow", "wrist"];

impl Run {
    fn with_controller(protocol: &str, model: &str, rest: &str) -> Self {
        let mut run = Self::of(&arm(protocol, model, rest));
        let joints: Vec<String> = JOINTS.map(str::to_owned).into();
        let numbers = [("rate_hz", 100.0), ("state_timeout", 0.5)];
        let numbers = numbers.map(|(name, value)| (name.to_owned(), value.into()));
        let settings = numbers.into_iter().chain([("joints".to_owned(), joints.into())]).collect();
        let options = ModuleOptions { settings, ..ModuleOptions::default() };
        run.core.add_with("arm", JointTrajectoryController::default(), options).unwrap();
        run.cycles(60);
        run
    }

    fn call<Q: Send + 'static, R: Send + 'static>(&mut self, part: &str, request: Q) -> Receiver<R> {
        let name = format!("arm/follow_joint_trajectory/_action/{part}");
        let (sender, answer) = mpsc::channel();
        let caller = self.core.caller::<Q, R>(&name).unwrap();
        caller.call(request, Duration::MAX, move |result| drop(sender.send(result.unwrap()))).unwrap();
        self.cycles(3);
        answer
    }

    /// Sends all joints to this angle; `None` if that is rejected.
    fn go_to(&mut self, number: u8, angle: f64, seconds: i32) -> Option<Receiver<Response>> {
        let goal_id = UUID { uuid: [number; 16] };
        let point = JointTrajectoryPoint {
            positions: vec![angle; 4],
            velocities: vec![0.0; 4],
            time_from_start: DurationMessage { sec: seconds, nanosec: 0 },
            ..JointTrajectoryPoint::default()
        };
        let joint_names = JOINTS.map(str::to_owned).into();
        let mut request = FollowJointTrajectorySendGoalRequest { goal_id, ..Default::default() };
        request.goal.trajectory =
            JointTrajectory { joint_names, points: vec![point], ..JointTrajectory::default() };
        let accepted: Receiver<FollowJointTrajectorySendGoalResponse> = self.call("send_goal", request);
        let request = FollowJointTrajectoryGetResultRequest { goal_id };
        accepted.try_recv().unwrap().accepted.then(|| self.call("get_result", request))
    }
}

#[test]
fn a_trajectory_ends_with_the_cable_and_nothing_moves_when_that_is_back() {
    for (protocol, model, rest) in KINDS {
        let mut run = Run::with_controller(protocol, model, rest);
        let result = run.go_to(1, 0.8, 4).unwrap();
        run.cycles(150);
        run.inject(Fault::lasting(FaultKind::ClosePort, Duration::from_secs(2)));
        run.cycles(70);
        let response = result.try_recv().unwrap_or_else(|_| panic!("{model}: it is not aborted"));
        assert_eq!((response.status, response.result.error_code), (ABORTED, -4), "{model}");
        let text = response.result.error_string;
        assert!(text.contains("\"pan\" is 0.5") && text.contains("check cable"), "{model}: {text}");
        assert!(run.go_to(2, 0.0, 1).is_none(), "{model}: no goal is accepted without a cable");
        run.cycles(100);
        run.joint_states.take();
        let states = run.cycles(400);
        assert!(!states.is_empty(), "{model}: the cable is back");
        for name in JOINTS {
            let at = |state: &JointState| position(state, name);
            let first = at(&states[0]);
            let most = states.iter().map(|state| (at(state) - first).abs()).fold(0.0, f64::max);
            // A servo approaches its old command for the cycles until the controller knows its position.
            assert!(most < 0.04, "{model}: {name} moves by {most} without a command");
        }
        let again = run.go_to(3, 0.1, 2).unwrap();
        let states = run.cycles(260);
        assert_eq!(again.try_recv().unwrap().status, SUCCEEDED, "{model}");
        let end = &states[states.len() - 1];
        assert!(JOINTS.iter().all(|name| (position(end, name) - 0.1).abs() < 0.03), "{model}: {end:?}");
    }
}

#[test]
fn a_trajectory_ends_with_one_dead_servo_and_the_others_hold() {
    for (protocol, model, rest) in KINDS {
        let mut run = Run::with_controller(protocol, model, rest);
        let result = run.go_to(1, 0.8, 4).unwrap();
        run.cycles(150);
        let dead = FaultKind::DeadServo(crate::servo_bus::protocol::Id::new(2).unwrap());
        run.inject(Fault::lasting(dead, Duration::from_secs(2)));
        run.cycles(80);
        let response = result.try_recv().unwrap_or_else(|_| panic!("{model}: it is not aborted"));
        assert_eq!(response.status, ABORTED, "{model}");
        assert!(response.result.error_string.contains("\"lift\""), "{}", response.result.error_string);
        let states = run.cycles(500);
        let (first, last) = (&states[50], &states[states.len() - 1]);
        for name in JOINTS {
            let moved = (position(last, name) - position(first, name)).abs();
            assert!(moved < 0.04, "{model}: {name} moves by {moved} without a command");
        }
        let again = run.go_to(3, 0.1, 2).unwrap();
        run.cycles(260);
        assert_eq!(again.try_recv().unwrap().status, SUCCEEDED, "{model}");
    }
}
