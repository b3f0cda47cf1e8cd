//! Actions between modules of a core, and with callers from outside.
#![allow(clippy::unwrap_used, missing_docs)]

mod modules;

use downbeat_actions::{ActionServer, GoalId, GoalStatus};
use downbeat_executor::{Core, Inlet, ManualClock, ModuleOptions, Pool, Threads, Time};
use downbeat_msgs::action_msgs::srv::{CancelGoalRequest, CancelGoalResponse};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::test_msgs::action::{
    Fibonacci, FibonacciGetResultRequest, FibonacciGetResultResponse, FibonacciGoal,
    FibonacciSendGoalRequest, FibonacciSendGoalResponse,
};
use downbeat_msgs::unique_identifier_msgs::msg::UUID;
use modules::{Asked, Caller, Counter, Eager, Statuses};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

const SECOND: Duration = Duration::from_secs(1);

/// A core with a counter and a manual clock; one number is computed each second.
struct World {
    core: Core,
    clock: ManualClock,
}

impl World {
    fn new() -> Self {
        Self::on(Core::new())
    }

    fn on(core: Core) -> Self {
        let clock = ManualClock::new(Time::from_nanos(1_000_000_000_000));
        let mut core = core.with_clock(clock.clone());
        core.add("counter", Counter::default()).unwrap();
        Self { core, clock }
    }

    /// Runs until nothing is in progress.
    fn settle(&mut self) {
        (0..8).try_for_each(|_| self.core.cycle()).unwrap();
    }

    fn pass(&mut self, seconds: u32) {
        for _ in 0..seconds {
            self.clock.advance(SECOND);
            self.settle();
        }
    }

    /// Calls one of the services of the action.
    fn call<Q: Send + 'static, R: Send + 'static>(&mut self, part: &str, request: Q) -> Receiver<R> {
        let caller = self.core.caller::<Q, R>(&format!("count/_action/{part}")).unwrap();
        let (sender, answer) = channel();
        let on_reply = move |result: Result<R, _>| drop(result.map(|answer| sender.send(answer)));
        caller.call(request, Duration::MAX, on_reply).unwrap();
        self.settle();
        answer
    }

    fn send(&mut self, id: u8, order: i32) -> bool {
        let request = FibonacciSendGoalRequest { goal_id: uuid(id), goal: FibonacciGoal { order } };
        self.call::<_, FibonacciSendGoalResponse>("send_goal", request).try_recv().unwrap().accepted
    }

    fn cancel(&mut self, goal_id: UUID, stamp: Stamp) -> (i8, Vec<UUID>) {
        let mut request = CancelGoalRequest::default();
        (request.goal_info.goal_id, request.goal_info.stamp) = (goal_id, stamp);
        let answer = self.call::<_, CancelGoalResponse>("cancel_goal", request).try_recv().unwrap();
        (answer.return_code, answer.goals_canceling.into_iter().map(|goal| goal.goal_id).collect())
    }

    fn ask_for_result(&mut self, id: u8) -> Receiver<FibonacciGetResultResponse> {
        self.call("get_result", FibonacciGetResultRequest { goal_id: uuid(id) })
    }
}

fn uuid(id: u8) -> UUID {
    UUID { uuid: [id; 16] }
}

/// A world with a module that sends the published goals and reports what it receives.
fn with_caller() -> (World, Inlet<Asked>, Receiver<String>) {
    let mut world = World::new();
    let (sender, heard) = channel();
    world.core.add("caller", Caller::new(sender)).unwrap();
    let ask = world.core.inlet("ask").unwrap();
    (world, ask, heard)
}

fn ended(answer: &Receiver<FibonacciGetResultResponse>) -> Option<(GoalStatus, Vec<i32>)> {
    let answer = answer.try_recv().ok()?;
    Some((GoalStatus::from_message(answer.status), answer.result.sequence))
}

#[test]
fn a_goal_of_another_module_is_accepted_publishes_feedback_and_ends_with_a_result() {
    let (mut world, ask, heard) = with_caller();
    ask.publish(Asked::Count(4)).unwrap();
    world.settle();
    assert_eq!(heard.try_iter().collect::<Vec<_>>(), ["accepted at 1000.000000000"]);
    world.pass(4);
    assert_eq!(
        heard.try_iter().collect::<Vec<_>>(),
        ["[0, 1, 1]", "[0, 1, 1, 2]", "succeeded [0, 1, 1, 2, 3]"]
    );
    ask.publish(Asked::Count(-1)).unwrap();
    world.settle();
    let rejected: Vec<_> = heard.try_iter().collect();
    assert!(rejected.len() == 1 && rejected[0].ends_with("was rejected"), "{rejected:?}");
}

