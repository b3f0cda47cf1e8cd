//! The client side of an action: goals that a module has sent.

use super::{
    GetResultRequest, GetResultResponse, GoalId, GoalStatus, SendGoalRequest, SendGoalResponse, part, stamp,
};
use downbeat_executor::{
    CallError, CallId, Client, Context, Module, Received, Reply, Setup, SetupError, Time,
};
use downbeat_msgs::Action;
use downbeat_msgs::action_msgs::msg::{GoalInfo, GoalStatusArray};
use downbeat_msgs::action_msgs::srv::{CancelGoalRequest, CancelGoalResponse};
use downbeat_msgs::unique_identifier_msgs::msg::UUID;
use std::time::Duration;
use thiserror::Error;

/// The active goals of one action that a module has sent; see the [module page](super).
pub struct ActionClient<A: Action> {
    action: String,
    keys: Option<ClientKeys<A>>,
    next: u64,
    goals: Vec<SentGoal>,
}

impl<A: Action> std::fmt::Debug for ActionClient<A> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ActionClient")
            .field("action", &self.action)
            .field("goals", &self.goals)
            .finish_non_exhaustive()
    }
}

/// A goal whose end is not known yet.
#[derive(Clone, Copy, Debug)]
struct SentGoal {
    id: GoalId,
    status: GoalStatus,
    /// The pending call: of `send_goal`, then of `get_result`.
    call: CallId,
    is_accepted: bool,
}

/// The server does not pursue a goal.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum GoalRefused {
    /// The server rejected it.
    #[error("goal {0} was rejected")]
    Rejected(GoalId),
    /// The server did not answer.
    #[error("goal {goal} was not answered: {error}")]
    Call {
        /// The goal.
        goal: GoalId,
        /// The reason.
        error: CallError,
    },
}

/// How a goal ended.
pub struct GoalResult<A: Action> {
    /// Succeeded, canceled or aborted; unknown if the server no longer knows the goal.
    pub status: GoalStatus,
    /// The result from the server.
    pub result: A::Result,
}

/// The outcome of a request for a result.
struct Ended<A: Action> {
    id: GoalId,
    result: Result<GoalResult<A>, CallError>,
}

impl<A: Action> Default for ActionClient<A> {
    /// Creates a client that cannot send goals until it is declared.
    fn default() -> Self {
        Self { action: String::new(), keys: None, next: 0, goals: Vec::new() }
    }
}

impl<A: Action> ActionClient<A> {
    /// The default time-out for accepting or canceling a goal.
    pub const TIMEOUT: Duration = Duration::from_secs(10);

    /// Starts a declaration; `access` returns the client in the module.
    pub fn builder<M: Module>(access: fn(&mut M) -> &mut Self) -> ClientBuilder<A, M> {
        ClientBuilder::new(access)
    }

    /// If the module was set up before, the counter continues, so that ids stay unique.
    fn declare(&mut self, action: &str, keys: ClientKeys<A>) {
        *self = Self { action: action.to_owned(), keys: Some(keys), next: self.next, goals: Vec::new() };
    }

    /// Sends a goal. The callbacks of the declaration report its progress.
    ///
    /// # Panics
    /// Panics if the client was not declared in the module's setup, which stops the module.
    pub fn send<P>(&mut self, ctx: &mut Context<'_, P>, goal: A::Goal) -> GoalId {
        let id = GoalId::new(ctx.module_name(), &self.action, ctx.now(), self.next);
        self.next += 1;
        let send_goal = self.keys().send_goal;
        let call = ctx.call(send_goal, A::send_goal_request(id.into(), goal));
        self.goals.push(SentGoal { id, status: GoalStatus::Unknown, call, is_accepted: false });
        id
    }

    /// Requests to cancel a goal.
    ///
    /// # Panics
    /// See [`send`](Self::send).
    pub fn cancel<P>(&self, ctx: &mut Context<'_, P>, id: GoalId) {
        self.ask_to_cancel(ctx, GoalInfo { goal_id: id.into(), ..GoalInfo::default() });
    }

    /// Requests to cancel all goals of the server, including those of other clients.
    ///
    /// # Panics
    /// See [`send`](Self::send).
    pub fn cancel_all<P>(&self, ctx: &mut Context<'_, P>) {
        self.ask_to_cancel(ctx, GoalInfo::default());
    }

    /// Requests to cancel all goals that the server accepted at or before that time, including those of other
    /// clients.
    ///
    /// # Panics
    /// See [`send`](Self::send).
    pub fn cancel_before<P>(&self, ctx: &mut Context<'_, P>, time: Time) {
        self.ask_to_cancel(ctx, GoalInfo { goal_id: UUID::default(), stamp: stamp(time) });
    }

