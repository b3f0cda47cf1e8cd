//! A module that serves an action, one that uses it, and one that listens.

use downbeat_actions::{ActionClient, ActionServer, CancelResponse, GoalId, GoalResponse, GoalStatus};
use downbeat_executor::{Context, Module, Received, Setup, SetupError};
use downbeat_msgs::action_msgs::msg::GoalStatusArray;
use downbeat_msgs::test_msgs::action::{Fibonacci, FibonacciFeedback, FibonacciGoal, FibonacciResult};
use std::sync::mpsc::Sender;
use std::time::Duration;

/// Computes Fibonacci numbers, one per second; the action is `count`.
#[derive(Default)]
pub struct Counter {
    server: ActionServer<Fibonacci>,
    sequences: Vec<(GoalId, Vec<i32>)>,
}

impl Counter {
    /// An order that it refuses to cancel.
    pub const STUBBORN: i32 = 13;
    /// An order that it starts a second later.
    pub const LATER: i32 = 14;

    fn tick(&mut self, ctx: &mut Context<'_>) {
        let mut sequences = std::mem::take(&mut self.sequences);
        sequences.retain_mut(|(id, sequence)| {
            let goal = self.server.goal(*id).unwrap();
            let order = goal.goal().order;
            if goal.status() == GoalStatus::Accepted {
                self.server.execute(ctx, *id).unwrap();
                return true;
            }
            let next = sequence.iter().rev().take(2).sum();
            sequence.push(next);
            let (id, sequence) = (*id, sequence.clone());
            let is_done = sequence.len() > order as usize;
            if is_done {
                self.server.succeed(ctx, id, FibonacciResult { sequence }).unwrap();
            } else {
                self.server.publish_feedback(ctx, id, FibonacciFeedback { sequence }).unwrap();
            }
            !is_done
        });
        self.sequences = sequences;
    }

    fn stop(&mut self, id: GoalId, ctx: &mut Context<'_>) {
        assert!(self.server.goal(id).unwrap().is_canceling());
        let position = self.sequences.iter().position(|(of, _)| *of == id).unwrap();
        let (_, sequence) = self.sequences.remove(position);
        self.server.canceled(ctx, id, FibonacciResult { sequence }).unwrap();
        self.server.abort(ctx, id, FibonacciResult::default()).unwrap_err();
    }
}

impl Module for Counter {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        ActionServer::builder(|counter: &mut Self| &mut counter.server)
            .on_goal(|_, _, goal, _| match goal.order {
                ..0 => GoalResponse::Reject,
                Self::LATER => GoalResponse::AcceptAndDefer,
                _ => GoalResponse::AcceptAndExecute,
            })
            .on_accepted(|counter, id, _| counter.sequences.push((id, vec![0, 1])))
            .on_cancel(|counter, id, _| match counter.server.goal(id).unwrap().goal().order {
                Self::STUBBORN => CancelResponse::Reject,
                _ => CancelResponse::Accept,
            })
            .on_canceling(Self::stop)
            .declare(setup, "count", &mut self.server)?;
        setup.every(Duration::from_secs(1), Self::tick)
    }
}

/// Ends each goal at once with a result of so many numbers, and reports how many goals it keeps.
pub struct Eager {
    server: ActionServer<Fibonacci>,
    numbers: usize,
    kept: Sender<usize>,
}

impl Eager {
    pub fn new(numbers: usize, kept: Sender<usize>) -> Self {
        Self { server: ActionServer::default(), numbers, kept }
    }
}

impl Module for Eager {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        ActionServer::builder(|eager: &mut Self| &mut eager.server)
            .on_accepted(|eager, id, ctx| {
                let result = FibonacciResult { sequence: vec![1; eager.numbers] };
                eager.server.succeed(ctx, id, result).unwrap();
                eager.kept.send(eager.server.goals().count()).unwrap();
            })
            .declare(setup, "count", &mut self.server)
    }
}

/// A request to a [`Caller`].
#[derive(Clone, Copy)]
pub enum Asked {
    Count(i32),
    CancelLast,
}

/// Sends a goal or cancels the last one on each message on `ask`, and reports the outcome.
pub struct Caller {
    client: ActionClient<Fibonacci>,
    sender: Sender<String>,
    last: GoalId,
    has_ids: bool,
}

impl Caller {
    pub fn new(sender: Sender<String>) -> Self {
        Self { client: ActionClient::default(), sender, last: GoalId::default(), has_ids: false }
    }

    /// Starts each line with the id of the goal.
    pub fn with_ids(self) -> Self {
        Self { has_ids: true, ..self }
    }

    fn report(&self, id: GoalId, line: String) {
        let line = if self.has_ids { format!("{id} {line}") } else { line };
        self.sender.send(line).unwrap();
    }

    fn ask(&mut self, asked: Received<'_, Asked>, ctx: &mut Context<'_>) {
        match *asked {
            Asked::Count(order) => self.last = self.client.send(ctx, FibonacciGoal { order }),
            Asked::CancelLast => self.client.cancel(ctx, self.last),
        }
    }
}

impl Module for Caller {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        ActionClient::builder(|caller: &mut Self| &mut caller.client)
            .on_response(|caller, id, response, _| {
                assert_eq!(caller.client.status(id).is_some(), response.is_ok());
                caller.report(
                    id,
                    response.map_or_else(|error| error.to_string(), |time| format!("accepted at {time}")),
                );
            })
            .on_feedback(|caller, id, feedback, _| {
                assert_eq!(caller.client.status(id), Some(GoalStatus::Executing));
                caller.report(id, format!("{:?}", feedback.sequence));
            })
            .on_result(|caller, id, end, _| {
                assert_eq!(caller.client.status(id), None);
                let line = match end {
                    Ok(end) => format!("{} {:?}", end.status, end.result.sequence),
                    Err(error) => error.to_string(),
                };
                caller.report(id, line);
            })
            .on_cancel(|caller, answer, _| {
                let answer = answer.unwrap();
                let (code, goals) = (answer.return_code, answer.goals_canceling.len());
                caller.report(caller.last, format!("cancel: {code}, {goals} goals"));
            })
            .declare(setup, "count", &mut self.client)?;
        setup.subscribe("ask", Self::ask)
    }
}

/// Reports each message on the topic of statuses.
pub struct Statuses(pub Sender<Vec<GoalStatus>>);

impl Module for Statuses {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe(
            "count/_action/status",
            |statuses: &mut Self, message: Received<'_, GoalStatusArray>, _| {
                let of = |goal: &downbeat_msgs::action_msgs::msg::GoalStatus| {
                    GoalStatus::from_message(goal.status)
                };
                statuses.0.send(message.status_list.iter().map(of).collect()).unwrap();
            },
        )
    }
}