#[test]
fn several_goals_run_at_once_and_a_client_receives_only_its_own() {
    let mut world = World::new();
    let (sender, heard) = channel();
    let (other_told, other_heard) = channel();
    world.core.add("caller", Caller::new(sender)).unwrap();
    let options = ModuleOptions {
        remaps: [("ask".to_owned(), "ask_other".to_owned())].into(),
        ..ModuleOptions::default()
    };
    world.core.add_with("other", Caller::new(other_told), options).unwrap();
    let (ask, ask_other) = (world.core.inlet("ask").unwrap(), world.core.inlet("ask_other").unwrap());
    ask.publish(Asked::Count(4)).unwrap();
    ask.publish(Asked::Count(3)).unwrap();
    ask_other.publish(Asked::Count(3)).unwrap();
    world.settle();
    heard.try_iter().chain(other_heard.try_iter()).for_each(|line| assert!(line.starts_with("accepted")));
    world.pass(2);
    let lines: Vec<_> = heard.try_iter().collect();
    assert_eq!(lines, ["[0, 1, 1]", "[0, 1, 1]", "[0, 1, 1, 2]", "succeeded [0, 1, 1, 2]"]);
    assert_eq!(other_heard.try_iter().collect::<Vec<_>>(), ["[0, 1, 1]", "succeeded [0, 1, 1, 2]"]);
}

#[test]
fn a_client_cancels_its_goal_and_receives_the_answer() {
    let (mut world, ask, heard) = with_caller();
    ask.publish(Asked::Count(9)).unwrap();
    world.settle();
    world.pass(1);
    ask.publish(Asked::CancelLast).unwrap();
    world.settle();
    assert_eq!(heard.try_iter().skip(2).collect::<Vec<_>>(), ["cancel: 0, 1 goals", "canceled [0, 1, 1]"]);
    ask.publish(Asked::CancelLast).unwrap();
    world.settle();
    assert_eq!(heard.try_recv().unwrap(), "cancel: 3, 0 goals", "it has ended");
}

#[test]
fn a_client_gets_an_error_if_there_is_no_server_or_it_stops() {
    let (mut world, ask, heard) = with_caller();
    ask.publish(Asked::Count(9)).unwrap();
    world.settle();
    let _removed = world.core.handle().remove("counter");
    world.settle();
    let lines: Vec<_> = heard.try_iter().collect();
    assert!(lines.last().unwrap().contains("\"counter\" does not run"), "{lines:?}");
    ask.publish(Asked::Count(9)).unwrap();
    world.settle();
    let line = heard.try_recv().unwrap();
    assert!(line.contains("was not answered") && line.contains("no module serves it"), "{line}");
}

#[test]
fn an_id_is_accepted_once() {
    let mut world = World::new();
    assert!(world.send(1, 3));
    assert!(!world.send(1, 3));
    assert!(world.send(2, 3));
}

#[test]
fn more_goals_than_are_kept_are_rejected() {
    let mut world = World::new();
    let server_limit = ActionServer::<Fibonacci>::MAX_GOALS;
    let send = world.core.caller::<_, FibonacciSendGoalResponse>("count/_action/send_goal").unwrap();
    let (sender, answers) = channel();
    for number in 0..=server_limit {
        let mut uuid = [0; 16];
        uuid[..8].copy_from_slice(&(number as u64 + 1).to_le_bytes());
        let request = FibonacciSendGoalRequest { goal_id: UUID { uuid }, goal: FibonacciGoal { order: 5 } };
        let sender = sender.clone();
        send.call(request, SECOND, move |answer| sender.send(answer.unwrap().accepted).unwrap()).unwrap();
    }
    world.settle();
    let answers: Vec<_> = answers.try_iter().collect();
    assert_eq!(answers.iter().filter(|accepted| **accepted).count(), server_limit);
    assert_eq!(answers.last(), Some(&false));
}