    /// The active goals in the order in which they were sent, with their last reported status; unknown until
    /// the server reports one.
    pub fn goals(&self) -> impl Iterator<Item = (GoalId, GoalStatus)> {
        self.goals.iter().map(|goal| (goal.id, goal.status))
    }

    /// The last reported status of a goal; `None` if it was not sent by this client or has ended.
    #[must_use]
    pub fn status(&self, id: GoalId) -> Option<GoalStatus> {
        self.goals().find(|(known, _)| *known == id).map(|(_, status)| status)
    }

    fn ask_to_cancel<P>(&self, ctx: &mut Context<'_, P>, goal_info: GoalInfo) {
        ctx.call(self.keys().cancel_goal, CancelGoalRequest { goal_info });
    }

    fn keys(&self) -> &ClientKeys<A> {
        match &self.keys {
            Some(keys) => keys,
            None => {
                panic!("a client of {} is used that was not declared in the module's setup", A::TYPE_NAME)
            }
        }
    }
}

/// Handling of answers and messages.
impl<A: Action> ActionClient<A> {
    /// Handles the answer to a goal, and requests the result if it was accepted.
    fn answered<P>(
        &mut self,
        ctx: &mut Context<'_, P>,
        call: CallId,
        answer: Result<(bool, Time), CallError>,
    ) -> Option<(GoalId, Result<Time, GoalRefused>)> {
        let get_result = self.keys().get_result;
        let position = self.goals.iter().position(|goal| !goal.is_accepted && goal.call == call)?;
        let goal = &mut self.goals[position];
        let id = goal.id;
        let response = match answer {
            Ok((true, stamp)) => {
                goal.is_accepted = true;
                goal.call = ctx.call(get_result, A::get_result_request(id.into()));
                // An earlier status message may be more recent.
                if goal.status == GoalStatus::Unknown {
                    goal.status = GoalStatus::Accepted;
                }
                return Some((id, Ok(stamp)));
            }
            Ok((false, _)) => GoalRefused::Rejected(id),
            Err(error) => GoalRefused::Call { goal: id, error },
        };
        self.goals.remove(position);
        Some((id, Err(response)))
    }

    fn ended(&mut self, call: CallId, answer: Result<(i8, A::Result), CallError>) -> Option<Ended<A>> {
        let position = self.goals.iter().position(|goal| goal.is_accepted && goal.call == call)?;
        let id = self.goals.remove(position).id;
        let result =
            answer.map(|(status, result)| GoalResult { status: GoalStatus::from_message(status), result });
        Some(Ended { id, result })
    }

    fn is_ours(&self, id: GoalId) -> bool {
        self.goals.iter().any(|goal| goal.id == id)
    }

    fn take_status(&mut self, statuses: &GoalStatusArray) {
        for status in &statuses.status_list {
            let id = GoalId::from(status.goal_info.goal_id);
            if let Some(goal) = self.goals.iter_mut().find(|goal| goal.id == id) {
                goal.status = GoalStatus::from_message(status.status);
            }
        }
    }
}

struct ClientKeys<A: Action> {
    send_goal: Client<SendGoalRequest<A>, SendGoalResponse<A>>,
    get_result: Client<GetResultRequest<A>, GetResultResponse<A>>,
    cancel_goal: Client<CancelGoalRequest, CancelGoalResponse>,
}

