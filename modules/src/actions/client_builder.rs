//! How a module declares that it uses an action.

use super::client::Ended;
use super::{
    ActionClient, GetResultRequest, GetResultResponse, GoalId, GoalRefused, GoalResult, SendGoalRequest,
    SendGoalResponse, part,
};
use downbeat_executor::{CallError, Client, Context, Module, Received, Reply, Setup, SetupError, Time};
use downbeat_msgs::Action;
use downbeat_msgs::action_msgs::msg::GoalStatusArray;
use downbeat_msgs::action_msgs::srv::{CancelGoalRequest, CancelGoalResponse};
use std::time::Duration;

pub(super) struct ClientKeys<A: Action> {
    pub(super) send_goal: Client<SendGoalRequest<A>, SendGoalResponse<A>>,
    pub(super) get_result: Client<GetResultRequest<A>, GetResultResponse<A>>,
    pub(super) cancel_goal: Client<CancelGoalRequest, CancelGoalResponse>,
}

type OnResponse<M> =
    dyn FnMut(&mut M, GoalId, Result<Time, GoalRefused>, &mut Context<'_, <M as Module>::Ports>) + Send;
type OnFeedback<A, M> =
    dyn FnMut(&mut M, GoalId, &<A as Action>::Feedback, &mut Context<'_, <M as Module>::Ports>) + Send;
type OnResult<A, M> = dyn FnMut(&mut M, GoalId, Result<GoalResult<A>, CallError>, &mut Context<'_, <M as Module>::Ports>)
    + Send;
type OnCancel<M> =
    dyn FnMut(&mut M, Result<CancelGoalResponse, CallError>, &mut Context<'_, <M as Module>::Ports>) + Send;

/// A declaration that a module uses an action; from [`ActionClient::builder`].
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
    pub(super) fn new(access: fn(&mut M) -> &mut ActionClient<A>) -> Self {
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

    /// Is called once for each goal: with the time at which it was accepted, or with why it is not pursued.
    pub fn on_response(
        mut self,
        take: impl FnMut(&mut M, GoalId, Result<Time, GoalRefused>, &mut Context<'_, M::Ports>) + Send + 'static,
    ) -> Self {
        self.on_response = Box::new(take);
        self
    }

    /// Is called with the feedback to goals that this client has sent.
    pub fn on_feedback(
        mut self,
        take: impl FnMut(&mut M, GoalId, &A::Feedback, &mut Context<'_, M::Ports>) + Send + 'static,
    ) -> Self {
        self.on_feedback = Box::new(take);
        self
    }

    /// Is called once for each goal that was accepted: with its end, or with why that is not known.
    pub fn on_result(
        mut self,
        take: impl FnMut(&mut M, GoalId, Result<GoalResult<A>, CallError>, &mut Context<'_, M::Ports>)
        + Send
        + 'static,
    ) -> Self {
        self.on_result = Box::new(take);
        self
    }

    /// Is called with the answer to each request to cancel.
    pub fn on_cancel(
        mut self,
        take: impl FnMut(&mut M, Result<CancelGoalResponse, CallError>, &mut Context<'_, M::Ports>)
        + Send
        + 'static,
    ) -> Self {
        self.on_cancel = Box::new(take);
        self
    }

    /// How long the server may take to say whether it takes a goal or cancels one; [`ActionClient::TIMEOUT`] unless given.
    pub fn timeout(mut self, timeout: Duration) -> Self {
        self.timeout = timeout;
        self
    }

    /// How long a goal may take from its acceptance to its end, after which its client gives it up; for ever unless given.
    pub fn result_timeout(mut self, timeout: Duration) -> Self {
        self.result_timeout = timeout;
        self
    }

    /// Declares that the module calls the three services of the action and hears its two topics, in the module's setup;
    /// `client` is what `access` leads to. A module has one client of an action: two would make the same ids.
    ///
    /// A name that the module was given for the action holds for all of them.
    ///
    /// # Errors
    /// A name that is not valid, or an action of another type.
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
        // Before the results, which come to the callbacks after them.
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