#[test]
fn results_that_are_never_requested_do_not_use_up_the_goals() {
    let mut world = World::new();
    for round in 0..3 {
        let send = world.core.caller::<_, FibonacciSendGoalResponse>("count/_action/send_goal").unwrap();
        let (sender, answers) = channel();
        for number in 0..1000_u64 {
            let mut uuid = [0; 16];
            uuid[..8].copy_from_slice(&(round * 1000 + number + 1).to_le_bytes());
            let request =
                FibonacciSendGoalRequest { goal_id: UUID { uuid }, goal: FibonacciGoal { order: 2 } };
            let sender = sender.clone();
            send.call(request, SECOND, move |answer| sender.send(answer.unwrap().accepted).unwrap()).unwrap();
        }
        world.settle();
        // The goals end after one second; their results would be kept for 10 s.
        world.pass(1);
        assert_eq!(answers.try_iter().filter(|accepted| *accepted).count(), 1000, "round {round}");
    }
}

/// Sends goals that end at once with results of some size, which nobody requests. Returns the number of
/// goals, and the bytes, that the server still keeps, and the most memory that all of it took.
fn unrequested(goals: u64, numbers: usize) -> (usize, usize) {
    let clock = ManualClock::new(Time::from_nanos(1_000_000_000_000));
    let mut core = Core::new().with_clock(clock);
    let (sender, kept) = channel();
    core.add("eager", Eager::new(numbers, sender)).unwrap();
    let send = core.caller::<_, FibonacciSendGoalResponse>("count/_action/send_goal").unwrap();
    let (most, ()) = fuzzing::most_in(|| {
        for number in 1..=goals {
            let goal_id = UUID { uuid: (u128::from(number)).to_le_bytes() };
            let request = FibonacciSendGoalRequest { goal_id, goal: FibonacciGoal { order: 1 } };
            send.call(request, SECOND, |answer| assert!(answer.unwrap().accepted)).unwrap();
            (0..2).try_for_each(|_| core.cycle()).unwrap();
        }
    });
    (kept.try_iter().last().unwrap(), most)
}

#[test]
fn results_that_are_never_requested_take_bounded_memory() {
    let (kept, most) = unrequested(10_000, 10);
    let limit = ActionServer::<Fibonacci>::MAX_GOALS;
    assert_eq!(kept, limit);
    println!("{kept} goals of 10 000 are kept, with at most {most} bytes: {} each", most / kept);
    // A goal, its result, and its part of the status messages that are on their way.
    assert!(most < limit * 1024, "{most}");

    // Large results are limited by their size.
    let numbers = 1 << 20;
    let (kept, most) = unrequested(40, numbers);
    let limit = ActionServer::<Fibonacci>::MAX_BYTES;
    println!("{kept} goals of 40 with results of 4 MiB are kept, with at most {most} bytes");
    assert_eq!(kept, limit / (4 * numbers + 64));
    assert!(most < limit + 3 * 4 * numbers, "{most}");
}

#[test]
fn results_expire_while_other_goals_come() {
    let mut world = World::new();
    assert!(world.send(1, 2));
    for id in 2..20 {
        world.pass(1);
        assert!(world.send(id, 2));
    }
    assert_eq!(ended(&world.ask_for_result(1)), Some((GoalStatus::Unknown, vec![])));
    assert!(matches!(ended(&world.ask_for_result(18)), Some((GoalStatus::Succeeded, _))));
}

#[test]
fn requests_for_a_result_are_limited() {
    let mut world = World::new();
    assert!(world.send(1, 5));
    let limit = ActionServer::<Fibonacci>::MAX_WAITING;
    let answers: Vec<_> = (0..limit + 10).map(|_| world.ask_for_result(1)).collect();
    world.pass(6);
    let answered = answers.iter().filter(|answer| ended(answer).is_some()).count();
    assert_eq!(answered, limit);
}

#[test]
fn cancel_requests_select_one_goal_or_those_up_to_a_time_or_all() {
    let mut world = World::new();
    let seconds = |sec| Stamp { sec, nanosec: 0 };
    for id in 1..=4 {
        assert!(world.send(id, 20));
        world.pass(1);
    }
    assert_eq!(world.cancel(uuid(9), Stamp::default()), (CancelGoalResponse::ERROR_UNKNOWN_GOAL_ID, vec![]));
    assert_eq!(world.cancel(uuid(2), Stamp::default()), (0, vec![uuid(2)]));
    assert_eq!(world.cancel(uuid(2), Stamp::default()), (CancelGoalResponse::ERROR_GOAL_TERMINATED, vec![]));
    // Accepted at 1000, 1001, 1002, 1003 s.
    assert_eq!(world.cancel(UUID::default(), seconds(1000)), (0, vec![uuid(1)]));
    assert!(world.send(5, 20));
    assert_eq!(world.cancel(uuid(5), seconds(1002)), (0, vec![uuid(3), uuid(5)]));
    assert_eq!(world.cancel(UUID::default(), Stamp::default()), (0, vec![uuid(4)]));
    assert_eq!(world.cancel(UUID::default(), Stamp::default()), (0, vec![]));
}