type OnResponse<M> =
    dyn FnMut(&mut M, GoalId, Result<Time, GoalRefused>, &mut Context<'_, <M as Module>::Ports>) + Send;
type OnFeedback<A, M> =
    dyn FnMut(&mut M, GoalId, &<A as Action>::Feedback, &mut Context<'_, <M as Module>::Ports>) + Send;
type OnResult<A, M> = dyn FnMut(&mut M, GoalId, Result<GoalResult<A>, CallError>, &mut Context<'_, <M as Module>::Ports>)
    + Send;
type OnCancel<M> =
    dyn FnMut(&mut M, Result<CancelGoalResponse, CallError>, &mut Context<'_, <M as Module>::Ports>) + Send;

/// The declaration that a module uses an action; created by [`ActionClient::builder`].
#[must_use = "an action can be used when this is declared"]
pub struct ClientBuilder<A: Action, M: Module> {
    access: fn(&mut M) -> &mut ActionClient<A>,
    on_response: Box<OnResponse<M>>,
    on_feedback: Box<OnFeedback<A, M>>,
    on_result: Box<OnResult<A, M>>,
    on_cancel: Box<OnCancel<M>>,
    timeout: Duration,
    result_timeout: Duration,
}

impl<A: Action, M: Module> ClientBuilder<A, M> {
    fn new(access: fn(&mut M) -> &mut ActionClient<A>) -> Self {
        Self {
            access,
            on_response: Box::new(|_, _, _, _| ()),
            on_feedback: Box::new(|_, _, _, _| ()),
            on_result: Box::new(|_, _, _, _| ()),
            on_cancel: Box::new(|_, _, _| ()),
            timeout: ActionClient::<A>::TIMEOUT,
            result_timeout: Duration::MAX,
        }
    }

    /// Sets the callback that is called once for each goal, with the time of acceptance or the reason why it
    /// is not pursued.
    pub fn on_response(
        mut self,
        take: impl FnMut(&mut M, GoalId, Result<Time, GoalRefused>, &mut Context<'_, M::Ports>) + Send + 'static,
    ) -> Self {
        self.on_response = Box::new(take);
        self
    }

    /// Sets the callback for feedback to goals of this client.
    pub fn on_feedback(
        mut self,
        take: impl FnMut(&mut M, GoalId, &A::Feedback, &mut Context<'_, M::Ports>) + Send + 'static,
    ) -> Self {
        self.on_feedback = Box::new(take);
        self
    }

    /// Sets the callback that is called once for each accepted goal, with its result or the reason why that
    /// is unknown.
    pub fn on_result(
        mut self,
        take: impl FnMut(&mut M, GoalId, Result<GoalResult<A>, CallError>, &mut Context<'_, M::Ports>)
        + Send
        + 'static,
    ) -> Self {
        self.on_result = Box::new(take);
        self
    }

    /// Sets the callback for the answers to cancel requests.
    pub fn on_cancel(
        mut self,
        take: impl FnMut(&mut M, Result<CancelGoalResponse, CallError>, &mut Context<'_, M::Ports>)
        + Send
        + 'static,
    ) -> Self {
        self.on_cancel = Box::new(take);
        self
    }

    /// How long the server may take to accept or cancel a goal; by default [`ActionClient::TIMEOUT`].
    pub fn timeout(mut self, timeout: Duration) -> Self {
        self.timeout = timeout;
        self
    }

    /// How long a goal may take from its acceptance to its end before the client gives up; by default
    /// forever.
    pub fn result_timeout(mut self, timeout: Duration) -> Self {
        self.result_timeout = timeout;
        self
    }

    /// Declares the calls of the action's three services and the subscriptions to its two topics, in the
    /// module's setup; `client` must be the one returned by `access`. A module may have only one client of an
    /// action: two would create the same ids.
    ///
    /// Remapping the action applies to all of them.
    ///
    /// # Errors
    /// Returns an error if the name is invalid, or the action has another type.
    pub fn declare(
        self,
        setup: &mut Setup<'_, M>,
        action: &str,
        client: &mut ActionClient<A>,
    ) -> Result<(), SetupError> {
        let Self { access, timeout, result_timeout, .. } = self;
        let (mut on_response, mut on_feedback) = (self.on_response, self.on_feedback);
        let (mut on_result, mut on_cancel) = (self.on_result, self.on_cancel);
        let action = setup.remapped(action);
        let send_goal = setup.client(
            &part(&action, "send_goal"),
            timeout,
            move |module, reply: Reply<SendGoalResponse<A>>, ctx| {
                let answer = reply.result.map(|response| {
                    let (accepted, stamp) = A::acceptance_of(response);
                    (accepted, Time::from_nanos(stamp.as_nanos()))
                });
                if let Some((id, response)) = access(module).answered(ctx, reply.call, answer) {
                    on_response(module, id, response, ctx);
                }
            },
        )?;
        let cancel_goal = setup.client(
            &part(&action, "cancel_goal"),
            timeout,
            move |module, reply: Reply<CancelGoalResponse>, ctx| on_cancel(module, reply.result, ctx),
        )?;
        // Before the results, so that callbacks receive results after feedback.
        setup.subscribe(
            &part(&action, "status"),
            move |module, statuses: Received<'_, GoalStatusArray>, _| access(module).take_status(&statuses),
        )?;
        setup.subscribe(
            &part(&action, "feedback"),
            move |module, message: Received<'_, A::FeedbackMessage>, ctx| {
                let (id, feedback) = A::feedback_of(&message);
                if access(module).is_ours(id.into()) {
                    on_feedback(module, id.into(), feedback, ctx);
                }
            },
        )?;
        let get_result = setup.client(
            &part(&action, "get_result"),
            result_timeout,
            move |module, reply: Reply<GetResultResponse<A>>, ctx| {
                let answer = reply.result.map(A::result_of);
                if let Some(Ended { id, result }) = access(module).ended(reply.call, answer) {
                    on_result(module, id, result, ctx);
                }
            },
        )?;
        client.declare(&action, ClientKeys { send_goal, get_result, cancel_goal });
        Ok(())
    }
}