#[test]
fn a_module_may_refuse_to_cancel() {
    let mut world = World::new();
    assert!(world.send(1, Counter::STUBBORN));
    assert_eq!(world.cancel(uuid(1), Stamp::default()), (CancelGoalResponse::ERROR_REJECTED, vec![]));
}

#[test]
fn a_result_can_be_requested_before_and_after_the_end_until_it_expires() {
    let mut world = World::new();
    assert!(world.send(1, 2));
    let early = world.ask_for_result(1);
    assert_eq!(ended(&early), None);
    world.pass(1);
    world.pass(1);
    assert_eq!(ended(&early), Some((GoalStatus::Succeeded, vec![0, 1, 1])));
    world.pass(8);
    let late = world.ask_for_result(1);
    assert_eq!(ended(&late), Some((GoalStatus::Succeeded, vec![0, 1, 1])));
    world.pass(1);
    let too_late = world.ask_for_result(1);
    assert_eq!(ended(&too_late), Some((GoalStatus::Unknown, vec![])));
    assert_eq!(ended(&world.ask_for_result(7)), Some((GoalStatus::Unknown, vec![])), "it never existed");
    assert!(world.send(1, 2), "its id is free again");
}

#[test]
fn a_status_is_published_at_each_change_with_all_goals() {
    let mut world = World::new();
    let (sender, heard) = channel();
    world.core.add("statuses", Statuses(sender)).unwrap();
    assert!(world.send(1, Counter::LATER));
    world.pass(1);
    assert!(world.send(2, 9));
    world.cancel(uuid(1), Stamp::default());
    use GoalStatus::{Accepted, Canceled, Canceling, Executing};
    assert_eq!(
        heard.try_iter().collect::<Vec<_>>(),
        [
            vec![Accepted],
            vec![Executing],
            vec![Executing, Executing],
            vec![Canceling, Executing],
            vec![Canceled, Executing],
        ]
    );
}

#[test]
fn remapping_an_action_applies_to_all_its_parts() {
    let mut core = Core::new();
    let remaps = [("count".to_owned(), "/numbers/fibonacci".to_owned())].into();
    core.add_with("counter", Counter::default(), ModuleOptions { remaps, ..ModuleOptions::default() })
        .unwrap();
    let mut names: Vec<_> = core.services().map(|service| service.name.to_string()).collect();
    names.extend(core.topics().map(|topic| topic.name.to_string()));
    names.retain(|name| name.contains("_action"));
    names.sort();
    let parts = ["cancel_goal", "feedback", "get_result", "send_goal", "status"];
    assert_eq!(names, parts.map(|part| format!("numbers/fibonacci/_action/{part}")));
}

#[test]
fn goals_ids_and_results_are_the_same_under_every_launcher() {
    let run = |core: Core| {
        let mut world = World::on(core);
        let (sender, heard) = channel();
        for name in ["one", "two", "three"] {
            world.core.add(name, Caller::new(sender.clone()).with_ids()).unwrap();
        }
        let ask = world.core.inlet("ask").unwrap();
        for round in 0..5 {
            ask.publish(Asked::Count(2 + round)).unwrap();
            world.pass(1);
            ask.publish(Asked::CancelLast).unwrap();
        }
        world.pass(9);
        // The callers run in parallel, so their lines are sorted.
        let mut lines: Vec<_> = heard.try_iter().collect();
        lines.sort();
        lines
    };
    let expected = run(Core::new());
    assert!(expected.iter().any(|line| line.contains("canceled")) && expected.len() > 40, "{expected:?}");
    assert_eq!(run(Core::new()), expected);
    assert_eq!(run(Core::new().with_launcher(Pool::new(3).unwrap())), expected);
    assert_eq!(run(Core::new().with_launcher(Threads::new())), expected);
    let ids: std::collections::BTreeSet<_> = expected.iter().map(|line| &line[..32]).collect();
    assert_eq!(ids.len(), 15, "each goal has a unique id");
    assert_eq!(GoalId::default().to_string(), "0".repeat(32));
}
